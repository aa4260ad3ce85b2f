//! Faults of the sensors of an array: frozen outputs, and outputs at the end of their range.

use nalgebra::Vector3;

use super::{Array, ArrayUnit};
use crate::imu::{Imu, Sample};
use crate::inertial::{Frozen, clipped};
use crate::series::Flags;

impl Array {
    /// Leaves out frozen outputs, and marks samples at a full scale. Remarks report each.
    #[must_use]
    pub fn judged(mut self) -> Self {
        self.leave_out_frozen();
        self.find_limits();
        self
    }

    fn leave_out_frozen(&mut self) {
        for (sensor, ArrayUnit { force, .. }) in self.units.iter_mut().enumerate() {
            let mut alone = Imu::default();
            for (time, force_mps2) in force.t.iter().zip(&force.v) {
                alone.push(*time, Sample { force_mps2: *force_mps2, ..Sample::default() });
            }
            let name = format!("sensor {sensor} (from 0)");
            let frozen = Frozen::of(&alone, &name, |sample| Some(sample.force_mps2));
            let Some(Frozen { samples, text }) = frozen else { continue };
            self.remarks.push(format!("{text}: left out there"));
            // The value that repeats is not one of the motion, either.
            for k in samples {
                force.v[k.saturating_sub(1)..=k].fill(Vector3::repeat(f64::NAN));
            }
        }
    }

    fn find_limits(&mut self) {
        let mut marked = vec![false; self.len()];
        let mut sensors = Vec::new();
        for (sensor, ArrayUnit { force, .. }) in self.units.iter_mut().enumerate() {
            let clipped = clipped(&force.v);
            for k in clipped.iter().filter(|k| !force.flags[**k].is_saturated()) {
                marked[*k] = true;
                sensors.push(sensor);
            }
            clipped.iter().for_each(|k| force.flags[*k] |= Flags::saturated(true));
        }
        sensors.dedup();
        let marked = marked.iter().filter(|is_marked| **is_marked).count();
        if marked > 0 {
            self.remarks.push(format!(
                "sensors {sensors:?} (from 0) are at their full scale in {marked} samples"
            ));
        }
    }
}
