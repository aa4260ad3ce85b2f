//! One unit: start, prediction, rests and motion profile, sample by sample.

mod model;

pub use model::{Gyroscope, Model, NoGyroscope};

use nalgebra::{Matrix1, Matrix3, RealField, Rotation3, Vector3};

use crate::filter::{Filter, Gate};
use crate::process::ImuErrors;
use crate::rotation::{about_up, level, real, yaw};
use crate::sensor::{MagneticField, Magnetometer, Velocity, recover};
use crate::state::{ATTITUDE, Layout, LayoutFull, POSITION, VELOCITY};

/// What is assumed of the motion.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[non_exhaustive]
pub enum Profile {
    /// In a hand or on a small robot: the velocity is 0 ± 2 m/s, once a second.
    #[default]
    Hand,
    /// On a foot: rests are stances of a step.
    Foot,
    /// No assumption.
    Free,
}

impl Profile {
    /// Standard deviation of a component of the velocity, m/s.
    fn speed_mps(self) -> Option<f64> {
        match self {
            Self::Hand => Some(2.0),
            Self::Foot | Self::Free => None,
        }
    }
}

/// Settings of a [`Navigator`].
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub struct Settings<R> {
    /// Errors of the sensors.
    pub errors: ImuErrors<R>,
    /// Gravity, m/s².
    pub gravity_mps2: R,
    /// Bound of the speed.
    pub profile: Profile,
    /// Zero velocity at rests, m/s, a component; `None`: rests are ignored.
    pub zero_velocity_mps: Option<R>,
    /// Interval of zero-velocity updates, s: the window of the detector, so that they are independent.
    pub rest_interval_s: R,
}

impl<R: RealField> Default for Settings<R> {
    fn default() -> Self {
        Self {
            errors: ImuErrors::default(),
            gravity_mps2: real(crate::GRAVITY_MPS2),
            profile: Profile::Hand,
            zero_velocity_mps: Some(real(0.01)),
            rest_interval_s: real(0.25),
        }
    }
}

/// A sample.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sample<R> {
    /// Time since the sample before, s.
    pub step_s: R,
    /// Specific force, m/s², body frame.
    pub force_mps2: Vector3<R>,
    /// Angular rate, rad/s, body frame.
    pub rate_rad_s: Option<Vector3<R>>,
    /// Magnetic field, µT, body frame.
    pub field_ut: Option<Vector3<R>>,
}

/// Means over the first samples, and what is known of the start.
#[derive(Clone, Copy, Debug)]
pub struct Start<R> {
    /// Body to navigation frame.
    pub attitude: Rotation3<R>,
    /// Magnetic field, µT, navigation frame.
    pub field_ut: Option<Vector3<R>>,
    /// Norm of the mean specific force, m/s².
    pub force_mps2: R,
    /// Whether the samples look like a rest.
    pub rest: bool,
}

impl<R: RealField + Copy> Start<R> {
    /// Alignment with gravity and the magnetic field. `None` without a specific force.
    pub fn align(samples: &[Sample<R>], rest: bool) -> Option<Self> {
        let count = real::<R>(samples.len() as f64);
        let force = samples.iter().map(|s| s.force_mps2).sum::<Vector3<R>>() / count;
        let (mut field, mut fields) = (Vector3::zeros(), R::zero());
        for reading in samples.iter().filter_map(|s| s.field_ut) {
            field += reading;
            fields += R::one();
        }
        let field = (fields > R::zero()).then(|| field / fields);
        let attitude = level(&force, field.as_ref())?;
        Some(Self {
            attitude,
            field_ut: field.map(|field| attitude * field),
            force_mps2: force.norm(),
            rest,
        })
    }
}

/// Deviations of a start at rest: tilt, rad; velocity, m/s. The tilt is that of a bias of 0.5 m/s²: zero-velocity
/// updates make it consistent with the bias of the accelerometer.
const REST_TILT: f64 = 0.05;
const REST_VELOCITY: f64 = 1e-3;
/// Deviations of a start in motion: accelerations of a third of gravity, walking speed.
const MOVING_TILT: f64 = 0.35;
const MOVING_VELOCITY: f64 = 1.5;
/// Heading and position define the frame, rad, m.
const START_HEADING: f64 = 1e-3;
const START_POSITION: f64 = 1e-4;
/// Interval of the updates of the profile's speed, s.
const SPEED_INTERVAL_S: f64 = 1.0;
/// A rest of which every update of such a time failed its test is certain, s: a hand moves at a constant velocity for
/// less.
const CERTAIN_REST_S: f64 = 1.5;

/// Times since the last updates, s.
#[derive(Clone, Copy, Debug)]
struct Since<R> {
    field: R,
    rest: R,
    speed: R,
    /// Of a rest without interruption.
    accepted: R,
}

/// The navigator: a model of the motion with `N` states.
#[derive(Clone, Debug)]
pub struct Navigator<R, M, const N: usize> {
    settings: Settings<R>,
    filter: Filter<R, N>,
    model: M,
    magnetometer: Magnetometer<R>,
    reference_ut: Option<Vector3<R>>,
    since: Since<R>,
    recoveries: u32,
}

/// A navigator with a gyroscope.
pub type WithGyroscope<R> = Navigator<R, Gyroscope<R>, 37>;
/// A navigator without a gyroscope.
pub type WithoutGyroscope<R> = Navigator<R, NoGyroscope<R>, 21>;

impl<R: RealField + Copy, M: Model<R, N>, const N: usize> Navigator<R, M, N> {
    /// A navigator at a start.
    ///
    /// # Errors
    /// [`LayoutFull`]: `N` is below the states of the model.
    pub fn new(settings: Settings<R>, start: &Start<R>) -> Result<Self, LayoutFull> {
        let (tilt, velocity) = match start.rest {
            true => (REST_TILT, REST_VELOCITY),
            false => (MOVING_TILT, MOVING_VELOCITY),
        };
        let attitude = [tilt, tilt, START_HEADING].map(real);
        let mut layout = Layout::new(attitude, real(velocity), real(START_POSITION));
        let magnetometer = Magnetometer::claim(&mut layout)?;
        let model = M::claim(&mut layout, &settings, start)?;
        let zero = R::zero();
        Ok(Self {
            settings,
            filter: Filter::new(&layout, start.attitude),
            model,
            magnetometer,
            reference_ut: start.field_ut,
            since: Since {
                field: zero,
                rest: zero,
                speed: zero,
                accepted: zero,
            },
            recoveries: 0,
        })
    }

    /// State and covariance.
    pub fn filter(&self) -> &Filter<R, N> {
        &self.filter
    }

    /// Rests that failed their test although they were certain: the covariance was scaled there.
    pub fn recoveries(&self) -> u32 {
        self.recoveries
    }

    /// A sample, and whether the unit is at rest there.
    pub fn push(&mut self, sample: &Sample<R>, at_rest: bool) {
        self.since.field += sample.step_s;
        self.since.rest += sample.step_s;
        self.since.speed += sample.step_s;
        self.since.accepted += sample.step_s;
        let step = self
            .model
            .step(&mut self.filter, sample, at_rest, &self.magnetometer);
        if let (Some(field_ut), Some(reference_ut)) = (step, self.reference_ut)
            && self.since.field >= self.model.field_interval_s()
        {
            let sensor = &self.magnetometer;
            let field = MagneticField {
                sensor,
                field_ut,
                reference_ut,
            };
            self.filter.update(&field, Gate::ChiSquare);
            self.since.field = R::zero();
        }
        self.update_velocity(at_rest);
    }

    fn update_velocity(&mut self, at_rest: bool) {
        let zero = self.settings.zero_velocity_mps.filter(|_| at_rest);
        match (zero, self.settings.profile.speed_mps()) {
            (Some(deviation), _) => {
                if self.since.rest >= self.settings.rest_interval_s {
                    self.update_rest(&Velocity::zero(deviation));
                    self.since.rest = R::zero();
                }
                self.since.speed = R::zero();
                return;
            }
            (None, Some(speed)) if self.since.speed >= real(SPEED_INTERVAL_S) => {
                self.filter
                    .update(&Velocity::zero(real(speed)), Gate::ChiSquare);
                self.since.speed = R::zero();
            }
            _ => {}
        }
        self.since.accepted = R::zero();
    }

    /// A rest that fails the test is constant velocity, or the start of a motion. One that goes on failing is certain.
    fn update_rest(&mut self, zero: &Velocity<R>) {
        let gate = if self.settings.profile == Profile::Foot {
            Gate::Open
        } else {
            Gate::ChiSquare
        };
        if self.filter.update(zero, gate).accepted {
            self.since.accepted = R::zero();
        } else if self.since.accepted >= real(CERTAIN_REST_S) {
            recover(&mut self.filter, zero, self.model.recovered());
            self.recoveries += 1;
            self.since.accepted = R::zero();
        }
    }

    /// Rotates the navigation frame so that the heading is this, rad: before the first sample.
    pub fn set_heading(&mut self, heading: R) {
        let turn = about_up(heading - self.heading());
        self.filter.state.attitude = turn * self.filter.state.attitude;
        self.reference_ut = self.reference_ut.map(|field| turn * field);
    }

    /// Position, m, velocity, m/s, and heading, rad, from outside, with their standard deviations. Roll, pitch and
    /// biases stay, with their covariance.
    pub fn set_pose(
        &mut self,
        position: Vector3<R>,
        velocity: Vector3<R>,
        heading: R,
        deviations: [R; 3],
    ) {
        let turn = about_up(heading - self.heading());
        self.filter.state.attitude = turn * self.filter.state.attitude;
        self.filter.state.set(POSITION, position);
        self.filter.state.set(VELOCITY, velocity);
        let [position, velocity, heading] = deviations.map(|deviation| deviation * deviation);
        self.filter
            .set_covariance(POSITION, &Matrix3::from_diagonal_element(position));
        self.filter
            .set_covariance(VELOCITY, &Matrix3::from_diagonal_element(velocity));
        self.filter
            .set_covariance(ATTITUDE.part::<1, 2>(), &Matrix1::new(heading));
    }

    /// Angle of the body x axis from east towards north, rad.
    pub fn heading(&self) -> R {
        yaw(&self.filter.state.attitude)
    }
}
