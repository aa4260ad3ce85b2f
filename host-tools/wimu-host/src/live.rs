//! Links of a board, each listened to in a thread of its own and opened again when it is lost.

use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::mpsc::{self, Receiver, RecvTimeoutError};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use wimu_link::LinkRole;
use wimu_link::message::Status;

use crate::authentication::Authentication;
use crate::client::{Client, nanoseconds};
use crate::clock::{ClockEstimator, ClockModel, Pace};
use crate::decode::{Arrival, Event, LinkStatistics};
use crate::mcap_file::Recorded;
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

/// A client of a real link.
pub type LiveClient = Client<Box<dyn Transport + Send>>;

/// Links that are listened to.
pub struct LiveLinks {
    receiver: Receiver<(usize, LinkUpdate)>,
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
        let listen = |(index, (url, client)): (usize, (LinkUrl, LiveClient))| {
            let (shared, sender) = (shared.clone(), sender.clone());
            let mut client = client.keeping_data();
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
    pub fn next(
        &self,
        timeout: Duration,
    ) -> std::result::Result<(usize, LinkUpdate), RecvTimeoutError> {
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
    pub fn finish(self, mut each: impl FnMut(usize, &LinkUpdate)) -> Vec<LiveClient> {
        self.stop();
        self.receiver.iter().for_each(|(index, heard)| each(index, &heard));
        let joined = self.threads.into_iter().map(JoinHandle::join);
        joined.filter_map(std::result::Result::ok).collect()
    }
}

/// What a link has brought since the last one.
#[derive(Default)]
pub struct LinkUpdate {
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

    fn run(mut self, tell: impl Fn(LinkUpdate) -> bool) -> LiveClient {
        let mut told_clock = Instant::now();
        while !self.stopped() {
            let mut arrivals = Vec::new();
            let outcome = self.listen(&mut arrivals);
            let mut entries = self.client.take_data();
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
                || tell(LinkUpdate {
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
        let _ = tell(LinkUpdate {
            entries: self.client.take_data(),
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
            if let Some((host_ns, question)) = self.client.ask_time()? {
                // Before its answer.
                self.clock.asked(host_ns, &question);
            }
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

    /// Tries until the link is back.
    fn reconnect(&mut self, mut error: Problem, tell: &impl Fn(LinkUpdate) -> bool) {
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
                    self.client.resume(transport)
                }
                Err(absent) => Err(absent),
            };
            let back = resumed.is_ok();
            let another = matches!(&resumed, Err(still) if still.code == Code::LinkLost);
            if let Err(still) = resumed {
                error = still;
            }
            let (role, heard) = (self.role, self.client.take_data());
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
            let told = tell(LinkUpdate {
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
