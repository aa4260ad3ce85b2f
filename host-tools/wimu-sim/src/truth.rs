//! The true errors of a simulated sensor, unknown to the device.

use wimu_model::{
    ErrorModel, ErrorTerms, GyroscopeModel, GyroscopeTerms, STANDARD_GRAVITY_MPS2, TemperatureTerms,
};

use crate::random::Random;

/// The true errors of one sensor.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SensorTruth {
    /// Bias, scale, misalignment, temperature terms, nonlinearity: equation (1).
    pub model: ErrorModel,
    /// Accelerometer noise, m/s²/√Hz, one-sided and white up to half the sample rate: a sample's
    /// σ is N √(fs / 2). At least 0.
    pub noise_mps2_per_rthz: f64,
    /// How much longer than nominal the sensor's sample period is, ppm, −100 000..=100 000.
    pub period_error_ppm: f64,
    /// Error of the sensor's thermometer, K: positive if it reads too high.
    pub thermometer_error_k: f64,
    /// The magnetometer's errors.
    pub magnetometer: MagnetometerTruth,
    /// The gyroscope's errors.
    pub gyroscope: GyroscopeTruth,
}

/// The true errors of a gyroscope.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct GyroscopeTruth {
    /// Bias, scale factor, misalignment, g-sensitivity: equation (25).
    pub model: GyroscopeModel,
    /// Noise density, rad/s/√Hz, one-sided and white up to half the sample rate.
    pub noise_radps_per_rthz: f64,
}

impl GyroscopeTruth {
    /// A poor but plausible LSM6DSO, the same for the same `seed`: uniform bias within ±2 °/s, scale
    /// factor within ±2 %, misalignments within ±0.02 rad, g-sensitivity within ±0.1 °/s/g; noise
    /// 3.8 m°/s/√Hz.
    pub fn random(seed: u64) -> Self {
        let mut random = Random::new(seed, 7);
        let mut axes = |most: f64| [(); 3].map(|()| random.uniform(-most, most));
        let bias_rad_s = axes(2_f64.to_radians());
        let mut matrix = [axes(0.02), axes(0.02), axes(0.02)];
        for axis in 0..3 {
            matrix[axis][axis] += 1.0;
        }
        let per_mps2 = 0.1_f64.to_radians() / STANDARD_GRAVITY_MPS2;
        let model = GyroscopeModel::new(GyroscopeTerms {
            bias_rad_s,
            matrix,
            g_sensitivity: [axes(per_mps2), axes(per_mps2), axes(per_mps2)],
            ..GyroscopeTerms::default()
        });
        Self {
            model: model.expect("these ranges lie within the model's bounds"),
            noise_radps_per_rthz: LSM6DSO_GYROSCOPE_NOISE_DPS_PER_RTHZ.to_radians(),
        }
    }
}

/// The true errors of a magnetometer: it reads S B + h + noise, equation (37).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MagnetometerTruth {
    /// h, nT, sensor axes.
    pub hard_iron_nt: [f64; 3],
    /// S, row by row; identity for an undisturbed field.
    pub soft_iron: [[f64; 3]; 3],
    /// σ of a sample, nT, at least 0.
    pub noise_nt: f64,
}

/// Which of a sensor's twelve terms are non-zero.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Gauge {
    /// All twelve, as estimated by a calibration with known orientations.
    Full,
    /// A is lower-triangular, nine terms: those that gravity alone can observe, since it is invariant to
    /// a rotation of the axes.
    LowerTriangular,
}

/// 220 µg/√Hz: the LSM303AGR's accelerometer in high-resolution mode (datasheet).
const LSM303AGR_NOISE_MPS2_PER_RTHZ: f64 = 220e-6 * STANDARD_GRAVITY_MPS2;
/// 0.75 LSB of 3.9 mg in the 50 Hz of a rate of 100 Hz: the datasheet's x and y axes of an ADXL345.
const ADXL345_NOISE_MPS2_PER_RTHZ: f64 = 414e-6 * STANDARD_GRAVITY_MPS2;
/// DS12140 Table 2: 70 µg/√Hz at ±2 g.
const LSM6DSO_NOISE_MPS2_PER_RTHZ: f64 = 70e-6 * STANDARD_GRAVITY_MPS2;
/// DS12140 Table 2: 3.8 m°/s/√Hz.
const LSM6DSO_GYROSCOPE_NOISE_DPS_PER_RTHZ: f64 = 3.8e-3;
/// 3 mG: the LSM303AGR's magnetometer in high-resolution mode.
const LSM303AGR_MAGNETIC_NOISE_NT: f64 = 300.0;

impl SensorTruth {
    /// A sensor without errors and noise.
    pub fn ideal() -> Self {
        Self {
            model: ErrorModel::default(),
            noise_mps2_per_rthz: 0.0,
            period_error_ppm: 0.0,
            thermometer_error_k: 0.0,
            magnetometer: MagnetometerTruth {
                hard_iron_nt: [0.0; 3],
                soft_iron: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
                noise_nt: 0.0,
            },
            gyroscope: GyroscopeTruth::default(),
        }
    }

    /// A typical uncalibrated LSM303AGR; the same for the same `seed` and `gauge`.
    ///
    /// Per axis, uniform: bias 50 to 80 mg of either sign; scale within ±4 %; misalignments within
    /// ±sin 2°; bias slope within ±0.2 mg/K and scale slope within ±100 ppm/K about 25 °C; sample
    /// period within ±3000 ppm; thermometer within ±2 K; hard iron within ±20 µT; soft iron within
    /// ±5 %. Noise 220 µg/√Hz and 300 nT.
    ///
    /// Uncalibrated, |y| − g is at least 400 mm/s² rms over the sphere of orientations: the bias
    /// alone, at least √3 · 50 mg long, contributes 490 mm/s², equation (39).
    pub fn random(seed: u64, gauge: Gauge) -> Self {
        let mut random = Random::new(seed, 0);
        let mg = STANDARD_GRAVITY_MPS2 * 1e-3;
        let mut axes = |low: f64, high: f64| [(); 3].map(|()| random.uniform(low, high));

        let bias = axes(50.0 * mg, 80.0 * mg);
        let scale = axes(0.96, 1.04);
        let sin_2_degrees = libm::sin(2.0_f64.to_radians());
        let above = axes(-sin_2_degrees, sin_2_degrees);
        let below = axes(-sin_2_degrees, sin_2_degrees);
        let above = match gauge {
            Gauge::Full => above,
            Gauge::LowerTriangular => [0.0; 3],
        };
        let temperature = TemperatureTerms {
            bias_mps2_per_k: axes(-0.2 * mg, 0.2 * mg),
            scale_per_k: axes(-100e-6, 100e-6),
            ..TemperatureTerms::default()
        };
        let hard_iron_nt = axes(-20_000.0, 20_000.0);
        let mut soft_iron = [axes(-0.05, 0.05), axes(-0.05, 0.05), axes(-0.05, 0.05)];
        for axis in 0..3 {
            soft_iron[axis][axis] += 1.0;
        }
        let bias_mps2 = bias.map(|b| b * random.sign());
        let model = ErrorModel::new(ErrorTerms {
            bias_mps2,
            matrix: [
                [scale[0], above[0], above[1]],
                [below[0], scale[1], above[2]],
                [below[1], below[2], scale[2]],
            ],
            temperature,
            nonlinearity: [0.0; 3],
        });
        Self {
            model: model.expect("these ranges lie within the model's bounds"),
            noise_mps2_per_rthz: LSM303AGR_NOISE_MPS2_PER_RTHZ,
            period_error_ppm: random.uniform(-3000.0, 3000.0),
            thermometer_error_k: random.uniform(-2.0, 2.0),
            magnetometer: MagnetometerTruth {
                hard_iron_nt,
                soft_iron,
                noise_nt: LSM303AGR_MAGNETIC_NOISE_NT,
            },
            gyroscope: GyroscopeTruth::default(),
        }
    }

    /// A typical uncalibrated ADXL345: as [`random`](Self::random), but with noise of 414 µg/√Hz and a
    /// sample period within ±5 %.
    pub fn random_adxl345(seed: u64, gauge: Gauge) -> Self {
        let mut random = Random::new(seed, 6);
        Self {
            noise_mps2_per_rthz: ADXL345_NOISE_MPS2_PER_RTHZ,
            period_error_ppm: random.uniform(-50_000.0, 50_000.0),
            ..Self::random(seed, gauge)
        }
    }

    /// A typical uncalibrated LSM6DSO: an accelerometer as [`random`](Self::random), but with noise of
    /// 70 µg/√Hz and a sample period within ±2 %, and [`GyroscopeTruth::random`].
    pub fn random_lsm6dso(seed: u64, gauge: Gauge) -> Self {
        Self {
            noise_mps2_per_rthz: LSM6DSO_NOISE_MPS2_PER_RTHZ,
            period_error_ppm: Random::new(seed, 8).uniform(-20_000.0, 20_000.0),
            gyroscope: GyroscopeTruth::random(seed),
            ..Self::random(seed, gauge)
        }
    }

    /// A typical uncalibrated MPU-6050: as [`random_lsm6dso`](Self::random_lsm6dso), but with noise of 400 µg/√Hz and
    /// 5 m°/s/√Hz (PS-MPU-6000A-00).
    pub fn random_mpu6050(seed: u64, gauge: Gauge) -> Self {
        let other = Self::random_lsm6dso(seed, gauge);
        let noise_radps_per_rthz = 5e-3_f64.to_radians();
        Self {
            noise_mps2_per_rthz: 400e-6 * STANDARD_GRAVITY_MPS2,
            gyroscope: GyroscopeTruth { noise_radps_per_rthz, ..other.gyroscope },
            ..other
        }
    }
}
