//! A recording of wimu: all of it in memory, or a survey of it.

use std::collections::{BTreeMap, BTreeSet};
use std::io::Read;
use std::path::Path;
use std::sync::OnceLock;

use wimu_link::auth::DeviceKey;
use wimu_link::batch::Stream;
use wimu_link::{LinkRole, WIRE_VERSION};

use super::{EpochMark, Link};
use crate::calibration::source::ActiveParameters;
use crate::clock::{ClockEstimator, ClockModel};
use crate::decode::Event;
use crate::mcap_file::{ClockAnchor, Recorded, RecordingReader, Wholeness};
use crate::units::{RawUnits, SampleUnit};
use crate::walk::{Start, Step, Walker};
use crate::{Code, Result};

/// Items of each kind that a survey keeps.
const SURVEYED: usize = 64;

/// A recording, decoded.
#[derive(Clone, Debug)]
pub struct Capture {
    /// Name of the file in errors.
    pub name: String,
    /// Its links.
    pub links: BTreeMap<LinkRole, Link>,
    /// The starts of the device, from both links together.
    pub starts: BTreeMap<Start, StartData>,
    /// Identifiers of the devices.
    pub devices: BTreeSet<u64>,
    /// Host's monotonic clock to UTC.
    pub anchor: Option<ClockAnchor>,
    /// Host time from the first bytes to the last, ns.
    pub duration_ns: u64,
    /// Completeness of the file.
    pub wholeness: Wholeness,
}

/// What both links together show of a start of the device.
#[derive(Clone, Debug, Default)]
pub struct StartData {
    clock: OnceLock<Option<ClockModel>>,
    /// Units of the raw samples, by sensor. An epoch that one link lost may have arrived on the other.
    units: BTreeMap<u8, RawUnits>,
    estimator: ClockEstimator,
}

impl StartData {
    /// The device's clock, from both links together; `None` without [`Capture::survey_of`].
    pub fn clock(&self) -> Option<&ClockModel> {
        let model = self.clock.get_or_init(|| self.estimator.model());
        model.as_ref()
    }

    /// The unit of a sample; `None` for a raw one whose range is unknown.
    pub fn unit(&self, stream: Stream, sensor: u8, sequence: u32) -> Option<SampleUnit> {
        match stream {
            Stream::Raw => Some(SampleUnit::Raw(self.units.get(&sensor)?.of(sequence)?)),
            Stream::Corrected => Some(SampleUnit::Corrected),
        }
    }

    fn see(&mut self, role: LinkRole, step: &Step, has_clock: bool) {
        match step {
            Step::Arrival(arrival) => {
                if has_clock {
                    self.estimator.heard(role, arrival);
                }
                if let Event::Epoch { epoch, .. } = &arrival.event {
                    self.units.entry(epoch.sensor).or_default().see(epoch);
                }
            }
            Step::Other(Recorded::Sent { host_ns, bytes, .. }) => {
                self.estimator.asked(*host_ns, bytes);
            }
            Step::Other(_) => {}
        }
    }
}

impl Capture {
    /// Reads and decodes a recording. One that was cut off gives its readable part.
    ///
    /// # Errors
    /// Those of [`Capture::read`].
    pub fn load(path: &Path) -> Result<Self> {
        Self::read(RecordingReader::open(path)?, &crate::untrusted::name(path))
    }

    /// The same from an open reader; `name` is its name in errors.
    ///
    /// # Errors
    /// Those of [`RecordingReader`]; `bad_recording` when all boards in it use another wire version.
    pub fn read<R: Read>(reader: RecordingReader<R>, name: &str) -> Result<Self> {
        let walker = Walker::new();
        Self::listen(walker, reader, name, (usize::MAX / 2, false), |_, _, _| {})
    }

    /// Counts, clocks and units of a recording, with the latest data only: memory does not grow with its length. Tags are
    /// verified with the keys.
    ///
    /// # Errors
    /// Those of [`Capture::read`].
    pub fn survey(path: &Path, keys: Vec<DeviceKey>) -> Result<Self> {
        let name = crate::untrusted::name(path);
        let (walker, reader) = (Walker::with_keys(keys), RecordingReader::open(path)?);
        Self::listen(walker, reader, &name, (SURVEYED, false), |_, _, _| {})
    }

    /// The same from an open reader, with the clock of each start from both links; `each` gets every step.
    ///
    /// # Errors
    /// Those of [`Capture::read`].
    pub fn survey_of<R: Read>(
        reader: RecordingReader<R>,
        name: &str,
        each: impl FnMut(LinkRole, Start, &Step),
    ) -> Result<Self> {
        Self::listen(Walker::new(), reader, name, (SURVEYED, true), each)
    }

    /// Reads a recording from start to end and keeps the latest `kept` items of each kind, with clocks from both links or
    /// without; `each` gets every step.
    fn listen<R: Read>(
        mut walker: Walker,
        mut reader: RecordingReader<R>,
        name: &str,
        (kept, has_clocks): (usize, bool),
        mut each: impl FnMut(LinkRole, Start, &Step),
    ) -> Result<Self> {
        let anchor = reader.anchor()?;
        let mut links: BTreeMap<LinkRole, Link> = BTreeMap::new();
        let mut starts: BTreeMap<Start, StartData> = BTreeMap::new();
        let mut devices = BTreeSet::new();
        let mut span: Option<(u64, u64)> = None;
        let mut take = |role: LinkRole, start: Start, step: Step| {
            each(role, start, &step);
            let known = starts.entry(start).or_default();
            known.see(role, &step, has_clocks);
            let link = (links.entry(role)).or_insert_with(|| Link::new(role));
            match &step {
                Step::Arrival(arrival) => {
                    if let Event::Hello(hello) = &arrival.event {
                        devices.insert(hello.device_id);
                    }
                    link.take(arrival);
                    let boot = link.latest();
                    boot.start = Some(start);
                    boot.keep_latest(kept);
                }
                Step::Other(Recorded::Sent { host_ns, bytes, .. }) => {
                    link.latest().clock.asked(*host_ns, bytes);
                }
                Step::Other(_) => {}
            }
            Ok(())
        };
        while let Some(entry) = reader.next_entry()? {
            if let Recorded::Received(received) = &entry {
                let (first, last) = span.unwrap_or((received.host_ns, received.host_ns));
                span = Some((first.min(received.host_ns), last.max(received.host_ns)));
            }
            walker.push(entry, &mut take)?;
        }
        let versions = walker.foreign_versions();
        for (role, carried) in walker.finish(&mut take)? {
            let link = (links.entry(role)).or_insert_with(|| Link::new(role));
            link.statistics = carried;
            link.boots.iter_mut().for_each(|boot| boot.ended = true);
        }
        readable(&links, &versions).map_err(|error| error.at(name))?;
        share_parameters(&mut links);
        Ok(Self {
            name: name.to_owned(),
            links,
            starts,
            devices,
            anchor,
            duration_ns: span.map_or(0, |(first, last)| last - first),
            wholeness: reader.wholeness(),
        })
    }

    /// The link of a role; `None` takes the cable if it has raw samples, else the link with the most.
    ///
    /// # Errors
    /// `no_rows` when there is none.
    pub fn link(&self, role: Option<LinkRole>) -> Result<&Link> {
        let raw = |link: &&Link| link.count(0, Stream::Raw);
        let found = match role {
            Some(role) => self.links.get(&role),
            None => (self.links.get(&LinkRole::Cable))
                .filter(|link| raw(link) > 0)
                .or_else(|| self.links.values().max_by_key(raw)),
        };
        found.ok_or_else(|| {
            let what = role.map_or("any link".to_owned(), |role| format!("the {role} link"));
            let message = format!("nothing was recorded on {what}");
            let error = Code::NoRows.error(message, "record again, or name the other link");
            error.at(&self.name)
        })
    }
}

/// Refuses a recording whose links all use another wire version.
fn readable(links: &BTreeMap<LinkRole, Link>, versions: &BTreeMap<LinkRole, u8>) -> Result<()> {
    let foreign = |(role, link): (&LinkRole, &Link)| {
        let version = versions.get(role)?;
        let has_epochs = link.boots.iter().any(|boot| boot.counts.epochs > 0);
        (!has_epochs && *version != WIRE_VERSION).then_some(*version)
    };
    match links.iter().map(foreign).collect::<Option<Vec<u8>>>().as_deref() {
        Some([version, ..]) => Err(Code::BadRecording.error(
            format!(
                "the board uses version {version} of the protocol, this wimu version {WIRE_VERSION}"
            ),
            "read it with the version of wimu that recorded it",
        )),
        _ => Ok(()),
    }
}

/// Gives each start the parameter sets that its epochs name and that only other starts or links have: a link may
/// have lost them. A set is identified by its content.
fn share_parameters(links: &mut BTreeMap<LinkRole, Link>) {
    let boots = || links.values().flat_map(|link| &link.boots);
    let known: Vec<ActiveParameters> = boots()
        .flat_map(|boot| &boot.parameters)
        .filter(|set| set.active.is_some())
        .copied()
        .collect();
    for boot in links.values_mut().flat_map(|link| &mut link.boots) {
        for set in &known {
            let uses = |mark: &EpochMark| mark.epoch.parameters == set.id;
            let has = |own: &ActiveParameters| own.id == set.id && own.active.is_some();
            if boot.epochs().iter().any(uses) && !boot.parameters.iter().any(has) {
                boot.parameters.insert(0, *set);
            }
        }
    }
}
