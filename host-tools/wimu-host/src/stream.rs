//! The joined stream of one link of a recording: its samples in order with what applies to them, part by part, in memory
//! that does not grow with the recording's length.
//!
//! A [`Part`] is a stretch of one start of the device. Late samples are in their place, and epochs, parameters, magnetic
//! field, temperature and positions that arrived after the samples which they belong to are there.

use std::collections::HashMap;
use std::io::Read;

use wimu_link::LinkRole;
use wimu_link::batch::Stream;
use wimu_link::message::{Environment, Epoch, Navigation};
use wimu_model::DeviceTimeUs;

use crate::Result;
use crate::capture::{Boot, Link};
use crate::decode::{Event, TimedSample, sequence_order};
use crate::mcap_file::RecordingReader;
use crate::walk::{Start, Step, Walker};

/// Device time for which samples wait for what belongs to them and arrives later, µs.
const WAIT_US: u64 = 10_000_000;
/// Items of a start after which a part of it is handed on.
const FULL: usize = 1 << 14;

/// A stretch of one start of the device.
#[derive(Debug)]
pub struct Part<'a> {
    /// Index of the start among those of the link, in their order.
    pub index: usize,
    /// The start: what is left of earlier parts, this part and what follows it.
    pub boot: &'a Boot,
    /// Whether it is the last part of its start.
    pub is_last: bool,
    /// The first epoch that is not in it.
    end: Option<Epoch>,
    /// Number of the latest sample of each track in the parts before.
    before: HashMap<(u8, Stream), u32>,
    /// Device time of the end of the part before, µs.
    from_us: Option<u64>,
}

impl Part<'_> {
    /// The samples of a track.
    pub fn samples(&self, sensor: u8, stream: Stream) -> &[TimedSample] {
        let all = self.boot.of(sensor, stream);
        let latest = self.before.get(&(sensor, stream));
        let is_before = |sample: &TimedSample| {
            latest.is_some_and(|latest| sequence_order(sample.sequence, *latest).is_le())
        };
        let is_within = |sample: &TimedSample| match (&self.end, sensor) {
            (None, _) => true,
            (Some(end), 0) => sequence_order(sample.sequence, end.sequence).is_lt(),
            (Some(end), _) => sample.time.0 < end.time_us,
        };
        let from = all.partition_point(is_before);
        let until = all.partition_point(is_within);
        &all[from..until.max(from)]
    }

    /// Magnetic fields and temperatures.
    pub fn environment(&self) -> &[Environment] {
        let all = &self.boot.environment;
        let until = |us: u64| all.partition_point(|environment| environment.time_us < us);
        let end = self.end.map_or(all.len(), |end| until(end.time_us));
        &all[self.from_us.map_or(0, until).min(end)..end]
    }

    /// Velocities and positions.
    pub fn navigation(&self) -> &[Navigation] {
        let all = &self.boot.navigation;
        let end = self.end.map_or(all.len(), |end| {
            all.partition_point(|sent| sequence_order(sent.sequence, end.sequence).is_lt())
        });
        &all[..end]
    }

    /// The magnetic field and temperature at a device time: the latest until then.
    pub fn environment_at(&self, time: DeviceTimeUs) -> Option<&Environment> {
        let all = &self.boot.environment;
        let after = all.partition_point(|environment| environment.time_us <= time.0);
        all.get(after.checked_sub(1)?)
    }
}

impl<'a> From<&'a Boot> for Part<'a> {
    /// All of a start.
    fn from(boot: &'a Boot) -> Self {
        Self { index: 0, boot, is_last: true, end: None, before: HashMap::new(), from_us: None }
    }
}

/// Reads one link of a recording; `each` gets its parts in order.
///
/// # Errors
/// Those of [`RecordingReader::next_entry`], and of `each`.
pub fn read<R: Read>(
    reader: &mut RecordingReader<R>,
    role: LinkRole,
    mut each: impl FnMut(&Part) -> Result<()>,
) -> Result<()> {
    let mut window = Window::new(role);
    let mut walker = Walker::new();
    let mut take = |_: LinkRole, _: Start, step: Step| match step {
        Step::Arrival(arrival) => window.take(&arrival.event, &mut each),
        _ => Ok(()),
    };
    while let Some(entry) = reader.next_entry()? {
        if entry.role() == role {
            walker.push(entry, &mut take)?;
        }
    }
    walker.finish(&mut take)?;
    window.end(&mut each)
}

/// The data of a link that still wait, and those that later ones need.
struct Window {
    link: Link,
    index: usize,
    before: HashMap<(u8, Stream), u32>,
    from_us: Option<u64>,
}

impl Window {
    fn new(role: LinkRole) -> Self {
        Self { link: Link::new(role), index: 0, before: HashMap::new(), from_us: None }
    }

    fn take(&mut self, event: &Event, each: &mut impl FnMut(&Part) -> Result<()>) -> Result<()> {
        self.link.take_event(event);
        if self.link.boots.len() > 1 {
            self.hand_on(None, each)?;
            self.link.boots.remove(0);
            self.index += 1;
            self.before.clear();
            self.from_us = None;
        }
        let boot = self.link.latest();
        let samples: usize = boot.samples.values().map(Vec::len).sum();
        let others = boot.navigation.len() + boot.environment.len();
        if samples + others < FULL
            || !matches!(event, Event::Epoch { epoch, .. } if epoch.sensor == 0)
        {
            return Ok(());
        }
        let epochs = boot.epochs();
        let latest_us = epochs.last().map_or(0, |mark| mark.epoch.time_us);
        let ended = latest_us.saturating_sub(WAIT_US);
        let after = epochs.partition_point(|mark| mark.epoch.time_us <= ended);
        match after.checked_sub(1).map(|last| epochs[last].epoch) {
            Some(end) => self.hand_on(Some(end), each),
            None => Ok(()),
        }
    }

    fn end(mut self, each: &mut impl FnMut(&Part) -> Result<()>) -> Result<()> {
        self.hand_on(None, each)
    }

    /// Hands on what precedes an epoch, or all, and drops it.
    fn hand_on(
        &mut self,
        end: Option<Epoch>,
        each: &mut impl FnMut(&Part) -> Result<()>,
    ) -> Result<()> {
        let boot = &mut self.link.boots[0];
        let part = Part {
            index: self.index,
            boot,
            is_last: end.is_none(),
            end,
            before: self.before.clone(),
            from_us: self.from_us,
        };
        each(&part)?;
        let Some(end) = end else { return Ok(()) };
        let navigation = part.navigation().len();
        for (sensor, stream) in boot.samples.keys() {
            if let Some(last) = part.samples(*sensor, *stream).last() {
                self.before.insert((*sensor, *stream), last.sequence);
            }
        }
        self.from_us = Some(end.time_us);
        boot.navigation.drain(..navigation);
        let is_before = |of: u32| sequence_order(of, end.sequence).is_lt();
        boot.attitude.retain(|sent| !is_before(sent.sequence));
        for (key, samples) in &mut boot.samples {
            if let Some(latest) = self.before.get(key) {
                let is_handed_on =
                    |sample: &TimedSample| sequence_order(sample.sequence, *latest).is_le();
                samples.drain(..samples.partition_point(is_handed_on));
            }
        }
        // The one before still applies.
        for marks in boot.marks.values_mut() {
            let ended = marks.partition_point(|mark| mark.epoch.time_us < end.time_us);
            marks.drain(..ended.saturating_sub(1));
        }
        let passed = (boot.environment).partition_point(|sent| sent.time_us < end.time_us);
        boot.environment.drain(..passed.saturating_sub(1));
        Ok(())
    }
}
