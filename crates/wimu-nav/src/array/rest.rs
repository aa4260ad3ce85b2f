//! Rests of an array: the detector of one unit on the specific force, and a χ² test of angular acceleration and z, which
//! are zero at a rest but for biases and noise.

use nalgebra::{SVector, Vector3};

use super::ArrayConfig;
use super::solver::{ArraySolver, Linear};
use crate::filter::chi_square_quantile;
use crate::stationarity::{RestDetector, RestLimits};

/// Values that are zero at a rest: angular acceleration and z.
type Zeros = SVector<f64, 9>;

/// Both tests, and the low-passed specific force.
#[derive(Clone, Debug)]
pub(super) struct RestTest {
    window_s: f64,
    detector: RestDetector,
    /// Variance of the specific force about its mean at a rest, (m/s²)².
    force_variance: f64,
    /// Means since the last sample that was not one of a rest, over at most the window, and that time, s.
    mean: Zeros,
    mean_force: Vector3<f64>,
    quiet_s: f64,
    /// Low-passed specific force, m/s², and the difference of the last sample to it.
    pub slow: Vector3<f64>,
    pub away: Vector3<f64>,
}

impl RestTest {
    pub fn new(config: &ArrayConfig, solver: &ArraySolver) -> Self {
        let noise = libm::sqrt(solver.covariance()[(3, 3)]);
        let mut settings = RestLimits::default().without_gyroscope(noise);
        settings.gravity_mps2 = config.gravity_mps2;
        let bias = config.bias_mps2 + config.common_bias_mps2;
        settings.force_offset_mps2 = settings.force_offset_mps2.max(bias);
        Self {
            window_s: settings.window_s,
            detector: RestDetector::new(settings),
            force_variance: settings.force_mps2 * settings.force_mps2,
            mean: Zeros::zeros(),
            mean_force: Vector3::zeros(),
            quiet_s: 0.0,
            slow: Vector3::zeros(),
            away: Vector3::zeros(),
        }
    }

    /// Forgets the last samples: a rest begins anew.
    pub fn interrupt(&mut self) {
        self.quiet_s = 0.0;
    }

    /// Mean specific force of the rest, m/s².
    pub fn force(&self) -> Vector3<f64> {
        self.mean_force
    }

    /// Takes a sample; whether the array is at rest. `bias` is the variance of the bias of an axis, `noise` that of a sample,
    /// both in units of what the geometry declares.
    pub fn push(
        &mut self,
        solver: &ArraySolver,
        linear: &Linear,
        step: f64,
        [bias, noise]: [f64; 2],
    ) -> bool {
        let force = linear.force_mps2();
        let sample = linear.rotation();
        let still = self.detector.push(&force, None, step);
        self.follow(&force, step);
        let rank = solver.rank().min(6);
        let zero = |values: &Zeros, variance: f64| {
            let squares = (0..3 + rank).map(|k| {
                let unit = if k < 3 { solver.covariance()[(k, k)] } else { 1.0 };
                values[k] * values[k] / (unit * variance)
            });
            squares.sum::<f64>() < chi_square_quantile(3 + rank)
        };
        // The last sample: a motion begins within the window.
        let away = force - self.mean_force;
        let variance = self.force_variance + noise * solver.covariance()[(3, 3)];
        let steady = away.norm_squared() < variance * chi_square_quantile(3);
        if !(steady && zero(&sample, bias + noise)) {
            (self.mean, self.mean_force, self.quiet_s) = (sample, force, 0.0);
            return false;
        }
        self.quiet_s += step;
        let part = (step / self.quiet_s.min(self.window_s)).min(1.0);
        self.mean += (sample - self.mean) * part;
        self.mean_force += away * part;
        // An exponential mean has the variance of a sample times α / (2 − α).
        let mean = bias + noise * part / (2.0 - part);
        still && self.quiet_s >= self.window_s && zero(&self.mean, mean)
    }

    fn follow(&mut self, force: &Vector3<f64>, step: f64) {
        let begins = if self.slow == Vector3::zeros() { 1.0 } else { 0.0 };
        self.away = force - self.slow;
        self.slow += self.away * (step / self.window_s).clamp(begins, 1.0);
        if !self.slow.iter().all(|v| v.is_finite()) {
            self.slow = Vector3::zeros();
        }
    }
}
