//! Faults of the sensors of an array: stopped outputs, and outputs at the end of their range.

use nalgebra::Vector3;

use super::{Array, ArrayUnit};
use crate::inertial::clipped;
use crate::series::Flags;

/// Shortest constant output of a stopped sensor while most others change in each sample, samples.
const STOPPED_SAMPLES: usize = 64;

/// Same value but for rounding.
fn same(a: f64, b: f64) -> bool {
    (a - b).abs() <= 1e-9 * a.abs().max(b.abs())
}

impl Array {
    /// Leaves out the constant outputs of stopped sensors, and marks samples at a full scale. Remarks report each.
    #[must_use]
    pub fn judged(mut self) -> Self {
        self.leave_out_stopped();
        self.find_limits();
        self
    }

    fn leave_out_stopped(&mut self) {
        let (sensors, count) = (self.sensors(), self.len());
        let value = |k: usize, axis: usize| self.units[axis / 3].force.v[k][axis % 3];
        // Samples up to each in which most outputs have moved.
        let mut lively = vec![0_usize; count];
        for k in 1..count {
            let (mut moved, mut finite) = (0, 0);
            for axis in 0..3 * sensors {
                let (before, now) = (value(k - 1, axis), value(k, axis));
                if before.is_finite() && now.is_finite() {
                    finite += 1;
                    moved += usize::from(!same(before, now));
                }
            }
            lively[k] = lively[k - 1] + usize::from(2 * moved > finite);
        }
        let mut stopped: Vec<(usize, usize, usize)> = Vec::new();
        for axis in 0..3 * sensors {
            let mut first = 0;
            for k in 1..=count {
                if k < count && same(value(k, axis), value(first, axis)) {
                    continue;
                }
                if lively[k - 1] - lively[first] >= STOPPED_SAMPLES {
                    stopped.push((axis, first, k));
                }
                first = k;
            }
        }
        for (axis, first, end) in stopped {
            let sensor = axis / 3;
            let force = &mut self.units[sensor].force;
            let at = force.v[first][axis % 3];
            // Its other axes may have been found before it.
            if end - first < count && at.is_finite() {
                self.remarks.push(format!(
                    "sensor {sensor} (from 0) stood still from {:.2} to {:.2} s: its {} axis gave {at:.3} m/s² \
                     each time; left out there",
                    force.t[first].s(),
                    force.t[end - 1].s(),
                    ["X", "Y", "Z"][axis % 3]
                ));
            }
            force.v[first..end].fill(Vector3::repeat(f64::NAN));
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
