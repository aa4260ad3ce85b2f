//! Settings, faults and result of the filter of an array.

use core::fmt;

use super::geometry::GeometryError;
use crate::navigator::Rests;

/// How an array is used, and the errors of its sensors as standard deviations.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ArrayConfig {
    /// Local gravity, m/s².
    pub gravity_mps2: f64,
    /// What a rest means. With [`Rests::Ignored`] only the one at the start is used, for the alignment.
    pub rests: Rests,
    /// Bias of each axis, m/s².
    pub bias_mps2: f64,
    /// Bias that all sensors share, m/s², on each axis of the body besides: what calibration at rests leaves.
    pub common_bias_mps2: f64,
    /// Random walk of the biases, m/s² per √s.
    pub bias_walk: f64,
    /// Scale factor of each axis, and its misalignment, rad.
    pub scale: f64,
    /// Scale factor and misalignment that all sensors share, besides.
    pub common_scale: f64,
    /// Lever arm of each sensor, m, along each axis.
    pub place_sd_m: f64,
    /// Delay of the sensors relative to each other, s.
    pub delay_sd_s: f64,
    /// Error of the specific force that the outputs do not show (scale factor, vibration), m/s² in each sample.
    pub force_noise_mps2: f64,
    /// Time of a sample, s: the low-pass filter of a sensor delays it by 1 to 2 ms.
    pub time_sd_s: f64,
}

impl Default for ArrayConfig {
    fn default() -> Self {
        Self {
            gravity_mps2: crate::GRAVITY_MPS2,
            rests: Rests::ZeroVelocity,
            bias_mps2: 0.02,
            common_bias_mps2: 0.0,
            bias_walk: 1e-4,
            scale: 0.0,
            common_scale: 0.0,
            place_sd_m: 0.0,
            delay_sd_s: 0.0,
            force_noise_mps2: 0.05,
            time_sd_s: 1e-3,
        }
    }
}

/// What was wrong with a sample. The filter continues.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub enum ArrayFault {
    /// Too few sensors remain for ω̇ and s: the angular rate is predicted, the position is not valid until the next rest.
    Blind(GeometryError),
    /// The time is not after that of the sample before, or not finite: the sample was not used.
    NoTime,
    /// More than 0.25 s since the sample before: the position is not valid until the next rest.
    Gap,
}

impl fmt::Display for ArrayFault {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Blind(why) => write!(out, "too few sensors can be used: {why}"),
            Self::NoTime => out.write_str(
                "the time of the sample is not after that of the sample before: it was not used; check its time",
            ),
            Self::Gap => out.write_str(
                "no sample for 0.25 s: the position is not valid until the next rest",
            ),
        }
    }
}

impl core::error::Error for ArrayFault {}

/// What is known after a sample: mean and covariance of all hypotheses.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ArrayState {
    /// Angular rate ω, rad/s, body frame.
    pub rate_rad_s: [f64; 3],
    /// Its covariance, (rad/s)². It grows at rests that are not used: an array does not observe ω there.
    pub rate_covariance: [[f64; 3]; 3],
    /// Angular acceleration, rad/s², body frame.
    pub angular_acceleration_rad_s2: [f64; 3],
    /// Body to navigation frame (east-north-up; heading is that of the body at the start), W X Y Z.
    pub quaternion: [f64; 4],
    /// Covariance of the attitude error about east, north and up, rad².
    pub attitude_covariance: [[f64; 3]; 3],
    /// Velocity of the sensors' centre, m/s, navigation frame.
    pub velocity_mps: [f64; 3],
    /// Its covariance, (m/s)².
    pub velocity_covariance: [[f64; 3]; 3],
    /// Position of the sensors' centre, m, navigation frame.
    pub position_m: [f64; 3],
    /// Its covariance, m².
    pub position_covariance: [[f64; 3]; 3],
    /// Probability of the most probable hypothesis: 1 where nothing is ambiguous, 0 before the alignment.
    pub certainty: f64,
    /// Time since the last rest that was used, or since the first sample, s.
    pub since_rest_s: f64,
    /// Whether it is at rest now.
    pub resting: bool,
    /// False before the first alignment, and after a gap or a start in motion until the next rest, where the position
    /// begins. False where a number is not finite.
    pub valid: bool,
}

impl ArrayState {
    /// Before the alignment: nothing is known.
    pub(super) fn unknown() -> Self {
        let zero = [0.0; 3];
        let none = [zero; 3];
        Self {
            rate_rad_s: zero,
            rate_covariance: [[1.0 / 0.0; 3]; 3],
            angular_acceleration_rad_s2: zero,
            quaternion: [1.0, 0.0, 0.0, 0.0],
            attitude_covariance: none,
            velocity_mps: zero,
            velocity_covariance: none,
            position_m: zero,
            position_covariance: none,
            certainty: 0.0,
            since_rest_s: 0.0,
            resting: false,
            valid: false,
        }
    }

    /// Standard deviation of the position in space, m.
    pub fn position_sd_m(&self) -> f64 {
        let p = &self.position_covariance;
        libm::sqrt((p[0][0] + p[1][1] + p[2][2]).abs())
    }

    pub(super) fn is_finite(&self) -> bool {
        let vectors = [self.rate_rad_s, self.velocity_mps, self.position_m];
        let covariances =
            [self.rate_covariance, self.velocity_covariance, self.position_covariance];
        let numbers = vectors.iter().flatten().chain(&self.quaternion);
        let mut numbers = numbers.chain(covariances.iter().flatten().flatten());
        numbers.all(|v| v.is_finite())
    }
}
