//! What is assumed of sensors and motion: one set of constants for each kind of recording.

use wimu_nav::process::{ImuErrors, OdometryErrors};
use wimu_nav::sensor::{NonLineOfSight, RangeErrors};

use super::engine::{Motion, Recording};
use super::{LocalizationChoice, RangeRecording};

/// What is known of ranges, as standard deviations.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RangePrior {
    /// Noise of a range, m: the search for its scale begins there.
    pub noise_m: f64,
    /// Bias, m.
    pub bias_m: f64,
    /// Scale error.
    pub scale: f64,
}

/// A plain filter, as it is often written: white noise, no calibration, a gate.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Plain {
    /// White noise of a range, m.
    pub noise_m: f64,
    /// Power spectral density of the acceleration, m²/s³.
    pub acceleration_m2s3: f64,
    /// A range is rejected beyond this number of standard deviations.
    pub gate: Option<f64>,
}

/// Ultra-wideband radios without calibration: bias by the antenna delay, half of its variance in that of the unit. No scale
/// error: their clocks are right to 20 ppm.
const ULTRA_WIDEBAND: RangePrior = RangePrior {
    noise_m: 0.03,
    bias_m: 0.1,
    scale: 0.0,
};
/// Radios of a vehicle outdoors whose kind is not known (Plaza data sets: 6 % too long, noise 0.5 m).
const VEHICLE: RangePrior = RangePrior {
    noise_m: 0.5,
    bias_m: 0.5,
    scale: 0.1,
};
/// Part of bias and of scale error, as standard deviations, that belongs to each anchor alone: half of the variance, and of
/// the scale error a tenth of the deviation.
const OWN_BIAS: f64 = std::f64::consts::FRAC_1_SQRT_2;
const OWN_SCALE: f64 = 0.1;
/// Density at which the search for that of the acceleration begins, m²/s³: a slow walk.
const ACCELERATION: f64 = 0.1;
/// Probability of a range without line of sight at which the search begins, and mean of its excess, m: a person or a wall.
const BLOCKED: NonLineOfSight = NonLineOfSight {
    probability: 0.1,
    mean_m: 1.0,
};
/// Noise of an accelerometer and a gyroscope whose scale factors and misalignments are not states, m/s²/√Hz and rad/s/√Hz.
const FORCE_NOISE: f64 = 0.05;
const RATE_NOISE: f64 = 0.003;

/// Constants of a run.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Model {
    pub ranges: RangeErrors<f64>,
    /// Part of the bias, m, and of the scale error that all anchors have in common, standard deviations.
    pub common: [f64; 2],
    pub line_of_sight: NonLineOfSight,
    /// Standard deviation of a range beside its bias before the search for the noise, m.
    pub expected_m: f64,
    /// A range is rejected beyond this number of standard deviations.
    pub gate: f64,
    /// Power spectral density of the acceleration, m²/s³.
    pub acceleration: f64,
    pub odometry: OdometryErrors<f64>,
    pub imu: ImuErrors<f64>,
    pub gravity_mps2: f64,
    /// Antenna of the unit, m, body frame.
    pub lever_arm_m: [f64; 3],
    /// Whether the unit stays at its height.
    pub planar: bool,
    /// Ranges are later than the other sensor's times by this, s.
    pub shift_s: f64,
}

impl Model {
    pub fn of(
        recording: &RangeRecording,
        choice: &LocalizationChoice,
        problem: &Recording,
    ) -> Self {
        let usual = match problem.motion {
            Motion::Odometry(_) => VEHICLE,
            _ => ULTRA_WIDEBAND,
        };
        let prior = choice.prior.unwrap_or(usual);
        let mut ranges = RangeErrors::default();
        ranges.noise_m = prior.noise_m;
        ranges.bias_m = prior.bias_m * OWN_BIAS;
        ranges.scale = prior.scale * OWN_SCALE;
        ranges.position_m = choice.survey_m.unwrap_or(0.0);
        if matches!(problem.motion, Motion::Odometry(_)) {
            // The slip of the wheels is as slow as a correlated error.
            ranges.correlated_m = 0.0;
        }
        let mut imu = ImuErrors::default();
        (imu.accelerometer_noise, imu.gyroscope_noise) = (FORCE_NOISE, RATE_NOISE);
        let gravity = recording
            .motion
            .as_ref()
            .map(|motion| motion.gravity_mps2());
        let mut model = Self {
            ranges,
            common: [prior.bias_m * OWN_BIAS, prior.scale],
            line_of_sight: BLOCKED,
            expected_m: ranges.noise_m.hypot(ranges.correlated_m),
            gate: f64::INFINITY,
            acceleration: ACCELERATION,
            odometry: OdometryErrors::default(),
            imu,
            gravity_mps2: gravity.unwrap_or(wimu_nav::GRAVITY_MPS2),
            lever_arm_m: choice.lever_arm_m,
            planar: recording.planar,
            shift_s: 0.0,
        };
        if let Some(plain) = choice.plain {
            model.ranges.noise_m = plain.noise_m;
            (
                model.ranges.correlated_m,
                model.ranges.bias_m,
                model.ranges.scale,
            ) = (0.0, 0.0, 0.0);
            model.common = [0.0; 2];
            model.line_of_sight.probability = 0.0;
            model.acceleration = plain.acceleration_m2s3;
            model.gate = plain.gate.unwrap_or(f64::INFINITY);
        }
        model
    }
}
