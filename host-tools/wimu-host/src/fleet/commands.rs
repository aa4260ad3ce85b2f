//! What a gateway forwards from the broker to a board.

use wimu_link::message::Signature;
use wimu_link::{Command, Deframer, Kind, Request};

/// Longest message of requests, bytes: a few frames.
pub const MAX_COMMAND: usize = 4096;

/// What a message asks for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Asks {
    /// The time only: the answer may wait for the next batch.
    Time,
    /// Something that a client waits for.
    Answer,
}

/// Why a message is not forwarded.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CommandFault {
    /// It is empty, too long, or not whole frames of requests.
    NotRequests,
    /// It changes the board and is not signed.
    Unsigned,
    /// It carries or erases a key, which only a cable may.
    Key,
}

/// Whether a message may be forwarded: whole frames, reads or signed writes, no keys. The signature is verified by the
/// board alone.
///
/// # Errors
/// Why not; nothing of it is forwarded then.
pub fn check(message: &[u8]) -> Result<Asks, CommandFault> {
    if message.len() > MAX_COMMAND || message.last() != Some(&0) {
        return Err(CommandFault::NotRequests);
    }
    let mut deframer = Deframer::new();
    let mut asks = None;
    for &byte in message {
        let Some(frame) = deframer.push(byte) else {
            continue;
        };
        let frame = frame.map_err(|_| CommandFault::NotRequests)?;
        let one = match frame.kind {
            Kind::WhoAreYou => Asks::Answer,
            Kind::Request => {
                let request = Request::decode(frame.body).map_err(|_| CommandFault::NotRequests)?;
                match request.command {
                    Command::SetKey(_) | Command::ForgetKey => return Err(CommandFault::Key),
                    command if command.is_write() && request.signature == Signature::NONE => {
                        return Err(CommandFault::Unsigned);
                    }
                    Command::GetTime => Asks::Time,
                    _ => Asks::Answer,
                }
            }
            _ => return Err(CommandFault::NotRequests),
        };
        asks = Some(if asks == Some(Asks::Answer) { Asks::Answer } else { one });
    }
    asks.ok_or(CommandFault::NotRequests)
}
