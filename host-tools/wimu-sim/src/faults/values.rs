//! Change of values between sensor and frame.

use std::num::NonZeroU8;

use wimu_host::units::RawUnits;
use wimu_link::batch::Layout;
use wimu_link::{Batch, Deframer, Kind, MAX_FRAME, Telemetry, batch};
use wimu_model::{Counts, DeviceTimeUs, SpecificForceQ16};

use super::ValueFaults;
use crate::random::Random;

/// Decodes frames, changes the samples of batches, and encodes them again. Other bytes pass unchanged,
/// and so do raw samples of unknown unit.
#[derive(Debug)]
pub(super) struct ValueChanger {
    faults: ValueFaults,
    random: Random,
    deframer: Deframer,
    /// The current frame so far.
    held: Vec<u8>,
    /// The latest output.
    out: Vec<u8>,
    units: RawUnits,
    /// The number of the latest epoch's first sample.
    latest: u32,
}

impl ValueChanger {
    pub(super) fn new(faults: ValueFaults, random: Random) -> Self {
        Self {
            faults,
            random,
            deframer: Deframer::new(),
            held: Vec::new(),
            out: Vec::new(),
            units: RawUnits::default(),
            latest: 0,
        }
    }

    /// Takes a byte; returns the resulting output.
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
                    if let Ok(Telemetry::Epoch(epoch)) = Telemetry::decode(frame.body)
                        && epoch.sensor == 0
                    {
                        if epoch.sequence < self.latest {
                            // The board has restarted.
                            self.units = RawUnits::default();
                        }
                        self.units.see(&epoch);
                        self.units.forget_old();
                        self.latest = epoch.sequence;
                    }
                }
                Kind::Batch => {
                    if let Ok(batch) = Batch::decode(frame.kind, frame.body) {
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
        // Only the low bits are sent.
        let sequence = u32::from(batch.sequence_low());
        let time = DeviceTimeUs(batch.time_low().into());
        let Some(every) = NonZeroU8::new(batch.every()) else {
            return;
        };
        let layout = Layout { sensor: 0, every };
        let encoded = match batch.stream() {
            batch::Stream::Raw => {
                let number = batch::extend_sequence(batch.sequence_low(), self.latest);
                let Some(unit) = self.units.of(number) else {
                    return;
                };
                let mps2_per_lsb = unit.mps2_per_lsb();
                let samples: Vec<Counts> = batch
                    .samples()
                    .iter()
                    .map(|sample| {
                        let si = sample.map(|value| f64::from(value) * mps2_per_lsb);
                        let lsb = self.changed(si).map(|value| value / mps2_per_lsb);
                        Counts(lsb.map(|value| libm::round(value) as i16))
                    })
                    .collect();
                batch::encode_with(layout, sequence, time, &samples, &mut frame)
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
                batch::encode_with(layout, sequence, time, &samples, &mut frame)
            }
        };
        if let Ok(length) = encoded {
            self.out.clear();
            self.out.extend_from_slice(&frame[..length]);
        }
    }

    fn changed(&mut self, mps2: [f64; 3]) -> [f64; 3] {
        let ValueFaults { bias_mps2, scale, noise_mps2 } = self.faults;
        std::array::from_fn(|axis| {
            let noise = noise_mps2 * self.random.gaussian();
            mps2[axis] * (1.0 + scale[axis]) + bias_mps2[axis] + noise
        })
    }
}
