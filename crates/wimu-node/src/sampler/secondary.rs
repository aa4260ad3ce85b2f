//! Sensors with index 1 to 3: their samples are sent without correction.

use embassy_sync::blocking_mutex::raw::RawMutex;
use wimu_link::batch;
use wimu_link::message::{Epoch, EpochReason};
use wimu_model::DeviceTimeUs;

use super::batches::{Batcher, Lane};
use super::clock::{Reads, sample_time};
use super::{EPOCH_DUE_US, epoch_gyroscope};
use crate::sample::RawSample;
use crate::sensor::{Batch, SensorPlan};
use crate::shared::{Common, Message};

/// Numbers and times of one sensor.
#[derive(Clone, Copy, Default)]
pub(super) struct Secondary {
    next_sequence: u32,
    /// Epochs sent, modulo 256.
    epochs: u8,
    reads: Reads,
    last_epoch: DeviceTimeUs,
    /// Whether an epoch has been sent since the latest configuration.
    begun: bool,
}

impl Secondary {
    /// The sensor has been configured again.
    pub(super) fn restart(&mut self) {
        self.begun = false;
        self.reads.broken = true;
    }

    /// Sends the samples of a read, and an epoch before them where one is due. Batches end with the read.
    pub(super) fn process<S: RawSample, M: RawMutex>(
        &mut self,
        plan: &SensorPlan,
        read: &Batch,
        samples: &[S],
        lanes: &[Lane<S>],
        shared: &Common<M>,
        temperature_centi_c: Option<i16>,
    ) {
        let missed = self.reads.missed_before(read, samples.len(), plan.period);
        let measured_ns = self.reads.spacing_ns(read).filter(|_| missed == 0);
        let spacing_ns = measured_ns.unwrap_or(plan.period.0.into());
        let time = sample_time(read, samples.len().saturating_sub(1), spacing_ns);
        self.next_sequence = self.next_sequence.wrapping_add(missed);
        let reason = match (self.begun, measured_ns) {
            (false, _) => Some(EpochReason::Settings),
            (true, None) => Some(EpochReason::Gap),
            // Before the read that would be later than hosts expect an epoch.
            _ if time.0.saturating_sub(self.last_epoch.0) >= EPOCH_DUE_US => {
                Some(EpochReason::Periodic)
            }
            _ => None,
        };
        if let Some(reason) = reason {
            self.begun = true;
            self.last_epoch = time;
            self.epochs = self.epochs.wrapping_add(1);
            let lsb_per_g = plan.sensitivity.lsb_per_g();
            let epoch = Message::Epoch(Epoch {
                reason,
                number: self.epochs,
                sequence: self.next_sequence,
                time_us: time.0,
                period_ns: plan.period.0,
                range_g: (f64::from(plan.full_scale) / lsb_per_g + 0.5) as u8,
                sensitivity_lsb_per_g: lsb_per_g,
                full_scale: plan.full_scale,
                temperature_centi_c,
                sensor: read.sensor,
                gyroscope: epoch_gyroscope(plan),
                ..Epoch::default()
            });
            shared.announce(&epoch, [true; 2]);
        }
        for lane in lanes {
            let first = self.next_sequence;
            match plan.gyroscope {
                Some(_) => send(lane, first, read, spacing_ns, samples, |s| s, shared),
                None => send(
                    lane,
                    first,
                    read,
                    spacing_ns,
                    samples,
                    S::accelerometer,
                    shared,
                ),
            }
        }
        self.next_sequence = self.next_sequence.wrapping_add(samples.len() as u32);
        self.reads.count(read.last_time);
    }
}

/// Sends the samples of a read on a lane.
fn send<S: RawSample, B: batch::Sample, M: RawMutex>(
    lane: &Lane<S>,
    first: u32,
    read: &Batch,
    spacing_ns: u64,
    samples: &[S],
    part: fn(S) -> B,
    shared: &Common<M>,
) {
    let mut batcher = Batcher::default();
    for (index, &sample) in samples.iter().enumerate() {
        let sequence = first.wrapping_add(index as u32);
        if lane.takes(sequence) {
            let newer = samples.len() - 1 - index;
            batcher.add(sequence, sample_time(read, newer, spacing_ns), part(sample));
        }
        if batcher.len() >= lane.length::<B>() {
            lane.send(shared, read.sensor, &mut batcher);
        }
    }
    lane.send(shared, read.sensor, &mut batcher);
}
