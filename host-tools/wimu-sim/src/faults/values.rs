//! Values that change between the sensor and the frame.

use wimu_link::{Batch, Deframer, Kind, MAX_FRAME, Telemetry, batch};
use wimu_model::{Counts, DeviceTimeUs, STANDARD_GRAVITY_MPS2, SpecificForceQ16};

use super::ValueFaults;
use crate::random::Random;

/// Takes frames apart, changes the samples of batches, and puts them together again. What is no
/// frame passes as it is, and so do raw samples before the first epoch tells their unit.
#[derive(Debug)]
pub(super) struct ValueChanger {
    faults: ValueFaults,
    random: Random,
    deframer: Deframer,
    /// What has come of the frame so far.
    held: Vec<u8>,
    /// What left last.
    out: Vec<u8>,
    mps2_per_lsb: Option<f64>,
}

impl ValueChanger {
    pub(super) fn new(faults: ValueFaults, random: Random) -> Self {
        Self {
            faults,
            random,
            deframer: Deframer::new(),
            held: Vec::new(),
            out: Vec::new(),
            mps2_per_lsb: None,
        }
    }

    /// Takes a byte; what leaves because of it.
    pub(super) fn push(&mut self, byte: u8) -> &[u8] {
        self.held.push(byte);
        let received = self.deframer.push(byte);
        if byte != 0 && self.held.len() < MAX_FRAME {
            return &[];
        }
        self.out.clear();
        std::mem::swap(&mut self.out, &mut self.held);
        if let Some(Ok(frame)) = received {
            match frame.kind {
                Kind::Telemetry => {
                    if let Ok(Telemetry::Epoch(epoch)) = Telemetry::decode(frame.body) {
                        self.mps2_per_lsb =
                            Some(STANDARD_GRAVITY_MPS2 / epoch.sensitivity_lsb_per_g);
                    }
                }
                Kind::Batch => {
                    if let Ok(batch) = Batch::decode(frame.body) {
                        self.change(&batch);
                    }
                }
                _ => {}
            }
        }
        &self.out
    }

    fn change(&mut self, batch: &Batch) {
        let mut frame = [0; MAX_FRAME];
        // Only the low bits travel.
        let sequence = u32::from(batch.sequence_low());
        let time = DeviceTimeUs(batch.time_low().into());
        let encoded = match batch.stream() {
            batch::Stream::Raw => {
                let Some(mps2_per_lsb) = self.mps2_per_lsb else {
                    return;
                };
                let samples: Vec<Counts> = batch
                    .samples()
                    .iter()
                    .map(|sample| {
                        let si = sample.map(|value| f64::from(value) * mps2_per_lsb);
                        let lsb = self.changed(si).map(|value| value / mps2_per_lsb);
                        Counts(lsb.map(|value| libm::round(value) as i16))
                    })
                    .collect();
                batch::encode(sequence, time, &samples, &mut frame)
            }
            batch::Stream::Corrected => {
                let samples: Vec<SpecificForceQ16> = batch
                    .specific_forces()
                    .map(|force| {
                        let changed = self.changed(force.to_mps2().0);
                        let lsb = changed.map(|value| value * SpecificForceQ16::LSB_PER_MPS2);
                        SpecificForceQ16(lsb.map(|value| libm::round(value) as i32))
                    })
                    .collect();
                batch::encode(sequence, time, &samples, &mut frame)
            }
        };
        if let Ok(length) = encoded {
            self.out.clear();
            self.out.extend_from_slice(&frame[..length]);
        }
    }

    fn changed(&mut self, mps2: [f64; 3]) -> [f64; 3] {
        let ValueFaults {
            bias_mps2,
            scale,
            noise_mps2,
        } = self.faults;
        std::array::from_fn(|axis| {
            let noise = noise_mps2 * self.random.gaussian();
            mps2[axis] * (1.0 + scale[axis]) + bias_mps2[axis] + noise
        })
    }
}
