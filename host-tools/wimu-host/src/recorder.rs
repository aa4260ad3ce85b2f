//! Recording of one or two links of a board.

use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::RecvTimeoutError;
use std::time::{Duration, Instant};

use wimu_link::{Hello, LinkRole};
use wimu_model::ParameterId;

use crate::authentication::Authentication;
use crate::client::{Client, ConnectOptions};
use crate::clock::{ClockSummary, Pace};
use crate::decode::{Event, LinkStatistics};
use crate::live::{LiveClient, LiveLinks};
use crate::mcap_file::{ClockAnchor, RecordingWriter};
use crate::transport::{self, Transport};
use crate::{Code, LinkUrl, Problem, Result};

/// Longest wait for data before the stop flag is checked.
const GLANCE: Duration = Duration::from_millis(20);

/// Progress or result of a recording.
#[derive(Clone, Debug, Default)]
pub struct Progress {
    /// The links.
    pub links: Vec<LinkProgress>,
    /// Why the recording ended: every link was lost and did not come back in time.
    pub ended: Option<Problem>,
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
    /// What its tags show.
    pub authentication: Authentication,
    /// Why it is lost at present.
    pub lost: Option<Problem>,
}

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
            let options = ConnectOptions { keep_data: true, ..ConnectOptions::default() };
            let client = Client::connect(transport::open(link)?, &link.to_string(), options)?;
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
                return Err(Code::Usage.error(
                    format!("{} and {} {trouble}", other.name(), client.name()),
                    "give the wireless link and the cable of one board",
                ));
            }
        }
        Ok(Self { links: clients, patience: Duration::from_secs(30) })
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
        let now = self.links.first_mut().map_or(Duration::ZERO, |(_, link)| link.transport().now());
        let mut writer = RecordingWriter::create(path, ClockAnchor::now(now))?;
        for hello in self.hellos() {
            writer.keep_calibration(hello.parameter_id)?;
        }
        let mut progress = Progress {
            links: self
                .links
                .iter()
                .map(|(_, link)| LinkProgress {
                    role: link.hello().role,
                    statistics: LinkStatistics::default(),
                    clock: None,
                    authentication: Authentication::default(),
                    lost: None,
                })
                .collect(),
            ended: None,
        };
        let through_broker = self.links.iter().any(|(url, _)| matches!(url, LinkUrl::Mqtt { .. }));
        let pace = if through_broker { Pace::sparse } else { Pace::on_line };
        let live = LiveLinks::start(self.links, pace);
        let mut outcome = Ok(());
        let mut lost_since: Option<Instant> = None;
        loop {
            match live.next(GLANCE) {
                Ok((index, heard)) => {
                    for entry in heard.entries {
                        outcome = outcome.and_then(|()| writer.record(&entry));
                    }
                    for arrival in heard.arrivals {
                        if let Event::Parameters(reported) = arrival.event {
                            let id = ParameterId(reported.id);
                            outcome = outcome.and_then(|()| writer.keep_calibration(id));
                        }
                    }
                    if let Some(link) = progress.links.get_mut(index) {
                        link.statistics = heard.statistics;
                        link.authentication = heard.authentication;
                        link.clock = heard.clock.map(|model| model.summary()).or(link.clock);
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
                live.stop();
            }
            if stop.load(Ordering::Relaxed) || outcome.is_err() {
                live.stop();
            }
        }
        outcome?;
        writer.finish()?;
        Ok(progress)
    }
}

/// A name for a new recording in a folder: `wimu-1.mcap`, or the next one.
pub fn free_name(folder: &Path) -> PathBuf {
    let name = |number: u32| folder.join(format!("wimu-{number}.mcap"));
    let mut names = (1..).map(name);
    names.find(|path| !path.exists()).unwrap_or_default()
}
