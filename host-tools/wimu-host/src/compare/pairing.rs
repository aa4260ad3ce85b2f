//! The samples with the same number on both links, in bounded memory, and what one of them lost.

use std::collections::{BTreeMap, VecDeque};
use std::ops::RangeInclusive;

use super::holes::Holes;
use crate::walk::Start;

/// Samples that wait for their twin at most: over three minutes at 1344 Hz.
const MAX_WAITING: usize = 1 << 18;
/// Starts of which samples wait: the links are at most so far apart.
const MAX_STARTS: usize = 4;

/// A sample that a link has brought.
#[derive(Clone, Copy, Debug)]
pub(super) struct Taken {
    /// Its sequence number.
    pub number: u32,
    /// X, Y, Z, LSB.
    pub value: [i32; 3],
    /// When it arrived, ns on the host's clock.
    pub host_ns: u64,
}

/// Finds the samples with the same number on both links.
pub(super) struct Pairing<'a> {
    holes: &'a Holes,
    /// When each link was first heard, ns on the host's clock.
    heard_ns: [u64; 2],
    starts: BTreeMap<Start, [Waiting; 2]>,
    /// The first start in which each link brought something, and its decimation since.
    begun: [Option<(Start, u8)>; 2],
    /// Samples that the other link brought and this one did not, between its first and last.
    lost: [u64; 2],
    /// Runs of samples that the other link brought outside of these, by link: the arrivals there.
    at_ends: Vec<(usize, Vec<u64>)>,
}

#[derive(Default)]
struct Waiting {
    samples: VecDeque<Taken>,
    /// The first number that the link brought.
    first: Option<u32>,
    /// What the other link brought before it.
    before_first: Vec<Taken>,
    /// It carries every `every`th sample.
    every: u8,
    /// Numbers of which the file does not tell whether it brought them.
    holes: Vec<RangeInclusive<u32>>,
}

impl Waiting {
    /// Whether the link carries this sample as far as is known, given that it has brought `known`.
    fn carries(&self, number: u32, known: u32) -> bool {
        if self.holes.iter().any(|hole| hole.contains(&number)) {
            return false;
        }
        let apart = known.wrapping_sub(number) as i32;
        apart
            .unsigned_abs()
            .is_multiple_of(self.every.max(1).into())
    }

    /// Notes that the other link has brought `sample` and this one, that has brought `later`, has not.
    /// Returns whether it is lost between this link's first and last.
    fn lacks(&mut self, sample: Taken, later: u32) -> bool {
        if !self.carries(sample.number, later) {
            return false;
        }
        let is_between = self.first.is_some_and(|first| sample.number > first);
        if !is_between && self.before_first.len() < MAX_WAITING {
            self.before_first.push(sample);
        }
        is_between
    }
}

impl<'a> Pairing<'a> {
    /// Of links that were first heard at `heard_ns` of the host.
    pub fn new(heard_ns: [u64; 2], holes: &'a Holes) -> Self {
        Self {
            holes,
            heard_ns,
            starts: BTreeMap::new(),
            begun: [None; 2],
            lost: [0; 2],
            at_ends: Vec::new(),
        }
    }

    /// Takes a link's next sample, of which it carries every `every`th; the other's value, if it has
    /// brought it already.
    pub fn take(
        &mut self,
        link: usize,
        start: Start,
        sample: Taken,
        every: u8,
    ) -> Option<[i32; 3]> {
        self.begun[link].get_or_insert((start, every)).1 = every;
        let holes = self.holes;
        let begun = |link| Waiting {
            holes: holes.of(link, start),
            ..Waiting::default()
        };
        let links = self.starts.entry(start);
        let [cable, wireless] = links.or_insert_with(|| [0, 1].map(begun));
        let (own, other) = if link == 0 {
            (cable, wireless)
        } else {
            (wireless, cable)
        };
        let number = sample.number;
        own.first.get_or_insert(number);
        own.every = every;
        let mut twin = None;
        // Each link brings its samples in order: what the other has brought before this one is
        // not coming any more.
        while let Some(before) = other.samples.front().copied() {
            if before.number > number {
                break;
            }
            other.samples.pop_front();
            if before.number == number {
                twin = Some(before.value);
            } else {
                self.lost[link] += u64::from(own.lacks(before, number));
            }
        }
        if twin.is_some() {
            // The other is further: what of this link still waits for it waits in vain.
            for before in std::mem::take(&mut own.samples) {
                self.lost[1 - link] += u64::from(other.lacks(before, number));
            }
        } else {
            own.samples.push_back(sample);
        }
        if own.samples.len() > MAX_WAITING
            && let Some(before) = own.samples.pop_front()
        {
            self.lost[1 - link] += u64::from(other.lacks(before, before.number));
        }
        if self.starts.len() > MAX_STARTS
            && let Some((start, links)) = self.starts.pop_first()
        {
            self.end(start, links, None);
        }
        twin
    }

    /// The recording is over; what of the other link arrived at or after `under_way_ns` may still have
    /// been on its way by each. Returns what each link lost between its first and last sample of each
    /// start, and calls `at_end` with each link and run of samples that it lost outside of these, as
    /// their times of arrival by the other.
    pub fn finish(
        mut self,
        under_way_ns: [u64; 2],
        mut at_end: impl FnMut(usize, &[u64]),
    ) -> [u64; 2] {
        while let Some((start, links)) = self.starts.pop_first() {
            let is_last = self.starts.is_empty();
            self.end(start, links, is_last.then_some(under_way_ns));
        }
        for (link, run) in &self.at_ends {
            at_end(*link, run);
        }
        self.lost
    }

    fn end(&mut self, start: Start, links: [Waiting; 2], under_way_ns: Option<[u64; 2]>) {
        for (link, waiting) in links.iter().enumerate() {
            // Whether it was heard in a start before.
            let Some((begun, every)) = self.begun[link].filter(|(begun, _)| *begun <= start) else {
                continue;
            };
            let mut note = |run: Vec<u64>| {
                if !run.is_empty() {
                    self.at_ends.push((link, run));
                }
            };
            let before = waiting.before_first.iter().map(|sample| sample.host_ns);
            let is_heard = |host_ns: &u64| begun < start || *host_ns > self.heard_ns[link];
            note(before.filter(is_heard).collect());
            let grid = Waiting {
                every,
                holes: waiting.holes.clone(),
                ..Waiting::default()
            };
            let arrived_in_time = |sample: &&Taken| {
                under_way_ns.is_none_or(|under_way_ns| sample.host_ns < under_way_ns[link])
            };
            let carried = |sample: &&Taken| grid.carries(sample.number, waiting.first.unwrap_or(0));
            let left = links[1 - link].samples.iter();
            note(
                left.filter(carried)
                    .filter(arrived_in_time)
                    .map(|sample| sample.host_ns)
                    .collect(),
            );
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Numbers that each link brings of each start, by turns; returns what each lost between and at
    /// the ends.
    fn lost(starts: &[[&[u32]; 2]], heard_ns: u64, under_way_ns: [u64; 2]) -> ([u64; 2], [u64; 2]) {
        let holes = Holes::default();
        let mut pairing = Pairing::new([0, heard_ns], &holes);
        for (start, links) in (7..).zip(starts) {
            let mut turns: Vec<(u32, usize)> = Vec::new();
            for (link, numbers) in links.iter().enumerate() {
                turns.extend(numbers.iter().map(|number| (*number, link)));
            }
            turns.sort_unstable();
            for (number, link) in turns {
                let sample = Taken {
                    number,
                    value: [0; 3],
                    host_ns: u64::from(number),
                };
                pairing.take(link, start, sample, 1);
            }
        }
        let mut at_ends = [0; 2];
        let between = pairing.finish(under_way_ns, |link, run| at_ends[link] += run.len() as u64);
        (between, at_ends)
    }

    #[test]
    fn losses_count_from_the_moment_a_link_was_heard_until_the_end_of_each_start() {
        let all: &[u32] = &[0, 1, 2, 3, 4, 5, 6, 7, 8, 9];
        let never = [u64::MAX; 2];
        // Heard from 1 on, dead after 5.
        assert_eq!(lost(&[[all, &[3, 5]]], 1, never), ([0, 1], [0, 1 + 4]));
        // At the end of the recording some may be under way.
        assert_eq!(lost(&[[all, &[3, 5]]], 9, [u64::MAX, 8]), ([0, 1], [0, 2]));
        // In the starts that follow all counts, a start without a sign of it too.
        let starts: [[&[u32]; 2]; 4] = [[all, &[8, 9]], [all, &[]], [all, &[5]], [&[0], &[0]]];
        assert_eq!(lost(&starts, 9, never), ([0, 0], [0, 10 + 9]));
        // The other one likewise.
        let starts: [[&[u32]; 2]; 2] = [[all, all], [&[], all]];
        assert_eq!(lost(&starts, 0, never), ([0, 0], [10, 0]));
        // A link that was never heard before is not listened to.
        let starts: [[&[u32]; 2]; 2] = [[all, &[]], [&[0], &[0]]];
        assert_eq!(lost(&starts, 0, never), ([0, 0], [0, 0]));
    }
}
