//! A recording of wimu as if it arrived now.

use std::collections::VecDeque;
use std::path::{Path, PathBuf};
use std::sync::mpsc::RecvTimeoutError;
use std::time::{Duration, Instant};

use serde::Serialize;
use wimu_host::Result;
use wimu_host::decode::Decoder;
use wimu_host::live::LinkUpdate;
use wimu_host::mcap_file::{Received, RecordingReader};
use wimu_link::LinkRole;

type Reader = RecordingReader<std::io::BufReader<wimu_host::progress::Watched>>;

/// Plays a recording.
pub struct Player {
    path: PathBuf,
    reader: Reader,
    /// The links so far, by their index.
    links: Vec<(LinkRole, Decoder)>,
    /// Time of the first entry, ns.
    first_ns: Option<u64>,
    waiting: VecDeque<Received>,
    /// Entries before this time are decoded without a pause, s.
    until_s: f64,
    clock: Instant,
    /// What the page shows.
    pub view: ReplayView,
}

/// State of a player.
#[derive(Clone, Debug, Default, Serialize)]
pub struct ReplayView {
    /// Time since the start of the recording, s.
    pub position_s: f64,
    pub speed: f64,
    pub paused: bool,
    pub over: bool,
}

impl Player {
    /// # Errors
    /// Those of [`RecordingReader::open`].
    pub fn open(path: &Path) -> Result<Self> {
        Ok(Self {
            reader: RecordingReader::open(path)?,
            path: path.to_owned(),
            links: Vec::new(),
            first_ns: None,
            waiting: VecDeque::new(),
            until_s: 0.0,
            clock: Instant::now(),
            view: ReplayView { speed: 1.0, ..ReplayView::default() },
        })
    }

    /// Goes to a time since the start, s.
    ///
    /// # Errors
    /// Those of [`RecordingReader::open`].
    pub fn seek(&mut self, to_s: f64) -> Result<()> {
        if to_s < self.view.position_s || self.view.over {
            let view = self.view.clone();
            *self = Self::open(&self.path)?;
            (self.view.speed, self.view.paused) = (view.speed, view.paused);
        }
        self.until_s = to_s;
        self.view.position_s = self.view.position_s.max(to_s);
        Ok(())
    }

    /// The next entry, when it is due.
    ///
    /// # Errors
    /// `Timeout` where none is.
    pub fn next(
        &mut self,
        timeout: Duration,
    ) -> std::result::Result<(usize, LinkUpdate), RecvTimeoutError> {
        let elapsed = self.clock.elapsed().as_secs_f64();
        self.clock = Instant::now();
        if !self.view.paused && !self.view.over {
            self.view.position_s += elapsed * self.view.speed;
        }
        if self.waiting.is_empty() && !self.view.over {
            // A damaged end is one.
            match self.reader.next_received() {
                Ok(Some(received)) => self.waiting.push_back(received),
                _ => self.view.over = true,
            }
        }
        let due = self.waiting.front().map(|received| {
            let first_ns = *self.first_ns.get_or_insert(received.host_ns);
            let at_s = received.host_ns.saturating_sub(first_ns) as f64 * 1e-9;
            at_s < self.until_s || (at_s <= self.view.position_s && !self.view.paused)
        });
        match self.waiting.pop_front() {
            Some(received) if due == Some(true) => Ok(self.decoded(&received)),
            held => {
                self.waiting.extend(held);
                std::thread::sleep(timeout.min(Duration::from_millis(10)));
                Err(RecvTimeoutError::Timeout)
            }
        }
    }

    /// Role of a link.
    pub fn roles(&self) -> impl Iterator<Item = LinkRole> + '_ {
        self.links.iter().map(|(role, _)| *role)
    }

    fn decoded(&mut self, received: &Received) -> (usize, LinkUpdate) {
        let known = self.links.iter().position(|(role, _)| *role == received.role);
        let index = known.unwrap_or_else(|| {
            self.links.push((received.role, Decoder::new()));
            self.links.len() - 1
        });
        let decoder = &mut self.links[index].1;
        let mut arrivals = Vec::new();
        decoder.push(received.host_ns, &received.bytes, |arrival| arrivals.push(arrival));
        let heard =
            LinkUpdate { arrivals, statistics: decoder.statistics(), ..LinkUpdate::default() };
        (index, heard)
    }
}
