//! Sample times against the device's clock.

use wimu_model::{DeviceTimeUs, PeriodNs};

use crate::sensor::Batch;

/// Shortest measurement of the sample period, ns.
const MEASURE_NS: u64 = 2_000_000_000;
/// Largest deviation of a measured period from the nominal one, per mille.
const BELIEVABLE_PER_MILLE: u64 = 200;
/// Time constant of the mean of the jitter, reads.
const JITTER_WEIGHT: u32 = 16;

/// Times of the reads of a sensor.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Reads {
    /// Time of the latest sample.
    pub(super) last: Option<DeviceTimeUs>,
    /// The sensor has failed since the last sample, so its queue was restarted.
    pub(crate) broken: bool,
}

impl Reads {
    /// Samples lost between the last one and this read of `count` samples, one every `period`.
    pub(crate) fn missed_before(&self, read: &Batch, count: usize, period: PeriodNs) -> u32 {
        let Some(last) = self.last else {
            return 0;
        };
        if read.queued && !read.overrun && !self.broken {
            return 0;
        }
        let period = u64::from(period.0.max(1));
        let elapsed_ns = read.last_time.0.saturating_sub(last.0).saturating_mul(1000);
        let taken = elapsed_ns.saturating_add(period / 2) / period;
        let missed = taken.saturating_sub(count as u64);
        // An overrun reported by the sensor means at least one lost sample.
        u32::try_from(missed.max(read.overrun.into())).unwrap_or(u32::MAX)
    }

    /// Mean time between the samples of a read that follows the latest sample without a gap, ns; `None` if there
    /// was no sample before it.
    pub(crate) fn spacing_ns(&self, read: &Batch) -> Option<u64> {
        let last = self.last.filter(|last| read.last_time > *last)?;
        let since = read.last_time.0.saturating_sub(last.0);
        since.checked_mul(1000)?.checked_div(read.count as u64)
    }

    pub(crate) fn count(&mut self, last: DeviceTimeUs) {
        self.last = Some(last);
        self.broken = false;
    }
}

/// Time of the sample `newer` samples before the newest of a read.
pub(crate) fn sample_time(read: &Batch, newer: usize, spacing_ns: u64) -> DeviceTimeUs {
    let before_us = (newer as u64).saturating_mul(spacing_ns) / 1000;
    DeviceTimeUs(read.last_time.0.saturating_sub(before_us))
}

/// Sample times, and the sample period measured from them.
pub(super) struct SampleClock {
    nominal: PeriodNs,
    /// In use.
    pub(super) period: PeriodNs,
    first: Option<DeviceTimeUs>,
    pub(super) reads: Reads,
    /// Sample periods from first to last, none of them missed.
    periods: u32,
    /// Equation (95).
    pub(super) jitter_ns: Option<u32>,
}

impl SampleClock {
    pub(super) fn new(nominal: PeriodNs) -> Self {
        Self {
            nominal,
            period: nominal,
            first: None,
            reads: Reads::default(),
            periods: 0,
            jitter_ns: None,
        }
    }

    /// Restarts the measurement: the number of periods in a gap is not known exactly.
    pub(super) fn restart_measurement(&mut self) {
        self.first = None;
        self.periods = 0;
    }

    /// Updates the jitter from a read that follows the latest sample, with the period measured before it:
    /// equation (95).
    pub(super) fn update_jitter(&mut self, read: &Batch, measured: Option<PeriodNs>) {
        let (Some(period), Some(last)) = (measured, self.reads.last) else {
            return;
        };
        let elapsed_ns = (read.last_time.0.saturating_sub(last.0)).saturating_mul(1000);
        let expected_ns = u64::from(period.0).saturating_mul(read.count as u64);
        let deviation = u32::try_from(elapsed_ns.abs_diff(expected_ns)).unwrap_or(u32::MAX);
        let before = self.jitter_ns.unwrap_or(deviation);
        self.jitter_ns = Some(before - before / JITTER_WEIGHT + deviation / JITTER_WEIGHT);
    }

    pub(super) fn count(&mut self, last: DeviceTimeUs, periods: u32) {
        if self.first.is_none() {
            self.first = Some(last);
        } else {
            self.periods = self.periods.saturating_add(periods);
        }
        self.reads.count(last);
    }

    /// The measured sample period, once it has been measured for long enough and is plausible.
    pub(super) fn measured(&self) -> Option<PeriodNs> {
        let elapsed_ns = self.reads.last?.0.checked_sub(self.first?.0)?.checked_mul(1000)?;
        if elapsed_ns < MEASURE_NS {
            return None;
        }
        let period = elapsed_ns.checked_div(u64::from(self.periods))?;
        let nominal = u64::from(self.nominal.0);
        let believable = period.abs_diff(nominal) * 1000 <= nominal * BELIEVABLE_PER_MILLE;
        believable.then_some(PeriodNs(period as u32))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The jitter after reads of `count` samples of 10.1 ms with the delays `late`, µs.
    fn jitter_ns(count: u64, late: impl Fn(u64) -> u64) -> Option<u32> {
        let mut clock = SampleClock::new(PeriodNs(10_000_000));
        for k in 1..=1000 {
            let last_time = DeviceTimeUs(k * count * 10_100 + late(k));
            let read = Batch::new(count as usize, last_time);
            clock.update_jitter(&read, clock.measured());
            clock.count(read.last_time, count as u32);
        }
        clock.jitter_ns
    }

    #[test]
    fn jitter_is_the_deviation_from_the_measured_period_not_the_nominal_one() {
        for count in [1, 4, 16] {
            let constant = jitter_ns(count, |_| 0).expect("long enough");
            assert!(constant <= 100, "{constant} ns");
            // Every second read is delayed by 40 µs, so each interval deviates by 40 µs.
            let alternating = jitter_ns(count, |k| k % 2 * 40).expect("long enough");
            assert!(alternating.abs_diff(40_000) <= 200, "{alternating} ns");
        }
    }
}
