//! Pairs of samples with the same number on both links, and the samples that one of them lost, in bounded memory.

use std::collections::{BTreeMap, VecDeque};
use std::ops::RangeInclusive;

use super::holes::Holes;
use super::in_order;
use crate::clock::ClockModel;
use crate::decode::{TimedSample, sequence_order};
use crate::walk::Start;

/// Largest number of samples that wait for their counterpart: over three minutes at 1344 Hz.
const MAX_WAITING: usize = 1 << 18;
/// Largest number of starts with waiting samples.
const MAX_STARTS: usize = 4;

/// Largest number of missing samples of a link that may still arrive late.
const MAX_LACKED: usize = 1 << 14;

/// X, Y, Z of the accelerometer and, if there is one, of the gyroscope, LSB.
pub(super) type Values = ([i32; 3], Option<[i32; 3]>);

/// A sample of a link.
#[derive(Clone, Copy, Debug)]
struct Taken {
    /// Its sequence number.
    number: u32,
    values: Values,
    /// Host time, ns: negative for samples taken before that clock began.
    taken_ns: i64,
}

/// When and how a link is heard.
#[derive(Clone, Copy, Debug)]
pub(super) struct Heard {
    /// Host time since which samples are expected, ns.
    pub from_ns: i64,
    /// Its first decimation.
    pub every: u8,
}

/// Consecutive samples of the other link that a link did not deliver.
#[derive(Default)]
pub(super) struct Run {
    /// Host times of the first of them, ns.
    pub taken_ns: Vec<i64>,
    /// Number of further ones.
    pub more: u64,
}

impl Run {
    fn push(&mut self, taken_ns: i64) {
        if self.taken_ns.len() < MAX_WAITING {
            self.taken_ns.push(taken_ns);
        } else {
            self.more += 1;
        }
    }
}

/// Samples that a link did not deliver before its first one of each start and after its last.
#[derive(Default)]
pub(super) struct AtEnds {
    /// In order of time.
    pub lost: Vec<Run>,
    /// Samples taken before the link was heard.
    pub before: u64,
    /// Samples that may still have been under way.
    pub under_way: u64,
}

/// Finds pairs of samples with the same number.
pub(super) struct Pairing<'a> {
    holes: &'a Holes,
    heard: [Heard; 2],
    starts: BTreeMap<Start, [Waiting; 2]>,
    /// Samples that the other link delivered and this one did not, between its first and last.
    lost: [u64; 2],
    /// The latest of these.
    lacked: [VecDeque<(Start, Taken)>; 2],
    at_ends: [AtEnds; 2],
}

#[derive(Default)]
struct Waiting {
    samples: VecDeque<Taken>,
    /// The first number of the link.
    first: Option<u32>,
    /// Samples of the other link before it.
    before_first: Run,
    /// Samples of the other link that are not expected.
    before_heard: u64,
    /// Host time since which samples are expected, ns.
    from_ns: i64,
    /// Decimation.
    every: u8,
    /// Numbers in missing parts of the file.
    holes: Vec<RangeInclusive<u32>>,
}

impl Waiting {
    /// Whether the link carries this sample, given that it has delivered `known`.
    fn carries(&self, number: u32, known: u32) -> bool {
        if self.holes.iter().any(|hole| hole.contains(&number)) {
            return false;
        }
        let distance = known.wrapping_sub(number) as i32;
        distance.unsigned_abs().is_multiple_of(self.every.max(1).into())
    }

    /// Takes a `sample` of the other link that this one, which has delivered `known`, has not.
    /// Returns whether it is lost between this link's first and last.
    fn lacks(&mut self, sample: Taken, known: u32) -> bool {
        if !self.carries(sample.number, known) {
            return false;
        }
        let is_between =
            self.first.is_some_and(|first| sequence_order(sample.number, first).is_gt());
        if !is_between && sample.taken_ns <= self.from_ns {
            self.before_heard += 1;
        } else if !is_between {
            self.before_first.push(sample.taken_ns);
        }
        is_between
    }
}

impl<'a> Pairing<'a> {
    pub fn new(heard: [Heard; 2], holes: &'a Holes) -> Self {
        Self {
            holes,
            heard,
            starts: BTreeMap::new(),
            lost: [0; 2],
            lacked: Default::default(),
            at_ends: Default::default(),
        }
    }

    /// Takes a sample of a link, late or not; returns the other link's values, if it has
    /// arrived.
    pub fn pair(
        &mut self,
        link: usize,
        start: Start,
        sample: &TimedSample,
        every: u8,
        is_late: bool,
        clock: &ClockModel,
    ) -> Option<Values> {
        let taken = Taken {
            number: sample.sequence,
            values: (sample.value, sample.rate),
            taken_ns: clock.host_ns(sample.time) as i64,
        };
        if is_late {
            self.take_late(link, start, taken)
        } else {
            self.take(link, start, taken, every)
        }
    }

    /// Takes a link's next sample, with decimation `every`; returns the other link's values, if it has
    /// arrived.
    fn take(&mut self, link: usize, start: Start, sample: Taken, every: u8) -> Option<Values> {
        self.heard[link].every = every;
        let [own, other] = self.links(link, start);
        let number = sample.number;
        own.first.get_or_insert(number);
        own.every = every;
        let mut twin = None;
        let mut lacked = [Vec::new(), Vec::new()];
        // Each link delivers its samples in order, except late ones: what the other has delivered before
        // this one will not arrive.
        while let Some(before) = other.samples.front().copied() {
            if sequence_order(before.number, number).is_gt() {
                break;
            }
            other.samples.pop_front();
            if before.number == number {
                twin = Some(before.values);
            } else if own.lacks(before, number) {
                lacked[link].push(before);
            }
        }
        if twin.is_some() {
            // The other link is ahead: the waiting samples of this one have no counterpart.
            for before in std::mem::take(&mut own.samples) {
                if other.lacks(before, number) {
                    lacked[1 - link].push(before);
                }
            }
        } else {
            own.samples.push_back(sample);
        }
        if own.samples.len() > MAX_WAITING
            && let Some(before) = own.samples.pop_front()
            && other.lacks(before, other.first.unwrap_or(0))
        {
            lacked[1 - link].push(before);
        }
        for (link, lacked) in lacked.into_iter().enumerate() {
            self.lost[link] += lacked.len() as u64;
            let known = &mut self.lacked[link];
            known.extend(lacked.into_iter().map(|sample| (start, sample)));
            let old = known.len().saturating_sub(MAX_LACKED);
            known.drain(..old);
        }
        if self.starts.len() > MAX_STARTS
            && let Some((_, links)) = self.starts.pop_first()
        {
            self.end(links, None);
        }
        twin
    }

    /// Takes a late sample of a link; returns the other link's values, if it has arrived.
    fn take_late(&mut self, link: usize, start: Start, sample: Taken) -> Option<Values> {
        let number = sample.number;
        let lacked = &mut self.lacked[link];
        let is_it = |(of, lacked): &(Start, Taken)| *of == start && lacked.number == number;
        if let Some(at) = lacked.iter().position(is_it) {
            self.lost[link] -= 1;
            return lacked.remove(at).map(|(_, twin)| twin.values);
        }
        let [own, other] = self.links(link, start);
        let is_before = |known: &Taken| sequence_order(known.number, number).is_lt();
        let at = other.samples.partition_point(is_before);
        if other.samples.get(at).is_some_and(|twin| twin.number == number) {
            return other.samples.remove(at).map(|twin| twin.values);
        }
        let at = own.samples.partition_point(is_before);
        own.samples.insert(at, sample);
        None
    }

    /// The waiting samples of a link and of the other one.
    fn links(&mut self, link: usize, start: Start) -> [&mut Waiting; 2] {
        let (holes, heard) = (self.holes, self.heard);
        let begun = |link: usize| Waiting {
            every: heard[link].every,
            from_ns: heard[link].from_ns,
            holes: holes.of(link, start),
            ..Waiting::default()
        };
        let links = self.starts.entry(start);
        let [cable, wireless] = links.or_insert_with(|| [0, 1].map(begun));
        in_order(link, cable, wireless)
    }

    /// Ends the recording; samples of the other link taken at or after `under_way_ns` may
    /// still have been under way. Returns what each link lost between its first and last sample
    /// of each start, and outside of these.
    pub fn finish(mut self, under_way_ns: [i64; 2]) -> ([u64; 2], [AtEnds; 2]) {
        while let Some((_, links)) = self.starts.pop_first() {
            let is_last = self.starts.is_empty();
            self.end(links, is_last.then_some(under_way_ns));
        }
        (self.lost, self.at_ends)
    }

    fn end(&mut self, links: [Waiting; 2], under_way_ns: Option<[i64; 2]>) {
        for link in 0..2 {
            let (waiting, other) = (&links[link], &links[1 - link]);
            let until_ns = under_way_ns.map_or(i64::MAX, |under_way_ns| under_way_ns[link]);
            let found = &mut self.at_ends[link];
            found.before += waiting.before_heard;
            let mut run = Run::default();
            for sample in &other.samples {
                if !waiting.carries(sample.number, waiting.first.unwrap_or(0)) {
                    continue;
                }
                if waiting.first.is_none() && sample.taken_ns <= waiting.from_ns {
                    found.before += 1;
                } else if sample.taken_ns >= until_ns {
                    found.under_way += 1;
                } else {
                    run.push(sample.taken_ns);
                }
            }
            found.lost.push(run);
        }
        for (found, waiting) in self.at_ends.iter_mut().zip(links) {
            // Samples before the first one come before those after the last one.
            let at = found.lost.len().saturating_sub(1);
            found.lost.insert(at, waiting.before_first);
        }
    }
}
