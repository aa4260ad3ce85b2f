//! FIFO of a sensor: watermark, and times of the samples read.

use wimu_model::{DeviceTimeUs, PeriodNs};

use crate::sensor::Batch;

/// Maximum watermark, samples, and at most half of the FIFO, so that the other half covers the latency of a read.
const MAX_WATERMARK: u16 = 16;
/// Target duration of the samples at the watermark, ns; the watermark is limited to [`MAX_WATERMARK`]. It limits
/// the latency of samples at low rates.
const LATENCY_NS: u32 = 40_000_000;
/// First part of the delay of the data-ready edge after which the FIFO is read without it, sample periods: allows
/// for a rate below the nominal one.
const LATE_PERIODS: u64 = 3;
/// Second part of that delay, µs: margin for the latency of interrupts and tasks.
const LATE_US: u64 = 20_000;

/// Watermark and sample times of a sensor's FIFO.
///
/// [`FifoSensor`](crate::FifoSensor) sets the chip's watermark to [`watermark`](Self::watermark), waits for the data-ready
/// line, reads the level ([`FifoState`]) and the samples, and gets from [`read`](Self::read) the [`Batch`] with the time of
/// the newest sample. If [`kept_up`](Self::kept_up) is false, it reads again: samples were overwritten meanwhile.
#[derive(Debug)]
pub struct SensorFifo {
    period: PeriodNs,
    /// Capacity, samples.
    depth: u16,
    /// Time to read a sample, µs.
    transfer_us: u64,
    watermark: u16,
    /// Time of the newest sample read.
    last: Option<DeviceTimeUs>,
}

/// State of a FIFO before a read.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub struct FifoState {
    /// Time of the data-ready edge, or of the wake-up without a captured edge.
    pub edge_time: DeviceTimeUs,
    /// Time at which the FIFO level was read.
    pub at: DeviceTimeUs,
    /// Samples in the FIFO.
    pub level: u16,
    /// Samples in the FIFO at the data-ready edge; `None`: the watermark.
    pub edge_level: Option<u16>,
    /// Whether earlier samples were lost.
    pub overrun: bool,
}

impl FifoState {
    /// `level` samples at the time `at`, after the data-ready edge at `edge_time`; no samples were lost.
    pub fn new(edge_time: DeviceTimeUs, at: DeviceTimeUs, level: u16) -> Self {
        Self { edge_time, at, level, edge_level: None, overrun: false }
    }

    /// The data-ready edge was that of the sample after which the FIFO held `level` samples.
    #[must_use]
    pub fn with_edge_at(self, level: u16) -> Self {
        Self { edge_level: Some(level), ..self }
    }

    /// Whether earlier samples were lost.
    #[must_use]
    pub fn with_overrun(self, overrun: bool) -> Self {
        Self { overrun, ..self }
    }
}

impl SensorFifo {
    /// An empty FIFO of `depth` samples with a sample every `period`, each of which is read in `transfer_us` µs.
    pub fn new(depth: u16, period: PeriodNs, transfer_us: u64) -> Self {
        let most = (depth / 2).clamp(1, MAX_WATERMARK);
        Self {
            depth,
            period,
            transfer_us,
            watermark: (LATENCY_NS / period.0.max(1)).clamp(1, most.into()) as u16,
            last: None,
        }
    }

    /// Time of the newest sample read; `None` before the first.
    pub fn last(&self) -> Option<DeviceTimeUs> {
        self.last
    }

    /// The watermark, samples: those of 40 ms, 1..=16, and at most half of the FIFO.
    pub fn watermark(&self) -> u16 {
        self.watermark
    }

    /// Duration of `count` sample periods, µs.
    pub fn micros(&self, count: u16) -> u64 {
        u64::from(count) * u64::from(self.period.0) / 1000
    }

    /// The time at which the line must have risen.
    pub fn deadline(&self, now: DeviceTimeUs) -> DeviceTimeUs {
        let late = LATE_PERIODS * u64::from(self.period.0) / 1000 + LATE_US;
        DeviceTimeUs((now.0).saturating_add(self.micros(self.watermark) + late))
    }

    /// Whether the samples read by `now` are those counted in `state`: if the read was delayed for long, newer
    /// samples have overwritten them.
    pub fn kept_up(&self, state: &FifoState, now: DeviceTimeUs) -> bool {
        let took = now.0.saturating_sub(state.at.0);
        let expected = u64::from(state.level).saturating_add(1) * self.transfer_us;
        let more = took.saturating_sub(expected) / self.micros(1).max(1);
        u64::from(state.level) + more <= state.level.max(self.depth).into()
    }

    /// The result of a read of `count` samples, with `unread` newer ones left in the FIFO.
    pub fn read(&mut self, state: FifoState, count: usize, unread: u16) -> Batch {
        let newest = self.newest(state).0;
        let last_time = DeviceTimeUs(newest.saturating_sub(self.micros(unread)));
        self.last = Some(last_time);
        Batch::new(count, last_time).with_overrun(state.overrun).queued()
    }

    /// Time of the newest sample in the FIFO.
    fn newest(&self, state: FifoState) -> DeviceTimeUs {
        let period = self.micros(1);
        let oldest = state.at.0.saturating_sub(period);
        let edge_level = state.edge_level.unwrap_or(self.watermark);
        let by_line =
            (state.edge_time.0).saturating_add(self.micros(state.level.saturating_sub(edge_level)));
        // The edge is not used if it is implausible: the wake-up was delayed, or another chip drives a shared
        // line.
        let believable = oldest.saturating_sub(period / 4)..=state.at.0;
        if state.level >= edge_level && believable.contains(&by_line) {
            return DeviceTimeUs(by_line);
        }
        let expected = match self.last {
            Some(last) if !state.overrun => last.0.saturating_add(self.micros(state.level)),
            // Half a period ago on average.
            _ => state.at.0.saturating_sub(period / 2),
        };
        DeviceTimeUs(expected.clamp(oldest, state.at.0))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_watermark_is_40_ms_at_most_16_samples_and_half_of_the_fifo() {
        let watermark =
            |depth, hz: u32| SensorFifo::new(depth, PeriodNs(1_000_000_000 / hz), 100).watermark();
        for (depth, hz, samples) in [
            (32, 1, 1),
            (32, 100, 4),
            (32, 400, 16),
            (512, 6400, 16),
            (8, 400, 4),
            (1, 400, 1),
            (0, 400, 1),
        ] {
            assert_eq!(watermark(depth, hz), samples, "{depth} at {hz} Hz");
        }
    }
}
