//! The gyroscope's analog side: true angular rate, errors, noise, failures.

use std::fmt;

use wimu_model::STANDARD_GRAVITY_MPS2;

use crate::random::Random;
use crate::scene::Scene;
use crate::source::quantise;
use crate::truth::{Gauge, SensorTruth};

/// Time step of the difference quotient in [`angular_rate_radps`], s.
const STEP_S: f64 = 1e-3;
/// DS12140 Table 2: 70 µg/√Hz at ±2 g.
const ACCELEROMETER_NOISE_MPS2_PER_RTHZ: f64 = 70e-6 * STANDARD_GRAVITY_MPS2;
/// DS12140 Table 2: 3.8 m°/s/√Hz.
const GYROSCOPE_NOISE_DPS_PER_RTHZ: f64 = 3.8e-3;

/// Angular rate of the body against east-north-up at `time_s`, rad/s, body axes.
///
/// Central quaternion differences over ±1 ms and ±0.5 ms, extrapolated (Richardson): the error is of
/// fourth order in the step, except within 1 ms of where a rotation begins or ends.
pub fn angular_rate_radps(scene: &Scene, time_s: f64) -> [f64; 3] {
    let mean_rate = |half_s: f64| {
        let [a, b, c, d] = scene.state(time_s - half_s).attitude.quaternion();
        let [e, f, g, h] = scene.state(time_s + half_s).attitude.quaternion();
        // conj(before) ∘ after; the sign takes the shorter of both rotations.
        let w = a * e + b * f + c * g + d * h;
        let vector = [
            a * f - b * e - c * h + d * g,
            a * g + b * h - c * e - d * f,
            a * h - b * g + c * f - d * e,
        ]
        .map(|v| v.copysign(v * w));
        let length = libm::sqrt(vector.iter().map(|v| v * v).sum());
        // 2 atan(length / w) / length, continuous at 0.
        let scale = match length {
            0.0 => 0.0,
            _ => libm::atan2(length, w.abs()) / (length * half_s),
        };
        vector.map(|v| v * scale)
    };
    let (coarse, fine) = (mean_rate(STEP_S), mean_rate(STEP_S / 2.0));
    [0, 1, 2].map(|axis| (4.0 * fine[axis] - coarse[axis]) / 3.0)
}

/// Gives a gyroscope its samples, one for each index, in order.
pub trait RateSource: fmt::Debug {
    /// Counts of sample `index` at `time_s`, at nominally `rate_hz` samples a second.
    fn counts(&mut self, index: u64, time_s: f64, rate_hz: f64, lsb_per_dps: f64) -> [i16; 3];
}

/// The true errors of a gyroscope: it reads b + M ω + G f + noise.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GyroscopeTruth {
    /// b, °/s.
    pub bias_dps: [f64; 3],
    /// M, row by row: scale factors on the diagonal, misalignments beside it.
    pub matrix: [[f64; 3]; 3],
    /// G, row by row: g-sensitivity, °/s per m/s² of specific force.
    pub g_sensitivity_dps_per_mps2: [[f64; 3]; 3],
    /// Noise density, °/s/√Hz, one-sided and white up to half the sample rate.
    pub noise_dps_per_rthz: f64,
}

impl GyroscopeTruth {
    /// A gyroscope without errors and noise.
    pub fn ideal() -> Self {
        Self {
            bias_dps: [0.0; 3],
            matrix: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
            g_sensitivity_dps_per_mps2: [[0.0; 3]; 3],
            noise_dps_per_rthz: 0.0,
        }
    }

    /// A poor but plausible LSM6DSO, the same for the same `seed`: uniform bias within ±2 °/s, scale
    /// factor within ±2 %, misalignments within ±0.02 rad, g-sensitivity within ±0.1 °/s/g; noise
    /// 3.8 m°/s/√Hz.
    pub fn random(seed: u64) -> Self {
        let mut random = Random::new(seed, 7);
        let mut axes = |most: f64| [(); 3].map(|()| random.uniform(-most, most));
        let bias_dps = axes(2.0);
        let mut matrix = [axes(0.02), axes(0.02), axes(0.02)];
        for axis in 0..3 {
            matrix[axis][axis] += 1.0;
        }
        let per_mps2 = 0.1 / STANDARD_GRAVITY_MPS2;
        Self {
            bias_dps,
            matrix,
            g_sensitivity_dps_per_mps2: [axes(per_mps2), axes(per_mps2), axes(per_mps2)],
            noise_dps_per_rthz: GYROSCOPE_NOISE_DPS_PER_RTHZ,
        }
    }
}

/// An LSM6DSO's accelerometer: [`SensorTruth::random`] with noise of 70 µg/√Hz and a sample period
/// within ±2 %.
pub fn accelerometer_truth(seed: u64, gauge: Gauge) -> SensorTruth {
    SensorTruth {
        noise_mps2_per_rthz: ACCELEROMETER_NOISE_MPS2_PER_RTHZ,
        period_error_ppm: Random::new(seed, 8).uniform(-20_000.0, 20_000.0),
        ..SensorTruth::random(seed, gauge)
    }
}

/// A gyroscope with errors and noise on a body in a scene.
#[derive(Clone, Debug)]
pub struct Gyroscope {
    /// Its errors.
    pub truth: GyroscopeTruth,
    scene: Scene,
    noise: Random,
}

impl Gyroscope {
    /// A gyroscope with the errors `truth` in `scene`, with the noise of `seed`.
    pub fn new(truth: GyroscopeTruth, scene: Scene, seed: u64) -> Self {
        let noise = Random::new(seed, 9);
        Self {
            truth,
            scene,
            noise,
        }
    }
}

impl RateSource for Gyroscope {
    fn counts(&mut self, index: u64, time_s: f64, rate_hz: f64, lsb_per_dps: f64) -> [i16; 3] {
        let rate_dps = angular_rate_radps(&self.scene, time_s).map(f64::to_degrees);
        let force = self.scene.state(time_s).specific_force_mps2;
        let dot = |row: [f64; 3], v: [f64; 3]| row[0] * v[0] + row[1] * v[1] + row[2] * v[2];
        let sigma = self.truth.noise_dps_per_rthz * libm::sqrt(rate_hz / 2.0);
        std::array::from_fn(|axis| {
            let output = self.truth.bias_dps[axis]
                + dot(self.truth.matrix[axis], rate_dps)
                + dot(self.truth.g_sensitivity_dps_per_mps2[axis], force)
                + sigma * self.noise.gaussian_at(3 * index + axis as u64);
            quantise(output * lsb_per_dps, 16)
        })
    }
}

/// How a gyroscope fails.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum GyroscopeFault {
    /// It works.
    #[default]
    None,
    /// It takes no samples: no new words in the FIFO, output registers unchanged.
    Stops,
    /// It repeats its last sample for ever.
    Stuck,
    /// Every axis reads positive full scale.
    Saturates,
}
