//! The queue of samples in a sensor, and when those that come out of it were taken.

use wimu_model::{DeviceTimeUs, PeriodNs};

use crate::accelerometer::Batch;

/// Samples that the FIFO of a sensor holds, here of each.
pub(crate) const DEPTH: u8 = 32;
/// Most samples for which the line rises: half of the FIFO is left for the time it takes to come.
pub(crate) const MOST: u8 = 16;
/// The line rises after this time, ns, unless that is too many.
const LATENCY_NS: u32 = 40_000_000;
/// How late the line may be before the FIFO is looked at without it: sample periods …
const LATE: u64 = 3;
/// … and this, µs.
const LATE_US: u64 = 20_000;

/// How a sensor's FIFO is run.
pub(crate) struct SensorFifo {
    period: PeriodNs,
    /// How long it takes to read a sample, µs.
    transfer_us: u64,
    watermark: u8,
    /// When the newest sample that was read was taken.
    last: Option<DeviceTimeUs>,
}

/// What was found in it.
#[derive(Clone, Copy)]
pub(crate) struct Look {
    /// When the line rose, as far as anybody knows.
    pub rose: DeviceTimeUs,
    /// When the samples were counted.
    pub at: DeviceTimeUs,
    /// How many waited.
    pub waiting: u8,
    /// Whether others before them were lost.
    pub overrun: bool,
}

impl SensorFifo {
    /// Empty, of samples every `period`, each of which is read in `transfer_us`.
    pub(crate) fn new(period: PeriodNs, transfer_us: u64) -> Self {
        Self {
            period,
            transfer_us,
            watermark: (LATENCY_NS / period.0.max(1)).clamp(1, MOST.into()) as u8,
            last: None,
        }
    }

    /// Samples for which the line rises, 1..=16.
    pub(crate) fn watermark(&self) -> u8 {
        self.watermark
    }

    /// The time of `count` samples, µs.
    pub(crate) fn micros(&self, count: u8) -> u64 {
        u64::from(count) * u64::from(self.period.0) / 1000
    }

    /// When the line has risen at the latest, if it works.
    pub(crate) fn deadline(&self, now: DeviceTimeUs) -> DeviceTimeUs {
        let late = LATE * u64::from(self.period.0) / 1000 + LATE_US;
        DeviceTimeUs((now.0).saturating_add(self.micros(self.watermark) + late))
    }

    /// Whether all that were found at `look` are those that have been read by `now`: a processor that
    /// stood still in between finds others in their places.
    pub(crate) fn kept_up(&self, look: &Look, now: DeviceTimeUs) -> bool {
        let took = now.0.saturating_sub(look.at.0);
        let expected = u64::from(look.waiting).saturating_add(1) * self.transfer_us;
        let more = took.saturating_sub(expected) / self.micros(1).max(1);
        u64::from(look.waiting) + more <= look.waiting.max(DEPTH).into()
    }

    /// What was read at `look`: `count` samples, with `unread` newer ones left behind.
    pub(crate) fn read(&mut self, look: Look, count: usize, unread: u8) -> Batch {
        let newest = self.newest(look).0;
        let last_time = DeviceTimeUs(newest.saturating_sub(self.micros(unread)));
        self.last = Some(last_time);
        Batch {
            count,
            last_time,
            overrun: look.overrun,
            queued: true,
        }
    }

    /// When the newest sample was taken.
    fn newest(&self, look: Look) -> DeviceTimeUs {
        let period = self.micros(1);
        let oldest = look.at.0.saturating_sub(period);
        let by_line =
            (look.rose.0).saturating_add(self.micros(look.waiting.saturating_sub(self.watermark)));
        // A line that nobody could look at in time tells when that was over instead, and one that
        // several chips share may tell of another.
        let believable = oldest.saturating_sub(period / 4)..=look.at.0;
        if look.waiting >= self.watermark && believable.contains(&by_line) {
            return DeviceTimeUs(by_line);
        }
        let expected = match self.last {
            Some(last) if !look.overrun => last.0.saturating_add(self.micros(look.waiting)),
            // In the middle of when it can have been.
            _ => look.at.0.saturating_sub(period / 2),
        };
        DeviceTimeUs(expected.clamp(oldest, look.at.0))
    }
}
