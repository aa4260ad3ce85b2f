//! The gateway: many boards, one connection to the broker.

use std::collections::HashMap;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::mpsc::{self, Receiver, SyncSender};
use std::sync::{Arc, Mutex, OnceLock};
use std::thread::{self, JoinHandle};

use super::bridge::{Bridge, Shown};
use super::commands::MAX_COMMAND;
use super::config::GatewayConfig;
use super::lock;
use super::metrics;
use super::mqtt::{Figures, Heard, Mqtt, MqttConfig};
use super::state::{self, BoardState, GatewayState};
use super::topics::{Content, Name, all_boards, board_of, gateway_topic};
use crate::mcap_file::ClockAnchor;
use crate::serve::Server;
use crate::transport::now;
use crate::{Problem, Result};

/// Stack of a board's thread, bytes; only pages that are used take memory.
const STACK: usize = 512 << 10;
/// Commands that wait for a board; beyond, they are dropped and counted.
const COMMANDS: usize = 32;
/// Notes that wait for their reader.
const NOTES: usize = 1024;

/// What all threads of a gateway use.
pub(crate) struct Shared {
    pub config: GatewayConfig,
    /// Number of this run; later ones are greater.
    pub session: u64,
    pub anchor: ClockAnchor,
    stop: AtomicBool,
    mqtt: OnceLock<Mqtt>,
    notes: Mutex<SyncSender<String>>,
    /// States of boards of this gateway that another one has published.
    pub conflicts: AtomicU64,
    /// Commands that found too many before them.
    pub crowded: AtomicU64,
}

impl Shared {
    pub fn stopped(&self) -> bool {
        self.stop.load(Ordering::Relaxed)
    }

    /// UTC of a time on this host's monotonic clock, ns: it never jumps.
    pub fn utc_ns(&self, host_ns: u64) -> u64 {
        self.anchor.to_utc_ns(host_ns)
    }

    /// The same in s.
    pub fn utc_s(&self, host_ns: u64) -> f64 {
        self.utc_ns(host_ns) as f64 * 1e-9
    }

    /// Topic and message of the gateway's state.
    fn state(&self, alive: bool) -> (String, Vec<u8>) {
        let config = &self.config;
        let state = GatewayState { alive, ..GatewayState::new(self.session, config.boards.len()) };
        let topic = gateway_topic(&config.fleet, &config.gateway);
        (topic, state::message(&state))
    }

    fn announce(&self, alive: bool) {
        let (topic, message) = self.state(alive);
        self.mqtt().retain(topic, message);
    }

    /// The connection to the broker.
    pub fn mqtt(&self) -> &Mqtt {
        self.mqtt.wait()
    }

    /// A line for people; dropped without a reader.
    pub fn note(&self, text: String) {
        let _ = lock(&self.notes).try_send(text);
    }
}

/// A running gateway.
pub struct Gateway {
    shared: Arc<Shared>,
    boards: Arc<Boards>,
    threads: Vec<JoinHandle<()>>,
    notes: Receiver<String>,
    metrics: Option<Server>,
}

/// The boards of a gateway.
pub(crate) type Boards = Vec<(Name, Arc<Shown>)>;

/// Sums over the boards of a gateway, and its figures.
#[derive(Clone, Copy, Debug, Default, PartialEq, serde::Serialize)]
#[non_exhaustive]
pub struct GatewaySummary {
    /// Boards in the configuration.
    pub boards: usize,
    /// Boards that are connected.
    pub alive: usize,
    /// The connection to the broker.
    #[serde(flatten)]
    pub mqtt: Figures,
    /// Raw samples received.
    pub samples: u64,
    /// Raw samples missing.
    pub missing: u64,
    /// Bytes received.
    pub bytes: u64,
    /// Bytes that could not be recorded.
    pub unrecorded_bytes: u64,
    /// Commands dropped because too many waited for a board.
    pub crowded: u64,
    /// States of boards of this gateway that another one has published.
    pub conflicts: u64,
}

impl GatewaySummary {
    pub(crate) fn of(shared: &Shared, boards: &Boards) -> Self {
        let mut sum = Self {
            boards: boards.len(),
            mqtt: shared.mqtt().figures(),
            crowded: shared.crowded.load(Ordering::Relaxed),
            conflicts: shared.conflicts.load(Ordering::Relaxed),
            ..Self::default()
        };
        for (_, shown) in boards {
            let state = lock(shown);
            sum.alive += usize::from(state.alive);
            sum.samples += state.samples;
            sum.missing += state.missing;
            sum.bytes += state.bytes;
            sum.unrecorded_bytes += state.unrecorded_bytes;
        }
        sum
    }
}

impl Gateway {
    /// Starts a gateway.
    ///
    /// # Errors
    /// Those of [`Mqtt::start`]; `file_failed` when the recordings cannot be written, `link_busy` when the metrics' address
    /// is in use. An absent broker or board is tried again.
    pub fn start(config: GatewayConfig) -> Result<Self> {
        let anchor = ClockAnchor::now(now());
        let (note, notes) = mpsc::sync_channel(NOTES);
        let shared = Arc::new(Shared {
            session: anchor.utc_ns,
            anchor,
            config,
            stop: AtomicBool::new(false),
            mqtt: OnceLock::new(),
            notes: Mutex::new(note),
            conflicts: AtomicU64::new(0),
            crowded: AtomicU64::new(0),
        });
        let config = &shared.config;
        let mut heard = HashMap::new();
        let mut boards = Vec::new();
        let mut bridges = Vec::new();
        for (name, link) in &config.boards {
            if let Some(folder) = &config.recordings {
                let folder = folder.join(name.as_str());
                let failed = |error| Problem::file(&folder.display().to_string(), "create", &error);
                std::fs::create_dir_all(&folder).map_err(failed)?;
            }
            let (down, commands) = mpsc::sync_channel(COMMANDS);
            let shown =
                Arc::new(Shown::new(BoardState::new(config.gateway.as_str(), shared.session)));
            heard.insert(name.clone(), (down, shown.clone()));
            boards.push((name.clone(), shown.clone()));
            bridges.push(Bridge::new(name.clone(), link.clone(), shared.clone(), shown, commands));
        }
        let will = shared.state(false);
        let mut subscriber = Subscriber { shared: shared.clone(), boards: heard, lost: false };
        let subscriptions = vec![
            all_boards(&config.fleet, Content::Down),
            all_boards(&config.fleet, Content::State),
            will.0.clone(),
        ];
        let connection = MqttConfig {
            will: Some(will),
            spool: Some((config.spool.clone(), config.spool_bytes)),
            ..MqttConfig::new(&config.broker, subscriptions)
        };
        let mqtt = Mqtt::start(connection, move |message| subscriber.hear(message))?;
        let _ = shared.mqtt.set(mqtt);
        let boards = Arc::new(boards);
        let metrics = |address| metrics::serve(address, shared.clone(), boards.clone());
        let metrics = config.metrics.map(metrics).transpose()?;
        shared.announce(true);
        let mut threads = Vec::new();
        for bridge in bridges {
            let builder = thread::Builder::new().name(bridge.name.to_string()).stack_size(STACK);
            let thread = builder.spawn(|| bridge.run());
            threads
                .push(thread.map_err(|error| Problem::file("a board's thread", "start", &error))?);
        }
        Ok(Self { shared, boards, threads, notes, metrics })
    }

    /// Lines for people since the last call: what was lost and came back.
    pub fn notes(&self) -> impl Iterator<Item = String> + '_ {
        self.notes.try_iter()
    }

    /// Address of the metrics.
    pub fn metrics(&self) -> Option<std::net::SocketAddr> {
        self.metrics.as_ref().map(Server::address)
    }

    /// Sums and figures.
    pub fn summary(&self) -> GatewaySummary {
        GatewaySummary::of(&self.shared, &self.boards)
    }

    /// Stops: closes the recordings, publishes the death, stores what waits for the broker. Returns the sums.
    pub fn stop(mut self) -> GatewaySummary {
        self.shared.stop.store(true, Ordering::Relaxed);
        for thread in self.threads.drain(..) {
            let _ = thread.join();
        }
        self.shared.announce(false);
        let broker = self.shared.mqtt().is_connected();
        self.shared.mqtt().stop();
        let mut summary = self.summary();
        summary.mqtt.broker = broker;
        summary
    }
}

/// Receiver of the broker's messages: commands for the boards, and other gateways with the same name or boards.
struct Subscriber {
    shared: Arc<Shared>,
    boards: HashMap<Name, (SyncSender<Vec<u8>>, Arc<Shown>)>,
    lost: bool,
}

impl Subscriber {
    fn hear(&mut self, heard: Heard) {
        let shared = &self.shared;
        match heard {
            Heard::Connected => {
                self.lost = false;
                shared.note(format!("connected to {}", shared.config.broker));
            }
            Heard::Lost(reason) => {
                if !std::mem::replace(&mut self.lost, true) {
                    shared.note(format!(
                        "{}: {reason}; data are stored until it is connected",
                        shared.config.broker
                    ));
                }
            }
            Heard::Message { topic, payload, retained } => {
                let fleet = &shared.config.fleet;
                if let Some(board) = board_of(topic, fleet, Content::Down) {
                    // A retained command is old, one that is too long is refused.
                    let command = &payload[..payload.len().min(MAX_COMMAND + 1)];
                    if let Some((down, _)) = self.boards.get(&board).filter(|_| !retained)
                        && down.try_send(command.to_vec()).is_err()
                    {
                        shared.crowded.fetch_add(1, Ordering::Relaxed);
                    }
                } else if let Some(board) = board_of(topic, fleet, Content::State) {
                    if !retained {
                        self.board(topic, &board, &BoardState::read(payload).unwrap_or_default());
                    }
                } else {
                    self.gateway(&GatewayState::read(payload).unwrap_or_default(), retained);
                }
            }
        }
    }

    fn board(&self, topic: &str, board: &Name, state: &BoardState) {
        let Some((_, shown)) = self.boards.get(board) else {
            return;
        };
        let (shared, ours) = (&self.shared, lock(shown).clone());
        if state.session == ours.session {
            return;
        }
        if state.alive {
            shared.conflicts.fetch_add(1, Ordering::Relaxed);
            shared.note(format!(
                "{board}: gateway `{}` serves it, too: remove it from one of them",
                state.gateway
            ));
        } else if ours.alive {
            // Another gateway does not reach the board, or someone has removed its state.
            shared.mqtt().retain(topic.to_owned(), state::message(&ours));
        }
    }

    fn gateway(&self, state: &GatewayState, retained: bool) {
        let shared = &self.shared;
        let is_ours = state.session == format!("{:016x}", shared.session);
        if !state.alive && (is_ours || !retained) && !shared.stopped() {
            // The will of an earlier connection, the end of another gateway of this name, or no state.
            shared.announce(true);
        } else if state.alive && !is_ours && !retained {
            shared.note(format!(
                "another gateway is named `{}`, too: rename one of them",
                shared.config.gateway
            ));
        }
    }
}
