//! The gateway: many boards, one connection to the broker.

use std::collections::HashMap;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::mpsc::{self, Receiver, SyncSender};
use std::sync::{Arc, Mutex, OnceLock, PoisonError};
use std::thread::{self, JoinHandle};

use super::bridge::{Bridge, Shown};
use super::config::GatewayConfig;
use super::metrics;
use super::mqtt::{Heard, Mqtt, MqttConfig};
use super::state::{self, BoardState, GatewayState};
use super::topics::{Content, Name, all_boards, board_of, gateway_topic};
use crate::mcap_file::ClockAnchor;
use crate::transport::now;
use crate::{HostError, Result};

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

    /// The connection to the broker.
    pub fn mqtt(&self) -> &Mqtt {
        self.mqtt.wait()
    }

    /// A line for people; dropped without a reader.
    pub fn note(&self, text: String) {
        let _ = self
            .notes
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .try_send(text);
    }
}

/// A running gateway.
pub struct Gateway {
    shared: Arc<Shared>,
    boards: Arc<Boards>,
    threads: Vec<JoinHandle<()>>,
    notes: Receiver<String>,
    metrics: Option<std::net::SocketAddr>,
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
    /// Whether the broker is connected.
    pub broker: bool,
    /// How often it was.
    pub broker_connections: u64,
    /// Raw samples received.
    pub samples: u64,
    /// Raw samples missing.
    pub missing: u64,
    /// Bytes received.
    pub bytes: u64,
    /// Bytes that could not be recorded.
    pub unrecorded_bytes: u64,
    /// Batches that the broker has acknowledged.
    pub acknowledged: u64,
    /// Bytes of these batches and their topics.
    pub acknowledged_bytes: u64,
    /// Batches that wait for the broker.
    pub waiting: u64,
    /// Bytes of the files in which they wait.
    pub spool_bytes: u64,
    /// Batches dropped because too many waited.
    pub dropped: u64,
    /// Messages of the broker that were too long.
    pub too_long: u64,
    /// Commands dropped because too many waited for a board.
    pub crowded: u64,
    /// States of boards of this gateway that another one has published.
    pub conflicts: u64,
}

impl GatewaySummary {
    pub(crate) fn of(shared: &Shared, boards: &Boards) -> Self {
        let counters = shared.mqtt().counters();
        let load = |counter: &AtomicU64| counter.load(Ordering::Relaxed);
        let mut sum = Self {
            boards: boards.len(),
            broker: shared.mqtt().is_connected(),
            broker_connections: load(&counters.connections),
            acknowledged: load(&counters.acknowledged),
            acknowledged_bytes: load(&counters.acknowledged_bytes),
            waiting: load(&counters.waiting),
            spool_bytes: load(&counters.spool_bytes),
            dropped: load(&counters.dropped),
            too_long: load(&counters.too_long),
            crowded: load(&shared.crowded),
            conflicts: load(&shared.conflicts),
            ..Self::default()
        };
        for (_, shown) in boards {
            let state = shown.lock();
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
    /// Those of [`Mqtt::start`]; `link_busy` when the metrics' address is in use. A broker or board that is absent is
    /// none: it is tried again.
    pub fn start(config: GatewayConfig) -> Result<Self> {
        let listener = config.metrics.map(metrics::listen).transpose()?;
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
        let mut downs = HashMap::new();
        let mut boards = Vec::new();
        let mut bridges = Vec::new();
        for (name, link) in &config.boards {
            let (down, commands) = mpsc::sync_channel(COMMANDS);
            let shown = Arc::new(Shown::new(BoardState::new(
                config.gateway.as_str(),
                shared.session,
            )));
            downs.insert(name.clone(), down);
            boards.push((name.clone(), shown.clone()));
            bridges.push(Bridge::new(
                name.clone(),
                link.clone(),
                shared.clone(),
                shown,
                commands,
            ));
        }
        let (topic, alive, dead) = births(&shared);
        let mqtt = Mqtt::start(
            MqttConfig {
                will: Some((topic.clone(), dead)),
                spool: config.spool.clone(),
                spool_bytes: config.spool_bytes,
                ..MqttConfig::new(
                    &config.broker,
                    vec![
                        all_boards(&config.fleet, Content::Down),
                        all_boards(&config.fleet, Content::State),
                        topic.clone(),
                    ],
                )
            },
            ear(shared.clone(), downs),
        )?;
        mqtt.retain(topic, alive);
        let _ = shared.mqtt.set(mqtt);
        let boards = Arc::new(boards);
        let metrics = listener
            .as_ref()
            .and_then(|listener| listener.local_addr().ok());
        let mut threads = Vec::new();
        if let Some(listener) = listener {
            let (shared, boards) = (shared.clone(), boards.clone());
            threads.push(thread::spawn(move || {
                metrics::serve(&listener, &shared, &boards)
            }));
        }
        for bridge in bridges {
            let builder = thread::Builder::new()
                .name(bridge.name.to_string())
                .stack_size(STACK);
            let thread = builder.spawn(|| bridge.run());
            threads.push(
                thread.map_err(|error| HostError::file("a board's thread", "start", &error))?,
            );
        }
        Ok(Self {
            shared,
            boards,
            threads,
            notes,
            metrics,
        })
    }

    /// Lines for people since the last call: what was lost and came back.
    pub fn notes(&self) -> impl Iterator<Item = String> + '_ {
        self.notes.try_iter()
    }

    /// Address of the metrics.
    pub fn metrics(&self) -> Option<std::net::SocketAddr> {
        self.metrics
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
        let (topic, _, dead) = births(&self.shared);
        self.shared.mqtt().retain(topic, dead);
        let broker = self.shared.mqtt().is_connected();
        self.shared.mqtt().stop();
        GatewaySummary {
            broker,
            ..self.summary()
        }
    }
}

/// The gateway's topic, and its states alive and dead.
fn births(shared: &Shared) -> (String, Vec<u8>, Vec<u8>) {
    let config = &shared.config;
    let alive = GatewayState::new(shared.session, config.boards.len());
    let dead = GatewayState {
        alive: false,
        ..alive.clone()
    };
    (
        gateway_topic(&config.fleet, &config.gateway),
        state::message(&alive),
        state::message(&dead),
    )
}

/// Passes commands to the boards, and finds other gateways with the same boards.
fn ear(
    shared: Arc<Shared>,
    downs: HashMap<Name, SyncSender<Vec<u8>>>,
) -> impl FnMut(Heard) + Send + 'static {
    let mut connected = None;
    move |heard| match heard {
        Heard::Connected => {
            connected = Some(true);
            shared.note(format!("connected to {}", shared.config.broker));
        }
        Heard::Lost(reason) => {
            if connected.replace(false) != Some(false) {
                shared.note(format!(
                    "{}: {reason}; data are stored until it is back",
                    shared.config.broker
                ));
            }
        }
        Heard::Message {
            topic,
            payload,
            retained,
        } => {
            let fleet = &shared.config.fleet;
            if let Some(board) = board_of(topic, fleet, Content::Down) {
                // A retained command is old.
                if let Some(down) = downs.get(&board).filter(|_| !retained)
                    && down.try_send(payload.to_vec()).is_err()
                {
                    shared.crowded.fetch_add(1, Ordering::Relaxed);
                }
            } else if let Some(board) = board_of(topic, fleet, Content::State) {
                let ours = format!("{:016x}", shared.session);
                if let Some(state) =
                    BoardState::read(payload).filter(|_| !retained && downs.contains_key(&board))
                    && state.alive
                    && state.session != ours
                {
                    shared.conflicts.fetch_add(1, Ordering::Relaxed);
                    shared.note(format!(
                        "{board}: gateway `{}` serves it, too: remove it from one of them",
                        state.gateway
                    ));
                }
            } else if let Some(state) = GatewayState::read(payload) {
                let is_ours = state.session == format!("{:016x}", shared.session);
                if !state.alive && (is_ours || !retained) && !shared.stopped() {
                    // The will of an earlier connection, or the end of another gateway of this name.
                    shared.rebirth();
                } else if state.alive && !is_ours && !retained {
                    shared.note(format!(
                        "another gateway is named `{}`, too: rename one of them",
                        shared.config.gateway
                    ));
                }
            }
        }
    }
}

impl Shared {
    /// Publishes the birth again. The connection's own thread may not wait for itself.
    fn rebirth(self: &Arc<Self>) {
        let shared = self.clone();
        thread::spawn(move || {
            let (topic, alive, _) = births(&shared);
            shared.mqtt().retain(topic, alive);
        });
    }
}
