//! Summary of a recording, in memory that does not grow with its length.

use std::collections::BTreeMap;
use std::io::Read;
use std::path::Path;

use wimu_link::batch::Stream;
use wimu_link::frame::OLDEST_RECORDED;
use wimu_link::message::{ActiveParameters, Answer, Payload, Status};
use wimu_link::{Hello, LinkRole, WIRE_VERSION};
use wimu_model::ParameterId;

use crate::clock::{ClockEstimator, ClockModel};
use crate::decode::{Arrival, Event, LinkStatistics};
use crate::error::{ErrorCode, Result};
use crate::mcap_file::{ClockAnchor, Recorded, RecordingReader, Wholeness};
use crate::units::RawUnits;
use crate::walk::{Start, Step, Walker};

/// Largest number of events of a link kept as text.
const MAX_EVENTS: usize = 500;
/// Largest number of parameter changes kept of a link.
const MAX_PARAMETERS: usize = 500;

/// Summary of a recording.
#[derive(Clone, Debug)]
pub struct Overview {
    /// Its links, the cable first.
    pub links: Vec<LinkOverview>,
    /// Host's monotonic clock to UTC.
    pub anchor: Option<ClockAnchor>,
    /// Host time from the first bytes to the last, ns.
    pub duration_ns: u64,
    /// Completeness of the file.
    pub wholeness: Wholeness,
}

/// Summary of one link.
#[derive(Clone, Debug)]
pub struct LinkOverview {
    /// Which link.
    pub role: LinkRole,
    /// The device, as last reported.
    pub hello: Option<Hello>,
    /// One for each start of the device, the latest last; at least one.
    pub boots: Vec<BootOverview>,
    /// The parameters in use, in order: the first 500.
    pub parameter_ids: Vec<ParameterId>,
    /// Events of the device with their times: the first 500.
    pub events: Vec<String>,
    /// Number of further events.
    pub more_events: u64,
    /// The latest status.
    pub status: Option<Status>,
    /// Statistics of the link.
    pub statistics: LinkStatistics,
}

/// Summary of a link in one start of the device.
#[derive(Clone, Debug, Default)]
pub struct BootOverview {
    /// Raw samples.
    pub raw: usize,
    /// Corrected samples.
    pub corrected: usize,
    /// Epochs.
    pub epochs: usize,
    /// Velocities and positions.
    pub navigation: usize,
    /// The device's clock.
    pub clock: Option<ClockModel>,
    /// The parameter sets in use, each once: the first 500. A set is often reported after the first samples corrected
    /// with it.
    pub parameters: Vec<ActiveParameters>,
    /// Units of the raw samples.
    pub units: RawUnits,
    greeted: bool,
    estimator: ClockEstimator,
}

impl BootOverview {
    fn use_parameters(&mut self, set: ActiveParameters) {
        if !self.parameters.contains(&set) && self.parameters.len() < MAX_PARAMETERS {
            self.parameters.push(set);
        }
    }
}

impl Overview {
    /// Reads a recording. One that was cut off gives its readable part.
    ///
    /// # Errors
    /// Those of [`RecordingReader`]; `bad_recording` when all boards in it use another wire version.
    pub fn read(path: &Path) -> Result<Self> {
        let name = path.display().to_string();
        let heard = listen(RecordingReader::open(path)?, &name, LinkOverview::new)?;
        Ok(Self {
            links: heard.links,
            anchor: heard.anchor,
            duration_ns: heard.duration_ns,
            wholeness: heard.wholeness,
        })
    }

    /// The link of a role; `None` takes the cable if it has raw samples, else the link with the most.
    ///
    /// # Errors
    /// `no_rows` when there is none.
    pub fn link(&self, role: Option<LinkRole>) -> Result<&LinkOverview> {
        choose(&self.links, role, |link| (link.role, link.raw()))
    }
}

impl LinkOverview {
    fn new(role: LinkRole) -> Self {
        Self {
            role,
            hello: None,
            boots: vec![BootOverview::default()],
            parameter_ids: Vec::new(),
            events: Vec::new(),
            more_events: 0,
            status: None,
            statistics: LinkStatistics::default(),
        }
    }

    /// Raw samples of all starts.
    pub fn raw(&self) -> usize {
        self.boots.iter().map(|boot| boot.raw).sum()
    }

    fn latest(&mut self) -> &mut BootOverview {
        if self.boots.is_empty() {
            self.boots.push(BootOverview::default());
        }
        let last = self.boots.len() - 1;
        &mut self.boots[last]
    }
}

impl Listen for LinkOverview {
    fn take(&mut self, _: Start, arrival: &Arrival) {
        let role = self.role;
        let boot = self.latest();
        boot.estimator.heard(role, arrival);
        match &arrival.event {
            Event::Restart { .. } if boot.greeted || boot.raw + boot.epochs > 0 => {
                self.boots.push(BootOverview::default());
            }
            Event::Hello(hello) => {
                boot.greeted = true;
                self.hello = Some(*hello);
            }
            Event::Samples(samples) => match samples.stream {
                Stream::Raw => boot.raw += samples.values.len(),
                Stream::Corrected => boot.corrected += samples.values.len(),
            },
            Event::Epoch { epoch, .. } => {
                boot.epochs += 1;
                boot.units.see(epoch);
                let id = epoch.parameter_id();
                if self.parameter_ids.last() != Some(&id)
                    && self.parameter_ids.len() < MAX_PARAMETERS
                {
                    self.parameter_ids.push(id);
                }
            }
            Event::Navigation(_) => boot.navigation += 1,
            Event::Status(status) => self.status = Some(*status),
            Event::Reply { reply, .. } => match reply.answer {
                Answer::Accepted(Payload::Status(status)) => self.status = Some(status),
                Answer::Accepted(Payload::Parameters(set)) => boot.use_parameters(set),
                _ => {}
            },
            Event::Parameters(set) => boot.use_parameters(*set),
            Event::Device { time, event } => {
                // Persistent faults are reported again to each new listener.
                let text = format!("{:.2} s: {event}", time.to_seconds());
                if !self.events.contains(&text) {
                    if self.events.len() < MAX_EVENTS {
                        self.events.push(text);
                    } else {
                        self.more_events += 1;
                    }
                }
            }
            _ => {}
        }
    }

    fn asked(&mut self, host_ns: u64, bytes: &[u8]) {
        self.latest().estimator.asked(host_ns, bytes);
    }

    fn has_epochs(&self) -> bool {
        self.boots.iter().any(|boot| boot.epochs > 0)
    }

    fn finish(&mut self, statistics: LinkStatistics) {
        self.statistics = statistics;
        for boot in &mut self.boots {
            boot.clock = boot.estimator.model();
        }
    }
}

/// Receives the data of a link.
pub(crate) trait Listen {
    /// Takes an arrival in this start of the device.
    fn take(&mut self, start: Start, arrival: &Arrival);
    /// Takes bytes sent by the host.
    fn asked(&mut self, host_ns: u64, bytes: &[u8]);
    /// Whether any epoch could be decoded.
    fn has_epochs(&self) -> bool;
    /// Ends the recording.
    fn finish(&mut self, statistics: LinkStatistics);
}

/// The result of [`listen`].
pub(crate) struct Heard<L> {
    /// The cable first.
    pub links: Vec<L>,
    pub anchor: Option<ClockAnchor>,
    pub duration_ns: u64,
    pub wholeness: Wholeness,
}

/// Reads a recording from start to end, each link into a listener made by `new`.
pub(crate) fn listen<R: Read, L: Listen>(
    mut reader: RecordingReader<R>,
    name: &str,
    new: impl Fn(LinkRole) -> L,
) -> Result<Heard<L>> {
    let anchor = reader.anchor()?;
    let mut walker = Walker::new();
    let mut links: BTreeMap<u8, L> = BTreeMap::new();
    let mut span: Option<(u64, u64)> = None;
    let mut each = |role: LinkRole, start, step| {
        let link = links.entry(role.number()).or_insert_with(|| new(role));
        match step {
            Step::Arrival(arrival) => link.take(start, &arrival),
            Step::Sent { host_ns, bytes } => link.asked(host_ns, &bytes),
            Step::Lost { .. } | Step::Connected { .. } | Step::Damaged => {}
        }
        Ok(())
    };
    while let Some(entry) = reader.next_entry()? {
        if let Recorded::Received(received) = &entry {
            let (first, last) = span.unwrap_or((received.host_ns, received.host_ns));
            span = Some((first.min(received.host_ns), last.max(received.host_ns)));
        }
        walker.push(entry, &mut each)?;
    }
    let versions = walker.foreign_versions();
    for (role, carried) in walker.finish(&mut each)? {
        let link = links.entry(role.number()).or_insert_with(|| new(role));
        link.finish(carried);
    }
    let readable = OLDEST_RECORDED..=WIRE_VERSION;
    let foreign = |(role, link): (&u8, &L)| {
        let version = versions.get(role)?;
        (!link.has_epochs() && !readable.contains(version)).then_some(version)
    };
    if !links.is_empty()
        && let Some(versions) = links.iter().map(foreign).collect::<Option<Vec<&u8>>>()
    {
        return Err(ErrorCode::BadRecording.error(format!(
                "the board uses version {} of the protocol, this wimu reads versions {OLDEST_RECORDED} to {WIRE_VERSION}",
                versions[0]
            ),
            "read it with the version of wimu that recorded it",
        )
        .at(name));
    }
    Ok(Heard {
        links: links.into_values().collect(),
        anchor,
        duration_ns: span.map_or(0, |(first, last)| last - first),
        wholeness: reader.wholeness(),
    })
}

/// The link of a role; `None` takes the cable if it has raw samples, else the link with the most. `of`
/// returns role and number of raw samples of a link.
pub(crate) fn choose<L>(
    links: &[L],
    role: Option<LinkRole>,
    of: impl Fn(&L) -> (LinkRole, usize),
) -> Result<&L> {
    let found = match role {
        Some(role) => links.iter().find(|link| of(link).0 == role),
        None => links
            .iter()
            .find(|link| of(link).0 == LinkRole::Cable && of(link).1 > 0)
            .or_else(|| links.iter().max_by_key(|link| of(link).1)),
    };
    found.ok_or_else(|| {
        let what = role.map_or("any link".to_owned(), |role| format!("the {role} link"));
        ErrorCode::NoRows.error(
            format!("nothing was recorded on {what}"),
            "record again, or name the other link",
        )
    })
}
