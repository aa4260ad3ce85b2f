//! Fit of one table's times to the other's.

use nalgebra::Matrix4;

use super::MAX_RATE;
use super::signal::Signal;
use crate::stats::norm;

/// Residuals are correlated within this time and taken as independent beyond, s.
const CLUSTER_S: f64 = 1.0;

/// The other's time in the reference's.
#[derive(Clone, Copy, Debug)]
pub(super) struct TimeFit {
    /// Added to the other's time at the middle, s.
    pub offset_s: f64,
    /// Its growth per second of the reference.
    pub rate: f64,
    pub middle: f64,
    /// Standard deviations of both.
    pub sd: [f64; 2],
}

impl TimeFit {
    pub fn theirs(&self, time: f64) -> f64 {
        time - self.offset_s - self.rate * (time - self.middle)
    }

    /// The reference's time of the other's.
    pub fn ours(&self, theirs: f64) -> f64 {
        (theirs + self.offset_s - self.rate * self.middle) / (1.0 - self.rate)
    }

    /// One step towards the best fit of |y| of the other by c + k|x|, by the derivative of |x| for an offset
    /// and that times the time for a rate. Residuals are weighted by the derivative of |y|, whose noise is independent
    /// of that of |x| (instrumental variables), so that noise does not bias the step. The standard deviations allow for
    /// correlated residuals within a second.
    pub fn refined(
        &self,
        a: &Signal,
        b: &Signal,
        (start, end): (f64, f64),
        step: f64,
        has_rate: bool,
    ) -> Option<Self> {
        let row = |time: f64| {
            let near = [time - step, time, time + step];
            let theirs = self.theirs(time);
            let is_saturated = |at: f64| a.is_saturated_at(at);
            if near.into_iter().any(is_saturated) || b.is_saturated_at(theirs) {
                return None;
            }
            let [before, now, after] = near.map(|at| a.at(at).map(norm));
            let now = now?;
            let theirs = [theirs - step, theirs, theirs + step];
            let [y_before, y, y_after] = theirs.map(|at| b.at(at).map(norm));
            let with = |change: f64| {
                let change = change / (2.0 * step);
                let growing = if has_rate { change * (time - self.middle) } else { 0.0 };
                [1.0, now, change, growing]
            };
            Some((with(after? - before?), with(y_after? - y_before?), y?))
        };
        let unknowns = if has_rate { 4 } else { 3 };
        let count = ((end - start) / step).max(0.0) as usize;
        let rows = || (1..count).filter_map(|k| row(start + k as f64 * step).map(|row| (k, row)));
        let (mut normal, mut right) = ([[0.0; 4]; 4], [0.0; 4]);
        for (_, (x, weights, y)) in rows() {
            for i in 0..unknowns {
                right[i] += weights[i] * y;
                for j in 0..unknowns {
                    normal[i][j] += weights[i] * x[j];
                }
            }
        }
        let inverse = inverse(normal, unknowns)?;
        let times =
            |v: [f64; 4]| inverse.map(|row| (0..unknowns).map(|j| row[j] * v[j]).sum::<f64>());
        let found = times(right);
        let of_cluster = (CLUSTER_S / step).ceil() as usize;
        let (mut sum, mut cluster, mut variances) = ([0.0; 4], 0, [0.0; 4]);
        let mut close = |sum: [f64; 4]| {
            for (variance, influence) in variances.iter_mut().zip(times(sum)) {
                *variance += influence * influence;
            }
        };
        for (k, (x, weights, y)) in rows() {
            if k / of_cluster != cluster {
                close(std::mem::take(&mut sum));
                cluster = k / of_cluster;
            }
            let left = y - (0..unknowns).map(|i| x[i] * found[i]).sum::<f64>();
            for i in 0..unknowns {
                sum[i] += weights[i] * left;
            }
        }
        close(sum);
        // The other's gain against the reference.
        let gain = found[1];
        if gain.abs() < 0.1 {
            return None;
        }
        let fit = Self {
            offset_s: self.offset_s + found[2] / gain,
            rate: self.rate + found[3] / gain,
            middle: self.middle,
            sd: [2, 3].map(|k| variances[k].sqrt() / gain.abs()),
        };
        // A valid step is small.
        let moved = (fit.offset_s - self.offset_s).abs();
        (moved < 5.0 * step && fit.rate.abs() <= MAX_RATE).then_some(fit)
    }
}

/// The inverse of the first `size` rows and columns of a nearly symmetric positive matrix.
fn inverse(matrix: [[f64; 4]; 4], size: usize) -> Option<[[f64; 4]; 4]> {
    // Normalised, because seconds and seconds squared differ in magnitude.
    let scale: [f64; 4] = std::array::from_fn(|k| if k < size { matrix[k][k].sqrt() } else { 1.0 });
    let scaled = Matrix4::from_fn(|row, column| match row.max(column) < size {
        true => matrix[row][column] / (scale[row] * scale[column]),
        false => f64::from(u8::from(row == column)),
    });
    // The pivots.
    let mut before = 1.0;
    for rows in 1..=size {
        let minor = scaled.view((0, 0), (rows, rows)).clone_owned().determinant();
        // Not a number where the diagonal was negative.
        if minor.is_nan() || minor < 1e-9 * before {
            return None;
        }
        before = minor;
    }
    let inverse = scaled.lu().try_inverse()?;
    Some(std::array::from_fn(|row| {
        std::array::from_fn(|column| inverse[(row, column)] / (scale[row] * scale[column]))
    }))
}
