//! Recording of one or two links of a board.

use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{self, RecvTimeoutError};
use std::sync::{Mutex, PoisonError};
use std::thread;
use std::time::{Duration, Instant};

use wimu_link::message::Status;
use wimu_link::{Command, Deframer, Hello, Kind, LinkRole, Request};

use crate::client::{Client, ConnectOptions};
use crate::clock::{ClockEstimator, ClockSummary, Pace};
use crate::decode::{Event, LinkStatistics};
use crate::mcap_file::{ClockAnchor, Received, Recorded, RecordingWriter};
use crate::transport::{self, Transport};
use crate::{ErrorCode, HostError, LinkUrl, Result};

/// Longest wait for data before the stop flag is checked.
const GLANCE: Duration = Duration::from_millis(20);
/// Interval between attempts to reopen a lost link.
const TRY_EVERY: Duration = Duration::from_millis(500);
/// Data of a link are passed on at this size, bytes.
const ENOUGH: u64 = 1 << 16;
/// Largest number of such pieces that wait for the file: 64 MiB, or six seconds of a stalled disk.
const MAX_QUEUED: usize = 1024;

/// Progress or result of a recording.
#[derive(Clone, Debug, Default)]
pub struct Progress {
    /// The links.
    pub links: Vec<LinkProgress>,
    /// Why the recording ended: every link was lost and did not come back in time.
    pub ended: Option<HostError>,
}

/// Progress of one link.
#[derive(Clone, Debug)]
pub struct LinkProgress {
    /// Which link.
    pub role: LinkRole,
    /// Its statistics.
    pub statistics: LinkStatistics,
    /// The board's clock by this link, since the board's last start.
    pub clock: Option<ClockSummary>,
    /// Why it is lost at present.
    pub lost: Option<HostError>,
}

type LiveClient = Client<Tap<Box<dyn Transport + Send>>>;

/// A recorder with open links, before its file is created.
pub struct Recorder {
    links: Vec<(LinkUrl, LiveClient)>,
    patience: Duration,
}

impl Recorder {
    /// Connects to every link; data that arrive from now on are kept.
    ///
    /// # Errors
    /// Those of [`transport::open`] and [`Client::connect`]; `usage` when the links are of
    /// different boards, or two have the same role.
    pub fn connect(links: &[LinkUrl]) -> Result<Self> {
        let mut clients: Vec<(LinkUrl, LiveClient)> = Vec::new();
        for link in links {
            let tap = Tap::on(transport::open(link)?);
            let client = Client::connect(tap, &link.to_string(), ConnectOptions::default())?;
            clients.push((link.clone(), client));
        }
        for (index, (_, client)) in clients.iter().enumerate() {
            for (_, other) in &clients[..index] {
                let trouble = if other.hello().device_id != client.hello().device_id {
                    "are links of different boards"
                } else if other.hello().role == client.hello().role {
                    "are the same link of the board"
                } else {
                    continue;
                };
                return Err(ErrorCode::Usage.error(
                    format!("{} and {} {trouble}", other.name(), client.name()),
                    "give the wireless link and the cable of one board",
                ));
            }
        }
        Ok(Self {
            links: clients,
            patience: Duration::from_secs(30),
        })
    }

    /// Sets the time after which a recording ends when every link is lost; default 30 s.
    #[must_use]
    pub fn with_patience(mut self, patience: Duration) -> Self {
        self.patience = patience;
        self
    }

    /// Identification received on each link.
    pub fn hellos(&self) -> impl Iterator<Item = &Hello> {
        self.links.iter().map(|(_, client)| client.hello())
    }

    /// Records into a new file at `path` until `stop` is set or every link is lost for too long;
    /// `report` gets the progress a few times a second. A lost link is opened again, with
    /// its gap in the file.
    ///
    /// # Errors
    /// `file_exists`, `file_failed`; a lost link is not an error.
    pub fn run(
        mut self,
        path: &Path,
        stop: &AtomicBool,
        mut report: impl FnMut(&Progress),
    ) -> Result<Progress> {
        let now = self
            .links
            .first_mut()
            .map_or(Duration::ZERO, |(_, link)| link.transport().now());
        let mut writer = RecordingWriter::create(path, ClockAnchor::now(now))?;
        let mut progress = Progress {
            links: self
                .links
                .iter()
                .map(|(_, link)| LinkProgress {
                    role: link.hello().role,
                    statistics: LinkStatistics::default(),
                    clock: None,
                    lost: None,
                })
                .collect(),
            ended: None,
        };
        let finished = AtomicBool::new(false);
        let board = Mutex::new(None);
        let (sender, receiver) = mpsc::sync_channel(MAX_QUEUED);
        thread::scope(|scope| {
            for (index, (url, mut client)) in self.links.into_iter().enumerate() {
                let sender = sender.clone();
                let (finished, board) = (&finished, &board);
                scope.spawn(move || {
                    let listener = Listener {
                        role: client.hello().role,
                        url,
                        pace: Pace::on_line(client.transport().baud()),
                        client,
                        clock: ClockEstimator::new(),
                        in_doubt: false,
                        board,
                    };
                    listener.run(|heard| sender.send((index, heard)).is_ok(), finished);
                });
            }
            drop(sender);
            let mut outcome = Ok(());
            let mut lost_since: Option<Instant> = None;
            loop {
                match receiver.recv_timeout(GLANCE) {
                    Ok((index, heard)) => {
                        for entry in heard.entries {
                            outcome = outcome.and_then(|()| writer.record(&entry));
                        }
                        if let Some(link) = progress.links.get_mut(index) {
                            link.statistics = heard.statistics;
                            link.clock = heard.clock.or(link.clock);
                            link.lost = heard.lost;
                        }
                        report(&progress);
                    }
                    Err(RecvTimeoutError::Timeout) => {}
                    Err(RecvTimeoutError::Disconnected) => break,
                }
                if progress.links.iter().any(|link| link.lost.is_none()) {
                    lost_since = None;
                } else if lost_since.get_or_insert_with(Instant::now).elapsed() >= self.patience {
                    progress.ended = progress.links.iter().find_map(|link| link.lost.clone());
                    finished.store(true, Ordering::Relaxed);
                }
                if stop.load(Ordering::Relaxed) || outcome.is_err() {
                    finished.store(true, Ordering::Relaxed);
                }
            }
            outcome
        })?;
        writer.finish()?;
        Ok(progress)
    }
}

/// Message of a listener to the recorder.
struct Heard {
    entries: Vec<Recorded>,
    statistics: LinkStatistics,
    clock: Option<ClockSummary>,
    lost: Option<HostError>,
}

/// Receives the data of one link and requests the board's time.
struct Listener<'a> {
    role: LinkRole,
    url: LinkUrl,
    client: LiveClient,
    clock: ClockEstimator,
    pace: Pace,
    /// Whether the board's identification was requested because it may have restarted.
    in_doubt: bool,
    /// The board's latest status on any link: a full link sheds it.
    board: &'a Mutex<Option<Status>>,
}

impl Listener<'_> {
    fn run(mut self, tell: impl Fn(Heard) -> bool, finished: &AtomicBool) {
        let mut told_clock = Instant::now();
        while !finished.load(Ordering::Relaxed) {
            let outcome = self.listen();
            let mut entries = self.heard();
            let lost = outcome.err();
            if let Some(error) = &lost {
                let host_ns = nanoseconds(self.client.transport().now());
                entries.push(Recorded::Lost {
                    role: self.role,
                    host_ns,
                    reason: error.message().to_owned(),
                });
            }
            // The estimate takes longer than a read.
            let clock = (told_clock.elapsed() >= Duration::from_secs(2) || lost.is_some())
                .then(|| {
                    told_clock = Instant::now();
                    Some(self.clock.model()?.summary())
                })
                .flatten();
            let told = entries.is_empty()
                || tell(Heard {
                    entries,
                    statistics: self.client.statistics(),
                    clock,
                    lost: lost.clone(),
                });
            if !told {
                return;
            }
            if let Some(error) = lost {
                self.reconnect(error, &tell, finished);
            }
        }
        let clock = self.clock.model().map(|model| model.summary());
        let _ = tell(Heard {
            entries: self.heard(),
            statistics: self.client.statistics(),
            clock,
            lost: None,
        });
    }

    fn listen(&mut self) -> Result<()> {
        let told = *self.board.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(status) = told {
            self.pace.report_status(self.role, &status);
        }
        let now = self.client.transport().now();
        if self.pace.is_due(now) {
            self.pace.asked(now);
            self.client.ask_time()?;
            self.note_sent();
        }
        let doubted = std::mem::replace(&mut self.in_doubt, self.client.is_in_doubt());
        if self.in_doubt && !doubted {
            self.client.ask_who()?;
        }
        let look_up = now + 5 * GLANCE;
        let enough = self.client.statistics().bytes + ENOUGH;
        while let Some(arrival) = self.client.next_event(self.pace.due_in(now).min(GLANCE))? {
            match &arrival.event {
                Event::Restart { .. } => self.clock = ClockEstimator::new(),
                Event::Status(status) => {
                    *self.board.lock().unwrap_or_else(PoisonError::into_inner) = Some(*status);
                }
                _ => {}
            }
            let trip = self.clock.heard(self.role, &arrival);
            let now = self.client.transport().now();
            if let Some(trip) = trip {
                self.pace.answered(now, trip);
            }
            let has_enough = self.client.statistics().bytes >= enough;
            if now >= look_up || has_enough || self.pace.is_due(now) {
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
    fn reconnect(
        &mut self,
        mut error: HostError,
        tell: &impl Fn(Heard) -> bool,
        finished: &AtomicBool,
    ) {
        loop {
            let wait = Instant::now();
            while wait.elapsed() < TRY_EVERY {
                if finished.load(Ordering::Relaxed) {
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
            let another = matches!(&resumed, Err(still) if still.code() == ErrorCode::LinkLost);
            if let Err(still) = resumed {
                error = still;
            }
            let (role, heard) = (self.role, self.heard());
            let brought = heard
                .iter()
                .any(|entry| matches!(entry, Recorded::Received(_)));
            let mut entries = Vec::new();
            // The data of another board are not recorded.
            if let Some(host_ns) = opened_ns.filter(|_| back || (brought && !another)) {
                entries.push(Recorded::Connected { role, host_ns });
                entries.extend(heard);
                if !back {
                    entries.push(Recorded::Lost {
                        role,
                        host_ns: nanoseconds(self.client.transport().now()),
                        reason: error.message().to_owned(),
                    });
                }
            }
            if back {
                self.pace = Pace::on_line(self.client.transport().baud());
            }
            let told = tell(Heard {
                entries,
                statistics: self.client.statistics(),
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
            Self::Received { host_ns, bytes } => Recorded::Received(Received {
                role,
                host_ns,
                bytes,
            }),
            Self::Sent { host_ns, bytes } => Recorded::Sent {
                role,
                host_ns,
                bytes,
            },
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
        Self {
            inner,
            heard: Vec::new(),
        }
    }

    /// The data since the last call.
    pub fn take(&mut self) -> Vec<Tapped> {
        std::mem::take(&mut self.heard)
    }

    /// The latest data.
    fn last(&self) -> Option<&Tapped> {
        self.heard.last()
    }
}

impl<T: Transport> Transport for Tap<T> {
    fn read(&mut self, buffer: &mut [u8], timeout: Duration) -> Result<usize> {
        let count = self.inner.read(buffer, timeout)?;
        if count > 0 {
            self.heard.push(Tapped::Received {
                host_ns: nanoseconds(self.inner.now()),
                bytes: buffer[..count].to_vec(),
            });
        }
        Ok(count)
    }

    fn write_all(&mut self, bytes: &[u8]) -> Result<()> {
        let host_ns = nanoseconds(self.inner.now());
        self.inner.write_all(bytes)?;
        if !carries_key(bytes) {
            self.heard.push(Tapped::Sent {
                host_ns,
                bytes: bytes.to_vec(),
            });
        }
        Ok(())
    }

    fn now(&self) -> Duration {
        self.inner.now()
    }

    fn baud(&self) -> Option<u32> {
        self.inner.baud()
    }

    fn set_baud(&mut self, baud: u32) -> Result<()> {
        self.inner.set_baud(baud)
    }
}

fn carries_key(bytes: &[u8]) -> bool {
    let mut deframer = Deframer::new();
    bytes.iter().any(|&byte| match deframer.push(byte) {
        Some(Ok(frame)) if frame.kind == Kind::Request => {
            let request = Request::decode(frame.body);
            matches!(
                request.map(|request| request.command),
                Ok(Command::SetKey(_))
            )
        }
        _ => false,
    })
}

fn nanoseconds(time: Duration) -> u64 {
    u64::try_from(time.as_nanos()).unwrap_or(u64::MAX)
}
