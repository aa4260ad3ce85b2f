//! What is assumed of sensors and motion: one set of constants for each kind of recording.

use wimu_nav::process::{ImuErrors, OdometryErrors};
use wimu_nav::sensor::{NonLineOfSight, RangeErrors};

use super::{LocalizationChoice, RangeRecording};

/// What is known of ranges, as standard deviations, and of the motion.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RangePrior {
    /// White noise of a range, m.
    pub noise_m: f64,
    /// Error that is correlated over 1 s, m.
    pub correlated_m: f64,
    /// Bias, m.
    pub bias_m: f64,
    /// Scale error.
    pub scale: f64,
    /// Probability of a range without line of sight.
    pub blocked: f64,
    /// Power spectral density of the acceleration, m²/s³, without another sensor.
    pub acceleration_m2s3: f64,
    /// Whether noise, correlated error, acceleration and probability are only where the search for those of greatest
    /// likelihood begins.
    pub adapts: bool,
}

impl RangePrior {
    /// Ultra-wideband radios without calibration: bias by the antenna delay, half of its variance in that of the unit. No
    /// scale error: their clocks are right to 20 ppm. A slow walk; a person or a wall is in one range of ten.
    pub const ULTRA_WIDEBAND: Self = Self {
        noise_m: 0.03,
        correlated_m: 0.06,
        bias_m: 0.1,
        scale: 0.0,
        blocked: 0.1,
        acceleration_m2s3: 0.1,
        adapts: true,
    };
    /// Radios of a vehicle outdoors whose kind is not known (Plaza data sets: 6 % too long, noise 0.5 m). The slip of its
    /// wheels is as slow as a correlated error.
    pub const VEHICLE: Self =
        Self { noise_m: 0.5, correlated_m: 0.0, bias_m: 0.5, scale: 0.1, ..Self::ULTRA_WIDEBAND };

    /// The same with standard deviations of noise, m, bias, m, and scale error.
    #[must_use]
    pub fn with_errors(self, [noise_m, bias_m, scale]: [f64; 3]) -> Self {
        Self { noise_m, bias_m, scale, ..self }
    }

    /// That of the kind of recording.
    pub fn of(recording: &RangeRecording) -> Self {
        if recording.increments.is_empty() || recording.motion.is_some() {
            Self::ULTRA_WIDEBAND
        } else {
            Self::VEHICLE
        }
    }
}

/// Part of bias and of scale error, as standard deviations, that belongs to each anchor alone: half of the variance, and of
/// the scale error a tenth of the deviation.
const OWN_BIAS: f64 = std::f64::consts::FRAC_1_SQRT_2;
const OWN_SCALE: f64 = 0.1;
/// Mean excess of a range without line of sight, m: a person or a wall.
const EXCESS_M: f64 = 1.0;
/// Noise of an accelerometer and a gyroscope whose scale factors and misalignments are not states, m/s²/√Hz and rad/s/√Hz.
const FORCE_NOISE: f64 = 0.05;
const RATE_NOISE: f64 = 0.003;

/// Constants of a run.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Model {
    pub ranges: RangeErrors,
    /// Part of the bias, m, and of the scale error that all anchors have in common, standard deviations.
    pub common: [f64; 2],
    pub line_of_sight: NonLineOfSight,
    /// Standard deviation of a range beside its bias before the search for the noise, m.
    pub expected_m: f64,
    /// Whether the scales of the noise are estimated.
    pub adapts: bool,
    /// Power spectral density of the acceleration, m²/s³.
    pub acceleration: f64,
    pub odometry: OdometryErrors,
    pub imu: ImuErrors,
    pub gravity_mps2: f64,
    /// Whether the unit stays at its height.
    pub planar: bool,
    /// Ranges are later than the other sensor's times by this, s.
    pub shift_s: f64,
}

impl Model {
    pub fn of(recording: &RangeRecording, choice: &LocalizationChoice) -> Self {
        let prior = choice.prior.unwrap_or_else(|| RangePrior::of(recording));
        let mut model = Self::new(&prior, recording.planar);
        model.ranges.position_m = choice.survey_m.unwrap_or(0.0);
        if let Some(motion) = &recording.motion {
            model.gravity_mps2 = motion.gravity_mps2();
        }
        model
    }

    /// Whether ranges have a scale error.
    pub fn has_scale(&self) -> bool {
        self.ranges.scale > 0.0
    }

    /// The same with the scale error of [`RangePrior::VEHICLE`].
    pub fn with_scale(mut self) -> Self {
        self.common[1] = RangePrior::VEHICLE.scale;
        self.ranges.scale = RangePrior::VEHICLE.scale * OWN_SCALE;
        self
    }

    pub fn new(prior: &RangePrior, planar: bool) -> Self {
        let mut ranges = RangeErrors::default();
        ranges.noise_m = prior.noise_m;
        ranges.correlated_m = prior.correlated_m;
        ranges.bias_m = prior.bias_m * OWN_BIAS;
        ranges.scale = prior.scale * OWN_SCALE;
        let mut imu = ImuErrors::default();
        (imu.accelerometer_noise, imu.gyroscope_noise) = (FORCE_NOISE, RATE_NOISE);
        (imu.accelerometer_matrix, imu.gyroscope_matrix, imu.delay_s) = ([0.0; 2], [0.0; 2], 0.0);
        Self {
            ranges,
            common: [prior.bias_m * OWN_BIAS, prior.scale],
            line_of_sight: NonLineOfSight { probability: prior.blocked, mean_m: EXCESS_M },
            expected_m: ranges.noise_m.hypot(ranges.correlated_m),
            adapts: prior.adapts,
            acceleration: prior.acceleration_m2s3,
            odometry: OdometryErrors::default(),
            imu,
            gravity_mps2: wimu_nav::GRAVITY_MPS2,
            planar,
            shift_s: 0.0,
        }
    }
}
