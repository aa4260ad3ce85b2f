//! One unit: start, prediction, rests and motion profile, sample by sample. Equations (130) to (133).

mod model;
mod vehicle;

pub use model::{Gyroscope, Model, NoGyroscope};
pub use vehicle::{Vehicle, VehicleErrors};

use core::fmt;

use nalgebra::{Matrix1, Matrix3, RealField, Rotation3, SMatrix, UnitQuaternion, Vector3};

use crate::consistency::Consistency;
use crate::filter::{Filter, Gate, Innovation};
use crate::process::{ImuErrors, Process, Unmeasured};
use crate::rotation::{about_up, level, real, yaw};
use crate::sensor::{MagneticField, Magnetometer, Measurement, Position, Velocity, recover};
use crate::smoother::Recorder;
use crate::state::{ATTITUDE, HEADING, Layout, LayoutFull, POSITION, Role, VELOCITY};

/// What is assumed of the motion.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[non_exhaustive]
pub enum Profile {
    /// In a hand or on a small robot: the velocity is 0 ± 2 m/s, once a second.
    #[default]
    Hand,
    /// On a foot: stances of steps are given to [`Navigator::stance`].
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

/// Standard deviation of the constant velocity at rests with [`Rests::ConstantVelocity`], m/s: a slow hand.
const HIDDEN_VELOCITY: f64 = 0.1;

/// Settings of a [`Navigator`].
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub struct Settings<R> {
    /// Errors of the sensors.
    pub errors: ImuErrors<R>,
    /// Gravity, m/s².
    pub gravity_mps2: R,
    /// What is assumed of the motion.
    pub profile: Profile,
    /// What a rest means.
    pub rests: Rests,
    /// The position stays within this distance of the origin, m, 1 σ of a component.
    pub within_m: Option<R>,
    /// The motion of a vehicle along its forward axis, which the unit must have a gyroscope for: eleven states.
    pub vehicle: Option<VehicleErrors<R>>,
}

impl<R: RealField> Settings<R> {
    /// Settings for a profile.
    pub fn of(profile: Profile) -> Self {
        let mut errors = ImuErrors::default();
        if profile == Profile::Foot {
            // Shocks of up to 16 g: bandwidth, clipping, scale factors and delay of the gyroscope act as noise (pyshoe).
            errors.accelerometer_noise = real(0.15);
            errors.gyroscope_noise = real(0.005);
            errors.gyroscope_matrix = [real(0.0), real(0.0)];
            errors.delay_s = real(0.0);
        }
        if profile == Profile::Vehicle {
            // Vibration of engine and road: chosen on one drive of a car (score_localization).
            errors.accelerometer_noise = real(0.02);
            errors.gyroscope_noise = real(0.0015);
        }
        if profile == Profile::Slide {
            // The rotation is a random walk of 0.1 deg/√s.
            errors.gyroscope_noise = real(0.002);
            errors.gyroscope_bias = real(1e-5);
            errors.gyroscope_bias_walk = real(0.0);
            errors.delay_s = real(0.0);
        }
        Self {
            errors,
            gravity_mps2: real(crate::GRAVITY_MPS2),
            profile,
            rests: Rests::ZeroVelocity,
            within_m: None,
            vehicle: None,
        }
    }
}

impl<R: RealField> Default for Settings<R> {
    fn default() -> Self {
        Self::of(Profile::Hand)
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
    /// Magnetic field, µT, body frame. A reading that is held over several samples is given once.
    pub field_ut: Option<Vector3<R>>,
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
pub struct Solution<R> {
    /// Position, m, and velocity, m/s, east-north-up.
    pub position_m: [R; 3],
    /// See [`position_m`](Self::position_m).
    pub velocity_mps: [R; 3],
    /// Body to navigation frame, W X Y Z.
    pub quaternion: [R; 4],
    /// Covariance of the position, m².
    pub position_covariance: [[R; 3]; 3],
    /// Covariance of the velocity, m²/s².
    pub velocity_covariance: [[R; 3]; 3],
    /// Covariance of the attitude error about east, north and up, rad².
    pub attitude_covariance: [[R; 3]; 3],
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
    /// Alignment with gravity and the magnetic field. Numbers that are not finite are left out; `None` without a specific
    /// force.
    pub fn align(samples: &[Sample<R>], rest: bool) -> Option<Self> {
        let mean = |vectors: &mut dyn Iterator<Item = Vector3<R>>| {
            let (mut sum, mut count) = (Vector3::zeros(), R::zero());
            for vector in vectors.filter(|v| v.iter().all(|x| x.is_finite())) {
                sum += vector;
                count += R::one();
            }
            (count > R::zero()).then(|| sum / count)
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
/// Standard deviation of the velocity at a rest, m/s, a component: assumption of reference/estimator.
const REST_SPEED: f64 = 0.01;
/// Interval of updates at rests, s: the window of the detector, so that they are independent.
const REST_INTERVAL_S: f64 = 0.25;
/// Speeds of the profiles, m/s, a component, and interval of the updates with the profile's bounds, s.
const HAND_SPEED: f64 = 2.0;
const VEHICLE_SPEED: f64 = 30.0;
const BOUND_INTERVAL_S: f64 = 1.0;
/// A step beyond this is a gap, s: a hand's acceleration is not constant over it.
const GAP_S: f64 = 0.1;
/// Speed beyond which the filter has diverged, m/s: that of an airliner. Standard deviation of the position then, m.
const DIVERGED_SPEED: f64 = 300.0;
const LOST_POSITION: f64 = 1e4;
/// A rest of which every update of such a time failed its test is certain, s, if the last accepted one was so long before
/// that the velocity may have drifted, s. Otherwise the unit moves at a constant velocity, for at most the last time, s.
const CERTAIN_REST_S: f64 = 1.5;
const DRIFT_S: f64 = 2.0;
const CONSTANT_VELOCITY_S: f64 = 10.0;
/// Acceleration of a rest, m/s², a component, over a quarter of a second: chosen on simulated journeys with steps and
/// stops (score_navigation).
const REST_ACCELERATION: f64 = 0.05;
/// What a detector takes for a rest at most: a motion of constant velocity, m/s, or acceleration, m/s², a component.
const SLOW_MOTION: f64 = 1.0;
const SLOW_ACCELERATION: f64 = 0.7;
/// Updates of a rest that are independent of those before: the first of them bind the velocity.
const INDEPENDENT_UPDATES: u8 = 2;
/// A break in a stance is shorter than this, s; a swing is longer.
const SWING_S: f64 = 0.1;
/// A stance that lasts longer is tested again, s: longer than one of a walk.
const LONG_STANCE_S: f64 = 1.0;

/// Uncertainty that contradictions add to the motion of a vehicle, m/s a component, and rad. Of 40 starts of a drive none fails
/// with it, and one without; gravity shows the tilt. Tried on the same drive: (1, 0.2) and two others with a tilt.
const LOOSE_VELOCITY: f64 = 1.0;
const LOOSE_HEADING: f64 = 0.2;

/// Times since the last updates, s.
#[derive(Clone, Copy, Debug)]
struct Since<R> {
    field: R,
    rest: R,
    bound: R,
    stance: R,
    /// Stance that was tested.
    test: R,
    /// Sample that predicted the motion.
    measured: R,
    /// Of a rest without interruption.
    accepted: R,
    /// Accepted rest.
    known: R,
}

/// The navigator: a model of the motion with `N` states. `L` records it for a smoother.
#[derive(Clone, Debug)]
pub struct Navigator<R, M, const N: usize, L = ()> {
    recorder: L,
    settings: Settings<R>,
    layout: Layout<R, N>,
    filter: Filter<R, N>,
    model: M,
    magnetometer: Magnetometer<R>,
    vehicle: Option<Vehicle<R>>,
    reference_ut: Option<Vector3<R>>,
    since: Since<R>,
    resting: bool,
    /// Updates of a rest without interruption, and those that failed their test.
    rest_updates: [u8; 2],
    consistency: Consistency<R>,
    fields: [u32; 2],
    recoveries: u32,
    divergences: u32,
}

/// A navigator with a gyroscope.
pub type WithGyroscope<R> = Navigator<R, Gyroscope<R>, 40>;
/// A navigator with a gyroscope in a vehicle: with [`Settings::vehicle`].
pub type InVehicle<R> = Navigator<R, Gyroscope<R>, 51>;
/// A navigator without a gyroscope.
pub type WithoutGyroscope<R> = Navigator<R, NoGyroscope<R>, 24>;

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
        let hidden = match settings.rests {
            Rests::ZeroVelocity => None,
            _ => Some(layout.claim(Role::Considered, [real(HIDDEN_VELOCITY); 3])?),
        };
        let model = M::claim(&mut layout, &settings, start, hidden)?;
        let errors = settings.vehicle.as_ref();
        let vehicle = errors.map(|errors| Vehicle::claim(&mut layout, errors));
        let vehicle = vehicle.transpose()?;
        let zero = R::zero();
        Ok(Self {
            recorder: (),
            settings,
            filter: Filter::new(&layout, start.attitude),
            layout,
            model,
            magnetometer,
            vehicle,
            reference_ut: start.field_ut,
            since: Since {
                field: zero,
                rest: zero,
                bound: zero,
                stance: zero,
                test: zero,
                measured: zero,
                accepted: zero,
                known: zero,
            },
            resting: false,
            rest_updates: [0; 2],
            consistency: Consistency::new(),
            fields: [0; 2],
            recoveries: 0,
            divergences: 0,
        })
    }

    /// The same navigator, recorded from here on.
    pub fn recorded<L: Recorder<R, N>>(self, mut recorder: L) -> Navigator<R, M, N, L> {
        recorder.restarted(&self.filter);
        Navigator {
            recorder,
            settings: self.settings,
            layout: self.layout,
            filter: self.filter,
            model: self.model,
            magnetometer: self.magnetometer,
            vehicle: self.vehicle,
            reference_ut: self.reference_ut,
            since: self.since,
            resting: self.resting,
            rest_updates: self.rest_updates,
            consistency: self.consistency,
            fields: self.fields,
            recoveries: self.recoveries,
            divergences: self.divergences,
        }
    }
}

impl<R, M, const N: usize, L> Navigator<R, M, N, L>
where
    R: RealField + Copy,
    M: Model<R, N>,
    L: Recorder<R, N>,
{
    /// The recorder.
    pub fn recorder(&self) -> &L {
        &self.recorder
    }

    /// The recorder, to take from it.
    pub fn recorder_mut(&mut self) -> &mut L {
        &mut self.recorder
    }

    /// The recorder, at the end.
    pub fn into_recorder(self) -> L {
        self.recorder
    }

    /// State and covariance.
    pub fn filter(&self) -> &Filter<R, N> {
        &self.filter
    }

    /// States of another sensor, such as the bias of a range: `claim` claims them in the layout.
    ///
    /// # Errors
    /// [`LayoutFull`].
    pub fn claim<T>(
        &mut self,
        claim: impl FnOnce(&mut Layout<R, N>) -> Result<T, LayoutFull>,
    ) -> Result<T, LayoutFull> {
        let mut layout = self.layout.clone();
        let claimed = claim(&mut layout)?;
        self.filter.extend(&layout, self.layout.used);
        self.layout = layout;
        self.recorder.restarted(&self.filter);
        Ok(claimed)
    }

    /// Changes what is known of claimed states, such as a correlation between them.
    pub fn correlate(&mut self, change: impl FnOnce(&mut Filter<R, N>)) {
        change(&mut self.filter);
        self.recorder.restarted(&self.filter);
    }

    /// Predicts claimed states, such as a correlated error, up to the last sample. The process changes no other state.
    pub fn predict(&mut self, process: &impl Process<R, N>) {
        self.filter.predict_recorded(process, &mut self.recorder);
    }

    /// Update with a measurement of another sensor, at the time of the last prediction: a position, a range, a height.
    pub fn update<const K: usize>(
        &mut self,
        measurement: &impl Measurement<R, N, K>,
        gate: Gate,
    ) -> Innovation<R> {
        let innovation = self.filter.update_recorded(measurement, gate, &mut self.recorder);
        self.finish(R::zero());
        innovation
    }

    /// Readings of the magnetic field that were used, and that contradicted the attitude: a magnet or iron is near.
    pub fn fields(&self) -> [u32; 2] {
        self.fields
    }

    /// Updates at rests that are certain which failed their test: the covariance was scaled there.
    pub fn recoveries(&self) -> u32 {
        self.recoveries
    }

    /// Innovations of rests and stances since they were taken last: the first of each, and one a second of a
    /// stance that lasts. The others rest on these.
    pub fn take_consistency(&mut self) -> Consistency<R> {
        core::mem::take(&mut self.consistency)
    }

    /// Whether the last update at a rest was accepted, and the rest goes on.
    pub fn is_at_rest(&self) -> bool {
        self.resting
    }

    /// Times at which the filter diverged and began again, with an unknown position.
    pub fn divergences(&self) -> u32 {
        self.divergences
    }

    /// What is estimated.
    pub fn solution(&self) -> Solution<R> {
        let filter = &self.filter;
        let quaternion = UnitQuaternion::from_rotation_matrix(&filter.state.attitude);
        let rows = |block| filter.covariance::<3>(block).transpose().into();
        Solution {
            position_m: filter.state.get(POSITION).into(),
            velocity_mps: filter.state.get(VELOCITY).into(),
            quaternion: [quaternion.w, quaternion.i, quaternion.j, quaternion.k],
            position_covariance: rows(POSITION),
            velocity_covariance: rows(VELOCITY),
            attitude_covariance: rows(ATTITUDE),
        }
    }

    /// Angular rate, rad/s, body frame: measured and corrected for its bias, or estimated.
    pub fn angular_rate(&self) -> Vector3<R> {
        self.model.angular_rate(&self.filter.state)
    }

    /// A sample, and whether the unit is at rest there.
    ///
    /// # Errors
    /// [`SampleFault`].
    pub fn push(&mut self, sample: &Sample<R>, at_rest: bool) -> Result<(), SampleFault> {
        let step_s = sample.step_s;
        if !step_s.is_finite() || step_s < R::zero() {
            return Err(SampleFault::NoTime);
        }
        let vectors = [Some(sample.force_mps2), sample.rate_rad_s, sample.field_ut];
        if !vectors.iter().flatten().all(|v| v.iter().all(|x| x.is_finite())) {
            self.interrupt(step_s);
            return Err(SampleFault::NotFinite);
        }
        if step_s > real(GAP_S) {
            self.interrupt(step_s);
            return Ok(());
        }
        self.count(step_s);
        let field = if self.model.is_measured(sample) {
            self.since.measured = R::zero();
            let (filter, recorder) = (&mut self.filter, &mut self.recorder);
            self.model.step(filter, sample, at_rest, &self.magnetometer, recorder)
        } else {
            self.predict_unmeasured(step_s);
            sample.field_ut
        };
        if let (Some(field_ut), Some(reference_ut)) = (field, self.reference_ut)
            && self.since.field >= self.model.field_interval_s()
        {
            let sensor = &self.magnetometer;
            let reading = MagneticField { sensor, field_ut, reference_ut };
            let found = self.model.update_field(&mut self.filter, &reading, &mut self.recorder);
            let count = &mut self.fields[usize::from(!found.accepted)];
            *count = count.saturating_add(1);
            self.since.field = R::zero();
        }
        self.update_velocity(at_rest);
        if let Some(vehicle) = &mut self.vehicle {
            let rate = self.model.angular_rate(&self.filter.state);
            let gravity = Vector3::z() * self.settings.gravity_mps2;
            let force = self.filter.state.attitude * sample.force_mps2;
            vehicle.accelerate(force - gravity, step_s);
            vehicle.step(&mut self.filter, &rate, step_s, at_rest, &mut self.recorder);
        }
        self.finish(step_s);
        Ok(())
    }

    /// Stance of a foot at the last sample, which is never tested: the velocity is 0 ± `deviation_mps` m/s, a component.
    pub fn stance(&mut self, deviation_mps: R) {
        let innovation = self.update(&Velocity::zero(deviation_mps, None), Gate::Open);
        let begins = self.since.stance >= real(SWING_S);
        if begins || self.since.test >= real(LONG_STANCE_S) {
            self.consistency.see(innovation.statistic, innovation.dof);
            self.since.test = R::zero();
        }
        self.since.stance = R::zero();
    }

    /// The vehicle, with [`Settings::vehicle`].
    pub fn vehicle(&self) -> Option<&Vehicle<R>> {
        self.vehicle.as_ref()
    }

    /// Speed over ground by the wheels at the last sample, m/s, positive forward. Without [`Settings::vehicle`] it is not
    /// used, and the answer is `None`; so it is until the forward axis is known.
    pub fn odometer(&mut self, speed_mps: R) -> Option<Innovation<R>> {
        let vehicle = self.vehicle.as_mut()?;
        let innovation = vehicle.odometer(&mut self.filter, speed_mps, &mut self.recorder);
        self.finish(R::zero());
        innovation
    }

    /// A position fix that was measured `age_s` before the last sample, by their time stamps. The states of the antenna and
    /// of the clock are used where there are some: with [`Settings::vehicle`].
    pub fn fix(&mut self, fix: Position<R>, age_s: R, gate: Gate) -> Innovation<R> {
        let rate_rad_s = self.angular_rate();
        match &self.vehicle {
            Some(vehicle) => {
                let antenna = vehicle.antenna(fix, age_s, rate_rad_s);
                self.update(&antenna, gate)
            }
            None => self.update(&fix, gate),
        }
    }

    /// Time without a usable sample, s: a gap, or clipped or missing samples.
    pub fn interrupt(&mut self, step_s: R) {
        self.count(step_s);
        self.since.accepted = R::zero();
        self.predict_unmeasured(step_s);
        self.finish(step_s);
    }

    fn predict_unmeasured(&mut self, step_s: R) {
        let since_s = (self.since.measured - step_s).max(R::zero());
        let step_s = step_s + self.model.interrupt();
        let gap = (Unmeasured { step_s, since_s }, self.magnetometer.step(step_s));
        self.filter.predict_recorded(&gap, &mut self.recorder);
    }

    fn count(&mut self, step_s: R) {
        let since = &mut self.since;
        for time in [
            &mut since.field,
            &mut since.rest,
            &mut since.bound,
            &mut since.stance,
            &mut since.test,
            &mut since.measured,
            &mut since.accepted,
            &mut since.known,
        ] {
            *time += step_s;
        }
    }

    fn update_velocity(&mut self, at_rest: bool) {
        let profile = self.settings.profile;
        let at_rest = at_rest && self.settings.rests != Rests::Ignored;
        if at_rest {
            if self.since.rest >= real(REST_INTERVAL_S) {
                self.update_rest();
                self.since.rest = R::zero();
            }
        } else {
            self.since.accepted = R::zero();
            self.resting = false;
            self.rest_updates = [0; 2];
        }
        if self.since.bound < real(BOUND_INTERVAL_S) {
            return;
        }
        self.since.bound = R::zero();
        let speed = match profile {
            Profile::Hand | Profile::Slide => Some(HAND_SPEED),
            // A known forward axis bounds it better: beside it the bound would only pull the speed towards zero.
            Profile::Vehicle if self.vehicle.is_some_and(|v| v.forward().is_some()) => None,
            Profile::Vehicle => Some(VEHICLE_SPEED),
            Profile::Foot | Profile::Free => None,
        };
        if let Some(speed) = speed.filter(|_| !at_rest) {
            let bound = Velocity::zero(real(speed), None);
            self.filter.update_recorded(&bound, Gate::ChiSquare, &mut self.recorder);
        }
        if let Some(deviation_m) = self.settings.within_m {
            let within = Position {
                position_m: Vector3::zeros(),
                deviation_m: Vector3::repeat(deviation_m),
                lever_arm_m: Vector3::zeros(),
            };
            self.filter.update_recorded(&within, Gate::Open, &mut self.recorder);
        }
    }

    /// A rest that fails the test is constant velocity, or the start of a motion. One that goes on failing is certain,
    /// until an update passes or the unit moves.
    fn update_rest(&mut self) {
        let zero = Velocity::zero(real(REST_SPEED), self.model.hidden_velocity());
        let gravity = self.model.gravity(&self.filter, real(REST_ACCELERATION));
        let accelerates = gravity.is_some_and(|innovation| !innovation.accepted);
        let velocity = if accelerates {
            self.filter.test(&zero)
        } else {
            self.filter.update_recorded(&zero, Gate::ChiSquare, &mut self.recorder)
        };
        self.resting = !accelerates && velocity.accepted;
        self.check_rest(&velocity);
        let failed = self.since.accepted;
        let drifted = self.since.known - failed >= real(DRIFT_S);
        let certain = if drifted { CERTAIN_REST_S } else { CONSTANT_VELOCITY_S };
        if self.resting {
            if let Some(rate) = self.model.zero_rate() {
                self.filter.update_recorded(&rate, Gate::ChiSquare, &mut self.recorder);
            }
            self.since.accepted = R::zero();
            self.since.known = R::zero();
        } else if failed >= real(certain) {
            recover(&mut self.filter, &zero, self.model.recovered());
            // A model that failed at an unknown time: the rest says nothing of the time before.
            self.recorder.restarted(&self.filter);
            self.recoveries += 1;
            self.resting = true;
        }
    }

    /// Takes the first updates of a rest for the consistency of the path. A rest that failed its test may be a slow motion:
    /// it contradicts the path as far as that does not explain it.
    fn check_rest(&mut self, velocity: &Innovation<R>) {
        let [updates, failures] = &mut self.rest_updates;
        *updates = updates.saturating_add(1);
        if self.resting {
            if *updates <= INDEPENDENT_UPDATES {
                self.consistency.see(velocity.statistic, velocity.dof);
            }
            return;
        }
        *failures = failures.saturating_add(1);
        if *failures != INDEPENDENT_UPDATES {
            return;
        }
        let slow = Velocity::zero(real(SLOW_MOTION), self.model.hidden_velocity());
        let tests = [
            Some(self.filter.test(&slow)),
            self.model.gravity(&self.filter, real(SLOW_ACCELERATION)),
        ];
        for innovation in tests.into_iter().flatten() {
            self.consistency.see(innovation.statistic, innovation.dof);
        }
    }

    /// Ends a step of the filter, s. If it diverged, it begins again with a start in motion at an unknown position.
    fn finish(&mut self, step_s: R) {
        let speed = self.filter.state.get(VELOCITY).norm();
        if self.filter.is_sound() && speed < real(DIVERGED_SPEED) {
            self.recorder.updated(&self.filter, step_s);
            return;
        }
        let attitude = self.filter.state.attitude;
        let finite = attitude.matrix().iter().all(|x| x.is_finite());
        let attitude = if finite { attitude } else { Rotation3::identity() };
        let start = Start {
            attitude,
            field_ut: self.reference_ut,
            force_mps2: self.settings.gravity_mps2,
            rest: false,
        };
        let Ok(new) = Navigator::<R, M, N>::new(self.settings, &start) else {
            return;
        };
        self.filter = new.filter;
        self.filter.extend(&self.layout, new.layout.used);
        self.model = new.model;
        self.vehicle = new.vehicle;
        self.since = new.since;
        self.resting = false;
        self.divergences += 1;
        let lost = Matrix3::from_diagonal_element(real(LOST_POSITION * LOST_POSITION));
        self.filter.set_covariance(POSITION, &lost);
        let heading = core::f64::consts::PI;
        let unknown = Matrix1::new(real(heading * heading));
        self.filter.set_covariance(HEADING, &unknown);
        self.recorder.restarted(&self.filter);
    }

    /// Rotates the navigation frame so that the heading is this, rad: before the first sample.
    pub fn set_heading(&mut self, heading: R) {
        let turn = about_up(heading - self.heading());
        self.filter.state.attitude = turn * self.filter.state.attitude;
        self.reference_ut = self.reference_ut.map(|field| turn * field);
        self.recorder.restarted(&self.filter);
    }

    /// Covariance of a calibration of the accelerometer: bias, m/s², then the matrix by rows, of equation (113), body
    /// frame. Before the first sample. A model without a matrix leaves it out: then
    /// [`ImuErrors::accelerometer_bias`] contains the effect of the matrix at rest.
    pub fn set_calibration(&mut self, covariance: &SMatrix<R, 12, 12>) {
        let Some((bias, matrix)) = self.model.calibrated() else {
            return;
        };
        let filter = &mut self.filter;
        filter.set_covariance(bias, &covariance.fixed_view::<3, 3>(0, 0).into_owned());
        filter.set_covariance(matrix, &covariance.fixed_view::<9, 9>(3, 3).into_owned());
        let cross = covariance.fixed_view::<3, 9>(0, 3).into_owned();
        filter.set_cross_covariance(bias, matrix, &cross);
    }

    /// Makes a position, m, east-north-up, that of the unit: at the start.
    pub fn set_position(&mut self, position: Vector3<R>) {
        self.filter.state.set(POSITION, position);
        let variance = real(START_POSITION * START_POSITION);
        self.filter.set_covariance(POSITION, &Matrix3::from_diagonal_element(variance));
        self.recorder.restarted(&self.filter);
    }

    /// Adds an uncertainty to the position, m, 1 σ of a component: it moved in a way that the sensors do not show. Of a
    /// vehicle the velocity and the heading are less certain, too: its start in motion was wrong.
    pub fn loosen(&mut self, deviation_m: R) {
        self.filter.add_variance(POSITION, [deviation_m * deviation_m; 3]);
        if self.vehicle.is_some() {
            self.filter.add_variance(VELOCITY, [real(LOOSE_VELOCITY * LOOSE_VELOCITY); 3]);
            self.filter.add_variance(HEADING, [real(LOOSE_HEADING * LOOSE_HEADING)]);
        }
        self.recorder.restarted(&self.filter);
    }

    /// Makes the position of the unit the origin, and its heading known: at the first rest of a start in motion.
    pub fn set_origin(&mut self) {
        self.set_position(Vector3::zeros());
        let variance = real(START_HEADING * START_HEADING);
        self.filter.set_covariance(HEADING, &Matrix1::new(variance));
        self.recorder.restarted(&self.filter);
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
        // The tilt errors are those of the same body axes in the new directions.
        self.filter.rotate(ATTITUDE, &turn);
        if let Some(acceleration) = self.model.acceleration() {
            self.filter.rotate(acceleration, &turn);
        }
        self.filter.state.set(POSITION, position);
        self.filter.state.set(VELOCITY, velocity);
        let [position, velocity, heading] = deviations.map(|deviation| deviation * deviation);
        self.filter.set_covariance(POSITION, &Matrix3::from_diagonal_element(position));
        self.filter.set_covariance(VELOCITY, &Matrix3::from_diagonal_element(velocity));
        self.filter.set_covariance(HEADING, &Matrix1::new(heading));
        self.recorder.restarted(&self.filter);
    }

    /// Angle of the body x axis from east towards north, rad.
    pub fn heading(&self) -> R {
        yaw(&self.filter.state.attitude)
    }
}
