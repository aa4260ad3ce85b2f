//! Records everything that one or two links of a board bring.

use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{self, RecvTimeoutError};
use std::thread;
use std::time::Duration;

use wimu_link::{Hello, LinkRole};

use crate::client::{Client, ConnectOptions};
use crate::decode::LinkStatistics;
use crate::mcap_file::{ClockAnchor, RecordingWriter};
use crate::transport::{self, Transport};
use crate::{ErrorCode, HostError, LinkUrl, Result};

/// How long a link may be silent before somebody looks whether to stop.
const GLANCE: Duration = Duration::from_millis(100);

/// What has been recorded so far, or in all.
#[derive(Clone, Debug, Default)]
pub struct Progress {
    /// Each link: its role and what it carried.
    pub links: Vec<(LinkRole, LinkStatistics)>,
    /// Links that failed while recording, and why.
    pub failures: Vec<(LinkRole, HostError)>,
}

/// A recorder whose links are open and whose file is not yet made.
pub struct Recorder {
    links: Vec<Client<Tap<Box<dyn Transport + Send>>>>,
}

impl Recorder {
    /// Connects to every link; from now on nothing that arrives is lost.
    ///
    /// # Errors
    /// Those of [`transport::open`] and [`Client::connect`]; `usage` when the links are of
    /// different boards, or two have the same role.
    pub fn connect(links: &[LinkUrl]) -> Result<Self> {
        let mut clients = Vec::new();
        for link in links {
            let tap = Tap::on(transport::open(link)?);
            clients.push(Client::connect(
                tap,
                &link.to_string(),
                ConnectOptions::default(),
            )?);
        }
        for (index, client) in clients.iter().enumerate() {
            for other in &clients[..index] {
                let trouble = if other.hello().device_id != client.hello().device_id {
                    "are links of different boards"
                } else if other.hello().role == client.hello().role {
                    "are the same link of the board"
                } else {
                    continue;
                };
                return Err(HostError::new(
                    ErrorCode::Usage,
                    format!("{} and {} {trouble}", other.name(), client.name()),
                    "give the wireless link and the cable of one board",
                ));
            }
        }
        Ok(Self { links: clients })
    }

    /// Who answered on each link.
    pub fn hellos(&self) -> impl Iterator<Item = &Hello> {
        self.links.iter().map(Client::hello)
    }

    /// Records into a new file at `path` until `stop` is set or every link has failed; `report`
    /// sees the progress a few times a second.
    ///
    /// # Errors
    /// `file_exists`, `file_failed`; a link that fails ends only itself and is in the result.
    pub fn run(
        mut self,
        path: &Path,
        stop: &AtomicBool,
        mut report: impl FnMut(&Progress),
    ) -> Result<Progress> {
        let now = self
            .links
            .first_mut()
            .map_or(Duration::ZERO, |link| link.transport().now());
        let mut writer = RecordingWriter::create(path, ClockAnchor::now(now))?;
        let mut progress = Progress {
            links: self
                .links
                .iter()
                .map(|link| (link.hello().role, LinkStatistics::default()))
                .collect(),
            failures: Vec::new(),
        };
        let finished = AtomicBool::new(false);
        let (sender, receiver) = mpsc::channel();
        thread::scope(|scope| {
            for link in self.links {
                let sender = sender.clone();
                let finished = &finished;
                scope.spawn(move || listen(link, &sender, finished));
            }
            drop(sender);
            let mut outcome = Ok(());
            loop {
                match receiver.recv_timeout(GLANCE) {
                    Ok(Heard::Bytes(role, arrived, statistics)) => {
                        for (host_ns, bytes) in arrived {
                            outcome = outcome.and_then(|()| writer.append(role, host_ns, &bytes));
                        }
                        for (known, slot) in &mut progress.links {
                            if *known == role {
                                *slot = statistics;
                            }
                        }
                        report(&progress);
                    }
                    Ok(Heard::Failed(role, error)) => progress.failures.push((role, error)),
                    Err(RecvTimeoutError::Timeout) => {}
                    Err(RecvTimeoutError::Disconnected) => break,
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

enum Heard {
    Bytes(LinkRole, Vec<(u64, Vec<u8>)>, LinkStatistics),
    Failed(LinkRole, HostError),
}

fn listen<T: Transport>(
    mut client: Client<Tap<T>>,
    to: &mpsc::Sender<Heard>,
    finished: &AtomicBool,
) {
    let role = client.hello().role;
    loop {
        let heard = client.next_event(GLANCE);
        let arrived = client.transport().take();
        if !arrived.is_empty()
            && to
                .send(Heard::Bytes(role, arrived, client.statistics()))
                .is_err()
        {
            return;
        }
        if let Err(error) = heard {
            let _ = to.send(Heard::Failed(role, error));
            return;
        }
        if finished.load(Ordering::Relaxed) {
            return;
        }
    }
}

/// A link that keeps a copy of all that is read from it, with the time.
pub struct Tap<T> {
    inner: T,
    heard: Vec<(u64, Vec<u8>)>,
}

impl<T: Transport> Tap<T> {
    /// A tap on `inner`.
    pub fn on(inner: T) -> Self {
        Self {
            inner,
            heard: Vec::new(),
        }
    }

    /// What was read since the last time, with when, ns on the link's clock.
    pub fn take(&mut self) -> Vec<(u64, Vec<u8>)> {
        std::mem::take(&mut self.heard)
    }
}

impl<T: Transport> Transport for Tap<T> {
    fn read(&mut self, buffer: &mut [u8], timeout: Duration) -> Result<usize> {
        let count = self.inner.read(buffer, timeout)?;
        if count > 0 {
            let host_ns = self.inner.now().as_nanos() as u64;
            self.heard.push((host_ns, buffer[..count].to_vec()));
        }
        Ok(count)
    }

    fn write_all(&mut self, bytes: &[u8]) -> Result<()> {
        self.inner.write_all(bytes)
    }

    fn now(&self) -> Duration {
        self.inner.now()
    }
}
