//! Statistics of one link, sample by sample.

use std::collections::{BTreeMap, VecDeque};

use serde::Serialize;
use wimu_link::LinkRole;
use wimu_link::message::LinkStatus;

use super::arrival::ByArrival;
use super::pairing::Run;
use super::quantiles::{Durations, Quantiles};
use crate::clock::{ClockModel, ClockSummary};
use crate::decode::{LinkStatistics, Samples, StreamStatistics};
use crate::walk::Start;

/// Statistics of one link.
#[derive(Clone, Debug, Serialize)]
pub struct LinkReport {
    /// `cable` or `wireless`.
    pub link: String,
    /// Samples delivered, of the compared stream.
    pub delivered: u64,
    /// Samples delivered by the other link and not by this one, of those taken since it was first
    /// heard, or since it was opened if it was then silent for more than 5 s.
    pub lost: u64,
    /// Samples of the other link taken before that.
    pub before: u64,
    /// Samples of the other link that may still have been under way at the end of the recording.
    pub under_way: u64,
    /// Samples delivered by neither: lost on both, or not taken by the device.
    pub missing_on_both: u64,
    /// Repeated samples.
    pub duplicated: u64,
    /// Samples that arrived after later ones, among those delivered.
    pub late: u64,
    /// Undamaged frames.
    pub frames: u64,
    /// Damaged frames.
    pub damaged: u64,
    /// Frames shed by the device because the link was too slow, as reported on either link; `None`
    /// where it did not report twice in a start.
    pub shed: Option<u64>,
    /// How often the link was lost and came back.
    pub interruptions: u64,
    /// Batches whose numbers no epoch defines, including those at the end of the recording.
    pub unplaced: u64,
    /// Undamaged frames with a number or time that the device cannot have reached.
    pub rejected: u64,
    /// Runs of missing samples by length, in powers of two.
    pub bursts: Vec<Burst>,
    /// From the newest sample of a batch to its arrival.
    pub latency: Quantiles,
    /// From a sample to its arrival, including the time to fill its batch.
    pub age: Quantiles,
    /// Mean change of the latency from one batch to the next, ms.
    pub jitter_ms: f64,
    /// Time that the link was open, from its first data to the end of the recording, without the
    /// intervals in which it was lost, s.
    pub open_s: f64,
    /// Samples delivered per second of that time.
    pub samples_per_s: f64,
    /// Bytes received per second of that time.
    pub bytes_per_s: f64,
    /// The device's clock, from this link alone.
    pub clock: Option<ClockSummary>,
    /// Error of values that are assigned to their time of arrival.
    pub by_arrival: Option<ByArrival>,
}

/// Number of runs of missing samples within a range of lengths.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct Burst {
    /// Shortest length, samples.
    pub from: u64,
    /// Longest length, samples.
    pub to: u64,
    /// Runs.
    pub runs: u64,
}

/// A slice of the recording for the charts.
#[derive(Clone, Debug, Default)]
pub(super) struct Slice {
    /// Of data that arrived in it.
    pub latency: Durations,
    /// Of samples taken in it.
    pub delivered: u64,
    pub missing: u64,
}

impl Slice {
    /// Fraction of the samples taken in it that did not arrive; `None` without samples.
    pub fn lost_share(&self) -> Option<f64> {
        let all = self.delivered + self.missing;
        (all > 0).then(|| self.missing as f64 / all as f64)
    }
}

/// The slices of a recording.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Slicing {
    /// Host time, ns.
    pub start_ns: i64,
    pub span_ns: u64,
    pub count: usize,
}

impl Slicing {
    /// Index of the slice at a host time.
    pub fn at(&self, host_ns: i64) -> usize {
        let passed = host_ns.saturating_sub(self.start_ns).max(0) as f64;
        let share = passed / (self.span_ns as f64).max(1.0);
        ((share * self.count as f64) as usize).min(self.count.saturating_sub(1))
    }
}

/// Samples missing in a link's own numbers.
#[derive(Clone, Copy, Debug)]
struct Gap {
    first: u32,
    /// From one to the next.
    step: u32,
    count: u32,
    /// Host times of the samples before the first and after the last, ns.
    between_ns: (i64, i64),
}

impl Gap {
    fn time_ns(&self, index: u32) -> i64 {
        let (from, to) = self.between_ns;
        let share = f64::from(index + 1) / f64::from(self.count + 1);
        from + (to.saturating_sub(from) as f64 * share) as i64
    }

    /// The first index after this one in a later slice, or the count; by bisection, because the count may be up to 2³¹.
    fn end_of_slice(&self, index: u32, slicing: &Slicing) -> u32 {
        let at = slicing.at(self.time_ns(index));
        let (mut low, mut high) = (index + 1, self.count);
        while low < high {
            let middle = low + (high - low) / 2;
            if slicing.at(self.time_ns(middle)) <= at {
                low = middle + 1;
            } else {
                high = middle;
            }
        }
        low
    }

    fn index_of(&self, number: u32) -> Option<u32> {
        let behind = number.wrapping_sub(self.first);
        let index = behind / self.step;
        (behind.is_multiple_of(self.step) && index < self.count).then_some(index)
    }

    /// The parts before and after a sample that arrived late.
    fn without(&self, index: u32) -> [Self; 2] {
        let there_ns = self.time_ns(index);
        [
            Self { count: index, between_ns: (self.between_ns.0, there_ns), ..*self },
            Self {
                first: self.first.wrapping_add((index + 1) * self.step),
                count: self.count - index - 1,
                between_ns: (there_ns, self.between_ns.1),
                ..*self
            },
        ]
    }
}

/// Largest number of gaps that late samples may still fill.
const MAX_GAPS: usize = 256;

/// Measures one link.
#[derive(Debug, Default)]
pub(super) struct LinkMeter {
    pub delivered: u64,
    /// Between the first and last sample of each start.
    pub lost: u64,
    /// Outside of these.
    lost_at_ends: u64,
    pub before: u64,
    pub under_way: u64,
    /// Samples missing in this link's own numbers.
    missing: u64,
    gaps: VecDeque<Gap>,
    bursts: BTreeMap<u32, u64>,
    latency: Durations,
    age: Durations,
    last_latency: Option<i64>,
    jitter_sum_ns: f64,
    jitter_count: u64,
    /// Number and host time, ns, of the latest sample.
    latest: Option<(u32, i64)>,
    shed: BTreeMap<Start, Shed>,
    /// When it was opened last, if it is open, and the total of earlier open times, ns.
    opened_ns: Option<u64>,
    open_ns: u64,
    slicing: Slicing,
    pub slices: Vec<Slice>,
}

/// Shed frames of a link in one start, as reported on any link.
#[derive(Clone, Copy, Debug)]
struct Shed {
    least: u32,
    most: u32,
    times: u32,
}

impl LinkMeter {
    pub fn new(slicing: Slicing) -> Self {
        Self { slicing, slices: vec![Slice::default(); slicing.count], ..Self::default() }
    }

    /// Ends the sequence: the device has restarted, or a part of the file is missing.
    pub fn skip(&mut self) {
        self.latest = None;
        self.last_latency = None;
        self.count_gaps(0);
    }

    /// Notes that the link is open.
    pub fn is_open(&mut self, host_ns: u64) {
        self.opened_ns.get_or_insert(host_ns);
    }

    /// The link was lost, or the recording has ended.
    pub fn close(&mut self, host_ns: u64) {
        if let Some(opened) = self.opened_ns.take() {
            self.open_ns += host_ns.saturating_sub(opened);
        }
    }

    /// Takes samples that arrived at `host_ns`.
    pub fn take(&mut self, samples: &Samples, host_ns: u64, clock: &ClockModel) {
        self.delivered += samples.values.len() as u64;
        let step = u32::from(samples.every.max(1));
        let mut latency = None;
        for sample in samples.iter() {
            let taken_ns = clock.host_ns(sample.time) as i64;
            if let Some((latest, before_ns)) = self.latest.replace((sample.sequence, taken_ns)) {
                let ahead = sample.sequence.wrapping_sub(latest);
                let count = ahead.saturating_sub(1) / step;
                if count > 0 && ahead < u32::MAX / 2 {
                    self.missing += u64::from(count);
                    self.gaps.push_back(Gap {
                        first: sample.sequence.wrapping_sub(count * step),
                        step,
                        count,
                        between_ns: (before_ns, taken_ns),
                    });
                }
            }
            let delay = (host_ns as i64).wrapping_sub(taken_ns);
            self.age.push(delay);
            latency = Some(delay);
            self.slice(taken_ns).delivered += 1;
        }
        self.count_gaps(MAX_GAPS);
        if let Some(latency) = latency {
            self.latency.push(latency);
            self.slice(host_ns as i64).latency.push(latency);
            if let Some(before) = self.last_latency.replace(latency) {
                self.jitter_sum_ns += latency.abs_diff(before) as f64;
                self.jitter_count += 1;
            }
        }
    }

    /// Takes samples that arrived at `host_ns`, after later ones.
    pub fn take_late(&mut self, samples: &Samples, host_ns: u64, clock: &ClockModel) {
        for sample in samples.iter() {
            let taken_ns = clock.host_ns(sample.time) as i64;
            self.delivered += 1;
            self.age.push((host_ns as i64).wrapping_sub(taken_ns));
            self.slice(taken_ns).delivered += 1;
            let found = self.gaps.iter().enumerate();
            let mut found =
                found.filter_map(|(at, gap)| Some((at, *gap, gap.index_of(sample.sequence)?)));
            if let Some((at, gap, index)) = found.next() {
                self.missing -= 1;
                self.gaps.remove(at);
                let left = gap.without(index).into_iter().rev();
                for part in left.filter(|part| part.count > 0) {
                    self.gaps.insert(at, part);
                }
            }
        }
    }

    fn slice(&mut self, host_ns: i64) -> &mut Slice {
        let at = self.slicing.at(host_ns);
        if self.slices.is_empty() {
            self.slices.push(Slice::default());
        }
        let last = self.slices.len() - 1;
        &mut self.slices[at.min(last)]
    }

    /// Counts all gaps but the last `left`, which late samples may still fill.
    fn count_gaps(&mut self, left: usize) {
        while self.gaps.len() > left
            && let Some(gap) = self.gaps.pop_front()
        {
            let mut index = 0;
            while index < gap.count {
                let end = gap.end_of_slice(index, &self.slicing);
                self.slice(gap.time_ns(index)).missing += u64::from(end - index);
                index = end;
            }
            *self.bursts.entry(gap.count.max(1).ilog2()).or_default() += 1;
        }
    }

    /// Takes a run of samples that the link did not deliver before its first or after its last one of a start.
    pub fn lack(&mut self, run: &Run) {
        for taken_ns in &run.taken_ns {
            self.slice(*taken_ns).missing += 1;
        }
        let count = run.taken_ns.len() as u64 + run.more;
        if let Some(power) = count.checked_ilog2() {
            self.lost_at_ends += count;
            *self.bursts.entry(power).or_default() += 1;
        }
    }

    /// Ends the recording at `host_ns`.
    pub fn finish(&mut self, host_ns: u64) {
        self.close(host_ns);
        self.count_gaps(0);
    }

    /// The longest time from a sample to its arrival, ns.
    pub fn longest_age_ns(&self) -> u64 {
        (self.age.summary().max_ms * 1e6) as u64
    }

    /// Takes the device's status of this link, received on any link.
    pub fn report_status(&mut self, start: Start, status: Option<LinkStatus>) {
        let Some(status) = status else { return };
        let now = status.telemetry_shed;
        let shed = self.shed.entry(start).or_insert(Shed { least: now, most: now, times: 0 });
        shed.least = shed.least.min(now);
        shed.most = shed.most.max(now);
        shed.times += 1;
    }

    /// Frames shed during the recording.
    fn shed(&self) -> Option<u64> {
        let first = self.shed.keys().next()?;
        let starts = self.shed.iter().map(|(start, shed)| {
            // A start that began during the recording was recorded from its beginning.
            let least = if start == first { shed.least } else { 0 };
            let known = start != first || shed.times > 1;
            known.then_some(u64::from(shed.most - least))
        });
        starts.flatten().reduce(|all, shed| all + shed)
    }

    pub fn median_latency_ns(&self) -> f64 {
        self.latency.quantile_ns(0.5)
    }

    pub fn report(
        &self,
        role: LinkRole,
        statistics: &LinkStatistics,
        stream: &StreamStatistics,
        clock: Option<&ClockModel>,
    ) -> LinkReport {
        let open_s = self.open_ns as f64 * 1e-9;
        let per_s = |count: u64| {
            if open_s > 0.0 { count as f64 / open_s } else { 0.0 }
        };
        LinkReport {
            link: role.to_string(),
            delivered: self.delivered,
            lost: self.lost + self.lost_at_ends,
            before: self.before,
            under_way: self.under_way,
            missing_on_both: self.missing.saturating_sub(self.lost),
            duplicated: stream.duplicated,
            late: stream.late,
            frames: statistics.frames,
            damaged: statistics.frames_damaged,
            shed: self.shed(),
            interruptions: statistics.interruptions,
            unplaced: statistics.batches_unplaced,
            rejected: statistics.frames_rejected,
            bursts: self
                .bursts
                .iter()
                .map(|(power, runs)| Burst { from: 1 << power, to: (2 << power) - 1, runs: *runs })
                .collect(),
            latency: self.latency.summary(),
            age: self.age.summary(),
            jitter_ms: self.jitter_sum_ns / self.jitter_count.max(1) as f64 * 1e-6,
            open_s,
            samples_per_s: per_s(self.delivered),
            bytes_per_s: per_s(statistics.bytes),
            clock: clock.map(ClockModel::summary),
            by_arrival: None,
        }
    }
}
