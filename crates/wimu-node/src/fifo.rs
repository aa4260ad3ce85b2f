//! FIFO of a sensor: watermark, and times of the samples read.

use wimu_model::{DeviceTimeUs, PeriodNs};

use crate::sensor::Batch;

/// Capacity of the FIFO of each supported sensor, samples.
pub(crate) const DEPTH: u8 = 32;
/// Maximum watermark, samples: half of the FIFO, so that the other half covers the latency of a read.
pub(crate) const MAX_WATERMARK: u8 = 16;
/// Target duration of the samples at the watermark, ns; the watermark is limited to [`MAX_WATERMARK`]. It limits
/// the latency of samples at low rates.
const LATENCY_NS: u32 = 40_000_000;
/// First part of the delay of the data-ready edge after which the FIFO is read without it, sample periods: allows
/// for a rate below the nominal one.
const LATE_PERIODS: u64 = 3;
/// Second part of that delay, µs: margin for the latency of interrupts and tasks.
const LATE_US: u64 = 20_000;

/// Watermark and sample times of a FIFO.
pub(crate) struct SensorFifo {
    period: PeriodNs,
    /// Time to read a sample, µs.
    transfer_us: u64,
    watermark: u8,
    /// Time of the newest sample read.
    last: Option<DeviceTimeUs>,
}

/// State of the FIFO before a read.
#[derive(Clone, Copy)]
pub(crate) struct FifoState {
    /// Time of the data-ready edge, or of the wake-up without a captured edge.
    pub edge_time: DeviceTimeUs,
    /// Time at which the FIFO level was read.
    pub at: DeviceTimeUs,
    /// Samples in the FIFO.
    pub level: u8,
    /// Whether earlier samples were lost.
    pub overrun: bool,
}

impl SensorFifo {
    /// An empty FIFO with a sample every `period`, each of which is read in `transfer_us`.
    pub(crate) fn new(period: PeriodNs, transfer_us: u64) -> Self {
        Self {
            period,
            transfer_us,
            watermark: (LATENCY_NS / period.0.max(1)).clamp(1, MAX_WATERMARK.into()) as u8,
            last: None,
        }
    }

    /// The watermark, samples, 1..=16.
    pub(crate) fn watermark(&self) -> u8 {
        self.watermark
    }

    /// Duration of `count` sample periods, µs.
    pub(crate) fn micros(&self, count: u8) -> u64 {
        u64::from(count) * u64::from(self.period.0) / 1000
    }

    /// The time at which the line must have risen.
    pub(crate) fn deadline(&self, now: DeviceTimeUs) -> DeviceTimeUs {
        let late = LATE_PERIODS * u64::from(self.period.0) / 1000 + LATE_US;
        DeviceTimeUs((now.0).saturating_add(self.micros(self.watermark) + late))
    }

    /// Whether the samples read by `now` are those counted in `state`: if the read was delayed for long, newer
    /// samples have overwritten them.
    pub(crate) fn kept_up(&self, state: &FifoState, now: DeviceTimeUs) -> bool {
        let took = now.0.saturating_sub(state.at.0);
        let expected = u64::from(state.level).saturating_add(1) * self.transfer_us;
        let more = took.saturating_sub(expected) / self.micros(1).max(1);
        u64::from(state.level) + more <= state.level.max(DEPTH).into()
    }

    /// The result of a read of `count` samples, with `unread` newer ones left in the FIFO.
    pub(crate) fn read(&mut self, state: FifoState, count: usize, unread: u8) -> Batch {
        let newest = self.newest(state).0;
        let last_time = DeviceTimeUs(newest.saturating_sub(self.micros(unread)));
        self.last = Some(last_time);
        Batch::new(count, last_time)
            .with_overrun(state.overrun)
            .from_queue()
    }

    /// Time of the newest sample in the FIFO.
    fn newest(&self, state: FifoState) -> DeviceTimeUs {
        let period = self.micros(1);
        let oldest = state.at.0.saturating_sub(period);
        let by_line = (state.edge_time.0)
            .saturating_add(self.micros(state.level.saturating_sub(self.watermark)));
        // The edge is not used if it is implausible: the wake-up was delayed, or another chip drives a shared
        // line.
        let believable = oldest.saturating_sub(period / 4)..=state.at.0;
        if state.level >= self.watermark && believable.contains(&by_line) {
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
