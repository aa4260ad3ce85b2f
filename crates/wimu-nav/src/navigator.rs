//! One unit: start, prediction, rests and motion profile, sample by sample. Equations (130) to (133).

mod model;
mod settings;
mod vehicle;

pub use settings::{Motion, Profile, Rests, Sample, SampleFault, Settings, Solution, Start};
pub use vehicle::{Vehicle, VehicleErrors};

use alloc::boxed::Box;

use nalgebra::{Matrix1, Matrix3, Rotation3, SMatrix, UnitQuaternion, Vector3};

use crate::consistency::Consistency;
use crate::filter::{Filter, Gate, Innovation};
use crate::process::{Process, Unmeasured};
use crate::rotation::{about_up, yaw};
use crate::sensor::{MagneticField, Magnetometer, Measurement, Position, Timed, Velocity, recover};
use crate::smoother::Log;
use crate::state::{ATTITUDE, HEADING, Layout, POSITION, Role, VELOCITY};
use model::Model;

/// Standard deviation of the constant velocity at rests with [`Rests::ConstantVelocity`], m/s: a slow hand.
pub(crate) const HIDDEN_VELOCITY: f64 = 0.1;
/// Standard deviation of the velocity of a start at rest and in motion, m/s: walking speed.
const REST_VELOCITY: f64 = 1e-3;
const MOVING_VELOCITY: f64 = 1.5;
/// Heading and position define the frame, rad, m.
const START_HEADING: f64 = 1e-3;
const START_POSITION: f64 = 1e-4;
/// Standard deviation of the velocity at a rest, m/s, a component: assumption of reference/estimator.
pub(crate) const REST_SPEED: f64 = 0.01;
/// Interval of updates at rests, s: the window of the detector, so that they are independent.
pub(crate) const REST_INTERVAL_S: f64 = 0.25;
/// Speeds of the profiles, m/s, a component, and interval of the updates with the profile's bounds, s.
const HAND_SPEED: f64 = 2.0;
const VEHICLE_SPEED: f64 = 30.0;
const BOUND_INTERVAL_S: f64 = 1.0;
/// A step beyond this is a gap, s: a hand's acceleration is not constant over it.
const GAP_S: f64 = 0.1;
/// Speed beyond which the filter has diverged, m/s: that of an airliner. Standard deviation of the position then, m.
pub(crate) const DIVERGED_SPEED: f64 = 300.0;
pub(crate) const LOST_POSITION: f64 = 1e4;
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
#[derive(Clone, Copy, Debug, Default)]
struct Since {
    field: f64,
    rest: f64,
    bound: f64,
    stance: f64,
    /// Stance that was tested.
    test: f64,
    /// Sample that predicted the motion.
    measured: f64,
    /// Of a rest without interruption.
    accepted: f64,
    /// Accepted rest.
    known: f64,
}

/// The navigator of one unit.
#[derive(Clone, Debug)]
pub struct Navigator {
    settings: Settings,
    layout: Layout,
    filter: Filter,
    model: Box<dyn Model>,
    magnetometer: Option<Magnetometer>,
    vehicle: Option<Vehicle>,
    reference_ut: Option<Vector3<f64>>,
    since: Since,
    resting: bool,
    /// Updates of a rest without interruption, and those that failed their test.
    rest_updates: [u8; 2],
    consistency: Consistency,
    fields: [u32; 2],
    recoveries: u32,
    divergences: u32,
}

impl Navigator {
    /// A navigator at a start.
    pub fn new(settings: Settings, start: &Start) -> Self {
        let velocity = if start.rest { REST_VELOCITY } else { MOVING_VELOCITY };
        let attitude = [start.tilt_rad, start.tilt_rad, START_HEADING];
        let mut layout = Layout::new(attitude, velocity, START_POSITION);
        let magnetometer = start.field_ut.map(|_| Magnetometer::claim(&mut layout));
        let hidden = (settings.rests != Rests::ZeroVelocity)
            .then(|| layout.claim(Role::Considered, [HIDDEN_VELOCITY; 3]));
        let model = model::claim(&mut layout, &settings, start, hidden);
        let vehicle = settings.vehicle.as_ref().map(|errors| Vehicle::claim(&mut layout, errors));
        Self {
            settings,
            filter: Filter::new(&layout, start.attitude),
            layout,
            model,
            magnetometer,
            vehicle,
            reference_ut: start.field_ut,
            // The velocity of a start in motion is not known.
            since: Since {
                known: if start.rest { 0.0 } else { f64::INFINITY },
                ..Since::default()
            },
            resting: false,
            rest_updates: [0; 2],
            consistency: Consistency::new(),
            fields: [0; 2],
            recoveries: 0,
            divergences: 0,
        }
    }

    /// Records all that follows, for a smoother.
    pub fn record(&mut self, log: Log) {
        self.filter.record(log);
    }

    /// What was recorded.
    pub fn log_mut(&mut self) -> Option<&mut Log> {
        self.filter.log_mut()
    }

    /// State and covariance.
    pub fn filter(&self) -> &Filter {
        &self.filter
    }

    /// States of another sensor, such as the bias of a range: `claim` claims them in the layout.
    pub fn claim<T>(&mut self, claim: impl FnOnce(&mut Layout) -> T) -> T {
        let claimed = claim(&mut self.layout);
        self.filter.extend(&self.layout);
        claimed
    }

    /// Changes what is known of states, such as a correlation between those that were claimed.
    pub fn change(&mut self, change: impl FnOnce(&mut Filter)) {
        change(&mut self.filter);
        self.filter.restart_log();
    }

    /// Predicts claimed states, such as a correlated error, up to the last sample. The process changes no other state.
    pub fn predict(&mut self, process: &impl Process) {
        self.filter.predict(process);
    }

    /// A step of a motion that a process describes: with [`Motion::Process`].
    pub fn travel(&mut self, process: &impl Process, step_s: f64) {
        self.count(step_s);
        self.filter.predict(process);
        self.finish(step_s);
    }

    /// Update with a measurement of another sensor, at the time of the last prediction: a position, a range, a height.
    pub fn update(&mut self, measurement: &impl Measurement, gate: Gate) -> Innovation {
        let innovation = self.filter.update(measurement, gate);
        self.finish(0.0);
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
    pub fn take_consistency(&mut self) -> Consistency {
        core::mem::take(&mut self.consistency)
    }

    /// Whether the last update at a rest was accepted, and the rest goes on.
    pub fn is_at_rest(&self) -> bool {
        self.resting
    }

    /// Whether the rest that goes on contradicts the velocity: it may be a slow motion.
    pub fn doubts_rest(&self) -> bool {
        let [_, failures] = self.rest_updates;
        failures > 0 && !self.resting
    }

    /// Times at which the filter diverged and began again, with an unknown position.
    pub fn divergences(&self) -> u32 {
        self.divergences
    }

    /// What is estimated.
    pub fn solution(&self) -> Solution {
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
    pub fn angular_rate(&self) -> Vector3<f64> {
        self.model.angular_rate(&self.filter.state)
    }

    /// A sample, and whether the unit is at rest there.
    ///
    /// # Errors
    /// [`SampleFault`].
    pub fn push(&mut self, sample: &Sample, at_rest: bool) -> Result<(), SampleFault> {
        let step_s = sample.step_s;
        if !step_s.is_finite() || step_s < 0.0 {
            return Err(SampleFault::NoTime);
        }
        let vectors = [Some(sample.force_mps2), sample.rate_rad_s, sample.field_ut];
        if !vectors.iter().flatten().all(|v| v.iter().all(|x| x.is_finite())) {
            self.interrupt(step_s);
            return Err(SampleFault::NotFinite);
        }
        if step_s > GAP_S {
            self.interrupt(step_s);
            return Ok(());
        }
        self.count(step_s);
        let field = if self.model.is_measured(sample) {
            self.since.measured = 0.0;
            self.model.step(&mut self.filter, sample, at_rest, self.magnetometer.as_ref())
        } else {
            self.predict_unmeasured(step_s);
            sample.field_ut
        };
        if let (Some(field_ut), Some(reference_ut), Some(sensor)) =
            (field, self.reference_ut, &self.magnetometer)
            && self.since.field >= self.model.field_interval_s()
        {
            let reading = MagneticField { sensor, field_ut, reference_ut };
            let found = self.model.update_field(&mut self.filter, &reading);
            let count = &mut self.fields[usize::from(!found.accepted)];
            *count = count.saturating_add(1);
            self.since.field = 0.0;
        }
        self.update_velocity(at_rest);
        if let Some(vehicle) = &mut self.vehicle {
            let rate = self.model.angular_rate(&self.filter.state);
            let gravity = Vector3::z() * self.settings.gravity_mps2;
            let force = self.filter.state.attitude * sample.force_mps2;
            vehicle.accelerate(force - gravity, step_s);
            vehicle.step(&mut self.filter, &rate, step_s, at_rest);
        }
        self.finish(step_s);
        Ok(())
    }

    /// Stance of a foot at the last sample, which is never tested: the velocity is 0 ± `deviation_mps` m/s, a component, but for
    /// one that rests do not show.
    pub fn stance(&mut self, deviation_mps: f64) {
        let zero = Velocity::zero(deviation_mps, self.model.hidden_velocity());
        let innovation = self.update(&zero, Gate::Open);
        let begins = self.since.stance >= SWING_S;
        if begins || self.since.test >= LONG_STANCE_S {
            self.consistency.see(innovation.statistic, innovation.dof);
            self.since.test = 0.0;
        }
        self.since.stance = 0.0;
    }

    /// The vehicle, with [`Settings::vehicle`].
    pub fn vehicle(&self) -> Option<&Vehicle> {
        self.vehicle.as_ref()
    }

    /// Speed over ground by the wheels at the last sample, m/s, positive forward. Without [`Settings::vehicle`] it is not
    /// used, and the answer is `None`; so it is until the forward axis is known.
    pub fn odometer(&mut self, speed_mps: f64) -> Option<Innovation> {
        let vehicle = self.vehicle.as_mut()?;
        let innovation = vehicle.odometer(&mut self.filter, speed_mps);
        self.finish(0.0);
        innovation
    }

    /// A position fix that was measured `age_s` before the last sample, by their time stamps, with a standard deviation of that
    /// time. The states of the antenna and of the clock are used where there are some: with [`Settings::vehicle`].
    pub fn fix(&mut self, fix: Position, [age_s, time_sd_s]: [f64; 2], gate: Gate) -> Innovation {
        let Some(vehicle) = &self.vehicle else {
            return self.update(&Timed { measurement: fix, time_sd_s }, gate);
        };
        let measurement = vehicle.antenna(fix, age_s, self.angular_rate());
        self.update(&Timed { measurement, time_sd_s }, gate)
    }

    /// Time without a usable sample, s: a gap, or clipped or missing samples.
    pub fn interrupt(&mut self, step_s: f64) {
        self.count(step_s);
        self.since.accepted = 0.0;
        self.predict_unmeasured(step_s);
        self.finish(step_s);
    }

    fn predict_unmeasured(&mut self, step_s: f64) {
        let since_s = (self.since.measured - step_s).max(0.0);
        let step_s = step_s + self.model.interrupt();
        let field = self.magnetometer.map(|magnetometer| magnetometer.step(step_s));
        self.filter.predict(&(Unmeasured { step_s, since_s }, field));
    }

    fn count(&mut self, step_s: f64) {
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
            if self.since.rest >= REST_INTERVAL_S {
                self.update_rest();
                self.since.rest = 0.0;
            }
        } else {
            self.since.accepted = 0.0;
            self.resting = false;
            self.rest_updates = [0; 2];
        }
        if self.since.bound < BOUND_INTERVAL_S {
            return;
        }
        self.since.bound = 0.0;
        let speed = match profile {
            Profile::Hand | Profile::Slide => Some(HAND_SPEED),
            // A known forward axis bounds it better: beside it the bound would only pull the speed towards zero.
            Profile::Vehicle if self.vehicle.is_some_and(|v| v.forward().is_some()) => None,
            Profile::Vehicle => Some(VEHICLE_SPEED),
            Profile::Foot | Profile::Free => None,
        };
        if let Some(speed) = speed.filter(|_| !at_rest) {
            let bound = Velocity::zero(speed, None);
            self.filter.update(&bound, Gate::ChiSquare);
        }
        if let Some(deviation_m) = self.settings.within_m {
            let within = Position {
                position_m: Vector3::zeros(),
                deviation_m: Vector3::repeat(deviation_m),
                lever_arm_m: Vector3::zeros(),
            };
            self.filter.update(&within, Gate::Open);
        }
    }

    /// A rest that fails the test is constant velocity, or the start of a motion. One that goes on failing is certain,
    /// until an update passes or the unit moves.
    fn update_rest(&mut self) {
        let zero = Velocity::zero(REST_SPEED, self.model.hidden_velocity());
        let gravity = self.model.gravity(&self.filter, REST_ACCELERATION);
        let accelerates = gravity.is_some_and(|innovation| !innovation.accepted);
        let velocity = if accelerates {
            self.filter.test(&zero)
        } else {
            self.filter.update(&zero, Gate::ChiSquare)
        };
        self.resting = !accelerates && velocity.accepted;
        self.check_rest(&velocity);
        let failed = self.since.accepted;
        let drifted = self.since.known - failed >= DRIFT_S;
        let certain = if drifted { CERTAIN_REST_S } else { CONSTANT_VELOCITY_S };
        if self.resting {
            if let Some(rate) = self.model.zero_rate() {
                self.filter.update(&rate, Gate::ChiSquare);
            }
            self.since.accepted = 0.0;
            self.since.known = 0.0;
        } else if failed >= certain {
            // A certain rest is no slow motion.
            self.consistency.see(velocity.statistic, velocity.dof);
            recover(&mut self.filter, &zero, self.model.recovered());
            // A model that failed at an unknown time: the rest says nothing of the time before.
            self.filter.restart_log();
            self.recoveries += 1;
            self.resting = true;
        }
    }

    /// Takes the first updates of a rest for the consistency of the path. A rest that failed its test may be a slow motion:
    /// it contradicts the path as far as that does not explain it.
    fn check_rest(&mut self, velocity: &Innovation) {
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
        let slow = Velocity::zero(SLOW_MOTION, self.model.hidden_velocity());
        let tests =
            [Some(self.filter.test(&slow)), self.model.gravity(&self.filter, SLOW_ACCELERATION)];
        for innovation in tests.into_iter().flatten() {
            self.consistency.see(innovation.statistic, innovation.dof);
        }
    }

    /// Ends a step of the filter, s. If it diverged, it begins again with a start in motion at an unknown position.
    fn finish(&mut self, step_s: f64) {
        let speed = self.filter.state.get(VELOCITY).norm();
        if self.filter.is_sound() && speed < DIVERGED_SPEED {
            self.filter.end_step(step_s);
            return;
        }
        let attitude = self.filter.state.attitude;
        let finite = attitude.matrix().iter().all(|x| x.is_finite());
        let attitude = if finite { attitude } else { Rotation3::identity() };
        let start = Start {
            field_ut: self.reference_ut,
            ..Start::moving(attitude, self.settings.gravity_mps2)
        };
        let new = Self::new(self.settings, &start);
        let log = self.filter.take_log();
        self.filter = new.filter;
        self.filter.extend(&self.layout);
        self.filter.put_log(log);
        self.model = new.model;
        self.vehicle = new.vehicle;
        self.since = new.since;
        self.resting = false;
        self.divergences += 1;
        let lost = Matrix3::from_diagonal_element(LOST_POSITION * LOST_POSITION);
        self.filter.set_covariance(POSITION, &lost);
        let heading = core::f64::consts::PI;
        let unknown = Matrix1::new(heading * heading);
        self.filter.set_covariance(HEADING, &unknown);
        self.filter.restart_log();
    }

    /// Rotates the navigation frame so that the heading is this, rad: before the first sample.
    pub fn set_heading(&mut self, heading: f64) {
        let turn = about_up(heading - self.heading());
        self.filter.state.attitude = turn * self.filter.state.attitude;
        self.reference_ut = self.reference_ut.map(|field| turn * field);
        self.filter.restart_log();
    }

    /// Covariance of a calibration of the accelerometer: bias, m/s², then the matrix by rows, of equation (113), body
    /// frame. Before the first sample. A model without a matrix leaves it out: then
    /// [`ImuErrors::accelerometer_bias`] contains the effect of the matrix at rest.
    pub fn set_calibration(&mut self, covariance: &SMatrix<f64, 12, 12>) {
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
    pub fn set_position(&mut self, position: Vector3<f64>) {
        self.filter.state.set(POSITION, position);
        let variance = START_POSITION * START_POSITION;
        self.filter.set_covariance(POSITION, &Matrix3::from_diagonal_element(variance));
        self.filter.restart_log();
    }

    /// Adds an uncertainty to the position, m, 1 σ of a component: it moved in a way that the sensors do not show. Of a
    /// vehicle the velocity and the heading are less certain, too: its start in motion was wrong.
    pub fn loosen(&mut self, deviation_m: f64) {
        self.filter.add_variance(POSITION, [deviation_m * deviation_m; 3]);
        if self.vehicle.is_some() {
            self.filter.add_variance(VELOCITY, [(LOOSE_VELOCITY * LOOSE_VELOCITY); 3]);
            self.filter.add_variance(HEADING, [(LOOSE_HEADING * LOOSE_HEADING)]);
        }
        self.filter.restart_log();
    }

    /// Makes the position of the unit the origin, and its heading known: at the first rest of a start in motion.
    pub fn set_origin(&mut self) {
        self.set_position(Vector3::zeros());
        let variance = START_HEADING * START_HEADING;
        self.filter.set_covariance(HEADING, &Matrix1::new(variance));
        self.filter.restart_log();
    }

    /// Position, m, velocity, m/s, and heading, rad, from outside, with their standard deviations. Roll, pitch and
    /// biases stay, with their covariance.
    pub fn set_pose(
        &mut self,
        position: Vector3<f64>,
        velocity: Vector3<f64>,
        heading: f64,
        deviations: [f64; 3],
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
        self.since.known = 0.0;
        self.filter.restart_log();
    }

    /// Angle of the body x axis from east towards north, rad.
    pub fn heading(&self) -> f64 {
        yaw(&self.filter.state.attitude)
    }
}
