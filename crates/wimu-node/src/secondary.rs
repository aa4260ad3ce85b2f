//! Sensors with index 1 and up: their samples are sent without correction.

use embassy_sync::blocking_mutex::raw::RawMutex;
use wimu_link::batch;
use wimu_link::message::{Epoch, EpochReason};
use wimu_model::DeviceTimeUs;

use crate::sample::RawSample;
use crate::sampler::batches::{Batcher, Lane};
use crate::sampler::clock::{Reads, sample_time};
use crate::sampler::{EPOCH_DUE_US, epoch_gyroscope};
use crate::sensor::{Batch, SensorPlan};
use crate::shared::{ALL, Common, Message};

/// A sensor with index 1 and up: its samples are sent without correction, with their own numbers and epochs, and
/// corrected on the host.
#[derive(Debug)]
pub struct Secondary {
    /// Its operation. Changes are made in [`configure`](crate::InertialSensor::configure).
    pub plan: SensorPlan,
    next_sequence: u32,
    /// Epochs sent, modulo 256.
    epochs: u8,
    reads: Reads,
    last_epoch: DeviceTimeUs,
    /// Why the next sample begins an epoch.
    due: Option<EpochReason>,
}

impl Secondary {
    /// A sensor that operates as `plan` says.
    pub fn new(plan: SensorPlan) -> Self {
        Self {
            plan,
            next_sequence: 0,
            epochs: 0,
            reads: Reads::default(),
            last_epoch: DeviceTimeUs(0),
            due: Some(EpochReason::Start),
        }
    }

    /// The sensor has failed, or has been configured again.
    pub(crate) fn restart(&mut self, reason: EpochReason) {
        self.due.get_or_insert(reason);
        self.reads.broken = true;
    }

    /// Sends the samples of a read, and an epoch before them where one is due. Batches end with the read.
    pub(crate) fn process<S: RawSample, M: RawMutex>(
        &mut self,
        read: &Batch,
        samples: &[S],
        lanes: &[Lane<S>],
        shared: &Common<M>,
        temperature_centi_c: Option<i16>,
    ) {
        let plan = self.plan;
        let missed = self.reads.missed_before(read, samples.len(), plan.period);
        let measured_ns = self.reads.spacing_ns(read).filter(|_| missed == 0);
        let spacing_ns = measured_ns.unwrap_or(plan.period.0.into());
        let time = sample_time(read, samples.len().saturating_sub(1), spacing_ns);
        self.next_sequence = self.next_sequence.wrapping_add(missed);
        let reason = match (self.due.take(), measured_ns) {
            (Some(reason), _) => Some(reason),
            (None, None) => Some(EpochReason::Gap),
            // Before the read that would be later than hosts expect an epoch.
            _ if time.0.saturating_sub(self.last_epoch.0) >= EPOCH_DUE_US => {
                Some(EpochReason::Periodic)
            }
            _ => None,
        };
        if let Some(reason) = reason {
            self.last_epoch = time;
            self.epochs = self.epochs.wrapping_add(1);
            let lsb_per_g = plan.accelerometer.sensitivity().lsb_per_g();
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
                gyroscope: epoch_gyroscope(&plan),
                ..Epoch::default()
            });
            shared.announce(&epoch, ALL);
        }
        for lane in lanes {
            let first = self.next_sequence;
            match plan.gyroscope {
                Some(_) => send(lane, first, read, spacing_ns, samples, |s| s, shared),
                None => send(lane, first, read, spacing_ns, samples, S::accelerometer, shared),
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
