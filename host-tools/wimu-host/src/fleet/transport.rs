//! `mqtt://HOST/FLEET/BOARD` as a LINK.

use std::sync::mpsc::{self, Receiver, RecvTimeoutError, TrySendError};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use super::commands::{self, CommandFault};
use super::mqtt::{Heard, Mqtt, MqttConfig};
use super::session::Follower;
use super::state::{BoardState, GatewayState};
use super::topics::{Broker, Content, Name, all_gateways, board_of, topic};
use crate::transport::{Transport, now};
use crate::{ErrorCode, HostError, Result};

/// Longest wait for the broker, and then for the board's state.
const PATIENCE: Duration = Duration::from_secs(5);
const STATE_PATIENCE: Duration = Duration::from_secs(2);
/// Time after which a link whose broker, gateway or board is away counts as lost. Shorter absences are gaps.
const LOST_AFTER: Duration = Duration::from_secs(10);
/// Pieces that wait for their reader; beyond, they are dropped, which the sequence numbers show.
const PIECES: usize = 1 << 14;

/// What the connection's thread has found.
#[derive(Default)]
struct Known {
    connected: bool,
    reason: String,
    state: Option<BoardState>,
    /// Session of the latest gateway that died.
    dead: Option<String>,
    follower: Follower,
    /// Pieces dropped because too many waited.
    dropped: u64,
    /// When a batch last arrived.
    heard: Duration,
}

/// A board behind a gateway and a broker.
pub(crate) struct MqttLink {
    name: String,
    down: String,
    mqtt: Mqtt,
    known: Arc<Mutex<Known>>,
    pieces: Receiver<(u64, Vec<u8>)>,
    /// The piece that is being read, and how much of it was.
    piece: (u64, Vec<u8>),
    used: usize,
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
    let known = Arc::new(Mutex::new(Known {
        heard: now(),
        ..Known::default()
    }));
    let (sender, pieces) = mpsc::sync_channel(PIECES);
    let shared = known.clone();
    let (ours, of_fleet) = (board.clone(), fleet.clone());
    let up = topic(fleet, board, Content::Up);
    let filters = vec![
        topic(fleet, board, Content::State),
        all_gateways(fleet),
        up.clone(),
    ];
    let mqtt = Mqtt::start(MqttConfig::new(broker, filters), move |heard| {
        let mut known = shared.lock().unwrap_or_else(PoisonError::into_inner);
        match heard {
            Heard::Connected => known.connected = true,
            Heard::Lost(reason) => {
                known.connected = false;
                reason.clone_into(&mut known.reason);
            }
            Heard::Message { topic, payload, .. } if topic == up => {
                known.heard = now();
                for piece in known.follower.take(now(), payload) {
                    if let Err(TrySendError::Full(_)) = sender.try_send(piece) {
                        known.dropped += 1;
                    }
                }
            }
            Heard::Message { topic, payload, .. }
                if board_of(topic, &of_fleet, Content::State).is_some_and(|b| b == ours) =>
            {
                if let Some(state) = BoardState::read(payload) {
                    known.state = Some(state);
                }
            }
            Heard::Message { payload, .. } => {
                if let Some(gateway) = GatewayState::read(payload) {
                    match gateway.alive {
                        false => known.dead = Some(gateway.session),
                        true => drop(known.dead.take_if(|dead| *dead == gateway.session)),
                    }
                }
            }
        }
    })?;
    let link = MqttLink {
        name: name.to_owned(),
        down: topic(fleet, board, Content::Down),
        mqtt,
        known,
        pieces,
        piece: (0, Vec::new()),
        used: 0,
    };
    link.wait_for_board(broker, fleet, board)?;
    Ok(link)
}

impl MqttLink {
    fn known<T>(&self, of: impl FnOnce(&Known) -> T) -> T {
        of(&self.known.lock().unwrap_or_else(PoisonError::into_inner))
    }

    fn wait_for_board(&self, broker: &Broker, fleet: &Name, board: &Name) -> Result<()> {
        let glance = Duration::from_millis(10);
        let began = now();
        while !self.known(|known| known.connected) {
            if now() >= began + PATIENCE {
                let reason = self.known(|known| known.reason.clone());
                return Err(ErrorCode::LinkRefused
                    .error(
                        format!("the broker {broker} does not answer: {reason}"),
                        "start it, or check address, user and password",
                    )
                    .at(&self.name));
            }
            std::thread::sleep(glance);
        }
        let connected = now();
        while now() < connected + STATE_PATIENCE {
            if self.known(|known| known.away().is_none() && known.state.is_some()) {
                return Ok(());
            }
            std::thread::sleep(glance);
        }
        Err(match self.known(Known::away) {
            Some(why) => ErrorCode::LinkAbsent.error(why, "start its gateway, or check the board's link there"),
            None => ErrorCode::LinkAbsent.error(
                format!("no gateway has reported a board `{board}` of fleet `{fleet}`"),
                "`wimu fleet status` lists the boards; check the names, and that `wimu gateway` runs",
            ),
        }
        .at(&self.name))
    }
}

impl Known {
    /// Why the board is away.
    fn away(&self) -> Option<String> {
        let state = self.state.as_ref()?;
        if !self.connected {
            Some(format!("the broker is away: {}", self.reason))
        } else if self.dead.as_ref() == Some(&state.session) {
            Some(format!("its gateway `{}` has ended", state.gateway))
        } else if !state.alive {
            let why = state.lost.as_deref().unwrap_or("not reached yet");
            Some(format!(
                "the gateway `{}` does not reach it: {why}",
                state.gateway
            ))
        } else {
            None
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
                    let lost = self
                        .known(|known| known.away().filter(|_| now() >= known.heard + LOST_AFTER));
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
                if self.mqtt.is_connected() {
                    self.mqtt.send(self.down.clone(), bytes.to_vec());
                }
                return Ok(());
            }
            Err(CommandFault::Unsigned) => (
                "through a broker a board is only changed by signed commands",
                "set a key with `wimu key set` on a cable of this computer to the board",
            ),
            Err(CommandFault::Key) => ("keys do not pass a broker", "connect a cable to the board"),
            Err(CommandFault::NotRequests) => {
                ("this does not pass a broker", "connect to the board itself")
            }
        };
        Err(ErrorCode::NotThroughBroker
            .error(message, remedy)
            .at(&self.name))
    }

    fn received_at(&self) -> Duration {
        Duration::from_nanos(self.piece.0)
    }
}

impl MqttLink {
    fn lost(&self, why: String) -> HostError {
        ErrorCode::LinkLost
            .error(why, "check broker and gateway, then connect again")
            .at(&self.name)
    }
}
