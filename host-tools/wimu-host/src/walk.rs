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
}

/// One start of the device: its boot count, or where that did not arrive the one before and one.
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
            start: None,
            held: Vec::new(),
        });
        match entry {
            Recorded::Received(received) => {
                let mut outcome = Ok(());
                let Link {
                    decoder,
                    start,
                    held,
                    ..
                } = link;
                decoder.push(received.host_ns, &received.bytes, |arrival| {
                    match (&arrival.event, &mut *start) {
                        (Event::Restart, Some(start)) => *start += 1,
                        (Event::Hello(hello), Some(start)) => *start = hello.boot_count.max(*start),
                        (Event::Hello(hello), start) => *start = Some(hello.boot_count),
                        _ => {}
                    }
                    held.push(Step::Arrival(arrival));
                    if outcome.is_ok() && (start.is_some() || held.len() > MAX_HELD) {
                        let start = *start.get_or_insert(0);
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
        let known = self.links.values().find_map(|link| link.start);
        self.links
            .into_values()
            .map(|link| {
                // Nobody said which start this was: the other link's, if there is one.
                let start = link.start.or(known).unwrap_or(0);
                for step in link.held {
                    each(link.role, start, step)?;
                }
                Ok((link.role, link.decoder.statistics()))
            })
            .collect()
    }
}

/// Steps before the board has said who it is: more than arrive until it does.
const MAX_HELD: usize = 4096;

#[derive(Debug)]
struct Link {
    role: LinkRole,
    decoder: Decoder,
    start: Option<Start>,
    /// What came before the start was known.
    held: Vec<Step>,
}

impl Link {
    fn step(
        &mut self,
        step: Step,
        each: &mut impl FnMut(LinkRole, Start, Step) -> Result<()>,
    ) -> Result<()> {
        match self.start {
            Some(start) => each(self.role, start, step),
            None => {
                self.held.push(step);
                Ok(())
            }
        }
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
                Step::Lost { .. } => {}
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
