//! A connection to a broker in a thread of its own: reconnects, resends what was not acknowledged, and stores what waits.

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::{Arc, Mutex};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use rumqttc::{
    AsyncClient, Event, EventLoop, Incoming, LastWill, MqttOptions, Outgoing, QoS, Request,
    SubscribeFilter,
};
use serde::Serialize;
use tokio::sync::Notify;

use super::lock;
use super::spool::{Message, Spool};
use super::topics::Broker;
use crate::{Code, Problem, Result};

/// Messages under way to the broker without its acknowledgement: 2,500 a second at a round trip of 200 ms.
const WINDOW: u16 = 500;
/// Most messages that the client holds: the states of all boards after a reconnection.
const HANDED: usize = 1 << 16;
/// Interval between attempts to connect.
const RETRY: Duration = Duration::from_millis(500);
/// After a new connection stored messages wait for this time, so that their receivers can come back too.
const SETTLE: Duration = Duration::from_millis(1500);
/// A connection that ends within this time may have been taken over by a client of the same id.
const SHORT: Duration = Duration::from_secs(5);
/// Most bytes of a received message: the most that MQTT allows, so none ends the connection. A broker may be set to less.
const MAX_INCOMING: usize = (256 << 20) + 4;
const KEEP_ALIVE: Duration = Duration::from_secs(10);
/// Longest wait for the first connection.
const PATIENCE: Duration = Duration::from_secs(5);
/// Interval between looks at the connection while something waits for it.
const GLANCE: Duration = Duration::from_millis(10);
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
    /// Folder for messages that wait while the broker is away, and most bytes of them. Without it messages are dropped then.
    pub spool: Option<(PathBuf, u64)>,
}

impl MqttConfig {
    /// Subscribes to these filters, and publishes nothing that may wait.
    pub fn new(broker: &Broker, subscriptions: Vec<String>) -> Self {
        Self { broker: broker.clone(), will: None, subscriptions, spool: None }
    }
}

/// Figures of a connection.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
#[non_exhaustive]
pub struct Figures {
    /// Whether the broker is connected.
    pub broker: bool,
    /// How often it was.
    pub broker_connections: u64,
    /// Messages published, without retained ones and those lost with a connection.
    pub published: u64,
    /// Bytes of these messages and their topics.
    pub published_bytes: u64,
    /// Messages that wait, or that the broker has not acknowledged.
    pub waiting: u64,
    /// Bytes of the files in which they wait.
    pub spool_bytes: u64,
    /// Messages dropped because too many waited.
    pub dropped: u64,
}

/// A connection to a broker.
pub struct Mqtt {
    broker: Broker,
    outbound: Arc<Mutex<Outbound>>,
    stop: Arc<Notify>,
    thread: Mutex<Option<JoinHandle<()>>>,
}

impl Mqtt {
    /// Connects, and again when the connection is lost. `hear` is called in the connection's thread and may not block.
    ///
    /// # Errors
    /// `feature_missing` for TLS in a build without; `link_busy` and `file_failed` for the folder of messages that wait.
    pub fn start(config: MqttConfig, hear: impl FnMut(Heard) + Send + 'static) -> Result<Self> {
        let (client, mut events) = AsyncClient::new(options(&config)?, HANDED);
        events.network_options.set_tcp_nodelay(true);
        let open = |(folder, bytes): &(PathBuf, u64)| Spool::open(folder, *bytes);
        let outbound = Arc::new(Mutex::new(Outbound {
            client,
            spool: config.spool.as_ref().map(open).transpose()?,
            retained: BTreeMap::new(),
            under_way: 0,
            connected: None,
            figures: Figures::default(),
            reason: None,
        }));
        let stop = Arc::new(Notify::new());
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build();
        let runtime =
            runtime.map_err(|error| Problem::file("the MQTT connection", "start", &error))?;
        let (out, stopped) = (outbound.clone(), stop.clone());
        let thread = thread::spawn(move || {
            runtime.block_on(async {
                tokio::select! {
                    () = run(&out, &mut events, &config.subscriptions, hear) => {}
                    () = stopped.notified() => {}
                }
                disconnect(&out, &mut events).await;
            });
        });
        Ok(Self { broker: config.broker, outbound, stop, thread: Mutex::new(Some(thread)) })
    }

    /// Figures of the connection.
    pub fn figures(&self) -> Figures {
        lock(&self.outbound).figures()
    }

    /// Whether the broker is connected.
    pub fn is_connected(&self) -> bool {
        self.figures().broker
    }

    /// Waits until the broker is connected.
    ///
    /// # Errors
    /// `link_refused` when it refuses, or does not answer for 5 s.
    pub fn wait_connected(&self) -> Result<()> {
        let until = Instant::now() + PATIENCE;
        while !self.is_connected() {
            let reason = lock(&self.outbound).reason.clone();
            if reason.is_some() || Instant::now() >= until {
                let reason = reason.unwrap_or_else(|| "no answer".to_owned());
                return Err(Code::LinkRefused
                    .error(
                        format!("cannot connect to the broker: {reason}"),
                        "start it, or check address, user and password (WIMU_MQTT_PASSWORD)",
                    )
                    .at(self.broker.to_string()));
            }
            thread::sleep(GLANCE);
        }
        Ok(())
    }

    /// Publishes a message after all earlier ones. While the broker is away it waits in the spool, or is dropped without one.
    pub fn publish(&self, topic: String, payload: Vec<u8>) {
        let message = Message { topic, payload };
        let mut out = lock(&self.outbound);
        match &mut out.spool {
            Some(spool) => spool.push(message),
            None => drop(out.hand(&message, false)),
        }
        out.fill();
    }

    /// Publishes the retained message of a topic, and again after each reconnection.
    pub fn retain(&self, topic: String, payload: Vec<u8>) {
        let message = Message { topic, payload };
        let mut out = lock(&self.outbound);
        out.hand(&message, true);
        out.retained.insert(message.topic, message.payload);
    }

    /// Delivers for at most 2 s what waits, stores the rest, and disconnects.
    pub fn stop(&self) {
        let thread = lock(&self.thread).take();
        // The last owner may be the thread itself.
        if let Some(thread) = thread.filter(|other| other.thread().id() != thread::current().id()) {
            let until = Instant::now() + PARTING;
            while !lock(&self.outbound).is_done() && Instant::now() < until {
                lock(&self.outbound).fill();
                thread::sleep(GLANCE);
            }
            self.stop.notify_one();
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
    options.set_keep_alive(KEEP_ALIVE).set_clean_session(true).set_inflight(WINDOW);
    options.set_max_packet_size(MAX_INCOMING, MAX_INCOMING);
    if let Some((topic, payload)) = &config.will {
        options.set_last_will(LastWill::new(topic, payload.clone(), QoS::AtLeastOnce, true));
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
        return Err(Code::FeatureMissing
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
    out: &Mutex<Outbound>,
    events: &mut EventLoop,
    subscriptions: &[String],
    mut hear: impl FnMut(Heard),
) {
    loop {
        match events.poll().await {
            Ok(Event::Incoming(Incoming::ConnAck(_))) => {
                lock(out).connect(subscriptions);
                hear(Heard::Connected);
            }
            Ok(Event::Incoming(Incoming::Publish(publish))) => hear(Heard::Message {
                topic: &publish.topic,
                payload: &publish.payload,
                retained: publish.retain,
            }),
            Ok(Event::Incoming(Incoming::PubAck(_))) => lock(out).acknowledge(),
            Ok(_) => {}
            Err(error) => {
                let reason = error.to_string();
                let since = lock(out).lose(events, &reason);
                if since.is_some_and(|since| since.elapsed() < SHORT) {
                    events.mqtt_options.set_client_id(client_id());
                }
                hear(Heard::Lost(&reason));
                tokio::time::sleep(RETRY).await;
            }
        }
    }
}

async fn disconnect(out: &Mutex<Outbound>, events: &mut EventLoop) {
    let client = lock(out).client.clone();
    if lock(out).connected.is_some() && client.try_disconnect().is_ok() {
        let disconnect = async {
            while let Ok(event) = events.poll().await {
                if event == Event::Outgoing(Outgoing::Disconnect) {
                    break;
                }
            }
        };
        let _ = tokio::time::timeout(Duration::from_millis(500), disconnect).await;
    }
    let mut out = lock(out);
    out.lose(events, "stopped");
    if let Some(spool) = &mut out.spool {
        let _ = spool.save();
    }
}

/// What is published.
struct Outbound {
    client: AsyncClient,
    spool: Option<Spool>,
    retained: BTreeMap<String, Vec<u8>>,
    /// Messages handed to the client and not yet acknowledged.
    under_way: u64,
    /// Since when it is connected.
    connected: Option<Instant>,
    figures: Figures,
    /// Why it is not connected.
    reason: Option<String>,
}

impl Outbound {
    /// Hands a message to the client; returns whether it took it.
    fn hand(&mut self, message: &Message, retain: bool) -> bool {
        let Message { topic, payload } = message;
        let qos = QoS::AtLeastOnce;
        let publish = || self.client.try_publish(topic, qos, retain, payload.clone());
        let taken = self.connected.is_some() && publish().is_ok();
        self.under_way += u64::from(taken);
        taken
    }

    /// Hands stored messages to the client, as many as may be under way.
    fn fill(&mut self) {
        let settled = self.connected.is_some_and(|since| since.elapsed() >= SETTLE);
        while settled
            && self.under_way < WINDOW.into()
            && let Some(message) = self.spool.as_mut().and_then(Spool::pop)
        {
            self.figures.published += 1;
            self.figures.published_bytes += message.bytes();
            if !self.hand(&message, false) {
                self.take_back(message);
                break;
            }
        }
    }

    fn take_back(&mut self, message: Message) {
        if let Some(spool) = &mut self.spool {
            self.figures.published -= 1;
            self.figures.published_bytes -= message.bytes();
            spool.put_back(message);
        }
    }

    fn connect(&mut self, filters: &[String]) {
        self.connected = Some(Instant::now());
        self.figures.broker_connections += 1;
        let filters = filters.iter().cloned();
        let filters = filters.map(|path| SubscribeFilter::new(path, QoS::AtLeastOnce));
        if filters.len() > 0 {
            let _ = self.client.try_subscribe_many(filters);
        }
        for (topic, payload) in self.retained.clone() {
            self.hand(&Message { topic, payload }, true);
        }
    }

    /// Takes back what the client has not delivered: it is next again. Returns since when it was connected.
    fn lose(&mut self, events: &mut EventLoop, reason: &str) -> Option<Instant> {
        events.clean();
        let collided = events.state.collision.take().map(Request::Publish);
        for request in events.pending.drain(..).chain(collided).rev() {
            if let Request::Publish(publish) = request
                && !publish.retain
            {
                self.take_back(Message { topic: publish.topic, payload: publish.payload.into() });
            }
        }
        self.under_way = 0;
        self.reason = Some(reason.to_owned());
        self.connected.take()
    }

    fn acknowledge(&mut self) {
        self.under_way = self.under_way.saturating_sub(1);
        self.fill();
    }

    fn is_done(&self) -> bool {
        self.connected.is_none() || self.figures().waiting == 0
    }

    fn figures(&self) -> Figures {
        let spool = self.spool.as_ref();
        Figures {
            broker: self.connected.is_some(),
            waiting: self.under_way + spool.map_or(0, Spool::messages),
            spool_bytes: spool.map_or(0, Spool::file_bytes),
            dropped: spool.map_or(0, |spool| spool.dropped),
            ..self.figures
        }
    }
}
