//! Completion of short sequence numbers and times.

use wimu_link::{Batch, batch};
use wimu_model::{DeviceTimeUs, PeriodNs};

/// Largest difference between a batch's time and that of its sequence number, µs: jitter. A quarter of the time since
/// the anchor is added, for a sensor whose rate is off by 20 %.
const PLACE_TOLERANCE_US: u64 = 250_000;
/// Largest lead of a device time over the latest one and the host time since, µs: the longest
/// stall of a link. Chosen: a Bluetooth link is given up after 30 s at most.
pub const MAX_AHEAD_US: u64 = 120_000_000;
/// Shortest accepted sample period, ns: twice the rate of the fastest supported sensor
/// (LSM303AGR, 5376 Hz).
const MIN_PERIOD_NS: u32 = 93_000;

/// A known sample of a link, by which short numbers are completed.
#[derive(Clone, Copy, Debug)]
pub struct Anchor {
    pub sequence: u32,
    pub time: DeviceTimeUs,
    pub period: PeriodNs,
    /// Time of arrival, ns of the host.
    pub host_ns: u64,
}

impl Anchor {
    /// Sequence number and time of a batch, if they are consistent.
    pub fn place(&self, batch: &Batch) -> Option<(u32, DeviceTimeUs)> {
        let sequence = batch::extend_sequence(batch.sequence_low(), self.sequence);
        let time = batch::extend_time(batch.time_low(), self.time);
        let samples = i64::from(sequence.wrapping_sub(self.sequence) as i32);
        let foretold_us = samples * i64::from(self.period.0) / 1000;
        let passed_us = time.0.wrapping_sub(self.time.0) as i64;
        let tolerance = PLACE_TOLERANCE_US + foretold_us.unsigned_abs() / 4;
        (foretold_us.abs_diff(passed_us) <= tolerance).then_some((sequence, time))
    }

    /// The latest device time that can arrive at `host_ns`, µs.
    pub fn latest_us(&self, host_ns: u64) -> u64 {
        let passed_us = host_ns.saturating_sub(self.host_ns) / 1000;
        let ahead_us = passed_us.saturating_add(MAX_AHEAD_US);
        self.time.0.saturating_add(ahead_us)
    }

    /// Whether the device can have taken a sample of this number by the device time `by_us`, at a
    /// rate that is up to 25 % off.
    pub fn reaches(&self, sequence: u32, by_us: u64) -> bool {
        let samples = sequence.wrapping_sub(self.sequence) as i32;
        let period_ns = self.period.0.max(MIN_PERIOD_NS);
        let foretold_us = u64::from(samples.unsigned_abs()) * u64::from(period_ns) / 1000;
        let passed_us = by_us.saturating_sub(self.time.0);
        foretold_us <= passed_us.saturating_add(passed_us / 4)
    }

    /// Whether the device can have sent `next` after this. Back in time, it may have restarted.
    pub fn leads_to(&self, next: &Self) -> bool {
        let period = PeriodNs(self.period.0.min(next.period.0));
        let by_us = next.time.0.saturating_add(MAX_AHEAD_US);
        let is_reached = Self { period, ..*self }.reaches(next.sequence, by_us);
        next.time <= self.time || (is_reached && next.time.0 <= self.latest_us(next.host_ns))
    }
}
