//! Models of the motion: with and without a gyroscope.

use nalgebra::{RealField, Vector3};

use super::{Sample, Settings, Start};
use crate::filter::{Filter, Gate};
use crate::process::{
    Carried, CarriedBlocks, ImuErrors, RandomWalk, Strapdown, StrapdownBlocks, Unmeasured,
};
use crate::rotation::real;
use crate::sensor::{Magnetometer, SpecificForce, ZeroAngularRate};
use crate::smoother::Recorder;
use crate::state::{Block, Layout, LayoutFull, Role, State};

/// How a navigator predicts from one sample to the next.
pub trait Model<R, const N: usize>: Sized {
    /// Claims its states.
    ///
    /// # Errors
    /// [`LayoutFull`].
    fn claim(
        layout: &mut Layout<R, N>,
        settings: &Settings<R>,
        start: &Start<R>,
    ) -> Result<Self, LayoutFull>;

    /// Predicts to a sample, and returns the reading of the magnetometer there, µT, body frame.
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

    /// Zero angular rate at a rest; `None` where it is not measured.
    fn zero_rate(&self) -> Option<ZeroAngularRate<R>>;

    /// Angular rate, rad/s, body frame.
    fn angular_rate(&self, state: &State<R, N>) -> Vector3<R>;

    /// The states of rotation whose covariance is scaled, with attitude, velocity and position, at a rest that fails its
    /// test.
    fn recovered(&self) -> Block<3>;

    /// Acceleration in the navigation frame, where it is a state.
    fn acceleration(&self) -> Option<Block<3>> {
        None
    }
}

/// Angular rate at a rest, rad/s, a component: noise of a sample, and rotation that the detector does not see.
const REST_RATE: f64 = 0.01;

/// Strapdown integration of a gyroscope's angular rate.
#[derive(Clone, Debug)]
pub struct Gyroscope<R> {
    blocks: StrapdownBlocks,
    errors: ImuErrors<R>,
    gravity_mps2: R,
    last: Option<(Vector3<R>, Vector3<R>)>,
}

impl<R: RealField + Copy, const N: usize> Model<R, N> for Gyroscope<R> {
    fn claim(
        layout: &mut Layout<R, N>,
        settings: &Settings<R>,
        _: &Start<R>,
    ) -> Result<Self, LayoutFull> {
        let errors = settings.errors;
        let blocks = StrapdownBlocks::claim(layout, &errors)?.consider(layout, &errors)?;
        Ok(Self {
            blocks,
            errors,
            gravity_mps2: settings.gravity_mps2,
            last: None,
        })
    }

    fn step(
        &mut self,
        filter: &mut Filter<R, N>,
        sample: &Sample<R>,
        _: bool,
        magnetometer: &Magnetometer<R>,
        recorder: &mut impl Recorder<R, N>,
    ) -> Option<Vector3<R>> {
        let step_s = sample.step_s;
        let Some(rate) = sample.rate_rad_s else {
            self.last = None;
            let gap = (Unmeasured { step_s }, magnetometer.step(step_s));
            filter.predict_recorded(&gap, recorder);
            return sample.field_ut;
        };
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
        R::zero()
    }

    /// The disturbance is correlated over shorter times.
    fn field_interval_s(&self) -> R {
        real(0.1)
    }

    fn zero_rate(&self) -> Option<ZeroAngularRate<R>> {
        let (_, rate_rad_s) = self.last?;
        let deviation_rad_s = real(REST_RATE);
        Some(ZeroAngularRate {
            rate_rad_s,
            bias: self.blocks.gyroscope_bias,
            deviation_rad_s,
        })
    }

    fn angular_rate(&self, state: &State<R, N>) -> Vector3<R> {
        let measured = self.last.map_or_else(Vector3::zeros, |(_, rate)| rate);
        measured - state.get(self.blocks.gyroscope_bias)
    }

    fn recovered(&self) -> Block<3> {
        self.blocks.gyroscope_bias
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
    ) -> Result<Self, LayoutFull> {
        let blocks = CarriedBlocks::claim(layout, real(0.05), real(0.3))?;
        let bias = layout.claim(Role::Estimated, [settings.errors.accelerometer_bias; 3])?;
        let level = Level {
            short: R::zero(),
            long: R::zero(),
        };
        Ok(Self {
            blocks,
            bias,
            bias_walk: settings.errors.accelerometer_bias_walk,
            gravity_mps2: settings.gravity_mps2,
            rest_mps2: start.force_mps2,
            group: Group::empty(),
            acceleration: level,
            rate: level,
            directions: heapless::Deque::new(),
        })
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
            rate_rad_s: (self.rate.rms() * real(RATE_FACTOR)).max(real(LEAST_RATE)),
            at_rest,
            step_s: group.time_s,
        };
        let walk = RandomWalk {
            block: self.bias,
            density: self.bias_walk,
            step_s: group.time_s,
        };
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

    fn zero_rate(&self) -> Option<ZeroAngularRate<R>> {
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
