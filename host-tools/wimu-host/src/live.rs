//! Links of a board, each listened to in a thread of its own and opened again when it is lost.

use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::mpsc::{self, Receiver, RecvTimeoutError};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use wimu_link::message::Status;
use wimu_link::{Command, Deframer, Kind, LinkRole, Request};

use crate::authentication::Authentication;
use crate::client::Client;
use crate::clock::{ClockEstimator, ClockModel, Pace};
use crate::decode::{Arrival, Event, LinkStatistics};
use crate::mcap_file::{Received, Recorded};
use crate::transport::{self, Transport};
use crate::{Code, LinkUrl, Problem, Result};

/// Longest wait for data before the stop flag is checked, and longest time until data are passed on.
const GLANCE: Duration = Duration::from_millis(20);
/// Interval between attempts to reopen a lost link.
const TRY_EVERY: Duration = Duration::from_millis(500);
/// Data of a link are passed on at this size, bytes.
const ENOUGH: u64 = 1 << 16;
/// Largest number of messages that wait for their receiver: 64 MiB, or six seconds of a stalled disk.
const MAX_QUEUED: usize = 1024;

/// A client whose data are kept.
pub type LiveClient = Client<Tap<Box<dyn Transport + Send>>>;

/// Links that are listened to.
pub struct LiveLinks {
    receiver: Receiver<(usize, Heard)>,
    shared: Arc<Shared>,
    threads: Vec<JoinHandle<LiveClient>>,
}

/// State that all threads use.
#[derive(Default)]
struct Shared {
    stop: AtomicBool,
    /// How often the identification of the device was requested.
    introductions: AtomicUsize,
    /// The board's latest status on any link: a full link sheds it.
    status: Mutex<Option<Status>>,
}

impl LiveLinks {
    /// Listens to these links, which are opened again at their URLs. `pace` gives the schedule of time requests at a baud
    /// rate.
    pub fn start(links: Vec<(LinkUrl, LiveClient)>, pace: fn(Option<u32>) -> Pace) -> Self {
        let shared = Arc::new(Shared::default());
        let (sender, receiver) = mpsc::sync_channel(MAX_QUEUED);
        let listen = |(index, (url, mut client)): (usize, (LinkUrl, LiveClient))| {
            let (shared, sender) = (shared.clone(), sender.clone());
            thread::spawn(move || {
                let baud = client.transport().baud();
                let authentication = Authentication::new(client.verify());
                let listener = Listener {
                    role: client.hello().role,
                    url,
                    pace,
                    schedule: pace(baud),
                    baud,
                    client,
                    clock: ClockEstimator::new(),
                    authentication,
                    in_doubt: false,
                    introductions: 0,
                    shared: &shared,
                };
                listener.run(|heard| sender.send((index, heard)).is_ok())
            })
        };
        let threads = links.into_iter().enumerate().map(listen).collect();
        Self { receiver, shared, threads }
    }

    /// The next message of a link, by its index.
    ///
    /// # Errors
    /// `Timeout`; `Disconnected` when all have stopped and everything was received.
    pub fn next(&self, timeout: Duration) -> std::result::Result<(usize, Heard), RecvTimeoutError> {
        self.receiver.recv_timeout(timeout)
    }

    /// Has every device identify itself and send its parameters and settings again.
    pub fn introduce(&self) {
        self.shared.introductions.fetch_add(1, Ordering::Relaxed);
    }

    /// Stops listening; what was received until then can still be taken with [`next`](Self::next).
    pub fn stop(&self) {
        self.shared.stop.store(true, Ordering::Relaxed);
    }

    /// Stops listening, passes on what was received until then, and returns the clients, in the order of the links.
    pub fn finish(self, mut each: impl FnMut(usize, &Heard)) -> Vec<LiveClient> {
        self.stop();
        self.receiver.iter().for_each(|(index, heard)| each(index, &heard));
        let joined = self.threads.into_iter().map(JoinHandle::join);
        joined.filter_map(std::result::Result::ok).collect()
    }
}

/// Message of a link.
#[derive(Default)]
pub struct Heard {
    /// Its data, byte for byte.
    pub entries: Vec<Recorded>,
    /// The same, decoded.
    pub arrivals: Vec<Arrival>,
    /// Its statistics.
    pub statistics: LinkStatistics,
    /// The device's clock by this link, every two seconds.
    pub clock: Option<ClockModel>,
    /// What its tags show.
    pub authentication: Authentication,
    /// Why it is lost at present.
    pub lost: Option<Problem>,
}

/// Receives the data of one link and requests the board's time.
struct Listener<'a> {
    role: LinkRole,
    url: LinkUrl,
    client: LiveClient,
    clock: ClockEstimator,
    authentication: Authentication,
    pace: fn(Option<u32>) -> Pace,
    schedule: Pace,
    /// Baud rate at this end when it was connected.
    baud: Option<u32>,
    /// Whether the board's identification was requested because it may have restarted.
    in_doubt: bool,
    /// Requests for an introduction that were passed on.
    introductions: usize,
    shared: &'a Shared,
}

impl Listener<'_> {
    fn stopped(&self) -> bool {
        self.shared.stop.load(Ordering::Relaxed)
    }

    fn run(mut self, tell: impl Fn(Heard) -> bool) -> LiveClient {
        let mut told_clock = Instant::now();
        while !self.stopped() {
            let mut arrivals = Vec::new();
            let outcome = self.listen(&mut arrivals);
            let mut entries = self.heard();
            let lost = outcome.err();
            if let Some(error) = &lost {
                let host_ns = nanoseconds(self.client.transport().now());
                entries.push(Recorded::Lost {
                    role: self.role,
                    host_ns,
                    reason: error.text.clone(),
                });
            }
            // The estimate takes longer than a read.
            let clock = (told_clock.elapsed() >= Duration::from_secs(2) || lost.is_some())
                .then(|| {
                    told_clock = Instant::now();
                    self.clock.model()
                })
                .flatten();
            let told = (entries.is_empty() && arrivals.is_empty())
                || tell(Heard {
                    entries,
                    arrivals,
                    statistics: self.client.statistics(),
                    authentication: self.authentication.clone(),
                    clock,
                    lost: lost.clone(),
                });
            if !told {
                return self.client;
            }
            if let Some(error) = lost {
                self.reconnect(error, &tell);
            }
        }
        let _ = tell(Heard {
            entries: self.heard(),
            arrivals: self.client.take_events(),
            statistics: self.client.statistics(),
            authentication: self.authentication,
            clock: self.clock.model(),
            lost: None,
        });
        self.client
    }

    fn listen(&mut self, arrivals: &mut Vec<Arrival>) -> Result<()> {
        let status = &self.shared.status;
        if let Some(status) = *status.lock().unwrap_or_else(PoisonError::into_inner) {
            self.schedule.report_status(self.role, &status);
        }
        let wanted = self.shared.introductions.load(Ordering::Relaxed);
        if std::mem::replace(&mut self.introductions, wanted) != wanted {
            self.client.ask_who()?;
        }
        let now = self.client.transport().now();
        if self.schedule.is_due(now) {
            self.schedule.asked(now);
            self.client.ask_time()?;
            self.note_sent();
        }
        let doubted = std::mem::replace(&mut self.in_doubt, self.client.is_in_doubt());
        if self.in_doubt && !doubted {
            self.client.ask_who()?;
        }
        let look_up = now + GLANCE;
        let enough = self.client.statistics().bytes + ENOUGH;
        while let Some(arrival) = self.client.next_event(self.schedule.due_in(now).min(GLANCE))? {
            match &arrival.event {
                Event::Restart { .. } => self.clock = ClockEstimator::new(),
                Event::Status(status) => {
                    let latest = &self.shared.status;
                    *latest.lock().unwrap_or_else(PoisonError::into_inner) = Some(*status);
                }
                _ => {}
            }
            self.authentication.see(&arrival);
            let trip = self.clock.heard(self.role, &arrival);
            let now = self.client.transport().now();
            if let Some(trip) = trip {
                self.schedule.answered(now, trip);
            }
            arrivals.push(arrival);
            let has_enough = self.client.statistics().bytes >= enough;
            if now >= look_up || has_enough || self.schedule.is_due(now) {
                break;
            }
        }
        Ok(())
    }

    /// Passes a time request to the clock estimator, before its answer.
    fn note_sent(&mut self) {
        if let Some(Tapped::Sent { host_ns, bytes }) = self.client.transport().last() {
            let (host_ns, bytes) = (*host_ns, bytes.clone());
            self.clock.asked(host_ns, &bytes);
        }
    }

    fn heard(&mut self) -> Vec<Recorded> {
        let role = self.role;
        let tapped = self.client.transport().take();
        tapped.into_iter().map(|entry| entry.of(role)).collect()
    }

    /// Tries until the link is back.
    fn reconnect(&mut self, mut error: Problem, tell: &impl Fn(Heard) -> bool) {
        loop {
            let wait = Instant::now();
            while wait.elapsed() < TRY_EVERY {
                if self.stopped() {
                    return;
                }
                thread::sleep(GLANCE);
            }
            let mut opened_ns = None;
            let resumed = match transport::open(&self.url) {
                Ok(transport) => {
                    opened_ns = Some(nanoseconds(transport.now()));
                    self.client.resume(Tap::on(transport))
                }
                Err(absent) => Err(absent),
            };
            let back = resumed.is_ok();
            let another = matches!(&resumed, Err(still) if still.code == Code::LinkLost);
            if let Err(still) = resumed {
                error = still;
            }
            let (role, heard) = (self.role, self.heard());
            let brought = heard.iter().any(|entry| matches!(entry, Recorded::Received(_)));
            let mut entries = Vec::new();
            // The data of another board are not recorded.
            if let Some(host_ns) = opened_ns.filter(|_| back || (brought && !another)) {
                entries.push(Recorded::Connected { role, host_ns });
                entries.extend(heard);
                if !back {
                    entries.push(Recorded::Lost {
                        role,
                        host_ns: nanoseconds(self.client.transport().now()),
                        reason: error.text.clone(),
                    });
                }
            }
            if back {
                self.schedule = (self.pace)(self.baud);
            }
            let told = tell(Heard {
                entries,
                arrivals: Vec::new(),
                statistics: self.client.statistics(),
                authentication: self.authentication.clone(),
                clock: None,
                lost: (!back).then(|| error.clone()),
            });
            if back || !told {
                return;
            }
        }
    }
}

/// Data that passed over a link.
#[derive(Clone, Debug)]
pub enum Tapped {
    /// Bytes from the board.
    Received {
        /// Time of reading, ns on the link's clock.
        host_ns: u64,
        /// As received.
        bytes: Vec<u8>,
    },
    /// Bytes to the board.
    Sent {
        /// Time before writing, ns on the link's clock.
        host_ns: u64,
        /// As sent.
        bytes: Vec<u8>,
    },
}

impl Tapped {
    /// As an entry of a recording.
    pub fn of(self, role: LinkRole) -> Recorded {
        match self {
            Self::Received { host_ns, bytes } => {
                Recorded::Received(Received { role, host_ns, bytes })
            }
            Self::Sent { host_ns, bytes } => Recorded::Sent { role, host_ns, bytes },
        }
    }
}

/// A link that keeps a copy of all its data with their times, except a device's key.
pub struct Tap<T> {
    inner: T,
    heard: Vec<Tapped>,
}

impl<T: Transport> Tap<T> {
    /// A tap on `inner`.
    pub fn on(inner: T) -> Self {
        Self { inner, heard: Vec::new() }
    }

    /// The data since the last call.
    pub fn take(&mut self) -> Vec<Tapped> {
        std::mem::take(&mut self.heard)
    }

    /// The latest data.
    pub(crate) fn last(&self) -> Option<&Tapped> {
        self.heard.last()
    }
}

impl<T: Transport> Transport for Tap<T> {
    fn read(&mut self, buffer: &mut [u8], timeout: Duration) -> Result<usize> {
        let count = self.inner.read(buffer, timeout)?;
        if count > 0 {
            self.heard.push(Tapped::Received {
                host_ns: nanoseconds(self.inner.received_at()),
                bytes: buffer[..count].to_vec(),
            });
        }
        Ok(count)
    }

    fn write_all(&mut self, bytes: &[u8]) -> Result<()> {
        let host_ns = nanoseconds(self.inner.now());
        self.inner.write_all(bytes)?;
        if !carries_key(bytes) {
            self.heard.push(Tapped::Sent { host_ns, bytes: bytes.to_vec() });
        }
        Ok(())
    }

    fn now(&self) -> Duration {
        self.inner.now()
    }

    fn received_at(&self) -> Duration {
        self.inner.received_at()
    }

    fn baud(&self) -> Option<u32> {
        self.inner.baud()
    }
}

fn carries_key(bytes: &[u8]) -> bool {
    let mut deframer = Deframer::new();
    bytes.iter().any(|&byte| match deframer.push(byte) {
        Some(Ok(frame)) if frame.kind == Kind::Request => {
            let request = Request::decode(frame.body);
            matches!(request.map(|request| request.command), Ok(Command::SetKey(_)))
        }
        _ => false,
    })
}

pub(crate) fn nanoseconds(time: Duration) -> u64 {
    u64::try_from(time.as_nanos()).unwrap_or(u64::MAX)
}
