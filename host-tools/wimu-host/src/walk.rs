//! A recording from its start to its end, one event at a time, in memory that does not grow with its length.

use std::collections::BTreeMap;
use std::io::Read;

use wimu_link::LinkRole;
use wimu_link::auth::DeviceKey;

use crate::Result;
use crate::decode::{Arrival, Decoder, Event, LinkStatistics};
use crate::mcap_file::{Recorded, RecordingReader};

/// A step through a recording.
#[derive(Debug)]
#[allow(clippy::large_enum_variant, reason = "steps are handed on one at a time")]
pub enum Step {
    /// A link received something.
    Arrival(Arrival),
    /// What else was recorded of the link.
    Other(Recorded),
}

/// One start of the device, numbered in the order of detection, because boot counts may repeat. Starts on two links are
/// the same one if they began at the same time and have no different boot counts.
pub type Start = u32;

/// Reads a recording; `each` gets every step with its link and the device's start. Returns the statistics of each link.
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

/// Converts the entries of a recording to steps.
#[derive(Debug, Default)]
pub struct Walker {
    links: BTreeMap<LinkRole, Link>,
    starts: Starts,
    keys: Vec<DeviceKey>,
}

impl Walker {
    /// At the start of a recording.
    pub fn new() -> Self {
        Self::default()
    }

    /// The same with keys, with which tags are verified.
    pub fn with_keys(keys: Vec<DeviceKey>) -> Self {
        Self { keys, ..Self::default() }
    }

    /// Takes the next entry; `each` gets the completed steps.
    ///
    /// # Errors
    /// Those of `each`.
    pub fn push(
        &mut self,
        entry: Recorded,
        each: &mut impl FnMut(LinkRole, Start, Step) -> Result<()>,
    ) -> Result<()> {
        let role = entry.role();
        let link = self.links.entry(role).or_insert_with(|| {
            let mut decoder = Decoder::new();
            decoder.use_keys(self.keys.clone());
            Link { role, decoder, place: Place::default(), held: Vec::new() }
        });
        match entry {
            Recorded::Received(received) => {
                let mut outcome = Ok(());
                let Link { decoder, place, held, .. } = link;
                decoder.push(received.host_ns, &received.bytes, |arrival| {
                    place.see(&arrival, &mut self.starts);
                    held.push(Step::Arrival(arrival));
                    if outcome.is_ok() && (place.now.is_some() || held.len() > MAX_HELD) {
                        let start = place.settle(&mut self.starts);
                        outcome = held.drain(..).try_for_each(|step| each(role, start, step));
                    }
                });
                outcome
            }
            other => {
                match &other {
                    Recorded::Lost { .. } => link.decoder.interrupt(),
                    // What the link received in it is unknown.
                    Recorded::Damaged { .. } => link.decoder.skip(),
                    _ => {}
                }
                link.step(Step::Other(other), each)
            }
        }
    }

    /// The latest wire version other than ours on each link.
    pub(crate) fn foreign_versions(&self) -> BTreeMap<LinkRole, u8> {
        let version =
            |(role, link): (&LinkRole, &Link)| Some((*role, link.decoder.foreign_version()?));
        self.links.iter().filter_map(version).collect()
    }

    /// Ends the recording; returns the statistics of each link.
    ///
    /// # Errors
    /// Those of `each`.
    pub fn finish(
        mut self,
        each: &mut impl FnMut(LinkRole, Start, Step) -> Result<()>,
    ) -> Result<Vec<(LinkRole, LinkStatistics)>> {
        let known = self.links.values().find_map(|link| link.place.now);
        self.links
            .into_values()
            .map(|mut link| {
                // The start of this link was never identified: it is the other link's, if there is one.
                if link.place.before.is_none() {
                    link.place.now = link.place.now.or(known);
                }
                let start = link.place.settle(&mut self.starts);
                for step in link.held {
                    each(link.role, start, step)?;
                }
                Ok((link.role, link.decoder.statistics()))
            })
            .collect()
    }
}

/// Steps held until their start is identified, at most.
const MAX_HELD: usize = 4096;
/// Starts that two links report this far apart are one, ns: a link may be delayed.
const SAME_START_NS: u64 = 5_000_000_000;

#[derive(Debug)]
struct Link {
    role: LinkRole,
    decoder: Decoder,
    place: Place,
    /// Steps before the start was identified.
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

/// The starts reported by any link.
#[derive(Debug, Default)]
struct Starts(Vec<Known>);

/// What is known of a start.
#[derive(Clone, Copy, Debug, Default)]
struct Known {
    /// When it began, host time, ns, by the latest epoch of any link.
    began_ns: Option<u64>,
    /// As the device reports it: 0 at every start if it cannot count.
    boot_count: Option<u32>,
}

impl Starts {
    fn known(&self, start: Start) -> Known {
        self.0.get(start as usize).copied().unwrap_or_default()
    }

    fn add(&mut self, known: Known) -> Start {
        self.0.push(known);
        self.0.len() as Start - 1
    }

    /// The start of a link that began at `began`, after its start `before`; a new one if no link has reported it.
    fn find(&mut self, before: Option<Start>, began: Known) -> Start {
        let earliest = before.map_or(0, |before| before as usize + 1);
        let counted_before = before.and_then(|before| self.known(before).boot_count);
        // A link may be delayed by any time, but a boot count that has increased identifies the start.
        let counts = began.boot_count.is_some()
            && counted_before.is_some()
            && began.boot_count != counted_before;
        let apart = |known: &Known| match (known.boot_count, began.boot_count) {
            (Some(known), Some(count)) if known != count => None,
            (Some(_), Some(_)) if counts => Some(0),
            _ => {
                let apart = known.began_ns?.abs_diff(began.began_ns?);
                (apart <= SAME_START_NS).then_some(apart)
            }
        };
        let known = self.0.iter().enumerate().skip(earliest);
        let near = known.filter_map(|(index, known)| Some((apart(known)?, index as Start)));
        match near.min() {
            Some((_, start)) => start,
            None => self.add(began),
        }
    }

    /// Stores what a link reports of its start.
    fn note(&mut self, start: Start, reported: Known) {
        if let Some(known) = self.0.get_mut(start as usize) {
            known.began_ns = reported.began_ns.or(known.began_ns);
            known.boot_count = known.boot_count.or(reported.boot_count);
        }
    }
}

/// The start that a link is in.
#[derive(Debug, Default)]
struct Place {
    now: Option<Start>,
    before: Option<Start>,
    /// Boot count of a new start before the time of its beginning is known.
    boot_count: Option<u32>,
}

impl Place {
    fn see(&mut self, arrival: &Arrival, starts: &mut Starts) {
        let began_ns = |time_us: u64| arrival.host_ns.saturating_sub(time_us.saturating_mul(1000));
        let reported = match &arrival.event {
            Event::Restart { boot_count } => {
                self.before = self.now.or(self.before);
                self.now = None;
                self.boot_count = *boot_count;
                return;
            }
            Event::Hello(hello) => Known {
                // A delayed greeting adds nothing to an identified start, and it may belong to the next one.
                began_ns: self.now.is_none().then(|| began_ns(hello.uptime_us)),
                boot_count: Some(hello.boot_count),
            },
            Event::Epoch { epoch, .. } => {
                Known { began_ns: Some(began_ns(epoch.time_us)), boot_count: self.boot_count }
            }
            _ => return,
        };
        let before = self.before;
        let start = *self.now.get_or_insert_with(|| starts.find(before, reported));
        starts.note(start, reported);
    }

    /// The start; a new one if none was identified.
    fn settle(&mut self, starts: &mut Starts) -> Start {
        let boot_count = self.boot_count;
        *self.now.get_or_insert_with(|| starts.add(Known { began_ns: None, boot_count }))
    }
}
