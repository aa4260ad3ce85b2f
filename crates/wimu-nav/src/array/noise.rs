//! Noise of a sample and of the motion, estimated from the samples: equations (76) and (104).

use alloc::vec::Vec;

use nalgebra::Vector3;

use super::ArrayConfig;
use super::solver::{ArraySolver, Linear};

/// Part of the sample's own excess residual in its noise; the rest is a mean over [`EXCESS_SAMPLES`] samples.
const OWN_PART: f64 = 0.8;
const EXCESS_SAMPLES: f64 = 5.0;
/// Excess residual above which there is vibration.
const EXCESS_OF_NOISE: f64 = 2.0;
/// Time constant of the mean square of the angular acceleration, s.
const ACTIVITY_S: f64 = 0.25;
/// Noise density of the angular acceleration: in its rms per √s, and at least, rad/s² per √s.
const JERK: f64 = 4.0;
const LEAST_JERK: f64 = 20.0;
/// Angular acceleration that lasts for one sample: part of its rms, and at least, rad/s².
const FAST: f64 = 0.2;
const LEAST_FAST: f64 = 1.0;
/// Angular acceleration by vibration, and random walk of the angular rate by it in √s, in units of vibration / arm.
const VIBRATION_ACCELERATION: f64 = 1.5;
const VIBRATION_RATE: f64 = 0.2;

/// Mean squares of the last samples.
#[derive(Clone, Debug)]
pub(super) struct Level {
    /// Excess residual, equation (76).
    pub excess: f64,
    /// Mean square of the angular acceleration, (rad/s²)².
    pub activity: f64,
    /// The outputs before, m/s², and the mean square of their rates of change, (m/s³)².
    last: Vec<f64>,
    jerk: f64,
}

/// Noise of a sample and of the motion.
#[derive(Clone, Copy, Debug)]
pub(super) struct Noise {
    /// Variance of the sensors in units of what the geometry declares.
    pub factor: f64,
    /// Variance of the angular acceleration that lasts for one sample, (rad/s²)².
    pub fast: f64,
    /// Variance of the specific force by vibration, (m/s²)².
    pub vibration: f64,
    /// Densities of the noise of the angular acceleration, (rad/s²)²/s, and of the angular rate, (rad/s)²/s.
    pub acceleration_walk: f64,
    pub rate_walk: f64,
}

impl Level {
    pub fn new() -> Self {
        Self { excess: 1.0, activity: 0.0, last: Vec::new(), jerk: 0.0 }
    }

    /// Noise of a sample. `rate` is the angular rate, rad/s; `away` the specific force less its low-passed value, m/s².
    pub fn push(
        &mut self,
        config: &ArrayConfig,
        solver: &ArraySolver,
        step: f64,
        output: &[f64],
        linear: &Linear,
        [rate, away]: [Vector3<f64>; 2],
    ) -> Noise {
        let variance = solver.variance_mps2();
        self.push_jerk(variance, step, output);
        let square = rate.norm_squared();
        let declared =
            config.place_sd_m * config.place_sd_m * (square * square / 1.5 + 2.0 * self.activity)
                + config.scale * config.scale * away.norm_squared()
                + config.delay_sd_s * config.delay_sd_s * self.jerk;
        // Without redundant sensors there is no excess residual: it is what was declared.
        let own = solver.excess(output, linear);
        let own = own.unwrap_or(1.0 + declared / variance).min(1e9);
        let excess = OWN_PART * own + (1.0 - OWN_PART) * self.excess;
        self.excess += (own - self.excess) / EXCESS_SAMPLES;
        let factor = excess.max(1.0);
        let vibration = variance * (excess - EXCESS_OF_NOISE).max(0.0);
        let covariance = solver.covariance();
        let seen = linear.theta.fixed_rows::<3>(0).norm_squared();
        let noise = covariance.fixed_view::<3, 3>(0, 0).trace() * 2.0 * factor;
        let size = (seen - noise).max(0.0) / 3.0;
        self.activity += (size - self.activity) * (step / ACTIVITY_S).min(1.0);
        let by_arm = vibration / (solver.arm_m() * solver.arm_m());
        Noise {
            factor,
            fast: LEAST_FAST * LEAST_FAST
                + FAST * FAST * self.activity
                + VIBRATION_ACCELERATION * VIBRATION_ACCELERATION * by_arm,
            vibration,
            acceleration_walk: LEAST_JERK * LEAST_JERK + JERK * JERK * self.activity,
            rate_walk: VIBRATION_RATE * VIBRATION_RATE * by_arm,
        }
    }

    fn push_jerk(&mut self, variance: f64, step: f64, output: &[f64]) {
        let last = core::mem::replace(&mut self.last, output.to_vec());
        if last.is_empty() || step <= 0.0 {
            return;
        }
        let changes = output.iter().zip(last).map(|(now, before)| now - before);
        let (mut squares, mut count) = (0.0, 0.0);
        for change in changes.filter(|change| change.is_finite()) {
            squares += change * change;
            count += 1.0;
        }
        let own = (squares / f64::max(count, 1.0) - 2.0 * variance).max(0.0) / (step * step);
        self.jerk += (own - self.jerk) / EXCESS_SAMPLES;
    }
}
