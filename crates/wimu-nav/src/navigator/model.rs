//! Models of the motion: with and without a gyroscope.

use nalgebra::{RealField, Vector3};

use super::{Sample, Settings, Start};
use crate::filter::{Filter, Gate, Innovation};
use crate::process::{Carried, CarriedBlocks, ImuErrors, RandomWalk, Strapdown, StrapdownBlocks};
use crate::rotation::real;
use crate::sensor::{
    FieldHeading, Gravity, MagneticField, Magnetometer, SpecificForce, ZeroAngularRate,
};
use crate::smoother::Recorder;
use crate::state::{Block, HEADING, Layout, LayoutFull, Role, State};

/// How a navigator predicts from one sample to the next.
pub trait Model<R, const N: usize>: Sized {
    /// Claims its states. `hidden` is a constant velocity that rests do not show.
    ///
    /// # Errors
    /// [`LayoutFull`].
    fn claim(
        layout: &mut Layout<R, N>,
        settings: &Settings<R>,
        start: &Start<R>,
        hidden: Option<Block<3>>,
    ) -> Result<Self, LayoutFull>;

    /// The constant velocity that a rest has in place of zero.
    fn hidden_velocity(&self) -> Option<Block<3>>;

    /// Whether a sample has what predicts the motion.
    fn is_measured(&self, sample: &Sample<R>) -> bool;

    /// Predicts to a sample that is measured, and returns the reading of the magnetometer there, µT, body frame.
    fn step(
        &mut self,
        filter: &mut Filter<R, N>,
        sample: &Sample<R>,
        at_rest: bool,
        magnetometer: &Magnetometer<R>,
        recorder: &mut impl Recorder<R, N>,
    ) -> Option<Vector3<R>>;

    /// Forgets the last samples, as time without a usable sample follows. Returns the time since the last prediction, s.
    fn interrupt(&mut self) -> R;

    /// Shortest interval of the magnetometer's updates, s.
    fn field_interval_s(&self) -> R;

    /// Updates with a reading of the magnetometer, if it fits.
    fn update_field(
        &self,
        filter: &mut Filter<R, N>,
        reading: &MagneticField<'_, R>,
        recorder: &mut impl Recorder<R, N>,
    ) -> Innovation<R>;

    /// Zero angular rate over the rest since the last one; `None` where it is not measured, or the rest is too short.
    fn zero_rate(&mut self) -> Option<ZeroAngularRate<R>>;

    /// Test of the specific force of the rest against gravity, with a deviation of the acceleration, m/s², a component;
    /// `None` where the acceleration is a state. A short window does not show that the unit accelerates.
    fn gravity(&self, filter: &Filter<R, N>, deviation_mps2: R) -> Option<Innovation<R>> {
        let _ = (filter, deviation_mps2);
        None
    }

    /// Angular rate, rad/s, body frame.
    fn angular_rate(&self, state: &State<R, N>) -> Vector3<R>;

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

/// Smallest deviation of the mean angular rate over part of a rest, rad/s: resolution of a sensor of 16 bits.
const LEAST_REST_RATE: f64 = 1e-3;

/// Least time of rest that tells an angular rate of zero, s: of fewer samples the mean is that of an engine's vibration,
/// and its deviation is found from the same samples. Of a drive with fixes, 188 of 240 were rejected without it, and 6 with
/// it (`vehicle/gnss_imu_drive`, 22.5 to 82.5 s).
const LEAST_REST_S: f64 = 0.2;

/// Sums of a rest since the last update there.
#[derive(Clone, Copy, Debug)]
struct RestSums<R> {
    count: R,
    time_s: R,
    force: Vector3<R>,
    rate: Vector3<R>,
    squares: R,
}

impl<R: RealField + Copy> RestSums<R> {
    fn none() -> Self {
        Self {
            count: R::zero(),
            time_s: R::zero(),
            force: Vector3::zeros(),
            rate: Vector3::zeros(),
            squares: R::zero(),
        }
    }

    fn push(&mut self, force: &Vector3<R>, rate: &Vector3<R>, step_s: R) {
        self.count += R::one();
        self.time_s += step_s;
        self.force += force;
        self.rate += rate;
        self.squares += rate.norm_squared();
    }

    /// Mean, and deviation of a sample: the rotation of a hand's rest lasts as long as the rest between two updates.
    fn mean_rate(&self) -> Option<(Vector3<R>, R)> {
        if self.time_s < real(LEAST_REST_S) {
            return None;
        }
        let mean = self.rate / self.count;
        let variance = (self.squares / self.count - mean.norm_squared()) / real(3.0);
        let least = real::<R>(LEAST_REST_RATE);
        Some((mean, variance.max(least * least).sqrt()))
    }
}

/// Strapdown integration of a gyroscope's angular rate.
#[derive(Clone, Debug)]
pub struct Gyroscope<R> {
    blocks: StrapdownBlocks,
    errors: ImuErrors<R>,
    gravity_mps2: R,
    hidden: Option<Block<3>>,
    last: Option<(Vector3<R>, Vector3<R>)>,
    rest: RestSums<R>,
}

impl<R: RealField + Copy, const N: usize> Model<R, N> for Gyroscope<R> {
    fn claim(
        layout: &mut Layout<R, N>,
        settings: &Settings<R>,
        _: &Start<R>,
        hidden: Option<Block<3>>,
    ) -> Result<Self, LayoutFull> {
        let errors = settings.errors;
        let role = match settings.vehicle {
            // Fixes and turns show them.
            Some(_) => Role::Estimated,
            None => Role::Considered,
        };
        let blocks = StrapdownBlocks::claim(layout, &errors)?.consider(layout, &errors, role)?;
        Ok(Self {
            blocks,
            errors,
            gravity_mps2: settings.gravity_mps2,
            hidden,
            last: None,
            rest: RestSums::none(),
        })
    }

    fn hidden_velocity(&self) -> Option<Block<3>> {
        self.hidden
    }

    fn is_measured(&self, sample: &Sample<R>) -> bool {
        sample.rate_rad_s.is_some()
    }

    fn step(
        &mut self,
        filter: &mut Filter<R, N>,
        sample: &Sample<R>,
        at_rest: bool,
        magnetometer: &Magnetometer<R>,
        recorder: &mut impl Recorder<R, N>,
    ) -> Option<Vector3<R>> {
        let step_s = sample.step_s;
        if !at_rest {
            self.rest = RestSums::none();
        }
        let Some(rate) = sample.rate_rad_s else {
            return sample.field_ut;
        };
        if at_rest {
            self.rest.push(&sample.force_mps2, &rate, step_s);
        }
        let now = (sample.force_mps2, rate);
        let before = self.last.replace(now).unwrap_or(now);
        let half = real::<R>(0.5);
        let strapdown = Strapdown {
            blocks: &self.blocks,
            errors: &self.errors,
            gravity_mps2: self.gravity_mps2,
            force_mps2: (before.0 + now.0) * half,
            rate_rad_s: (before.1 + now.1) * half,
            step_s,
        };
        filter.predict_recorded(&(strapdown, magnetometer.step(step_s)), recorder);
        sample.field_ut
    }

    fn interrupt(&mut self) -> R {
        self.last = None;
        self.rest = RestSums::none();
        R::zero()
    }

    /// The disturbance is correlated over shorter times.
    fn field_interval_s(&self) -> R {
        real(0.1)
    }

    /// The heading: gyroscope and rests know the tilt better.
    fn update_field(
        &self,
        filter: &mut Filter<R, N>,
        reading: &MagneticField<'_, R>,
        recorder: &mut impl Recorder<R, N>,
    ) -> Innovation<R> {
        let vector = filter.test(reading);
        if !vector.accepted {
            return vector;
        }
        let (bias, disturbance) = (self.blocks.gyroscope_bias, reading.sensor.disturbance);
        let estimated = |state: usize| {
            HEADING.contains(state) || bias.contains(state) || disturbance.contains(state)
        };
        filter.update_only(estimated, &FieldHeading(reading), recorder)
    }

    fn zero_rate(&mut self) -> Option<ZeroAngularRate<R>> {
        let (rate_rad_s, deviation_rad_s) = self.rest.mean_rate()?;
        self.rest = RestSums::none();
        Some(ZeroAngularRate { rate_rad_s, bias: self.blocks.gyroscope_bias, deviation_rad_s })
    }

    fn gravity(&self, filter: &Filter<R, N>, deviation_mps2: R) -> Option<Innovation<R>> {
        let gravity = Gravity {
            force_mps2: self.rest.force / self.rest.count.max(R::one()),
            blocks: &self.blocks,
            gravity_mps2: self.gravity_mps2,
            deviation_mps2,
        };
        (self.rest.count > R::zero()).then(|| filter.test(&gravity))
    }

    fn angular_rate(&self, state: &State<R, N>) -> Vector3<R> {
        let measured = self.last.map_or_else(Vector3::zeros, |(_, rate)| rate);
        measured - state.get(self.blocks.gyroscope_bias)
    }

    fn recovered(&self) -> Block<3> {
        self.blocks.gyroscope_bias
    }

    fn calibrated(&self) -> Option<(Block<3>, Block<9>)> {
        let matrix = self.blocks.considered?.accelerometer_matrix;
        Some((self.blocks.accelerometer_bias, matrix))
    }
}

/// Samples are averaged to this interval, s: at least twice the bandwidth of a hand's motion.
const STEP_S: f64 = 0.02;
/// Steps over which the direction of the magnetic field is differenced, and steps averaged at both ends: 0.3 s and 0.14 s,
/// as in reference/estimator.
const TURN_STEPS: usize = 21;
const TURN_MEAN: usize = 7;

/// Mean square of a signal over a short and a long time; the larger counts.
#[derive(Clone, Copy, Debug)]
struct Level<R> {
    short: R,
    long: R,
}

impl<R: RealField + Copy> Level<R> {
    fn push(&mut self, square: R, step_s: R) {
        let one = real::<R>(1.0);
        let weight = |time_s: f64| one - (-step_s / real(time_s)).exp();
        self.short += (square - self.short) * weight(SHORT_S);
        self.long += (square - self.long) * weight(LONG_S);
    }

    fn rms(&self) -> R {
        self.short.max(self.long).sqrt()
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
#[derive(Clone, Copy, Debug)]
struct Group<R> {
    count: R,
    time_s: R,
    force: Vector3<R>,
    fields: R,
    field: Vector3<R>,
}

impl<R: RealField + Copy> Group<R> {
    fn empty() -> Self {
        let zero = R::zero();
        Self {
            count: zero,
            time_s: zero,
            force: Vector3::zeros(),
            fields: zero,
            field: Vector3::zeros(),
        }
    }
}

/// Angular rate and acceleration are states.
#[derive(Clone, Debug)]
pub struct NoGyroscope<R> {
    blocks: CarriedBlocks,
    bias: Block<3>,
    bias_walk: R,
    least_rate_rad_s: R,
    gravity_mps2: R,
    /// Mean |f| of the start, m/s².
    rest_mps2: R,
    group: Group<R>,
    acceleration: Level<R>,
    rate: Level<R>,
    directions: heapless::Deque<Vector3<R>, TURN_STEPS>,
}

impl<R: RealField + Copy> NoGyroscope<R> {
    /// Deviations of the process noise from the last samples.
    fn learn(&mut self, force: &Vector3<R>, field: Option<&Vector3<R>>, step_s: R) {
        let excess = force.norm() - self.rest_mps2;
        self.acceleration.push(excess * excess, step_s);
        let Some(direction) = field.and_then(|field| field.try_normalize(real(1e-3))) else {
            return;
        };
        if self.directions.is_full() {
            self.directions.pop_front();
        }
        let _ = self.directions.push_back(direction);
        if self.directions.is_full() {
            let mean = |first: usize| {
                let part = self.directions.iter().skip(first).take(TURN_MEAN);
                part.sum::<Vector3<R>>() / real::<R>(TURN_MEAN as f64)
            };
            let over_s = step_s * real::<R>((TURN_STEPS - TURN_MEAN) as f64);
            let turned: Vector3<R> = (mean(TURN_STEPS - TURN_MEAN) - mean(0)) / over_s;
            // A fixed field shows two of three components.
            self.rate.push(turned.norm_squared() * real(0.5), step_s);
        }
    }
}

impl<R: RealField + Copy, const N: usize> Model<R, N> for NoGyroscope<R> {
    fn claim(
        layout: &mut Layout<R, N>,
        settings: &Settings<R>,
        start: &Start<R>,
        hidden: Option<Block<3>>,
    ) -> Result<Self, LayoutFull> {
        let blocks = CarriedBlocks {
            constant_velocity: hidden,
            ..CarriedBlocks::claim(layout, real(0.05), real(0.3))?
        };
        let bias = layout.claim(Role::Estimated, [settings.errors.accelerometer_bias; 3])?;
        let level = Level { short: R::zero(), long: R::zero() };
        Ok(Self {
            blocks,
            bias,
            bias_walk: settings.errors.accelerometer_bias_walk,
            least_rate_rad_s: real(if start.field_ut.is_some() { LEAST_RATE } else { HIDDEN_RATE }),
            gravity_mps2: settings.gravity_mps2,
            rest_mps2: start.force_mps2,
            group: Group::empty(),
            acceleration: level,
            rate: level,
            directions: heapless::Deque::new(),
        })
    }

    /// None: the oscillator is at rest, and the constant velocity moves it.
    fn hidden_velocity(&self) -> Option<Block<3>> {
        None
    }

    fn is_measured(&self, _: &Sample<R>) -> bool {
        true
    }

    fn step(
        &mut self,
        filter: &mut Filter<R, N>,
        sample: &Sample<R>,
        at_rest: bool,
        magnetometer: &Magnetometer<R>,
        recorder: &mut impl Recorder<R, N>,
    ) -> Option<Vector3<R>> {
        self.group.count += R::one();
        self.group.time_s += sample.step_s;
        self.group.force += sample.force_mps2;
        if let Some(field) = sample.field_ut {
            self.group.field += field;
            self.group.fields += R::one();
        }
        if self.group.time_s + sample.step_s * real(0.5) < real(STEP_S) {
            return None;
        }
        let group = core::mem::replace(&mut self.group, Group::empty());
        let force = group.force / group.count;
        let field = (group.fields > R::zero()).then(|| group.field / group.fields);
        self.learn(&force, field.as_ref(), group.time_s);

        let carried = Carried {
            blocks: &self.blocks,
            acceleration_mps2: (self.acceleration.rms() * real(ACCELERATION_FACTOR))
                .max(real(LEAST_ACCELERATION)),
            rate_rad_s: (self.rate.rms() * real(RATE_FACTOR)).max(self.least_rate_rad_s),
            at_rest,
            step_s: group.time_s,
        };
        let walk = RandomWalk { block: self.bias, density: self.bias_walk, step_s: group.time_s };
        let process = ((carried, walk), magnetometer.step(group.time_s));
        filter.predict_recorded(&process, recorder);
        let reading = SpecificForce {
            force_mps2: force,
            acceleration: self.blocks.acceleration,
            bias: self.bias,
            gravity_mps2: self.gravity_mps2,
            deviation_mps2: real::<R>(FORCE_NOISE) / group.count.sqrt(),
        };
        filter.update_recorded(&reading, Gate::Open, recorder);
        field
    }

    fn interrupt(&mut self) -> R {
        self.directions.clear();
        core::mem::replace(&mut self.group, Group::empty()).time_s
    }

    /// Every step: it is the only measurement of the rotation about the vertical.
    fn field_interval_s(&self) -> R {
        R::zero()
    }

    /// All of it: nothing else measures the rotation.
    fn update_field(
        &self,
        filter: &mut Filter<R, N>,
        reading: &MagneticField<'_, R>,
        recorder: &mut impl Recorder<R, N>,
    ) -> Innovation<R> {
        filter.update_recorded(reading, Gate::ChiSquare, recorder)
    }

    fn zero_rate(&mut self) -> Option<ZeroAngularRate<R>> {
        None
    }

    fn angular_rate(&self, state: &State<R, N>) -> Vector3<R> {
        state.get(self.blocks.angular_rate)
    }

    fn recovered(&self) -> Block<3> {
        self.blocks.angular_rate
    }

    fn acceleration(&self) -> Option<Block<3>> {
        Some(self.blocks.acceleration)
    }
}
