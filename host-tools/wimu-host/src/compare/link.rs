//! What one link carried, sample by sample.

use std::collections::{BTreeMap, VecDeque};

use serde::Serialize;
use wimu_link::LinkRole;
use wimu_link::message::Status;

use super::quantiles::{Durations, Quantiles};
use crate::clock::{ClockModel, ClockSummary};
use crate::decode::{LinkStatistics, Samples, StreamStatistics};

/// One link in numbers.
#[derive(Clone, Debug, Serialize)]
pub struct LinkReport {
    /// `cable` or `wireless`.
    pub link: String,
    /// Samples delivered, of the stream that is compared.
    pub delivered: u64,
    /// Samples that the other link delivered and this one did not, from when it was first heard; but
    /// for those that may still have been under way when the recording ended.
    pub lost: u64,
    /// Samples that neither delivered: lost on both, or never taken by the device.
    pub missing_on_both: u64,
    /// Samples that arrived again.
    pub duplicated: u64,
    /// Samples that arrived after later ones and were left out.
    pub late: u64,
    /// Undamaged frames.
    pub frames: u64,
    /// Damaged frames.
    pub damaged: u64,
    /// Frames that the device shed because the link was too slow, as it says.
    pub shed: u64,
    /// How often the link was lost and came back.
    pub interruptions: u64,
    /// Runs of missing samples: how many runs of how many samples, by powers of two.
    pub bursts: Vec<Burst>,
    /// From the newest sample of a batch to its arrival.
    pub latency: Quantiles,
    /// From a sample to its arrival: the wait for its batch to fill included.
    pub age: Quantiles,
    /// Mean change of the latency from one batch to the next, ms.
    pub jitter_ms: f64,
    /// Samples a second.
    pub samples_per_s: f64,
    /// Bytes a second, everything included.
    pub bytes_per_s: f64,
    /// The device's clock by this link alone.
    pub clock: Option<ClockSummary>,
    /// Error of values taken at their time of arrival.
    pub by_arrival: Option<ByArrival>,
}

/// How many runs of missing samples had a length.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct Burst {
    /// From so many samples.
    pub from: u64,
    /// To so many.
    pub to: u64,
    /// Runs.
    pub runs: u64,
}

/// What a user gets wrong who resamples by the time of arrival, m/s² rms, equation (64): by device
/// time it is nothing.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct ByArrival {
    /// As samples arrive.
    pub rms_mps2: f64,
    /// With the median latency taken off: what jitter alone does.
    pub rms_without_latency_mps2: f64,
}

/// A stretch of the recording for the pictures.
#[derive(Clone, Debug, Default)]
pub(super) struct Slice {
    pub latency: Durations,
    pub delivered: u64,
    pub missing: u64,
}

/// Measures one link.
#[derive(Debug, Default)]
pub(super) struct LinkMeter {
    pub delivered: u64,
    /// Between the first and last sample of each start.
    pub lost: u64,
    /// Outside of these.
    lost_at_ends: u64,
    /// Gaps in this link's own numbers.
    gaps: u64,
    bursts: BTreeMap<u32, u64>,
    latency: Durations,
    age: Durations,
    last_latency: Option<i64>,
    jitter_sum_ns: f64,
    jitter_count: u64,
    latest: Option<u32>,
    shed: Option<(u32, u32)>,
    shed_before: u64,
    span: Option<(u64, u64)>,
    pub slices: Vec<Slice>,
}

impl LinkMeter {
    pub fn new(slices: usize) -> Self {
        Self {
            slices: vec![Slice::default(); slices],
            ..Self::default()
        }
    }

    /// The device has started anew.
    pub fn restart(&mut self) {
        self.latest = None;
        self.last_latency = None;
        if let Some((first, last)) = self.shed.take() {
            self.shed_before += u64::from(last.wrapping_sub(first));
        }
    }

    /// A part of the file is missing: what comes next does not follow what came before.
    pub fn skip(&mut self) {
        self.latest = None;
        self.last_latency = None;
    }

    /// Samples that arrived at `host_ns`; `slice` says where in the recording.
    pub fn take(&mut self, samples: &Samples, host_ns: u64, clock: &ClockModel, slice: usize) {
        let count = samples.values.len() as u64;
        self.delivered += count;
        let (first, _) = *self.span.get_or_insert((host_ns, host_ns));
        self.span = Some((first, host_ns));
        let mut missing = 0;
        let mut last = None;
        for sample in samples.iter() {
            let latest = self.latest.replace(sample.sequence);
            let ahead = latest.map_or(0, |latest| sample.sequence.wrapping_sub(latest));
            let gap = ahead.saturating_sub(1) / u32::from(samples.every.max(1));
            if gap > 0 && ahead < u32::MAX / 2 {
                missing += u64::from(gap);
                *self.bursts.entry(gap.ilog2()).or_default() += 1;
            }
            self.age.push(clock.delay_ns(sample.time, host_ns));
            last = Some(sample);
        }
        self.gaps += missing;
        let latency = last.map(|sample| clock.delay_ns(sample.time, host_ns));
        if let Some(latency) = latency {
            self.latency.push(latency);
            if let Some(before) = self.last_latency.replace(latency) {
                self.jitter_sum_ns += latency.abs_diff(before) as f64;
                self.jitter_count += 1;
            }
        }
        if let Some(slice) = self.slices.get_mut(slice) {
            slice.delivered += count;
            slice.missing += missing;
            if let Some(latency) = latency {
                slice.latency.push(latency);
            }
        }
    }

    /// A run of samples that the link did not bring before its first or after its last one of a start.
    /// `slices` say where in the recording each of them arrived by the other link.
    pub fn lack(&mut self, slices: impl Iterator<Item = usize>) {
        let mut run = 0_u64;
        for slice in slices {
            run += 1;
            if let Some(slice) = self.slices.get_mut(slice) {
                slice.missing += 1;
            }
        }
        if let Some(power) = run.checked_ilog2() {
            self.lost_at_ends += run;
            *self.bursts.entry(power).or_default() += 1;
        }
    }

    /// The longest time from a sample to its arrival, ns.
    pub fn longest_age_ns(&self) -> u64 {
        (self.age.summary().max_ms * 1e6) as u64
    }

    pub fn status(&mut self, role: LinkRole, status: &Status) {
        let link = match role {
            LinkRole::Cable => status.cable,
            _ => status.wireless,
        };
        if let Some(link) = link {
            let (first, _) = *self
                .shed
                .get_or_insert((link.telemetry_shed, link.telemetry_shed));
            self.shed = Some((first, link.telemetry_shed));
        }
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
        let seconds = self.span.map_or(0.0, |(first, last)| {
            last.saturating_sub(first) as f64 * 1e-9
        });
        let per_s = |count: u64| {
            if seconds > 0.0 {
                count as f64 / seconds
            } else {
                0.0
            }
        };
        let shed = self
            .shed
            .map_or(0, |(first, last)| last.wrapping_sub(first));
        LinkReport {
            link: role.to_string(),
            delivered: self.delivered,
            lost: (self.lost + self.lost_at_ends).saturating_sub(stream.late),
            missing_on_both: self.gaps.saturating_sub(self.lost),
            duplicated: stream.duplicated,
            late: stream.late,
            frames: statistics.frames,
            damaged: statistics.frames_damaged,
            shed: self.shed_before + u64::from(shed),
            interruptions: statistics.interruptions,
            bursts: self
                .bursts
                .iter()
                .map(|(power, runs)| Burst {
                    from: 1 << power,
                    to: (2 << power) - 1,
                    runs: *runs,
                })
                .collect(),
            latency: self.latency.summary(),
            age: self.age.summary(),
            jitter_ms: self.jitter_sum_ns / self.jitter_count.max(1) as f64 * 1e-6,
            samples_per_s: per_s(self.delivered),
            bytes_per_s: per_s(statistics.bytes),
            clock: clock.map(ClockModel::summary),
            by_arrival: None,
        }
    }
}

/// The values of one link as a user has them who goes by the time of arrival, against the values at
/// the true times: equation (64).
#[derive(Debug)]
pub(super) struct ArrivalUser {
    /// Taken off the times of arrival, ns.
    latency_ns: f64,
    /// What the user has, from the value at or before the oldest true time on.
    points: VecDeque<(i64, [f64; 3])>,
    /// True times and values to compare at.
    waiting: VecDeque<(i64, [f64; 3])>,
    squares: f64,
    count: u64,
}

/// Values held at most: more than a link holds up.
const MAX_HELD: usize = 1 << 16;

impl ArrivalUser {
    pub fn new(latency_ns: f64) -> Self {
        Self {
            latency_ns,
            points: VecDeque::new(),
            waiting: VecDeque::new(),
            squares: 0.0,
            count: 0,
        }
    }

    /// What comes next does not follow what came before.
    pub fn restart(&mut self) {
        self.points.clear();
        self.waiting.clear();
    }

    /// A sample of `value`, m/s², taken at `true_ns`, that the user thinks was at `arrived_ns`.
    pub fn take(&mut self, true_ns: u64, arrived_ns: u64, value: [f64; 3]) {
        self.waiting.push_back((true_ns as i64, value));
        let time = (arrived_ns as i64).wrapping_sub(self.latency_ns as i64);
        // Time does not go back for the user either.
        let time = self.points.back().map_or(time, |(last, _)| time.max(*last));
        self.points.push_back((time, value));
        while let Some(&(true_ns, truth)) = self.waiting.front() {
            if true_ns > time {
                break;
            }
            self.waiting.pop_front();
            while self.points.get(1).is_some_and(|(next, _)| *next <= true_ns) {
                self.points.pop_front();
            }
            let (Some(&(before, from)), Some(&(next, to))) =
                (self.points.front(), self.points.get(1))
            else {
                continue;
            };
            if before > true_ns {
                continue;
            }
            let share = (true_ns - before) as f64 / (next - before) as f64;
            for axis in 0..3 {
                let seen = from[axis] + share * (to[axis] - from[axis]);
                self.squares += (seen - truth[axis]).powi(2);
            }
            self.count += 1;
        }
        while self.waiting.len() > MAX_HELD {
            self.waiting.pop_front();
        }
        while self.points.len() > MAX_HELD {
            self.points.pop_front();
        }
    }

    /// m/s² rms over the three axes together.
    pub fn rms_mps2(&self) -> f64 {
        (self.squares / self.count.max(1) as f64).sqrt()
    }
}
