//! A connection to a broker in a thread of its own: reconnects, resends what was not acknowledged, and stores what waits.

use std::collections::{BTreeMap, VecDeque};
use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use rumqttc::mqttbytes::Error as Malformed;
use rumqttc::{
    AsyncClient, ConnectionError, Event, EventLoop, Incoming, LastWill, MqttOptions, Outgoing, QoS,
    StateError, SubscribeFilter,
};
use tokio::sync::mpsc;
use tokio::time::sleep_until;

use super::spool::{Message, Spool};
use super::topics::Broker;
use crate::{ErrorCode, HostError, Result};

/// Messages under way to the broker without its acknowledgement: 2,500 a second at a round trip of 200 ms.
const WINDOW: u16 = 500;
/// Most messages that the client holds: the states of all boards after a reconnection.
const HANDED: usize = 1 << 16;
/// Orders that wait for the connection's thread; beyond, the boards' threads wait.
const ORDERS: usize = 4096;
/// Shortest and longest interval between attempts to connect.
const RETRY: [Duration; 2] = [Duration::from_millis(250), Duration::from_secs(1)];
/// After a new connection stored messages wait for this time, so that their receivers can come back too.
const SETTLE: Duration = Duration::from_millis(1500);
/// A connection that ends within this time may have been taken over by a client of the same id.
const SHORT: Duration = Duration::from_secs(5);
/// Most bytes of a received message. A longer one ends the connection: see [`SUSPENDED`].
const MAX_INCOMING: usize = 4 << 20;
/// Time without subscriptions after a message that was too long, so that a retained one does not end every connection.
const SUSPENDED: Duration = Duration::from_secs(60);
const KEEP_ALIVE: Duration = Duration::from_secs(10);
/// Longest time in which messages are still delivered when the connection is stopped.
const PARTING: Duration = Duration::from_secs(2);

/// What a connection hears.
#[derive(Clone, Copy, Debug)]
pub enum Heard<'a> {
    /// It is connected, and its subscriptions are requested.
    Connected,
    /// It is lost, for this reason; it will be tried again.
    Lost(&'a str),
    /// A message.
    Message {
        /// Its topic.
        topic: &'a str,
        /// Its content.
        payload: &'a [u8],
        /// Whether the broker had stored it.
        retained: bool,
    },
}

/// Options of a connection.
#[derive(Debug)]
pub struct MqttConfig {
    /// The broker.
    pub broker: Broker,
    /// Topic and retained payload that the broker publishes when the connection dies.
    pub will: Option<(String, Vec<u8>)>,
    /// Topic filters.
    pub subscriptions: Vec<String>,
    /// Folder for messages that wait while the broker is away; in memory without.
    pub spool: Option<PathBuf>,
    /// Most bytes that wait; the oldest messages are dropped first.
    pub spool_bytes: u64,
}

impl MqttConfig {
    /// Subscribes to these filters, and publishes little.
    pub fn new(broker: &Broker, subscriptions: Vec<String>) -> Self {
        Self {
            broker: broker.clone(),
            will: None,
            subscriptions,
            spool: None,
            spool_bytes: 0,
        }
    }
}

/// Figures of a connection.
#[derive(Debug, Default)]
pub struct Counters {
    /// Whether it is connected.
    pub connected: AtomicBool,
    /// How often it was.
    pub connections: AtomicU64,
    /// Messages that the broker has acknowledged, and their bytes with topics.
    pub acknowledged: AtomicU64,
    /// Bytes of these messages and their topics.
    pub acknowledged_bytes: AtomicU64,
    /// Messages that wait.
    pub waiting: AtomicU64,
    /// Bytes of the files in which they wait.
    pub spool_bytes: AtomicU64,
    /// Messages dropped because too many waited.
    pub dropped: AtomicU64,
    /// Messages received that were too long.
    pub too_long: AtomicU64,
}

enum Order {
    /// Publish in order, stored while the broker is away.
    Publish(Message),
    /// Publish now, or never.
    Send(Message),
    /// Publish retained, and again after each reconnection.
    Retain(Message),
    Stop,
}

/// A connection to a broker.
pub struct Mqtt {
    orders: mpsc::Sender<Order>,
    counters: Arc<Counters>,
    thread: Mutex<Option<JoinHandle<()>>>,
}

impl Mqtt {
    /// Connects, and again when the connection is lost. `hear` is called in the connection's thread and may not block.
    ///
    /// # Errors
    /// `feature_missing` for TLS in a build without; `file_failed` for the folder of messages that wait.
    pub fn start(config: MqttConfig, hear: impl FnMut(Heard) + Send + 'static) -> Result<Self> {
        let options = options(&config)?;
        let folder = config.spool.as_deref();
        let spool = Spool::open(folder, config.spool_bytes).map_err(|error| {
            let name = folder.map(|folder| folder.display().to_string());
            HostError::file(&name.unwrap_or_default(), "open", &error)
        })?;
        let (orders, received) = mpsc::channel(ORDERS);
        let counters = Arc::new(Counters::default());
        let figures = counters.clone();
        let runtime = tokio::runtime::Builder::new_current_thread()
            .enable_all()
            .build();
        let runtime =
            runtime.map_err(|error| HostError::file("the MQTT connection", "start", &error))?;
        let thread = thread::spawn(move || {
            let (client, events) = AsyncClient::new(options, HANDED);
            let outgoing = Outbound {
                client,
                spool,
                retained: BTreeMap::new(),
                handed: VecDeque::new(),
                unacknowledged: BTreeMap::new(),
                given: 0,
                connected: None,
                counters: figures,
            };
            runtime.block_on(run(outgoing, events, received, config.subscriptions, hear));
        });
        Ok(Self {
            orders,
            counters,
            thread: Mutex::new(Some(thread)),
        })
    }

    /// Figures of the connection.
    pub fn counters(&self) -> &Arc<Counters> {
        &self.counters
    }

    /// Whether the broker is connected.
    pub fn is_connected(&self) -> bool {
        self.counters.connected.load(Ordering::Relaxed)
    }

    /// Publishes a message after all earlier ones; it is stored while the broker is away.
    pub fn publish(&self, topic: String, payload: Vec<u8>) {
        let _ = self
            .orders
            .blocking_send(Order::Publish(Message { topic, payload }));
    }

    /// Publishes a message now; without a connection it is dropped.
    pub fn send(&self, topic: String, payload: Vec<u8>) {
        let _ = self
            .orders
            .blocking_send(Order::Send(Message { topic, payload }));
    }

    /// Publishes the retained message of a topic, and again after each reconnection.
    pub fn retain(&self, topic: String, payload: Vec<u8>) {
        let _ = self
            .orders
            .blocking_send(Order::Retain(Message { topic, payload }));
    }

    /// Delivers for at most 2 s what waits, stores the rest, and disconnects.
    pub fn stop(&self) {
        let thread = self
            .thread
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .take();
        // The last owner may be the thread itself.
        if let Some(thread) = thread.filter(|other| other.thread().id() != thread::current().id()) {
            let _ = self.orders.blocking_send(Order::Stop);
            let _ = thread.join();
        }
    }
}

impl Drop for Mqtt {
    fn drop(&mut self) {
        self.stop();
    }
}

fn options(config: &MqttConfig) -> Result<MqttOptions> {
    let broker = &config.broker;
    let mut options = MqttOptions::new(client_id(), &broker.host, broker.port);
    options
        .set_keep_alive(KEEP_ALIVE)
        .set_clean_session(true)
        .set_inflight(WINDOW);
    options.set_max_packet_size(MAX_INCOMING, MAX_INCOMING);
    if let Some((topic, payload)) = &config.will {
        options.set_last_will(LastWill::new(
            topic,
            payload.clone(),
            QoS::AtLeastOnce,
            true,
        ));
    }
    if let Some(user) = &broker.user {
        let password = std::env::var("WIMU_MQTT_PASSWORD").unwrap_or_default();
        options.set_credentials(user, password);
    }
    #[cfg(feature = "mqtt-tls")]
    if broker.tls {
        options.set_transport(rumqttc::Transport::tls_with_default_config());
    }
    if broker.tls && cfg!(not(feature = "mqtt-tls")) {
        return Err(ErrorCode::FeatureMissing
            .error(
                "TLS is not built into this wimu",
                "build it with `--features mqtt-tls` (needs a C compiler), or use mqtt://",
            )
            .at(broker.to_string()));
    }
    Ok(options)
}

/// A random id: a second gateway or a copy of a configuration does not take the connection over.
fn client_id() -> String {
    format!("wimu-{:016x}", getrandom::u64().unwrap_or_default())
}

async fn run(
    mut out: Outbound,
    mut events: EventLoop,
    mut orders: mpsc::Receiver<Order>,
    subscriptions: Vec<String>,
    mut hear: impl FnMut(Heard),
) {
    events.network_options.set_tcp_nodelay(true);
    let mut retry = RETRY[0];
    let mut retry_at: Option<Instant> = None;
    let mut suspended: Option<Instant> = None;
    let mut stop: Option<Instant> = None;
    loop {
        let event = {
            let poll = events.poll();
            tokio::pin!(poll);
            loop {
                if stop.is_some_and(|end| end <= Instant::now() || out.is_done()) {
                    break None;
                }
                let settles = out.connected.map(|since| since + SETTLE);
                let settles = settles.filter(|end| *end > Instant::now());
                let resumes = suspended.filter(|_| out.connected.is_some());
                let resumes = resumes.map(|since| since + SUSPENDED);
                let wakes = [stop, retry_at, settles, resumes];
                let wake = wakes.into_iter().flatten().min();
                tokio::select! {
                    event = &mut poll, if retry_at.is_none() => break Some(event),
                    order = orders.recv(), if stop.is_none() => match order {
                        Some(Order::Stop) | None => stop = Some(Instant::now() + PARTING),
                        Some(order) => out.take(order),
                    },
                    () = sleep_until(wake.unwrap_or_else(Instant::now).into()), if wake.is_some() => {
                        retry_at.take_if(|at| *at <= Instant::now());
                        if resumes.is_some_and(|at| at <= Instant::now()) {
                            suspended = None;
                            out.subscribe(&subscriptions);
                        }
                        out.fill();
                    }
                }
            }
        };
        match event {
            None => break,
            Some(Ok(Event::Incoming(Incoming::ConnAck(_)))) => {
                suspended.take_if(|since| since.elapsed() >= SUSPENDED);
                if suspended.is_none() {
                    out.subscribe(&subscriptions);
                }
                out.connect();
                hear(Heard::Connected);
            }
            Some(Ok(Event::Incoming(Incoming::Publish(publish)))) => hear(Heard::Message {
                topic: &publish.topic,
                payload: &publish.payload,
                retained: publish.retain,
            }),
            Some(Ok(Event::Incoming(Incoming::PubAck(ack)))) => out.acknowledge(ack.pkid),
            Some(Ok(Event::Outgoing(Outgoing::Publish(id)))) => out.sent(id),
            Some(Ok(_)) => {}
            Some(Err(error)) => {
                let since = out.lose();
                if is_too_long(&error) {
                    suspended = Some(Instant::now());
                    out.counters.too_long.fetch_add(1, Ordering::Relaxed);
                } else if since.is_some_and(|since| since.elapsed() < SHORT) {
                    events.mqtt_options.set_client_id(client_id());
                }
                retry = match since {
                    Some(_) => RETRY[0],
                    None => (retry * 2).min(RETRY[1]),
                };
                retry_at = Some(Instant::now() + retry);
                hear(Heard::Lost(&error.to_string()));
            }
        }
    }
    out.finish(&mut events).await;
}

fn is_too_long(error: &ConnectionError) -> bool {
    matches!(
        error,
        ConnectionError::MqttState(StateError::Deserialization(
            Malformed::PayloadSizeLimitExceeded(_)
        ))
    )
}

/// What is published.
struct Outbound {
    client: AsyncClient,
    spool: Spool,
    retained: BTreeMap<String, Vec<u8>>,
    /// Handed to the client and not yet sent, with their order; `None` for those that are not repeated.
    handed: VecDeque<(u64, Option<Message>)>,
    /// Sent and not yet acknowledged, by packet id.
    unacknowledged: BTreeMap<u16, (u64, Option<Message>)>,
    /// Messages handed to the client so far.
    given: u64,
    /// Since when it is connected.
    connected: Option<Instant>,
    counters: Arc<Counters>,
}

impl Outbound {
    fn take(&mut self, order: Order) {
        match order {
            Order::Publish(message) => {
                self.spool.push(message);
                self.fill();
            }
            Order::Send(message) => self.hand(message, false, false),
            Order::Retain(message) => {
                self.retained
                    .insert(message.topic.clone(), message.payload.clone());
                self.hand(message, true, false);
            }
            Order::Stop => {}
        }
        self.count();
    }

    fn subscribe(&self, filters: &[String]) {
        let filters = filters.iter().cloned();
        let filters = filters.map(|path| SubscribeFilter::new(path, QoS::AtLeastOnce));
        if filters.len() > 0 {
            let _ = self.client.try_subscribe_many(filters);
        }
    }

    fn hand(&mut self, message: Message, retain: bool, repeat: bool) {
        if self.connected.is_none() {
            return;
        }
        let kept = repeat.then(|| message.clone());
        let published =
            self.client
                .try_publish(message.topic, QoS::AtLeastOnce, retain, message.payload);
        if published.is_ok() {
            self.handed.push_back((self.given, kept));
            self.given += 1;
        } else if let Some(message) = kept {
            self.spool.put_back([message].into_iter());
        }
    }

    /// Hands stored messages to the client, as many as may be under way.
    fn fill(&mut self) {
        let settled = self
            .connected
            .is_some_and(|since| since.elapsed() >= SETTLE);
        while settled && self.handed.len() + self.unacknowledged.len() < WINDOW.into() {
            let Some(message) = self.spool.pop() else {
                break;
            };
            self.hand(message, false, true);
        }
        self.count();
    }

    fn connect(&mut self) {
        self.connected = Some(Instant::now());
        self.counters.connected.store(true, Ordering::Relaxed);
        self.counters.connections.fetch_add(1, Ordering::Relaxed);
        for (topic, payload) in self.retained.clone() {
            self.hand(Message { topic, payload }, true, false);
        }
        self.fill();
    }

    /// The client has forgotten all messages under way: they are next again. Returns since when it was connected.
    fn lose(&mut self) -> Option<Instant> {
        self.counters.connected.store(false, Ordering::Relaxed);
        let sent = std::mem::take(&mut self.unacknowledged).into_values();
        let mut again: Vec<_> = sent.chain(self.handed.drain(..)).collect();
        again.sort_by_key(|(order, _)| *order);
        self.spool
            .put_back(again.into_iter().filter_map(|(_, message)| message));
        self.count();
        self.connected.take()
    }

    fn sent(&mut self, id: u16) {
        if let Some(message) = self.handed.pop_front() {
            self.unacknowledged.insert(id, message);
        }
    }

    fn acknowledge(&mut self, id: u16) {
        if let Some((_, Some(message))) = self.unacknowledged.remove(&id) {
            self.counters.acknowledged.fetch_add(1, Ordering::Relaxed);
            let bytes = message.topic.len() + message.payload.len();
            self.counters
                .acknowledged_bytes
                .fetch_add(bytes as u64, Ordering::Relaxed);
        }
        self.fill();
    }

    fn is_done(&self) -> bool {
        let nothing = self.handed.is_empty() && self.unacknowledged.is_empty();
        self.connected.is_none() || (nothing && self.spool.messages() == 0)
    }

    fn count(&self) {
        let waiting =
            self.spool.messages() + self.handed.len() as u64 + self.unacknowledged.len() as u64;
        self.counters.waiting.store(waiting, Ordering::Relaxed);
        self.counters
            .spool_bytes
            .store(self.spool.file_bytes(), Ordering::Relaxed);
        self.counters
            .dropped
            .store(self.spool.dropped, Ordering::Relaxed);
    }

    async fn finish(mut self, events: &mut EventLoop) {
        if self.connected.is_some() && self.client.try_disconnect().is_ok() {
            let disconnect = async {
                while let Ok(event) = events.poll().await {
                    if event == Event::Outgoing(Outgoing::Disconnect) {
                        break;
                    }
                }
            };
            let _ = tokio::time::timeout(Duration::from_millis(500), disconnect).await;
        }
        self.lose();
        let _ = self.spool.save();
    }
}
