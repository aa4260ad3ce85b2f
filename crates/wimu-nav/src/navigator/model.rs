//! Models of the motion: with and without a gyroscope.

use alloc::boxed::Box;
use core::fmt;

use nalgebra::Vector3;

use super::{Motion, Sample, Settings, Start};
use crate::filter::{Filter, Gate, Innovation};
use crate::process::{
    AccelerationOffset, Carried, CarriedBlocks, ImuErrors, RandomWalk, Strapdown, StrapdownBlocks,
};
use crate::sensor::{FieldHeading, Gravity, Known, MagneticField, Magnetometer, SpecificForce};
use crate::state::{ATTITUDE, Block, HEADING, Layout, Role, State};

/// How a navigator predicts from one sample to the next.
pub(super) trait Model: fmt::Debug + Send {
    /// The same.
    fn boxed(&self) -> Box<dyn Model>;

    /// The constant velocity that a rest has in place of zero.
    fn hidden_velocity(&self) -> Option<Block<3>> {
        None
    }

    /// Whether a sample has what predicts the motion.
    fn is_measured(&self, sample: &Sample) -> bool;

    /// Predicts to a sample that is measured, and returns the reading of the magnetometer there, µT, body frame.
    fn step(
        &mut self,
        filter: &mut Filter,
        sample: &Sample,
        at_rest: bool,
        magnetometer: Option<&Magnetometer>,
    ) -> Option<Vector3<f64>>;

    /// Forgets the last samples, as time without a usable sample follows. Returns the time since the last prediction, s.
    fn interrupt(&mut self) -> f64 {
        0.0
    }

    /// Shortest interval of the magnetometer's updates, s.
    fn field_interval_s(&self) -> f64 {
        0.0
    }

    /// Updates with a reading of the magnetometer, if it fits.
    fn update_field(&self, filter: &mut Filter, reading: &MagneticField<'_>) -> Innovation {
        filter.update(reading, Gate::ChiSquare)
    }

    /// Zero angular rate over the rest since the last one; `None` where it is not measured, or the rest is too short.
    fn zero_rate(&mut self) -> Option<Known<3>> {
        None
    }

    /// Test of the specific force of the rest against gravity, with a deviation of the acceleration, m/s², a component;
    /// `None` where the acceleration is a state. A short window does not show that the unit accelerates.
    fn gravity(&self, _: &Filter, _deviation_mps2: f64) -> Option<Innovation> {
        None
    }

    /// Angular rate, rad/s, body frame.
    fn angular_rate(&self, state: &State) -> Vector3<f64>;

    /// The states of rotation whose covariance is scaled, with attitude, velocity and position, at a rest that fails its
    /// test.
    fn recovered(&self) -> Block<3>;

    /// Bias and matrix of the accelerometer, where both are in the state.
    fn calibrated(&self) -> Option<(Block<3>, Block<9>)> {
        None
    }

    /// Acceleration in the navigation frame, where it is a state.
    fn acceleration(&self) -> Option<Block<3>> {
        None
    }
}

impl Clone for Box<dyn Model> {
    fn clone(&self) -> Self {
        self.boxed()
    }
}

/// The model of a motion, with its states. `hidden` is a constant velocity that rests do not show.
pub(super) fn claim(
    layout: &mut Layout,
    settings: &Settings,
    start: &Start,
    hidden: Option<Block<3>>,
) -> Box<dyn Model> {
    match settings.motion {
        Motion::Gyroscope => Box::new(Gyroscope::claim(layout, settings, hidden)),
        Motion::NoGyroscope => Box::new(NoGyroscope::claim(layout, settings, start, hidden)),
        Motion::Process => Box::new(Unsensed),
    }
}

/// No inertial sensor: no sample is measured.
#[derive(Clone, Debug)]
struct Unsensed;

impl Model for Unsensed {
    fn boxed(&self) -> Box<dyn Model> {
        Box::new(self.clone())
    }

    fn is_measured(&self, _: &Sample) -> bool {
        false
    }

    fn step(
        &mut self,
        _: &mut Filter,
        _: &Sample,
        _: bool,
        _: Option<&Magnetometer>,
    ) -> Option<Vector3<f64>> {
        None
    }

    fn angular_rate(&self, _: &State) -> Vector3<f64> {
        Vector3::zeros()
    }

    fn recovered(&self) -> Block<3> {
        ATTITUDE
    }
}

/// Smallest deviation of the mean angular rate over part of a rest, rad/s: resolution of a sensor of 16 bits.
const LEAST_REST_RATE: f64 = 1e-3;

/// Least time of rest that tells an angular rate of zero, s: of fewer samples the mean is that of an engine's vibration,
/// and its deviation is found from the same samples. Of a drive with fixes, 188 of 240 were rejected without it, and 6 with
/// it (`vehicle/gnss_imu_drive`, 22.5 to 82.5 s).
const LEAST_REST_S: f64 = 0.2;

/// Sums of a rest since the last update there.
#[derive(Clone, Copy, Debug, Default)]
struct RestSums {
    count: f64,
    time_s: f64,
    force: Vector3<f64>,
    rate: Vector3<f64>,
    squares: f64,
}

impl RestSums {
    fn push(&mut self, force: &Vector3<f64>, rate: &Vector3<f64>, step_s: f64) {
        self.count += 1.0;
        self.time_s += step_s;
        self.force += force;
        self.rate += rate;
        self.squares += rate.norm_squared();
    }

    /// Mean, and deviation of a sample: the rotation of a hand's rest lasts as long as the rest between two updates.
    fn mean_rate(&self) -> Option<(Vector3<f64>, f64)> {
        if self.time_s < LEAST_REST_S {
            return None;
        }
        let mean = self.rate / self.count;
        let variance = (self.squares / self.count - mean.norm_squared()) / 3.0;
        Some((mean, libm::sqrt(variance).max(LEAST_REST_RATE)))
    }
}

/// Strapdown integration of a gyroscope's angular rate.
#[derive(Clone, Debug)]
struct Gyroscope {
    blocks: StrapdownBlocks,
    errors: ImuErrors,
    gravity_mps2: f64,
    /// Error of gravity, m/s², navigation frame.
    frame: Option<Block<3>>,
    hidden: Option<Block<3>>,
    last: Option<(Vector3<f64>, Vector3<f64>)>,
    rest: RestSums,
}

impl Gyroscope {
    fn claim(layout: &mut Layout, settings: &Settings, hidden: Option<Block<3>>) -> Self {
        let errors = settings.errors;
        // Fixes and turns of a vehicle show the matrices.
        let in_vehicle = settings.vehicle.is_some();
        let role = if in_vehicle { Role::Estimated } else { Role::Considered };
        Self {
            blocks: StrapdownBlocks::claim(layout, &errors).consider(layout, &errors, role),
            errors,
            gravity_mps2: settings.gravity_mps2,
            frame: layout.claim_unknown(Role::Estimated, settings.frame_mps2),
            hidden,
            last: None,
            rest: RestSums::default(),
        }
    }
}

impl Model for Gyroscope {
    fn boxed(&self) -> Box<dyn Model> {
        Box::new(self.clone())
    }

    fn hidden_velocity(&self) -> Option<Block<3>> {
        self.hidden
    }

    fn is_measured(&self, sample: &Sample) -> bool {
        sample.rate_rad_s.is_some()
    }

    fn step(
        &mut self,
        filter: &mut Filter,
        sample: &Sample,
        at_rest: bool,
        magnetometer: Option<&Magnetometer>,
    ) -> Option<Vector3<f64>> {
        let step_s = sample.step_s;
        if !at_rest {
            self.rest = RestSums::default();
        }
        let Some(rate) = sample.rate_rad_s else {
            return sample.field_ut;
        };
        if at_rest {
            self.rest.push(&sample.force_mps2, &rate, step_s);
        }
        let now = (sample.force_mps2, rate);
        let before = self.last.replace(now).unwrap_or(now);
        let strapdown = Strapdown {
            blocks: &self.blocks,
            errors: &self.errors,
            gravity_mps2: self.gravity_mps2,
            force_mps2: (before.0 + now.0) * 0.5,
            rate_rad_s: (before.1 + now.1) * 0.5,
            step_s,
        };
        let frame = self.frame.map(|block| AccelerationOffset { block, step_s });
        let field = magnetometer.map(|magnetometer| magnetometer.step(step_s));
        filter.predict(&((strapdown, frame), field));
        sample.field_ut
    }

    fn interrupt(&mut self) -> f64 {
        self.last = None;
        self.rest = RestSums::default();
        0.0
    }

    /// The disturbance is correlated over shorter times.
    fn field_interval_s(&self) -> f64 {
        0.1
    }

    /// The heading: gyroscope and rests know the tilt better.
    fn update_field(&self, filter: &mut Filter, reading: &MagneticField<'_>) -> Innovation {
        let vector = filter.test(reading);
        if !vector.accepted {
            return vector;
        }
        let (bias, disturbance) = (self.blocks.gyroscope_bias, reading.sensor.disturbance);
        let estimated = |state: usize| {
            HEADING.contains(state) || bias.contains(state) || disturbance.contains(state)
        };
        filter.update_only(estimated, &FieldHeading(reading))
    }

    fn zero_rate(&mut self) -> Option<Known<3>> {
        let (value, deviation) = self.rest.mean_rate()?;
        self.rest = RestSums::default();
        Some(Known { block: self.blocks.gyroscope_bias, value, deviation: [deviation; 3] })
    }

    fn gravity(&self, filter: &Filter, deviation_mps2: f64) -> Option<Innovation> {
        let gravity = Gravity {
            force_mps2: self.rest.force / self.rest.count.max(1.0),
            blocks: &self.blocks,
            gravity_mps2: self.gravity_mps2,
            deviation_mps2,
        };
        (self.rest.count > 0.0).then(|| filter.test(&gravity))
    }

    fn angular_rate(&self, state: &State) -> Vector3<f64> {
        let measured = self.last.map_or_else(Vector3::zeros, |(_, rate)| rate);
        measured - state.get(self.blocks.gyroscope_bias)
    }

    fn recovered(&self) -> Block<3> {
        self.blocks.gyroscope_bias
    }

    fn calibrated(&self) -> Option<(Block<3>, Block<9>)> {
        Some((self.blocks.accelerometer_bias, self.blocks.accelerometer_matrix?))
    }
}

/// Samples are averaged to this interval, s: at least twice the bandwidth of a hand's motion.
const STEP_S: f64 = 0.02;
/// Steps over which the direction of the magnetic field is differenced, and steps averaged at both ends: 0.3 s and 0.14 s,
/// as in reference/estimator.
const TURN_STEPS: usize = 21;
const TURN_MEAN: usize = 7;

/// Mean square of a signal over a short and a long time; the larger counts.
#[derive(Clone, Copy, Debug, Default)]
struct Level {
    short: f64,
    long: f64,
}

impl Level {
    fn push(&mut self, square: f64, step_s: f64) {
        let weight = |time_s: f64| 1.0 - libm::exp(-step_s / time_s);
        self.short += (square - self.short) * weight(SHORT_S);
        self.long += (square - self.long) * weight(LONG_S);
    }

    fn rms(&self) -> f64 {
        libm::sqrt(self.short.max(self.long))
    }
}

/// Time constants of the mean squares, s: a gesture, and half the window of reference/estimator.
const SHORT_S: f64 = 0.5;
const LONG_S: f64 = 5.0;
/// Deviation of the acceleration over the RMS of |f| − g, and of the angular rate over that of the field's turning rate:
/// each sees part of the motion only. Chosen on BROAD (score_navigation).
const ACCELERATION_FACTOR: f64 = 1.8;
const RATE_FACTOR: f64 = 2.0;
/// Smallest deviations, m/s² and rad/s.
const LEAST_ACCELERATION: f64 = 0.05;
const LEAST_RATE: f64 = 0.02;
/// The same where no field shows a rotation. Assumed, not fitted; scored by `wimu-scores --only accelerometer`.
const HIDDEN_RATE: f64 = 0.2;
/// Noise of a sample of the accelerometer, m/s², that the model of the motion does not follow.
const FORCE_NOISE: f64 = 0.05;

/// Sums of the samples of a step.
#[derive(Clone, Copy, Debug, Default)]
struct Group {
    count: f64,
    time_s: f64,
    force: Vector3<f64>,
    fields: f64,
    field: Vector3<f64>,
}

/// Angular rate and acceleration are states.
#[derive(Clone, Debug)]
struct NoGyroscope {
    blocks: CarriedBlocks,
    bias: Block<3>,
    bias_walk: f64,
    least_rate_rad_s: f64,
    gravity_mps2: f64,
    /// Mean |f| of the start, m/s².
    rest_mps2: f64,
    group: Group,
    acceleration: Level,
    rate: Level,
    directions: heapless::Deque<Vector3<f64>, TURN_STEPS>,
}

impl NoGyroscope {
    /// Deviations of the process noise from the last samples.
    fn learn(&mut self, force: &Vector3<f64>, field: Option<&Vector3<f64>>, step_s: f64) {
        let excess = force.norm() - self.rest_mps2;
        self.acceleration.push(excess * excess, step_s);
        let Some(direction) = field.and_then(|field| field.try_normalize(1e-3)) else {
            return;
        };
        if self.directions.is_full() {
            self.directions.pop_front();
        }
        let _ = self.directions.push_back(direction);
        if self.directions.is_full() {
            let mean = |first: usize| {
                let part = self.directions.iter().skip(first).take(TURN_MEAN);
                part.sum::<Vector3<f64>>() / (TURN_MEAN as f64)
            };
            let over_s = step_s * ((TURN_STEPS - TURN_MEAN) as f64);
            let turned: Vector3<f64> = (mean(TURN_STEPS - TURN_MEAN) - mean(0)) / over_s;
            // A fixed field shows two of three components.
            self.rate.push(turned.norm_squared() * 0.5, step_s);
        }
    }
}

impl NoGyroscope {
    fn claim(
        layout: &mut Layout,
        settings: &Settings,
        start: &Start,
        hidden: Option<Block<3>>,
    ) -> Self {
        let blocks =
            CarriedBlocks { constant_velocity: hidden, ..CarriedBlocks::claim(layout, 0.05, 0.3) };
        Self {
            blocks,
            bias: layout.claim(Role::Estimated, [settings.errors.accelerometer_bias; 3]),
            bias_walk: settings.errors.accelerometer_bias_walk,
            least_rate_rad_s: if start.field_ut.is_some() { LEAST_RATE } else { HIDDEN_RATE },
            gravity_mps2: settings.gravity_mps2,
            rest_mps2: start.force_mps2,
            group: Group::default(),
            acceleration: Level::default(),
            rate: Level::default(),
            directions: heapless::Deque::new(),
        }
    }
}

/// A rest has no constant velocity of its own: the oscillator is at rest, and the constant velocity moves it. The magnetic
/// field is used at every step, all of it: nothing else measures the rotation.
impl Model for NoGyroscope {
    fn boxed(&self) -> Box<dyn Model> {
        Box::new(self.clone())
    }

    fn is_measured(&self, _: &Sample) -> bool {
        true
    }

    fn step(
        &mut self,
        filter: &mut Filter,
        sample: &Sample,
        at_rest: bool,
        magnetometer: Option<&Magnetometer>,
    ) -> Option<Vector3<f64>> {
        self.group.count += 1.0;
        self.group.time_s += sample.step_s;
        self.group.force += sample.force_mps2;
        if let Some(field) = sample.field_ut {
            self.group.field += field;
            self.group.fields += 1.0;
        }
        if self.group.time_s + sample.step_s * 0.5 < STEP_S {
            return None;
        }
        let group = core::mem::take(&mut self.group);
        let force = group.force / group.count;
        let field = (group.fields > 0.0).then(|| group.field / group.fields);
        self.learn(&force, field.as_ref(), group.time_s);

        let carried = Carried {
            blocks: &self.blocks,
            acceleration_mps2: (self.acceleration.rms() * ACCELERATION_FACTOR)
                .max(LEAST_ACCELERATION),
            rate_rad_s: (self.rate.rms() * RATE_FACTOR).max(self.least_rate_rad_s),
            at_rest,
            step_s: group.time_s,
        };
        let walk = RandomWalk { block: self.bias, density: self.bias_walk, step_s: group.time_s };
        let field_step = magnetometer.map(|magnetometer| magnetometer.step(group.time_s));
        filter.predict(&((carried, walk), field_step));
        let reading = SpecificForce {
            force_mps2: force,
            acceleration: self.blocks.acceleration,
            bias: self.bias,
            gravity_mps2: self.gravity_mps2,
            deviation_mps2: FORCE_NOISE / libm::sqrt(group.count),
        };
        filter.update(&reading, Gate::Open);
        field
    }

    fn interrupt(&mut self) -> f64 {
        self.directions.clear();
        core::mem::take(&mut self.group).time_s
    }

    fn angular_rate(&self, state: &State) -> Vector3<f64> {
        state.get(self.blocks.angular_rate)
    }

    fn recovered(&self) -> Block<3> {
        self.blocks.angular_rate
    }

    fn acceleration(&self) -> Option<Block<3>> {
        Some(self.blocks.acceleration)
    }
}
