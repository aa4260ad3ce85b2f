//! Which samples each link delivered, as runs of their numbers, and what one lacks of the other; and the pairs of samples with the
//! same number. Both in bounded memory.

use std::collections::{BTreeMap, VecDeque};

use super::in_order;
use crate::decode::{TimedSample, sequence_order};
use crate::walk::Start;

/// Largest number of samples that wait for their counterpart: over three minutes at 1344 Hz.
const MAX_WAITING: usize = 1 << 18;
/// Samples before the last pair whose counterpart may still arrive late.
const MAX_LATE: usize = 1 << 12;
/// Largest number of starts with waiting samples.
const MAX_STARTS: usize = 4;

/// Samples that a link delivered one after the other. Numbers do not overflow.
#[derive(Clone, Copy, Debug)]
struct Run {
    first: i64,
    last: i64,
    /// From one to the next.
    every: i64,
    /// Host times of both ends, ns: negative for samples taken before that clock began.
    taken_ns: [i64; 2],
    /// Whether a part of the file is missing before it.
    after_hole: bool,
}

impl Run {
    /// Host time of a number, ns.
    fn time_ns(&self, number: i64) -> i64 {
        let part = (number - self.first) as f64 / (self.last - self.first).max(1) as f64;
        let [from_ns, to_ns] = self.taken_ns;
        from_ns + (to_ns.saturating_sub(from_ns) as f64 * part) as i64
    }

    fn numbers(&self) -> impl Iterator<Item = i64> {
        let every = self.every;
        let count = (self.last - self.first) / every + 1;
        let first = self.first;
        (0..count).map(move |k| first + k * every)
    }

    fn has(&self, number: i64) -> bool {
        (self.first..=self.last).contains(&number) && (number - self.first) % self.every == 0
    }
}

/// Samples that are missing one after the other, with the host times before the first and after the last, ns.
#[derive(Clone, Copy, Debug)]
pub(super) struct Missing {
    pub count: u64,
    pub between_ns: [i64; 2],
}

/// What a link did not deliver of the samples of a start.
#[derive(Debug, Default)]
pub(super) struct Lack {
    /// Delivered by the other link, and expected.
    pub lost: u64,
    /// Taken before the link was heard, and those that may still have been under way.
    pub before: u64,
    pub under_way: u64,
    /// Delivered by neither.
    pub on_both: u64,
    pub runs: Vec<Missing>,
}

/// When and how a link is heard.
#[derive(Clone, Copy, Debug)]
pub(super) struct Heard {
    /// Host time since which samples are expected, ns.
    pub from_ns: i64,
    /// Its first decimation.
    pub every: u8,
}

/// The samples of a start that a link delivered.
#[derive(Debug, Default)]
pub(super) struct Delivered {
    /// In order.
    runs: Vec<Run>,
    /// Whether a part of the file is missing since the last sample.
    hole: bool,
}

impl Delivered {
    /// Notes that a part of the file is missing: what the link delivered there is not known.
    pub fn interrupt(&mut self) {
        self.hole = true;
    }

    /// Takes a sample, in order or late.
    pub fn take(&mut self, sequence: u32, every: u8, taken_ns: i64) {
        let every = i64::from(every.max(1));
        let number = self.runs.last().map_or(i64::from(sequence), |run| {
            run.last + i64::from(sequence.wrapping_sub(run.last as u32) as i32)
        });
        let at = self.runs.partition_point(|run| run.first <= number);
        let (earlier, later) = self.runs.split_at_mut(at);
        let before = earlier.last_mut();
        if before.as_ref().is_some_and(|run| number <= run.last) {
            return;
        }
        let adjoins = |run: &&mut Run| run.every == every && number - run.last == every;
        let follows = before.filter(adjoins).filter(|_| !self.hole);
        let precedes = later.first_mut().filter(|run| run.first - number == run.every);
        match (follows, precedes) {
            (Some(run), None) => (run.last, run.taken_ns[1]) = (number, taken_ns),
            (None, Some(run)) => (run.first, run.taken_ns[0]) = (number, taken_ns),
            (Some(run), Some(next)) => {
                (run.last, run.taken_ns[1]) = (next.last, next.taken_ns[1]);
                self.runs.remove(at);
            }
            (None, None) => {
                let (taken_ns, after_hole) = ([taken_ns; 2], std::mem::take(&mut self.hole));
                let run = Run { first: number, last: number, every, taken_ns, after_hole };
                self.runs.insert(at, run);
            }
        }
    }

    /// What this link did not deliver, as far as the file is whole. Samples of the other link from `until_ns` on may still have
    /// been under way.
    pub fn lack(&self, other: &Self, heard: Heard, until_ns: i64) -> Lack {
        let mut lack = Lack::default();
        self.lack_between(other, &mut lack);
        let ends = self.runs.first().zip(self.runs.last());
        let [every, known] = ends
            .map_or([i64::from(heard.every.max(1)), 0], |(first, _)| [first.every, first.first]);
        let carries = |number: &i64| (number - known) % every == 0;
        let is_whole = [ends.is_none_or(|(first, _)| !first.after_hole), !self.hole];
        let mut at_ends: [Option<Missing>; 2] = [None; 2];
        for run in &other.runs {
            let inside =
                ends.filter(|(first, last)| first.first < run.first && run.last < last.last);
            if inside.is_some() {
                continue;
            }
            for number in run.numbers().filter(carries) {
                let taken_ns = run.time_ns(number);
                let is_first = ends.is_none_or(|(first, _)| number < first.first);
                let is_last = ends.is_none_or(|(_, last)| number > last.last);
                if !(is_first && is_whole[0] || is_last && is_whole[1]) {
                    continue;
                }
                if is_first && taken_ns <= heard.from_ns {
                    lack.before += 1;
                } else if is_last && taken_ns >= until_ns {
                    lack.under_way += 1;
                } else {
                    lack.lost += 1;
                    let between_ns = [taken_ns; 2];
                    let end = &mut at_ends[usize::from(is_last)];
                    let end = end.get_or_insert(Missing { count: 0, between_ns });
                    (end.count, end.between_ns[1]) = (end.count + 1, taken_ns);
                }
            }
        }
        lack.runs.extend(at_ends.into_iter().flatten());
        lack
    }

    /// What is missing between the first and the last sample.
    fn lack_between(&self, other: &Self, lack: &mut Lack) {
        let mut from = 0;
        for pair in self.runs.windows(2) {
            let (before, next) = (&pair[0], &pair[1]);
            let count = (next.first - before.last - 1).max(0) / next.every;
            if count == 0 || next.after_hole {
                continue;
            }
            from += other.runs[from..].partition_point(|run| run.last <= before.last);
            let delivered = other.runs[from..].iter().take_while(|run| run.first < next.first);
            let delivered: u64 = delivered
                .map(|run| {
                    // Numbers of the gap in this run.
                    let least = run.first.max(next.first - count * next.every);
                    let skipped = (next.first - least) / next.every;
                    let numbers = (1..=skipped).map(|k| next.first - k * next.every);
                    numbers.filter(|number| run.has(*number)).count() as u64
                })
                .sum();
            lack.lost += delivered;
            lack.on_both += count as u64 - delivered.min(count as u64);
            lack.runs.push(Missing {
                count: count as u64,
                between_ns: [before.taken_ns[1], next.taken_ns[0]],
            });
        }
    }
}

/// X, Y, Z of the accelerometer and, if there is one, of the gyroscope, LSB.
pub(super) type Values = ([i32; 3], Option<[i32; 3]>);

/// Finds pairs of samples with the same number.
#[derive(Default)]
pub(super) struct Pairing {
    starts: BTreeMap<Start, [VecDeque<(u32, Values)>; 2]>,
}

impl Pairing {
    /// Takes a sample of a link, late or not; returns the other link's values, if it has arrived.
    pub fn pair(&mut self, link: usize, start: Start, sample: &TimedSample) -> Option<Values> {
        let [cable, wireless] = self.starts.entry(start).or_default();
        let [own, other] = in_order(link, cable, wireless);
        let number = sample.sequence;
        let order = |known: &(u32, Values)| sequence_order(known.0, number);
        if let Ok(at) = other.binary_search_by(order) {
            let twin = other.remove(at);
            // Each link delivers its samples in order, but for late ones.
            other.drain(..at.saturating_sub(MAX_LATE));
            return twin.map(|(_, values)| values);
        }
        let at = own.partition_point(|known| order(known).is_lt());
        own.insert(at, (number, (sample.value, sample.rate)));
        if own.len() > MAX_WAITING {
            own.pop_front();
        }
        if self.starts.len() > MAX_STARTS {
            self.starts.pop_first();
        }
        None
    }
}
