//! A recording from its start to its end, an event at a time: memory does not grow with its length.

use std::collections::BTreeMap;
use std::io::Read;

use wimu_link::LinkRole;

use crate::Result;
use crate::clock::{ClockEstimator, ClockModel};
use crate::decode::{Arrival, Decoder, Event, LinkStatistics};
use crate::mcap_file::{Recorded, RecordingReader};

/// Something at its place in a recording.
#[derive(Debug)]
#[allow(
    clippy::large_enum_variant,
    reason = "steps are handed on one at a time"
)]
pub enum Step {
    /// A link brought something.
    Arrival(Arrival),
    /// The host sent these bytes.
    Sent {
        /// Before they were written, ns on the host's monotonic clock.
        host_ns: u64,
        /// As sent.
        bytes: Vec<u8>,
    },
    /// The link was lost.
    Lost {
        /// When, ns on the host's monotonic clock.
        host_ns: u64,
    },
    /// A part of the file is damaged and left out: what the link brought in it is not known.
    Damaged,
}

/// One start of the device: its boot count where that is known. Where it is not, the start of the other
/// link that began at the same time; else the one before and one.
pub type Start = u32;

/// Walks through a recording; `each` gets every step with its link and the device's start.
/// Returns what each link carried and lost.
///
/// # Errors
/// Those of [`RecordingReader::next_entry`], and of `each`.
pub fn walk<R: Read>(
    reader: &mut RecordingReader<R>,
    mut each: impl FnMut(LinkRole, Start, Step) -> Result<()>,
) -> Result<Vec<(LinkRole, LinkStatistics)>> {
    let mut walker = Walker::new();
    while let Some(entry) = reader.next_entry()? {
        walker.push(entry, &mut each)?;
    }
    walker.finish(&mut each)
}

/// Makes steps of a recording's entries.
#[derive(Debug, Default)]
pub struct Walker {
    links: BTreeMap<u8, Link>,
    begun: Begun,
}

impl Walker {
    /// At the start of a recording.
    pub fn new() -> Self {
        Self::default()
    }

    /// Takes the next entry; `each` gets the steps that it completes.
    ///
    /// # Errors
    /// Those of `each`.
    pub fn push(
        &mut self,
        entry: Recorded,
        each: &mut impl FnMut(LinkRole, Start, Step) -> Result<()>,
    ) -> Result<()> {
        let role = entry.role();
        let link = self.links.entry(role.number()).or_insert_with(|| Link {
            role,
            decoder: Decoder::new(),
            place: Place::default(),
            held: Vec::new(),
        });
        match entry {
            Recorded::Received(received) => {
                let mut outcome = Ok(());
                let Link {
                    decoder,
                    place,
                    held,
                    ..
                } = link;
                decoder.push(received.host_ns, &received.bytes, |arrival| {
                    place.see(&arrival, &mut self.begun);
                    held.push(Step::Arrival(arrival));
                    if outcome.is_ok() && (place.now.is_some() || held.len() > MAX_HELD) {
                        let start = place.settle();
                        outcome = held.drain(..).try_for_each(|step| each(role, start, step));
                    }
                });
                outcome
            }
            Recorded::Sent { host_ns, bytes, .. } => link.step(Step::Sent { host_ns, bytes }, each),
            Recorded::Lost { host_ns, .. } => {
                link.decoder.interrupt();
                link.step(Step::Lost { host_ns }, each)
            }
            Recorded::Damaged { .. } => {
                link.decoder.skip();
                link.step(Step::Damaged, each)
            }
            Recorded::Connected { .. } => Ok(()),
        }
    }

    /// The recording is over: what each link carried and lost.
    ///
    /// # Errors
    /// Those of `each`.
    pub fn finish(
        self,
        each: &mut impl FnMut(LinkRole, Start, Step) -> Result<()>,
    ) -> Result<Vec<(LinkRole, LinkStatistics)>> {
        let known = self.links.values().find_map(|link| link.place.now);
        self.links
            .into_values()
            .map(|mut link| {
                // Nobody said which start this was: the other link's, if there is one.
                if link.place.before.is_none() {
                    link.place.now = link.place.now.or(known);
                }
                let start = link.place.settle();
                for step in link.held {
                    each(link.role, start, step)?;
                }
                Ok((link.role, link.decoder.statistics()))
            })
            .collect()
    }
}

/// Steps before it is known which start they are of: more than arrive until it is.
const MAX_HELD: usize = 4096;
/// Starts of which two links say that they began so far apart are one, ns: a link may be late.
const SAME_START_NS: u64 = 5_000_000_000;

#[derive(Debug)]
struct Link {
    role: LinkRole,
    decoder: Decoder,
    place: Place,
    /// What came before the start was known.
    held: Vec<Step>,
}

impl Link {
    fn step(
        &mut self,
        step: Step,
        each: &mut impl FnMut(LinkRole, Start, Step) -> Result<()>,
    ) -> Result<()> {
        match self.place.now {
            Some(start) => each(self.role, start, step),
            None => {
                self.held.push(step);
                Ok(())
            }
        }
    }
}

/// When each start began, ns of the host, as the links tell: the latest of both.
#[derive(Debug, Default)]
struct Begun(BTreeMap<Start, u64>);

impl Begun {
    /// The start that began at about `began_ns`.
    fn at(&self, began_ns: u64) -> Option<Start> {
        let apart = |(start, known): (&Start, &u64)| (known.abs_diff(began_ns), *start);
        let (apart, start) = self.0.iter().map(apart).min()?;
        (apart <= SAME_START_NS).then_some(start)
    }
}

/// Which start a link is in.
#[derive(Debug, Default)]
struct Place {
    now: Option<Start>,
    before: Option<Start>,
}

impl Place {
    fn see(&mut self, arrival: &Arrival, begun: &mut Begun) {
        let began_ns = |time_us: u64| arrival.host_ns.saturating_sub(time_us.saturating_mul(1000));
        match &arrival.event {
            Event::Restart { boot_count } => {
                self.before = self.now.or(self.before);
                self.now = *boot_count;
            }
            Event::Hello(hello) => {
                self.now = Some(hello.boot_count);
                begun.0.insert(hello.boot_count, began_ns(hello.uptime_us));
            }
            Event::Epoch { epoch, .. } => {
                let began_ns = began_ns(epoch.time_us);
                if self.now.is_none() {
                    let next = |before: Start| before.saturating_add(1);
                    self.now = begun.at(began_ns).or(self.before.map(next));
                }
                if let Some(start) = self.now {
                    begun.0.insert(start, began_ns);
                }
            }
            _ => {}
        }
    }

    /// The start, for want of a sign the one after that before.
    fn settle(&mut self) -> Start {
        let next = self.before.map_or(0, |before| before.saturating_add(1));
        *self.now.get_or_insert(next)
    }
}

/// The device's clock in each of its starts, by both links together and by each alone.
#[derive(Debug, Default)]
pub struct Clocks {
    joint: BTreeMap<Start, ClockEstimator>,
    single: BTreeMap<(u8, Start), ClockEstimator>,
}

impl Clocks {
    /// Takes a step of [`walk`].
    pub fn see(&mut self, role: LinkRole, start: Start, step: &Step) {
        let joint = self.joint.entry(start).or_default();
        let single = self.single.entry((role.number(), start)).or_default();
        for clock in [joint, single] {
            match step {
                Step::Arrival(arrival) => {
                    clock.heard(role, arrival);
                }
                Step::Sent { host_ns, bytes } => clock.asked(*host_ns, bytes),
                Step::Lost { .. } | Step::Damaged => {}
            }
        }
    }

    /// The best clocks there are: from both links.
    pub fn models(&self) -> BTreeMap<Start, ClockModel> {
        let model = |(start, clock): (&Start, &ClockEstimator)| Some((*start, clock.model()?));
        self.joint.iter().filter_map(model).collect()
    }

    /// A link's own view of the longest start.
    pub fn of_link(&self, role: LinkRole) -> Option<ClockModel> {
        self.single
            .iter()
            .filter(|((number, _), _)| *number == role.number())
            .max_by_key(|(_, clock)| clock.transfers())
            .and_then(|(_, clock)| clock.model())
    }
}
