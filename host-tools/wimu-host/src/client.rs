//! Connection to a live board: identification, data, requests and answers.

use std::cmp::Ordering;
use std::collections::VecDeque;
use std::hash::{BuildHasher, RandomState};
use std::time::Duration;

use wimu_link::auth::{DeviceKey, KeyId, Session};
use wimu_link::message::{Answer, Event as DeviceEvent, Payload, Refusal, Status};
use wimu_link::requester::Next;
use wimu_link::{
    Command, Deframer, Hello, Kind, LinkRole, MAX_FRAME, Request, Requester, Settings,
    WIRE_VERSION, WhoAreYou, WriteAccess,
};
use wimu_model::{ParameterId, ParameterSet};

use crate::clock::wire_length;
use crate::decode::{Arrival, Decoder, Event, LinkStatistics};
use crate::keys;
use crate::link_url::LinkUrl;
use crate::mcap_file::{Received, Recorded};
use crate::transport::{self, Transport};
use crate::{Code, Problem, Result};

/// Interval between identification requests.
const ASK_EVERY: Duration = Duration::from_millis(400);
/// Longest wait between looks at the clock.
const GLANCE: Duration = Duration::from_millis(50);
/// Longest pause accepted from one announcement: five times the longest of a supported board
/// (RP2040, 400 ms for erasing a sector).
const MAX_PAUSE: Duration = Duration::from_secs(2);
/// Longest sum of the pauses that hold up one request.
const MAX_PAUSES: Duration = Duration::from_secs(6);
/// Largest number of events that wait to be handed out: 16 MB, and more than arrive while a request is repeated.
const MAX_ARRIVALS: usize = 16_384;
/// Room for events that is kept: those of a read without a backlog.
const FEW_ARRIVALS: usize = 16;
/// Bytes without an event after which [`Client::next_event`] returns, and bytes without identification after which
/// connecting fails (80 s at 115,200 baud).
const MAX_WITHOUT_EVENT: u64 = 1 << 16;
const MAX_UNGREETED: u64 = 1 << 20;

mod requests;

/// Options of connecting.
#[derive(Clone, Copy, Debug)]
pub struct ConnectOptions {
    /// Longest wait for the board to identify itself.
    pub patience: Duration,
    /// Number of this host in requests; random if `None`.
    pub session: Option<u32>,
    /// Whether all data that pass over the link are kept for [`Client::take_data`].
    pub keep_data: bool,
}

impl Default for ConnectOptions {
    /// 3 s, a random session, no data kept.
    fn default() -> Self {
        Self { patience: Duration::from_secs(3), session: None, keep_data: false }
    }
}

impl ConnectOptions {
    /// 1 s, for a port that may not be a board.
    pub fn probe() -> Self {
        Self { patience: Duration::from_secs(1), ..Self::default() }
    }
}

/// Opens a link and connects to the board; `auto` tries the candidate ports, 1 s each.
///
/// # Errors
/// Those of [`transport::open`] and [`Client::connect`]. For `auto`, those of the last port tried.
pub fn connect(link: &LinkUrl) -> Result<Client<Box<dyn Transport + Send>>> {
    if *link != LinkUrl::Auto {
        let transport = transport::open(link)?;
        return Client::connect(transport, &link.to_string(), ConnectOptions::default());
    }
    let mut outcome = Err(Code::LinkAbsent.error("no port to try", "plug the board in"));
    for candidate in transport::candidates()? {
        outcome = transport::open(&candidate).and_then(|transport| {
            Client::connect(transport, &candidate.to_string(), ConnectOptions::probe())
        });
        if outcome.is_ok() {
            break;
        }
    }
    outcome
}

/// A connection to a board.
///
/// What arrives while it waits for something else is kept for [`Client::next_event`], in order: the
/// latest 16,384 events. [`LinkStatistics::events_dropped`] counts the older ones.
pub struct Client<T> {
    transport: T,
    name: String,
    decoder: Decoder,
    requester: Requester,
    hello: Hello,
    /// Events that arrived and are not yet handed out.
    arrivals: VecDeque<Arrival>,
    dropped: u64,
    /// Identification received since the last request for it.
    greeting: Option<Hello>,
    /// Answer to the current request.
    answer: Option<Answer>,
    /// Key for signing writes.
    key: Option<DeviceKey>,
    /// Seed that makes sessions reproducible.
    seed: Option<u32>,
    /// Until then the device writes its flash and does not receive.
    deaf_until: Duration,
    /// Rest of [`MAX_PAUSES`] until the next request or answer.
    pauses_left: Duration,
    /// Length of time requests, bytes.
    time_bytes: usize,
    /// Nominal scales of sensor 0, LSB/*g* and rad/s per LSB, from its latest epoch.
    nominal: Option<(f64, Option<f64>)>,
    /// Data that passed over the link, if they are kept.
    kept: Option<Vec<Passed>>,
}

/// Data that passed over the link.
struct Passed {
    /// Time of reading, or before writing, ns on the link's clock.
    host_ns: u64,
    bytes: Vec<u8>,
    is_sent: bool,
}

impl<T: Transport> Client<T> {
    /// Requests the board's identification and waits for it; `name` is the link's name in errors.
    ///
    /// # Errors
    /// `not_a_wimu_board` without an answer, `protocol_version` when the board uses another version,
    /// `link_busy` when the other end closes the link at once, `link_lost` when it does so later.
    pub fn connect(transport: T, name: &str, options: ConnectOptions) -> Result<Self> {
        let mut client = Self::new(transport, name, options);
        client.greet(options.patience)?;
        Ok(client)
    }

    fn new(transport: T, name: &str, options: ConnectOptions) -> Self {
        let session = options.session;
        let random = || RandomState::new().hash_one(name) as u32;
        Self {
            transport,
            name: name.to_owned(),
            decoder: Decoder::new(),
            requester: Requester::new(session.unwrap_or_else(random)),
            hello: Hello::new(wimu_link::LinkRole::Other(0)),
            arrivals: VecDeque::new(),
            dropped: 0,
            greeting: None,
            answer: None,
            key: None,
            seed: session,
            deaf_until: Duration::ZERO,
            pauses_left: MAX_PAUSES,
            time_bytes: 0,
            nominal: None,
            kept: options.keep_data.then(Vec::new),
        }
    }

    /// Continues with a new transport to the same board after the old one was lost; counters and
    /// numbers continue.
    ///
    /// # Errors
    /// Those of [`Client::connect`]; `link_lost` when another board, or its other link, answers.
    pub fn resume(&mut self, transport: T) -> Result<()> {
        self.transport = transport;
        self.decoder.interrupt();
        self.answer = None;
        self.deaf_until = Duration::ZERO;
        self.pauses_left = MAX_PAUSES;
        let (known, role) = (self.hello.device_id, self.hello.role);
        let greeted = self.greet(ConnectOptions::default().patience);
        let hello = self.hello;
        if greeted.is_ok() && (hello.device_id, hello.role) != (known, role) {
            self.hello.device_id = known;
            self.hello.role = role;
            return Err(Code::LinkLost
                .error(
                    format!(
                        "the {} link of device {:016x} answers now",
                        hello.role, hello.device_id
                    ),
                    "reconnect the first board, or make another recording",
                )
                .at(&self.name));
        }
        greeted
    }

    /// Whether the device may have restarted unnoticed: its identification decides.
    pub fn is_in_doubt(&self) -> bool {
        self.decoder.is_in_doubt()
    }

    /// Requests the device's identification; it arrives among the events.
    ///
    /// # Errors
    /// Those of the transport.
    pub fn ask_who(&mut self) -> Result<()> {
        let mut question = [0; MAX_FRAME + 1];
        // The leading zero ends an incomplete frame of an earlier host.
        let length = WhoAreYou::default().encode(&mut question[1..]).map_or(0, |length| length + 1);
        self.send(&question[..length]).map(drop)
    }

    fn greet(&mut self, patience: Duration) -> Result<()> {
        let start = self.transport.now();
        let mut ask_at = start;
        // An earlier identification does not count.
        self.greeting = None;
        let most = self.decoder.statistics().bytes + MAX_UNGREETED;
        loop {
            let now = self.transport.now();
            if now >= start + patience || self.decoder.statistics().bytes >= most {
                return Err(self.no_greeting());
            }
            if now >= ask_at {
                self.ask_who().map_err(|error| self.turned_away(error))?;
                ask_at = now + ASK_EVERY;
            }
            self.poll(GLANCE).map_err(|error| self.turned_away(error))?;
            if let Some(hello) = self.greeting.take() {
                self.hello = hello;
                return if hello.wire_version == WIRE_VERSION {
                    Ok(())
                } else {
                    Err(self.foreign(hello.wire_version))
                };
            }
        }
    }

    /// The error for a link that ends before any data: a server that accepts one host at a time.
    fn turned_away(&self, error: Problem) -> Problem {
        if error.code != Code::LinkLost || self.decoder.statistics().bytes > 0 {
            return error;
        }
        Code::LinkBusy
            .error(
                "the other end closed the link at once",
                "another program may be using it: close it; else check the address",
            )
            .at(&self.name)
    }

    /// The error for a board of another wire version.
    fn foreign(&self, version: u8) -> Problem {
        let older = match version.cmp(&WIRE_VERSION) {
            Ordering::Less => "the board's firmware",
            _ => "wimu on this computer",
        };
        Code::ProtocolVersion.error(format!(
                "the board uses version {version} of the protocol, this wimu version {WIRE_VERSION}"
            ),
            format!("update {older}, which is the older one"),
        )
        .at(&self.name)
    }

    fn no_greeting(&self) -> Problem {
        let older = self.decoder.latest_version();
        let older = older.filter(|version| *version < WIRE_VERSION);
        if let Some(version) = self.decoder.foreign_version().or(older) {
            return self.foreign(version);
        }
        let statistics = self.decoder.statistics();
        let (message, remedy) = if statistics.bytes == 0 {
            (
                "no answer".to_owned(),
                "check that the board is powered and runs wimu, and that TX and RX are not swapped",
            )
        } else if statistics.frames == 0 {
            (
                format!("{} bytes arrived, but no frame of a wimu board", statistics.bytes),
                "check the baud rate at both ends, and that this is the board's port",
            )
        } else {
            (
                format!("the board sends data ({} frames) but does not answer", statistics.frames),
                "check the line from this computer to the board (TX of this side)",
            )
        };
        Code::NotAWimuBoard.error(message, remedy).at(&self.name)
    }

    /// Verifies the board's tags with the keys that this computer has of it; the results are among the events. Returns
    /// whether it has one.
    pub fn verify(&mut self) -> bool {
        let known = keys::KeyFolder::own(self.hello.device_id);
        let key_known = !known.is_empty();
        self.decoder.use_keys(known);
        key_known
    }

    /// The board's latest identification.
    pub fn hello(&self) -> &Hello {
        &self.hello
    }

    /// Name of the link in errors.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Keeps all data that pass over the link from now on, for [`take_data`](Self::take_data).
    #[must_use]
    pub fn keeping_data(mut self) -> Self {
        self.kept.get_or_insert_default();
        self
    }

    /// All data that passed over the link since the last call, except a device's key.
    pub fn take_data(&mut self) -> Vec<Recorded> {
        let role = self.hello.role;
        let kept = self.kept.as_mut().map(std::mem::take).unwrap_or_default();
        let entries = kept.into_iter().map(|Passed { host_ns, bytes, is_sent }| {
            if is_sent {
                Recorded::Sent { role, host_ns, bytes }
            } else {
                Recorded::Received(Received { role, host_ns, bytes })
            }
        });
        entries.collect()
    }

    /// Sends whole frames; returns the time before, ns on the link's clock.
    ///
    /// # Errors
    /// Those of the transport.
    pub fn send(&mut self, bytes: &[u8]) -> Result<u64> {
        let host_ns = nanoseconds(self.transport.now());
        self.transport.write_all(bytes)?;
        if let Some(kept) = &mut self.kept
            && !carries_key(bytes)
        {
            kept.push(Passed { host_ns, bytes: bytes.to_vec(), is_sent: true });
        }
        Ok(host_ns)
    }

    /// Statistics of the link.
    pub fn statistics(&self) -> LinkStatistics {
        LinkStatistics { events_dropped: self.dropped, ..self.decoder.statistics() }
    }

    /// The transport, for its clock.
    pub fn transport(&mut self) -> &mut T {
        &mut self.transport
    }

    /// The next event, after at most `timeout` and 64 KiB; `None` without one by then.
    ///
    /// # Errors
    /// `link_lost`, after all earlier events have been handed out.
    pub fn next_event(&mut self, timeout: Duration) -> Result<Option<Arrival>> {
        let until = self.transport.now() + timeout;
        let most = self.decoder.statistics().bytes + MAX_WITHOUT_EVENT;
        loop {
            if let Some(arrival) = self.arrivals.pop_front() {
                return Ok(Some(arrival));
            }
            // The memory of a burst is given back: many clients may run beside each other.
            self.arrivals.shrink_to(FEW_ARRIVALS);
            let left = until.saturating_sub(self.transport.now());
            let nothing = self.decoder.statistics().bytes >= most;
            if (left.is_zero() && !timeout.is_zero()) || nothing {
                return Ok(None);
            }
            self.poll(left)?;
            if timeout.is_zero() {
                return Ok(self.arrivals.pop_front());
            }
        }
    }

    /// The events that have arrived and are not yet handed out.
    pub fn take_events(&mut self) -> Vec<Arrival> {
        self.arrivals.drain(..).collect()
    }

    /// Waits while the device writes its flash and does not receive.
    fn wait_while_deaf(&mut self) -> Result<()> {
        loop {
            let left = self.deaf_until.saturating_sub(self.transport.now());
            if left.is_zero() {
                return Ok(());
            }
            self.poll(left.min(GLANCE))?;
        }
    }

    /// Reads once.
    fn poll(&mut self, timeout: Duration) -> Result<()> {
        let mut buffer = [0; 4096];
        let count = self.transport.read(&mut buffer, timeout)?;
        let now = self.transport.now();
        let Self {
            decoder,
            requester,
            hello,
            arrivals,
            dropped,
            greeting,
            answer,
            deaf_until,
            pauses_left,
            time_bytes,
            nominal,
            ..
        } = self;
        let host_ns = nanoseconds(self.transport.received_at());
        if count > 0
            && let Some(kept) = &mut self.kept
        {
            kept.push(Passed { host_ns, bytes: buffer[..count].to_vec(), is_sent: false });
        }
        decoder.push(host_ns, &buffer[..count], |arrival| {
            match &arrival.event {
                Event::Hello(new) => {
                    *hello = *new;
                    *greeting = Some(*new);
                }
                Event::Reply { reply, body } => {
                    if let Answer::Accepted(Payload::Time { .. }) = reply.answer {
                        *time_bytes = wire_length(reply).max(*time_bytes);
                    }
                    if let Some(ours) = requester.on_reply(body) {
                        *answer = Some(ours);
                        // It has finished writing.
                        *deaf_until = Duration::ZERO;
                        *pauses_left = MAX_PAUSES;
                    }
                }
                Event::Epoch { epoch, .. } if epoch.sensor == 0 => {
                    let gyroscope = epoch.gyroscope.map(|gyroscope| gyroscope.rad_s_per_lsb);
                    *nominal = Some((epoch.sensitivity_lsb_per_g, gyroscope));
                }
                Event::Device { event: DeviceEvent::Pause { longest_ms }, .. } => {
                    let pause = Duration::from_millis((*longest_ms).into()).min(MAX_PAUSE);
                    let from = now.max(*deaf_until);
                    let longer = (now + pause).saturating_sub(from).min(*pauses_left);
                    *pauses_left -= longer;
                    *deaf_until = from + longer;
                }
                _ => {}
            }
            if arrivals.len() >= MAX_ARRIVALS {
                arrivals.pop_front();
                *dropped += 1;
            }
            arrivals.push_back(arrival);
        });
        Ok(())
    }
}

/// Whether data to a board carry a device's key.
fn carries_key(bytes: &[u8]) -> bool {
    let is_key = |request: Request| matches!(request.command, Command::SetKey(_));
    requests_in(bytes).any(is_key)
}

/// The requests in data sent by the host.
pub(crate) fn requests_in(bytes: &[u8]) -> impl Iterator<Item = Request> {
    let mut deframer = Deframer::new();
    bytes.iter().filter_map(move |&byte| match deframer.push(byte) {
        Some(Ok(frame)) if frame.kind == Kind::Request => Request::decode(frame.body).ok(),
        _ => None,
    })
}

pub(crate) fn nanoseconds(time: Duration) -> u64 {
    u64::try_from(time.as_nanos()).unwrap_or(u64::MAX)
}
