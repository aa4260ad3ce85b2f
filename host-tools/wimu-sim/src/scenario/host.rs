//! A host on both links of a board in virtual time.

use std::cell::RefCell;
use std::collections::VecDeque;
use std::io::Cursor;
use std::rc::Rc;
use std::time::Duration;

use wimu_host::Result;
use wimu_host::capture::Capture;
use wimu_host::client::{Client, ConnectOptions};
use wimu_host::decode::{Decoder, Event};
use wimu_host::mcap_file::{ClockAnchor, Recorded, RecordingReader, RecordingWriter};
use wimu_host::transport::Transport;
use wimu_link::LinkRole;
use wimu_link::auth::DeviceKey;
use wimu_model::ParameterId;

use crate::board::{SimLink, VirtualBoard};
use crate::scene::Scene;

/// A host on both links of a board in virtual time, which records everything.
pub struct Host<'a, R> {
    /// Its client on the cable.
    pub cable: Client<End<'a, R>>,
    /// Its client on the wireless link.
    pub wireless: Client<End<'a, R>>,
    ends: Rc<RefCell<Ends<'a, R>>>,
    pub(super) board: &'a RefCell<R>,
    pub(super) scene: Scene,
    key: Option<DeviceKey>,
    /// Number of restarts of the board.
    pub(super) start: usize,
    heard: Vec<Recorded>,
}

impl<'a, R: VirtualBoard> Host<'a, R> {
    /// Connects to `board`, whose sensor is in `scene`.
    ///
    /// # Errors
    /// Those of [`Client::connect`].
    pub fn connect(board: &'a RefCell<R>, scene: Scene) -> Result<Self> {
        let ends = Rc::new(RefCell::new(Ends::of(board)));
        Ok(Self {
            board,
            scene,
            cable: client(&ends, LinkRole::Cable)?,
            wireless: client(&ends, LinkRole::Wireless)?,
            ends,
            key: None,
            start: 0,
            heard: Vec::new(),
        })
    }

    /// Sets the board's key over the cable; both clients sign with it.
    ///
    /// # Errors
    /// Those of [`Client::set_key`].
    pub fn set_key(&mut self, key: DeviceKey) -> Result<()> {
        self.cable.set_key(key)?;
        self.wireless.use_key(Some(key));
        self.key = Some(key);
        Ok(())
    }

    /// Restarts the board, once everything it has sent is read, and reconnects.
    ///
    /// # Errors
    /// Those of [`Client::connect`]; an error of the board.
    pub fn restart(&mut self) -> Result<()> {
        self.keep()?;
        self.board.borrow_mut().restart()?;
        self.start += 1;
        *self.ends.borrow_mut() = Ends::of(self.board);
        self.cable = client(&self.ends, LinkRole::Cable)?;
        self.wireless = client(&self.ends, LinkRole::Wireless)?;
        self.cable.use_key(self.key);
        self.wireless.use_key(self.key);
        Ok(())
    }

    /// Time since the board's first start, s.
    pub fn now_s(&self) -> f64 {
        self.board.borrow().now_us() as f64 * 1e-6
    }

    /// Runs until `end_s` and receives on both links.
    ///
    /// # Errors
    /// When a link fails.
    pub fn run_until(&mut self, end_s: f64) -> Result<()> {
        while self.now_s() < end_s {
            self.cable.next_event(Duration::from_millis(20))?;
            self.keep()?;
        }
        Ok(())
    }

    /// Stores the data of both links so far for the recording: whatever has arrived is read.
    fn keep(&mut self) -> Result<()> {
        for (index, client) in [&mut self.cable, &mut self.wireless].into_iter().enumerate() {
            while client.next_event(Duration::ZERO)?.is_some()
                || !self.ends.borrow().arrived[index].is_empty()
            {}
            self.heard.extend(client.take_data());
        }
        Ok(())
    }

    /// The recording so far, as an MCAP file.
    ///
    /// # Errors
    /// Those of writing a recording.
    pub fn file(&mut self) -> Result<Vec<u8>> {
        self.keep()?;
        self.heard.sort_by_key(Recorded::host_ns);
        let anchor = ClockAnchor { monotonic_ns: 0, utc_ns: 0 };
        let sink = Cursor::new(Vec::new());
        let mut writer = RecordingWriter::new(sink, "the recording", anchor)?;
        writer.keep_calibration(self.cable.hello().parameter_id)?;
        let mut decoder = Decoder::new();
        let mut reported = Vec::new();
        for entry in &self.heard {
            writer.record(entry)?;
            if let Recorded::Received(received) = entry
                && received.role == LinkRole::Cable
            {
                decoder.push(received.host_ns, &received.bytes, |arrival| {
                    if let Event::Parameters(parameters) = arrival.event {
                        reported.push(ParameterId(parameters.id));
                    }
                });
            }
        }
        for id in reported {
            writer.keep_calibration(id)?;
        }
        Ok(writer.finish()?.into_inner())
    }

    /// The recording so far, decoded.
    ///
    /// # Errors
    /// Those of reading a recording.
    pub fn recording(&mut self) -> Result<Capture> {
        let file = self.file()?;
        let name = "the recording";
        Capture::read(RecordingReader::new(Cursor::new(file), name)?, name)
    }
}

fn client<'a, R: VirtualBoard>(
    ends: &Rc<RefCell<Ends<'a, R>>>,
    role: LinkRole,
) -> Result<Client<End<'a, R>>> {
    let options = ConnectOptions {
        // Not random: the same bytes in every run.
        session: Some(1),
        keep_data: true,
        ..ConnectOptions::default()
    };
    let link = usize::from(role != LinkRole::Cable);
    let end = End { ends: Rc::clone(ends), link, received_at: Duration::ZERO };
    Client::connect(end, &format!("the simulated {role} link"), options)
}

const ROLES: [LinkRole; 2] = [LinkRole::Cable, LinkRole::Wireless];

/// The host's ends of both links. Waiting on one reads both, so that each byte has the time of
/// its arrival.
struct Ends<'a, R> {
    links: [SimLink<'a, R>; 2],
    /// Arrived, not yet read, with the times.
    arrived: [VecDeque<(Duration, Vec<u8>)>; 2],
}

impl<'a, R: VirtualBoard> Ends<'a, R> {
    fn of(board: &'a RefCell<R>) -> Self {
        Self { links: ROLES.map(|role| SimLink::new(board, role)), arrived: Default::default() }
    }

    /// Reads both links until there are data for `link`, for `timeout` at most.
    fn listen(&mut self, link: usize, timeout: Duration) -> Result<()> {
        let deadline = self.links[link].now() + timeout;
        loop {
            let left = deadline.saturating_sub(self.links[link].now());
            let waits = self.arrived[link].is_empty();
            for (index, end) in self.links.iter_mut().enumerate() {
                let wait = if index == link && waits { left.min(TICK) } else { Duration::ZERO };
                let mut buffer = [0; 4096];
                match end.read(&mut buffer, wait) {
                    Ok(0) => {}
                    Ok(count) => {
                        self.arrived[index].push_back((end.now(), buffer[..count].to_vec()));
                    }
                    // An error of the other link is reported when that is read.
                    Err(error) if index == link && waits => return Err(error),
                    Err(_) => {}
                }
            }
            if left.is_zero() || !self.arrived[link].is_empty() {
                return Ok(());
            }
        }
    }
}

/// Time for which one link is read before the other.
const TICK: Duration = Duration::from_millis(1);

/// The host's end of one link, see [`Host`].
pub struct End<'a, R> {
    ends: Rc<RefCell<Ends<'a, R>>>,
    link: usize,
    /// Of the latest data read.
    received_at: Duration,
}

impl<R: VirtualBoard> Transport for End<'_, R> {
    fn read(&mut self, buffer: &mut [u8], timeout: Duration) -> Result<usize> {
        let mut ends = self.ends.borrow_mut();
        ends.listen(self.link, timeout)?;
        let arrived = &mut ends.arrived[self.link];
        let Some((at, mut bytes)) = arrived.pop_front() else {
            return Ok(0);
        };
        self.received_at = at;
        let rest = bytes.split_off(bytes.len().min(buffer.len()));
        buffer[..bytes.len()].copy_from_slice(&bytes);
        if !rest.is_empty() {
            arrived.push_front((at, rest));
        }
        Ok(bytes.len())
    }

    fn write_all(&mut self, bytes: &[u8]) -> Result<()> {
        self.ends.borrow_mut().links[self.link].write_all(bytes)
    }

    fn now(&self) -> Duration {
        self.ends.borrow().links[self.link].now()
    }

    fn received_at(&self) -> Duration {
        self.received_at
    }

    fn baud(&self) -> Option<u32> {
        self.ends.borrow().links[self.link].baud()
    }
}
