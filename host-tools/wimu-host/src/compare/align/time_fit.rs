//! Fit of one table's times to the other's.

use nalgebra::{Matrix4, Vector4};

use super::signal::Signal;
use crate::lag::{Search, lag};
use crate::series::{Interp, Ns, Series};

/// Largest rate difference of the clocks.
const MAX_RATE: f64 = 0.01;
/// Shortest part that is aligned by itself, s, and its least correlation.
const MIN_PART_S: f64 = 3.0;
const MIN_CORRELATION: f64 = 0.6;
/// Steps towards the best fit.
const STEPS: usize = 4;
/// Residuals are correlated within this time and taken as independent beyond, s.
const CLUSTER_S: f64 = 1.0;
/// Smallest standard deviation of a time, as a fraction of the row interval, because of linear interpolation.
const BETWEEN_ROWS: f64 = 0.02;
/// Least determinant of the normalised equations.
const SINGULAR: f64 = 1e-12;

/// The other's time in the reference's. Times are seconds after the reference's first.
#[derive(Clone, Copy, Debug)]
pub(super) struct TimeFit {
    pub origin: Ns,
    /// Added to the other's time at the middle, s.
    pub offset_s: f64,
    /// Its growth per second of the reference; zero where the overlap is short.
    pub rate: f64,
    pub has_rate: bool,
    /// Start and end of the overlap.
    pub overlap_s: [f64; 2],
    /// Standard deviations of offset and rate.
    pub sd: [f64; 2],
}

/// Derivatives by offset, gain, and both changes, the instruments, and the other's magnitude.
struct Row {
    cluster: usize,
    x: Vector4<f64>,
    weights: Vector4<f64>,
    y: f64,
}

impl TimeFit {
    /// From the lag of both.
    pub fn of(signals: &[Signal; 2], offset_s: f64, step_s: f64, least_rate_s: f64) -> Self {
        let [a, b] = signals.each_ref().map(|signal| signal.force.span().unwrap_or_default());
        let origin = a[0];
        let from_s = f64::max(0.0, b[0].since_s(origin) + offset_s);
        let to_s = a[1].since_s(origin).min(b[1].since_s(origin) + offset_s);
        let has_rate = to_s - from_s >= least_rate_s;
        let overlap_s = [from_s, to_s];
        let mut fit = Self { origin, offset_s, rate: 0.0, has_rate, overlap_s, sd: [0.0; 2] };
        if has_rate {
            // The rate changes the ends: first a rough correction, then refinements.
            fit.rate = fit.drift(signals, step_s).unwrap_or(0.0);
        }
        for _ in 0..STEPS {
            fit = fit.refined(signals, step_s).unwrap_or(fit);
        }
        let between_s = BETWEEN_ROWS * step_s;
        fit.sd[0] = fit.sd[0].hypot(between_s);
        fit.sd[1] = fit.sd[1].hypot(between_s * 12.0_f64.sqrt() / (to_s - from_s));
        fit
    }

    fn middle_s(&self) -> f64 {
        0.5 * (self.overlap_s[0] + self.overlap_s[1])
    }

    pub fn theirs(&self, time_s: f64) -> f64 {
        time_s - self.offset_s - self.rate * (time_s - self.middle_s())
    }

    /// The reference's time of the other's.
    pub fn ours(&self, theirs_s: f64) -> f64 {
        (theirs_s + self.offset_s - self.rate * self.middle_s()) / (1.0 - self.rate)
    }

    /// Growth of the offset from the first third of the overlap to the last, per second; `None` where a third does not fit on
    /// its own.
    fn drift(&self, signals: &[Signal; 2], step_s: f64) -> Option<f64> {
        let [from_s, to_s] = self.overlap_s;
        let third_s = (to_s - from_s) / 3.0;
        if third_s < MIN_PART_S {
            return None;
        }
        let [a, b] = signals.each_ref().map(|signal| signal.force.map(|force| force.norm()));
        let part = |series: &Series<f64>, from_s: f64| {
            series.within([from_s, from_s + third_s].map(|s| self.origin.after_s(s)))
        };
        let reach_s = MAX_RATE * (to_s - from_s) + step_s;
        let search = Search { around_s: self.offset_s, reach_s, overlap_s: 0.5 * third_s };
        let offset_s = |from_s: f64| {
            let found = lag(&part(&a, from_s), &part(&b, from_s - self.offset_s), &search)?;
            (found.correlation >= MIN_CORRELATION).then_some(found.offset_s)
        };
        Some((offset_s(to_s - third_s)? - offset_s(from_s)?) / (2.0 * third_s))
    }

    /// One step towards the best fit of |y| of the other by c + k|x|, by the derivative of |x| for an offset
    /// and that times the time for a rate. Residuals are weighted by the derivative of |y|, whose noise is independent
    /// of that of |x| (instrumental variables), so that noise does not bias the step. The standard deviations allow for
    /// correlated residuals within a second.
    fn refined(&self, signals: &[Signal; 2], step_s: f64) -> Option<Self> {
        let [from_s, to_s] = self.overlap_s;
        let count = ((to_s - from_s) / step_s).max(0.0) as usize;
        let rows: Vec<Row> = (1..count).filter_map(|k| self.row(signals, k, step_s)).collect();
        let (mut normal, mut right) = (Matrix4::zeros(), Vector4::zeros());
        for row in &rows {
            normal += row.weights * row.x.transpose();
            right += row.weights * row.y;
        }
        if !self.has_rate {
            normal[(3, 3)] = 1.0;
        }
        // Normalised, because seconds and seconds squared differ in magnitude.
        let scale = Matrix4::from_diagonal(&normal.diagonal().map(|v| v.sqrt().recip()));
        let normalised = scale * normal * scale;
        if normalised.determinant().is_nan() || normalised.determinant() < SINGULAR {
            return None;
        }
        let inverse = scale * normalised.try_inverse()? * scale;
        let found = inverse * right;
        let mut variances = Vector4::zeros();
        for cluster in rows.chunk_by(|a, b| a.cluster == b.cluster) {
            let left = cluster.iter().map(|row| row.weights * (row.y - row.x.dot(&found)));
            let influence = inverse * left.sum::<Vector4<f64>>();
            variances += influence.component_mul(&influence);
        }
        // The other's gain against the reference.
        let gain = found[1];
        if gain.abs() < 0.1 {
            return None;
        }
        let fit = Self {
            offset_s: self.offset_s + found[2] / gain,
            rate: self.rate + found[3] / gain,
            sd: [2, 3].map(|k| variances[k].sqrt() / gain.abs()),
            ..*self
        };
        // A valid step is small.
        let moved_s = (fit.offset_s - self.offset_s).abs();
        (moved_s < 5.0 * step_s && fit.rate.abs() <= MAX_RATE).then_some(fit)
    }

    /// Point `k` of the overlap; `None` where a value is missing or saturated.
    fn row(&self, [a, b]: &[Signal; 2], k: usize, step_s: f64) -> Option<Row> {
        let time_s = self.overlap_s[0] + k as f64 * step_s;
        let magnitudes = |signal: &Signal, time_s: f64| -> Option<[f64; 3]> {
            let mut found = [0.0; 3];
            for (found, time_s) in found.iter_mut().zip([time_s - step_s, time_s, time_s + step_s])
            {
                let at = signal.at(self.origin, time_s, Interp::Linear)?;
                *found = (!at.flags.is_saturated()).then(|| at.value.norm())?;
            }
            Some(found)
        };
        let [before, now, after] = magnitudes(a, time_s)?;
        let [y_before, y, y_after] = magnitudes(b, self.theirs(time_s))?;
        let with = |change: f64| {
            let change = change / (2.0 * step_s);
            let growing = if self.has_rate { change * (time_s - self.middle_s()) } else { 0.0 };
            Vector4::new(1.0, now, change, growing)
        };
        let of_cluster = (CLUSTER_S / step_s).ceil() as usize;
        let (x, weights) = (with(after - before), with(y_after - y_before));
        Some(Row { cluster: k / of_cluster, x, weights, y })
    }
}
