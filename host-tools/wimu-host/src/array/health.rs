//! Faults of the sensors of an array: stopped outputs, and outputs at the end of their range.

use nalgebra::Vector3;
use wimu_model::STANDARD_GRAVITY_MPS2;

use super::Array;
use crate::series::Flags;

/// Shortest constant output of a stopped sensor while most others change in each sample, samples.
const STOPPED_SAMPLES: usize = 64;
/// Fewest samples at the end of the range.
const LIMIT_SAMPLES: usize = 4;
/// Width of the band below the end of the range that is compared with it, relative to the largest output.
const NEAR_LIMIT: f64 = 0.02;
/// Least width of that band, steps of the output.
const NEAR_STEPS: f64 = 3.0;
/// Lowest range of a sensor, g.
const LEAST_LIMIT: f64 = 1.08;
/// Least ratio of the ranges of two sensors of one array.
const ALIKE: f64 = 0.8;

/// Same value but for rounding.
fn same(a: f64, b: f64) -> bool {
    (a - b).abs() <= 1e-9 * a.abs().max(b.abs())
}

impl Array {
    /// Leaves out the constant outputs of stopped sensors. Marks samples at the end of the range: the largest output, if it is
    /// more frequent than those just below it. Remarks report each.
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
        let mut found: Vec<(usize, usize, f64)> = Vec::new();
        let mut rest = Vec::new();
        for sensor in 0..self.sensors() {
            for axis in 0..3 {
                for sign in [-1.0, 1.0] {
                    let values = || {
                        let all =
                            self.units[sensor].force.v.iter().map(|output| sign * output[axis]);
                        all.filter(|v| v.is_finite())
                    };
                    let largest = values().fold(f64::NEG_INFINITY, f64::max);
                    let shows = is_limit(largest, &values);
                    let list = if shows { &mut found } else { &mut rest };
                    list.push((sensor, axis, sign * largest));
                }
            }
        }
        let largest = found.iter().map(|(.., v)| v.abs()).fold(0.0, f64::max);
        found.retain(|(.., limit)| limit.abs() >= ALIKE * largest);
        if found.is_empty() {
            return;
        }
        // Others that reach the very same value were there too, if less often.
        let shown: Vec<f64> = found.iter().map(|(.., v)| v.abs()).collect();
        rest.retain(|(.., v)| shown.iter().any(|limit| same(v.abs(), *limit)));
        found.extend(rest);
        let mut marked = vec![false; self.len()];
        for (sensor, axis, limit) in &found {
            let force = &mut self.units[*sensor].force;
            for ((output, flags), marked) in force.v.iter().zip(&mut force.flags).zip(&mut marked) {
                let is_beyond = output[*axis] * limit.signum() >= limit.abs() * (1.0 - 1e-9);
                *marked |= is_beyond && !flags.is_saturated();
                *flags |= Flags::saturated(is_beyond);
            }
        }
        let marked = marked.iter().filter(|is_marked| **is_marked).count();
        if marked > 0 {
            let mut sensors: Vec<usize> = found.iter().map(|(sensor, ..)| *sensor).collect();
            sensors.sort_unstable();
            sensors.dedup();
            self.remarks.push(format!(
                "sensors {sensors:?} (from 0) repeat outputs of up to {largest:.2} m/s² and none beyond: taken \
                 for their limit, {marked} samples"
            ));
        }
    }
}

/// Whether the largest of values looks like a limit.
fn is_limit<I: Iterator<Item = f64>>(largest: f64, values: &dyn Fn() -> I) -> bool {
    if !(largest.is_finite() && largest > LEAST_LIMIT * STANDARD_GRAVITY_MPS2) {
        return false;
    }
    let mut last = f64::NAN;
    let mut step = f64::INFINITY;
    let (mut at, mut on_end) = (0, false);
    for value in values() {
        let change = (value - last).abs();
        if change > 1e-9 * largest {
            step = step.min(change);
        }
        if same(value, largest) {
            at += 1;
            on_end |= same(value, last);
        }
        last = value;
    }
    if at < LIMIT_SAMPLES || !on_end {
        return false;
    }
    let below = largest - (NEAR_LIMIT * largest).max(NEAR_STEPS * step);
    let near = values().filter(|v| *v >= below && !same(*v, largest));
    at > 2 * near.count()
}
