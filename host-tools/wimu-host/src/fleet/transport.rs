//! `mqtt://HOST/FLEET/BOARD` as a LINK.

use std::sync::mpsc::{self, Receiver, RecvTimeoutError};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use super::commands::{self, CommandFault};
use super::lock;
use super::mqtt::{Heard, Mqtt, MqttConfig};
use super::session::Follower;
use super::status::FleetStatus;
use super::topics::{Broker, Content, Name, all_gateways, topic};
use crate::transport::{Transport, now};
use crate::{Code, Problem, Result};

/// Longest wait for the board's state.
const PATIENCE: Duration = Duration::from_secs(2);
const GLANCE: Duration = Duration::from_millis(10);
/// Time after which a link whose broker, gateway or board is away counts as lost. Shorter absences are gaps.
const LOST_AFTER: Duration = Duration::from_secs(10);
/// Pieces that wait for their reader; beyond, they are dropped, which the sequence numbers show.
const PIECES: usize = 1 << 14;

/// What the connection's thread has found.
#[derive(Default)]
struct Known {
    status: FleetStatus,
    follower: Follower,
    /// When a batch last arrived.
    heard: Option<Duration>,
}

/// A board behind a gateway and a broker.
pub(crate) struct MqttLink {
    name: String,
    board: Name,
    down: String,
    mqtt: Mqtt,
    known: Arc<Mutex<Known>>,
    pieces: Receiver<(u64, Vec<u8>)>,
    /// The piece that is being read, and how much of it was.
    piece: (u64, Vec<u8>),
    used: usize,
    opened: Duration,
}

/// Opens the link to a board through a broker.
///
/// # Errors
/// `link_refused` without a broker; `link_absent` when it knows no such board, or when the board or its gateway is away.
pub fn open(
    name: &str,
    broker: &Broker,
    fleet: &Name,
    board: &Name,
) -> Result<impl Transport + Send + use<>> {
    let known = Arc::new(Mutex::new(Known::default()));
    let (sender, pieces) = mpsc::sync_channel(PIECES);
    let (shared, of_fleet) = (known.clone(), fleet.clone());
    let up = topic(fleet, board, Content::Up);
    let state = topic(fleet, board, Content::State);
    let filters = vec![state, all_gateways(fleet), up.clone()];
    let mqtt = Mqtt::start(MqttConfig::new(broker, filters), move |heard| {
        let Heard::Message { topic, payload, .. } = heard else {
            return;
        };
        let mut known = lock(&shared);
        if topic != up {
            return known.status.take(&of_fleet, topic, payload);
        }
        if let Some(pieces) = known.follower.take(now(), payload) {
            known.heard = Some(now());
            for piece in pieces {
                let _ = sender.try_send(piece);
            }
        }
    })?;
    mqtt.wait_connected()?;
    let link = MqttLink {
        name: name.to_owned(),
        board: board.clone(),
        down: topic(fleet, board, Content::Down),
        mqtt,
        known,
        pieces,
        piece: (0, Vec::new()),
        used: 0,
        opened: now(),
    };
    while let Some(why) = link.away() {
        if now() >= link.opened + PATIENCE {
            let remedy = "`wimu fleet status` lists the boards; check the names, that `wimu fleet gateway` runs, and the board's link there";
            return Err(Code::LinkAbsent.error(why, remedy).at(name));
        }
        std::thread::sleep(GLANCE);
    }
    Ok(link)
}

impl MqttLink {
    /// Why the board is away: it is not while its batches arrive, whatever its state says.
    fn away(&self) -> Option<String> {
        let known = lock(&self.known);
        if known.heard.is_some_and(|heard| now() < heard + LOST_AFTER) {
            None
        } else if !self.mqtt.is_connected() {
            Some("the broker is away".to_owned())
        } else if let Some(state) = known.status.boards.get(self.board.as_str()) {
            known.status.why_away(state)
        } else {
            Some(format!("no gateway has reported a board `{}`", self.board))
        }
    }
}

impl Transport for MqttLink {
    fn read(&mut self, buffer: &mut [u8], timeout: Duration) -> Result<usize> {
        if self.used == self.piece.1.len() {
            let timeout = timeout.max(Duration::from_millis(1));
            match self.pieces.recv_timeout(timeout) {
                Ok(piece) => (self.piece, self.used) = (piece, 0),
                Err(RecvTimeoutError::Timeout) => {
                    let lost = self.away().filter(|_| now() >= self.opened + LOST_AFTER);
                    return lost.map_or(Ok(0), |why| Err(self.lost(why)));
                }
                Err(RecvTimeoutError::Disconnected) => {
                    return Err(self.lost("the connection has ended".to_owned()));
                }
            }
        }
        let rest = &self.piece.1[self.used..];
        let count = rest.len().min(buffer.len());
        buffer[..count].copy_from_slice(&rest[..count]);
        self.used += count;
        Ok(count)
    }

    /// Requests are dropped while the broker is away: whoever waits for the answer repeats them.
    fn write_all(&mut self, bytes: &[u8]) -> Result<()> {
        let (message, remedy) = match commands::check(bytes) {
            Ok(_) => {
                self.mqtt.publish(self.down.clone(), bytes.to_vec());
                return Ok(());
            }
            Err(CommandFault::Unsigned) => (
                "through a broker a board is only changed by signed commands",
                "set a key with `wimu device key set` on a cable of this computer to the board",
            ),
            Err(CommandFault::Key) => ("keys do not pass a broker", "connect a cable to the board"),
            Err(CommandFault::NotRequests) => {
                ("this does not pass a broker", "connect to the board itself")
            }
        };
        Err(Code::NotThroughBroker.error(message, remedy).at(&self.name))
    }

    fn received_at(&self) -> Duration {
        Duration::from_nanos(self.piece.0)
    }
}

impl MqttLink {
    fn lost(&self, why: String) -> Problem {
        Code::LinkLost.error(why, "check broker and gateway, then connect again").at(&self.name)
    }
}
