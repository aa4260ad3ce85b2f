//! What a navigator is given, and what it answers.

use core::fmt;

use nalgebra::{Rotation3, Vector3};

use super::VehicleErrors;
use crate::process::ImuErrors;
use crate::rotation::level;

/// What is assumed of the motion.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[non_exhaustive]
pub enum Profile {
    /// In a hand or on a small robot: the velocity is 0 ± 2 m/s, once a second.
    #[default]
    Hand,
    /// On a foot: stances of steps are given to [`Navigator::stance`](super::Navigator::stance).
    Foot,
    /// In a vehicle: the velocity is 0 ± 30 m/s, once a second.
    Vehicle,
    /// Pushed over a table without rotation: an angular rate of zero stands for a gyroscope.
    Slide,
    /// No assumption.
    Free,
}

/// What a rest means. An accelerometer does not distinguish a rest from constant velocity.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Rests {
    /// The velocity is zero.
    #[default]
    ZeroVelocity,
    /// The velocity is an unknown constant of 0 ± 0.1 m/s, the same at all rests: a considered state.
    ConstantVelocity,
    /// Nothing: rests are not used.
    Ignored,
}

/// What carries the unit from one time to the next.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Motion {
    /// Specific force, and the angular rate of a gyroscope.
    #[default]
    Gyroscope,
    /// Specific force: angular rate and acceleration are states.
    NoGyroscope,
    /// A process, given to [`Navigator::travel`](super::Navigator::travel): white acceleration, or wheel odometry.
    Process,
}

/// Settings of a [`Navigator`](super::Navigator).
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub struct Settings {
    /// Errors of the sensors.
    pub errors: ImuErrors,
    /// Gravity, m/s².
    pub gravity_mps2: f64,
    /// What carries the unit.
    pub motion: Motion,
    /// What is assumed of the motion.
    pub profile: Profile,
    /// What a rest means.
    pub rests: Rests,
    /// The position stays within this distance of the origin, m, 1 σ of a component.
    pub within_m: Option<f64>,
    /// The motion of a vehicle along its forward axis, which the unit must have a gyroscope for: eleven states.
    pub vehicle: Option<VehicleErrors>,
    /// Error of gravity in a frame that is not level, such as that of surveyed anchors, m/s², 1 σ in east, north and up; zero
    /// without. With a gyroscope.
    pub frame_mps2: [f64; 3],
}

impl Settings {
    /// Settings for a profile.
    pub fn of(profile: Profile) -> Self {
        let mut errors = ImuErrors::default();
        if profile == Profile::Foot {
            // Shocks of up to 16 g: bandwidth, clipping, scale factors and delay of the gyroscope act as noise (pyshoe).
            errors.accelerometer_noise = 0.15;
            errors.gyroscope_noise = 0.005;
            errors.gyroscope_matrix = [0.0, 0.0];
            errors.delay_s = 0.0;
        }
        if profile == Profile::Vehicle {
            // Vibration of engine and road: chosen on one drive of a car (score_localization).
            errors.accelerometer_noise = 0.02;
            errors.gyroscope_noise = 0.0015;
        }
        if profile == Profile::Slide {
            // The rotation is a random walk of 0.1 deg/√s.
            errors.gyroscope_noise = 0.002;
            errors.gyroscope_bias = 1e-5;
            errors.gyroscope_bias_walk = 0.0;
            errors.delay_s = 0.0;
        }
        Self {
            errors,
            gravity_mps2: crate::GRAVITY_MPS2,
            motion: Motion::Gyroscope,
            profile,
            rests: Rests::ZeroVelocity,
            within_m: None,
            vehicle: None,
            frame_mps2: [0.0; 3],
        }
    }
}

impl Default for Settings {
    fn default() -> Self {
        Self::of(Profile::Hand)
    }
}

/// A sample.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Sample {
    /// Time since the sample before, s.
    pub step_s: f64,
    /// Specific force, m/s², body frame.
    pub force_mps2: Vector3<f64>,
    /// Angular rate, rad/s, body frame.
    pub rate_rad_s: Option<Vector3<f64>>,
    /// Magnetic field, µT, body frame. A reading that is held over several samples is given once.
    pub field_ut: Option<Vector3<f64>>,
}

/// Why a sample was not used. The navigator went on as if it had not been there.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum SampleFault {
    /// Its time is not after that of the sample before.
    NoTime,
    /// A component is not a finite number.
    NotFinite,
}

impl fmt::Display for SampleFault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::NoTime => "the time of the sample is not after that of the sample before",
            Self::NotFinite => "a component of the sample is not a finite number",
        })
    }
}

impl core::error::Error for SampleFault {}

/// What is estimated.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub struct Solution {
    /// Position, m, and velocity, m/s, east-north-up.
    pub position_m: [f64; 3],
    /// See [`position_m`](Self::position_m).
    pub velocity_mps: [f64; 3],
    /// Body to navigation frame, W X Y Z.
    pub quaternion: [f64; 4],
    /// Covariance of the position, m².
    pub position_covariance: [[f64; 3]; 3],
    /// Covariance of the velocity, m²/s².
    pub velocity_covariance: [[f64; 3]; 3],
    /// Covariance of the attitude error about east, north and up, rad².
    pub attitude_covariance: [[f64; 3]; 3],
}

/// Means over the first samples, and what is known of the start.
#[derive(Clone, Copy, Debug)]
pub struct Start {
    /// Body to navigation frame.
    pub attitude: Rotation3<f64>,
    /// Magnetic field, µT, navigation frame.
    pub field_ut: Option<Vector3<f64>>,
    /// Norm of the mean specific force, m/s².
    pub force_mps2: f64,
    /// Whether the samples look like a rest.
    pub rest: bool,
    /// Standard deviation of the tilt, rad.
    pub tilt_rad: f64,
}

/// Standard deviation of the tilt of a start at rest, rad: that of a bias of 0.5 m/s². Zero-velocity updates make it
/// consistent with the bias of the accelerometer.
const REST_TILT: f64 = 0.05;
/// The same of a start in motion: accelerations of a third of gravity.
const MOVING_TILT: f64 = 0.35;

impl Start {
    /// A start in motion at an attitude.
    pub fn moving(attitude: Rotation3<f64>, force_mps2: f64) -> Self {
        Self { attitude, field_ut: None, force_mps2, rest: false, tilt_rad: MOVING_TILT }
    }

    /// Alignment with gravity and the magnetic field. Numbers that are not finite are left out; `None` without a specific
    /// force.
    pub fn align(samples: &[Sample], rest: bool) -> Option<Self> {
        let mean = |vectors: &mut dyn Iterator<Item = Vector3<f64>>| {
            let (mut sum, mut count) = (Vector3::zeros(), 0.0);
            for vector in vectors.filter(|v| v.iter().all(|x| x.is_finite())) {
                sum += vector;
                count += 1.0;
            }
            (count > 0.0).then(|| sum / count)
        };
        let force = mean(&mut samples.iter().map(|s| s.force_mps2))?;
        let field = mean(&mut samples.iter().filter_map(|s| s.field_ut));
        let attitude = level(&force, field.as_ref())?;
        let finite = attitude.matrix().iter().all(|x| x.is_finite());
        finite.then(|| Self {
            attitude,
            field_ut: field.map(|field| attitude * field),
            force_mps2: force.norm(),
            rest,
            tilt_rad: if rest { REST_TILT } else { MOVING_TILT },
        })
    }
}
