//! The two halves of a link.

use core::convert::Infallible;

use embassy_sync::blocking_mutex::raw::RawMutex;
use embedded_io_async::{Read, Write};
use wimu_link::message::{Command, EncodedParameters};
use wimu_link::responder::Decision;
use wimu_link::{Deframer, Kind, LinkRole};
use wimu_model::DeviceTimeUs;

use crate::queue::PIECE;
use crate::shared::Shared;
use crate::slot::Slot;
use crate::timer::Timer;

/// A host that asks who is there more often has been answered.
const INTRODUCED_US: u64 = 250_000;

/// Sends what waits for one link.
pub struct LinkWriter<'a, W, M: RawMutex> {
    pub(crate) role: LinkRole,
    pub(crate) line: W,
    pub(crate) shared: &'a Shared<M>,
}

impl<W: Write, M: RawMutex> LinkWriter<'_, W, M> {
    /// Runs for ever. A line that fails loses the frame that was under way; the next goes out.
    pub async fn run(&mut self) -> ! {
        let mut piece = [0; PIECE];
        // Ends whatever was under way when the device lost its power.
        let _ = self.line.write_all(&[0]).await;
        loop {
            let (length, ended) = self.shared.next_piece(self.role, &mut piece).await;
            let piece = piece.get(..length).unwrap_or_default();
            if self.line.write_all(piece).await.is_err() {
                embassy_futures::yield_now().await;
            }
            if ended {
                let _ = self.line.flush().await;
                self.shared.frame_sent(self.role);
            }
        }
    }
}

/// Receives what hosts say on one link: answers who it is, hands requests to the control.
pub struct LinkReader<'a, R, T, M: RawMutex> {
    pub(crate) role: LinkRole,
    pub(crate) line: R,
    pub(crate) timer: T,
    pub(crate) shared: &'a Shared<M>,
}

impl<R: Read, T: Timer, M: RawMutex> LinkReader<'_, R, T, M> {
    /// Runs for ever. The line's `read` must be cancel-safe: bytes are taken or left, never lost.
    pub async fn run(&mut self) -> ! {
        let mut deframer = Deframer::new();
        let mut bytes = [0; 64];
        let mut introduced: Option<DeviceTimeUs> = None;
        loop {
            let read = match self.line.read(&mut bytes).await {
                Ok(read) if read > 0 => read,
                // A line that ended or failed may come back; do not spin meanwhile.
                _ => {
                    self.shared.rate_signals(self.role).noise.signal(());
                    self.timer.after_us(10_000).await;
                    continue;
                }
            };
            let mut heard = false;
            for &byte in bytes.get(..read).unwrap_or_default() {
                let Some(received) = deframer.push(byte) else {
                    continue;
                };
                match received {
                    Ok(frame) if frame.kind == Kind::WhoAreYou => {
                        heard = true;
                        // One that asks without end gets samples in between.
                        let now = self.timer.now();
                        if introduced
                            .is_none_or(|last| now.0.saturating_sub(last.0) >= INTRODUCED_US)
                        {
                            introduced = Some(now);
                            self.shared.introduce(self.role, now);
                        }
                    }
                    Ok(frame) if frame.kind == Kind::Request => {
                        heard = true;
                        let Some(command) = self.accept(frame.body).await else {
                            continue;
                        };
                        if let Command::StageParameters(set) = command {
                            let mut desk = self.shared.desk.lock().await;
                            desk.set.put(Some(set));
                            desk.from = Slot::Full(self.role);
                            desk.id = None;
                        }
                        // The set lies on the desk.
                        let Ok(command) = command.try_map(|_| Ok::<_, Infallible>(()));
                        self.shared.requests.send((self.role, command)).await;
                    }
                    // Frames that a device sends, looped back.
                    Ok(_) => {}
                    Err(_) => self.count_damaged(),
                }
            }
            let signals = self.shared.rate_signals(self.role);
            match heard {
                true => signals.heard.signal(()),
                false => signals.noise.signal(()),
            }
        }
    }

    /// A command to carry out; anything else is answered here.
    async fn accept<'b>(&self, request: &'b [u8]) -> Option<Command<EncodedParameters<'b>>> {
        let lock = self.shared.lock();
        let mut responder = self.shared.responder(self.role).await;
        let command = match responder.accept_at(request, &lock, self.timer.now().0) {
            Decision::Execute(command) => Some(command),
            // One that finds no room is asked for again.
            Decision::Send(answer) => {
                self.shared.keep_if_room(self.role, answer);
                None
            }
            Decision::Ignore => None,
        };
        let repeated = responder.repeated();
        self.shared
            .with_heard(self.role, |heard| heard.repeated = repeated);
        command
    }

    fn count_damaged(&self) {
        self.shared.with_heard(self.role, |heard| {
            heard.damaged = heard.damaged.wrapping_add(1);
        });
    }
}
