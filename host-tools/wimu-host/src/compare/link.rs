//! Statistics of one link, sample by sample.

use std::collections::BTreeMap;

use serde::Serialize;
use wimu_link::LinkRole;
use wimu_link::message::LinkStatus;

use super::arrival::ByArrival;
use super::delivery::{Delivered, Lack, Missing};
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

    /// Host time of the end of a slice, ns.
    fn end_ns(&self, slice: usize) -> i64 {
        let share = (slice + 1) as f64 / self.count.max(1) as f64;
        self.start_ns.saturating_add((self.span_ns as f64 * share) as i64)
    }
}

/// Measures one link.
#[derive(Debug, Default)]
pub(super) struct LinkMeter {
    pub delivered: u64,
    /// What it delivered of each start, and what it lacks of all.
    starts: BTreeMap<Start, Delivered>,
    /// The latest start.
    current: Option<Start>,
    /// Whether a part of the file is missing since the last sample.
    hole: bool,
    lack: Lack,
    bursts: BTreeMap<u32, u64>,
    latency: Durations,
    age: Durations,
    last_latency: Option<i64>,
    jitter_sum_ns: f64,
    jitter_count: u64,
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

    /// Ends the sequence: a part of the file is missing.
    pub fn interrupt(&mut self) {
        self.last_latency = None;
        self.hole = true;
    }

    /// Notes that the link is open.
    pub fn is_open(&mut self, host_ns: u64) {
        self.opened_ns.get_or_insert(host_ns);
    }

    /// Ends the recording: what was delivered in each start.
    pub fn finish(&mut self, host_ns: u64) -> BTreeMap<Start, Delivered> {
        self.close(host_ns);
        if let Some(start) = self.current.filter(|_| self.hole) {
            self.enter(start);
        }
        std::mem::take(&mut self.starts)
    }

    /// The link was lost, or the recording has ended.
    pub fn close(&mut self, host_ns: u64) {
        if let Some(opened) = self.opened_ns.take() {
            self.open_ns += host_ns.saturating_sub(opened);
        }
    }

    /// Takes samples that arrived at `host_ns`, after later ones if `is_late`.
    pub fn take(
        &mut self,
        start: Start,
        samples: &Samples,
        is_late: bool,
        host_ns: u64,
        clock: &ClockModel,
    ) {
        if self.current != Some(start) || self.hole {
            self.enter(start);
        }
        let mut latency = None;
        for sample in samples.iter() {
            let taken_ns = clock.host_ns(sample.time) as i64;
            let delivered = self.starts.entry(start).or_default();
            delivered.take(sample.sequence, samples.every, taken_ns);
            self.delivered += 1;
            let delay = (host_ns as i64).wrapping_sub(taken_ns);
            self.age.push(delay);
            latency = Some(delay);
            self.slice(taken_ns).delivered += 1;
        }
        if let Some(latency) = latency.filter(|_| !is_late) {
            self.latency.push(latency);
            self.slice(host_ns as i64).latency.push(latency);
            if let Some(before) = self.last_latency.replace(latency) {
                self.jitter_sum_ns += latency.abs_diff(before) as f64;
                self.jitter_count += 1;
            }
        }
    }

    /// Begins a start of the board, or goes on after a hole, which is in the start before too.
    fn enter(&mut self, start: Start) {
        let before = self.current.replace(start);
        if before != Some(start) {
            self.last_latency = None;
        }
        if std::mem::take(&mut self.hole) {
            for start in [before, Some(start)].into_iter().flatten() {
                self.starts.entry(start).or_default().interrupt();
            }
        }
    }

    /// Takes what the link did not deliver of a start.
    pub fn lack(&mut self, lack: Lack) {
        self.lack.lost += lack.lost;
        self.lack.before += lack.before;
        self.lack.under_way += lack.under_way;
        self.lack.on_both += lack.on_both;
        for missing in lack.runs {
            *self.bursts.entry(missing.count.max(1).ilog2()).or_default() += 1;
            self.spread(&missing);
        }
    }

    /// Adds missing samples, evenly over their time, to the slices.
    fn spread(&mut self, missing: &Missing) {
        let [from_ns, to_ns] = missing.between_ns;
        let [first, last] = [from_ns, to_ns].map(|ns| self.slicing.at(ns));
        let length_ns = to_ns.saturating_sub(from_ns).max(1) as f64;
        let mut done = 0;
        for slice in first..=last {
            let end_ns = self.slicing.end_ns(slice);
            let part = end_ns.saturating_sub(from_ns) as f64 / length_ns;
            let until = if slice == last {
                missing.count
            } else {
                ((part * missing.count as f64).round() as u64).clamp(done, missing.count)
            };
            if let Some(slice) = self.slices.get_mut(slice) {
                slice.missing += until - done;
            }
            done = until;
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
            lost: self.lack.lost,
            before: self.lack.before,
            under_way: self.lack.under_way,
            missing_on_both: self.lack.on_both,
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
