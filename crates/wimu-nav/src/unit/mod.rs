//! One unit: position, velocity and attitude from an accelerometer and a magnetometer, or from an
//! angular rate where there is one. Equations (81) to (85) and (89).
//!
//! An accelerometer cannot tell tilt from acceleration. What separates them is that a body that is
//! carried about is not accelerated one way for long, and that the magnetic field turns with the tilt
//! but not with the acceleration. [`UnitFilter`] holds both as states of a Kalman filter, so that its
//! covariance says how well they were told apart. It assumes nothing about position or speed; how
//! strongly, how fast and with how much turning the body moves, and what the sensors' noise is, it
//! learns on the way.

mod anchor;
mod covariance;
mod manner;
mod model;
mod rest;
mod start;
mod turned;

use covariance::{
    ACCELERATION, BIAS, Block, Covariance, FIELD, OMEGA, PHI, POSITION, RISE, STATES, SWING,
    VELOCITY,
};
use manner::{Manner, Swept};
use rest::Quiet;
use turned::Turned;

use crate::Real;
pub use crate::drift::Drift;
use crate::unseen::Unseen;
use crate::vector::{
    Matrix, Vector, add, all_finite, cross, diagonal, dot, product, quaternion, scale, sub, times,
    turn, zero,
};
pub use crate::zupt::Zupt;

/// A sample is apart from its neighbours where the product of both changes is so many times a change's usual square.
const APART: f64 = 25.0;
/// Samples are brought together over so long before the filter looks at them, s: it follows what a
/// hand does, and costs a few operations a sample.
const UPDATE_S: f64 = 0.035;
/// The first attitude is from so much, s, and from what shows whether it rests; where it does not, from the first rest of
/// so much.
const ALIGN_S: f64 = 1.0;
/// Bias of a gyroscope that is not known, rad/s.
const BIAS_RAD_S: f64 = 0.01;
/// A pause longer than this is a gap: what happened in it is not known.
const GAP_S: f64 = 0.25;
/// A shorter one of more than so many usual steps is a hole: samples are missing, or time jumped.
const HOLE_STEPS: f64 = 2.5;

/// How a unit is used.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct UnitConfig {
    /// Local gravity, m/s².
    pub gravity_mps2: f64,
    /// Whether a stillness is taken for zero velocity: an accelerometer cannot tell a rest from even
    /// motion, nor without an angular rate from a steady push. One at which the velocity is known to be another
    /// is not taken for a rest.
    pub zupt: Zupt,
    /// Noise of the mean of 35 ms of force, m/s²; `None`: what the rests show, and 0.05 before the
    /// first.
    pub force_noise_mps2: Option<f64>,
    /// Random walk of the angle from the angular rate, where there is one, rad/√s; `None`: what the
    /// rests show, and 3·10⁻⁴ before the first.
    pub angle_walk: Option<f64>,
    /// How the bias settles after switching on, where that is known. Its C1 is estimated on.
    pub drift: Option<Drift>,
    /// Standard deviation of the accelerometer's bias, m/s²: 0.05 of a calibrated one.
    pub bias_mps2: f64,
}

impl Default for UnitConfig {
    fn default() -> Self {
        Self {
            gravity_mps2: 9.80665,
            zupt: Zupt::Assumed,
            force_noise_mps2: None,
            angle_walk: None,
            drift: None,
            bias_mps2: model::BIAS_MPS2,
        }
    }
}

/// One sample of a unit.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct UnitSample<R = f64> {
    /// Time since the sample before, s.
    pub step_s: R,
    /// Specific force, m/s², body axes.
    pub force_mps2: [R; 3],
    /// Magnetic field, µT, body axes.
    pub field_ut: Option<[R; 3]>,
    /// Angular rate, rad/s, body axes, from a gyroscope or an array: that at the sample's time, as `force_mps2` is.
    pub rate_rad_s: Option<[R; 3]>,
}

/// What was wrong with a sample.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum UnitFault {
    /// A value is not finite: the sample was left out.
    NotFinite,
    /// Time went back or stood still: the sample was left out.
    NoTime,
    /// Longer than 0.25 s since the sample before: position is not valid from here on.
    Gap,
}

impl core::fmt::Display for UnitFault {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str(match self {
            Self::NotFinite => "a value of the sample is no number: the sample was left out",
            Self::NoTime => "the sample is not later than the one before: it was left out",
            Self::Gap => {
                "more than 0.25 s without a sample: hold the unit still for the next start"
            }
        })
    }
}

impl core::error::Error for UnitFault {}

/// Where the unit is, and how well that is known.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct UnitState<R = f64> {
    /// Position, m, east-north-up (east is that of the magnetic field, or body x at the start).
    pub position_m: [R; 3],
    /// Velocity, m/s, east-north-up.
    pub velocity_mps: [R; 3],
    /// Body to navigation axes, W X Y Z.
    pub quaternion: [R; 4],
    /// Angular rate, rad/s, body axes: measured, or estimated.
    pub rate_rad_s: [R; 3],
    /// Covariance of the position, m²; with [`Zupt::Assumed`] that of [`unseen_m`](Self::unseen_m) in it.
    pub position_covariance: [[R; 3]; 3],
    /// Standard deviation of the velocity, m/s; the same.
    pub velocity_sd_mps: [R; 3],
    /// Standard deviation of the attitude about east, north and up, rad.
    pub attitude_sd_rad: [R; 3],
    /// Seconds since velocity was last known to be zero (or given).
    pub since_rest_s: R,
    /// Whether it seems to be at rest now, and nothing that is known speaks against it.
    pub resting: bool,
    /// The speed at which it might be moved evenly at the rest that it is at and that would not show, m/s.
    pub unseen_mps: R,
    /// How far even motion that no rest since the start would have shown may have taken it, one standard deviation
    /// in space, m: equation (103). Zero with [`Zupt::Off`].
    pub unseen_m: R,
    /// Stillnesses, each of a tenth of a second, at which it was known to be pushed.
    pub pushed: u32,
    /// False before the first alignment, until the first rest of a second where it moved then, after a gap until
    /// the next rest, and where the filter diverged: a state that is not finite is never valid.
    pub valid: bool,
    /// Whether it is still at the first rest. Position is measured from where that ends, in the frame in which it rested
    /// there: here it is zero, whatever even motion the rest may be.
    pub at_origin: bool,
    /// Updates of the magnetic field that were left out as disturbed.
    pub disturbed: u32,
    /// Updates at a seeming rest at which the velocity was known not to be zero: even motion.
    pub even: u32,
    /// Times that samples were missing, or time jumped, by more than 2.5 usual steps and less than a gap: doubted as much
    /// as the motion is strong.
    pub holes: u32,
    /// Mean of the squared innovations of gravity, each divided by its expectation (NIS per component),
    /// over the last 3 s of motion: 1 where the covariance is right.
    pub innovation: R,
    /// What was learnt of the bias's rise C1 after switching on, m/s², and its standard deviation; that
    /// of [`UnitConfig::drift`] at first.
    pub rise_mps2: [(R, R); 3],
}

impl<R: Real> UnitState<R> {
    /// Standard deviation of the position in space, m: the root of the sum over the three axes.
    pub fn position_sd_m(&self) -> R {
        let p = &self.position_covariance;
        let sum = p[0][0] + p[1][1] + p[2][2];
        // Rounding may leave it below zero. What is not a number stays so.
        if sum < R::default() {
            R::default()
        } else {
            sum.sqrt()
        }
    }
}

/// The filter of one unit, in f32 or f64.
#[derive(Clone, Debug)]
pub struct UnitFilter<R = f64> {
    config: UnitConfig,
    attitude: Matrix<R>,
    mean: [R; STATES],
    cov: Covariance<R>,
    field: Option<Vector<R>>,
    manner: Manner<R>,
    rate: Vector<R>,
    last_force: Vector<R>,
    apart: Apart<R>,
    group: Group<R>,
    quiet: Quiet<R>,
    age_s: R,
    since_rest_s: R,
    aligned: bool,
    valid: bool,
    /// Position was valid once.
    begun: bool,
    /// It is not any more at the rest from which position is measured.
    moved: bool,
    /// The rest that it seems to be at was not believed.
    doubted: bool,
    /// Its velocity was taken for zero at the last update.
    held: bool,
    /// Deviation of the velocity at the rest's beginning, m/s.
    loose_mps: R,
    unseen: Unseen<R>,
    gyroscope: Gyroscope<R>,
    swept: Swept<R>,
    turned: Turned<R>,
    disturbed: u32,
    even: u32,
    /// The usual step, s.
    usual_s: R,
    holes: u32,
}

/// What is brought together before an update.
#[derive(Clone, Copy, Debug, Default)]
struct Group<R> {
    time_s: R,
    count: R,
    force: Vector<R>,
    square: R,
    /// Σ |Δf|² Δt², and that of samples apart from both their neighbours.
    jumps: R,
    apart: R,
    field: Vector<R>,
    fields: R,
    rated: R,
    /// Σ of the squares of what samples that are missing would have taken, s².
    missing: R,
    /// Σ |Δ²ω|² Δt².
    bends: R,
    /// What it turned by while it was rated, rad, body axes.
    turned: Vector<R>,
}

/// Samples apart from both their neighbours: a knock, or a wrong reading.
#[derive(Clone, Copy, Debug, Default)]
struct Apart<R> {
    /// The last change from sample to sample, m/s², and what its square usually is.
    jump: Vector<R>,
    usual: Option<R>,
}

impl<R: Real> Apart<R> {
    /// Takes the change from the sample before to this one; how far the one before stands apart from both, squared.
    fn see(&mut self, jump: Vector<R>) -> R {
        let back = -dot(jump, self.jump);
        let square = dot(jump, jump);
        self.jump = jump;
        let Some(usual) = &mut self.usual else {
            self.usual = Some(square);
            return R::default();
        };
        let most = R::from_f64(APART) * *usual;
        let near = if square < most { square } else { most };
        *usual += (near - *usual) * R::from_f64(1.0 / 64.0);
        if back > most { back } else { R::default() }
    }
}

/// Whether an angular rate is measured: the state is its bias then, and else the rate.
#[derive(Clone, Copy, Debug, Default)]
struct Gyroscope<R> {
    on: bool,
    /// The last reading and its change, rad/s, and the time since, s.
    last: Vector<R>,
    change: Vector<R>,
    out_s: R,
    /// The bias before it failed, or at the rest that it was aligned at, rad/s, and its variance there.
    bias: Vector<R>,
    bias2: Option<R>,
}

impl<R: Real> UnitFilter<R> {
    /// A filter that has seen nothing.
    pub fn new(config: UnitConfig) -> Self {
        Self {
            config,
            attitude: diagonal(R::from_f64(1.0)),
            mean: [R::default(); STATES],
            cov: Covariance::zero(),
            field: None,
            manner: Manner::default(),
            rate: zero(),
            last_force: zero(),
            apart: Apart::default(),
            group: Group::default(),
            quiet: Quiet::default(),
            age_s: R::default(),
            since_rest_s: R::default(),
            aligned: false,
            valid: false,
            begun: false,
            moved: false,
            doubted: false,
            held: false,
            loose_mps: R::default(),
            unseen: Unseen::default(),
            gyroscope: Gyroscope::default(),
            swept: Swept::default(),
            turned: Turned::default(),
            disturbed: 0,
            even: 0,
            usual_s: R::default(),
            holes: 0,
        }
    }

    /// Takes one sample. A fault is reported, and the filter goes on.
    ///
    /// # Errors
    /// [`UnitFault`].
    pub fn push(&mut self, sample: &UnitSample<R>) -> Result<(), UnitFault> {
        let values = sample
            .force_mps2
            .iter()
            .chain(sample.rate_rad_s.iter().flatten())
            .chain(sample.field_ut.iter().flatten());
        // Beyond 10⁶ of any unit nothing is a measurement, and squares would overflow.
        let most = R::from_f64(1e6);
        if !values.clone().all(|v| v.abs() < most) || !sample.step_s.is_finite() {
            return Err(UnitFault::NotFinite);
        }
        let nothing = R::default();
        if sample.step_s < nothing || (sample.step_s == nothing && self.age_s > nothing) {
            return Err(UnitFault::NoTime);
        }
        let longest = R::from_f64(GAP_S);
        // The usual step follows slowly, and no missing sample.
        if self.usual_s == nothing {
            self.usual_s = sample.step_s;
        }
        let most = R::from_f64(2.0) * self.usual_s;
        let near = if sample.step_s < most {
            sample.step_s
        } else {
            most
        };
        self.usual_s += (near - self.usual_s) * R::from_f64(1.0 / 64.0);
        if sample.step_s > R::from_f64(HOLE_STEPS) * self.usual_s && sample.step_s <= longest {
            let missing = sample.step_s - self.usual_s;
            self.group.missing += missing * missing;
            self.holes = self.holes.saturating_add(1);
        }
        let gap = sample.step_s > longest;
        let step = if gap { longest } else { sample.step_s };
        self.age_s += sample.step_s;
        self.since_rest_s += sample.step_s;
        if gap {
            self.lose(sample.step_s);
        }
        let force = match self.config.drift {
            Some(drift) => sub(
                sample.force_mps2,
                drift.at(self.age_s.to_f64()).map(R::from_f64),
            ),
            None => sample.force_mps2,
        };
        let aligned = self.aligned;
        if aligned {
            self.strapdown(force, sample, step);
        } else {
            self.gather(force, sample, step);
        }
        self.judge(force, sample.rate_rad_s, sample.field_ut, step);
        // A part of a step more: at no usual rate it depends on how times are rounded.
        let lasted = self.group.time_s + step * R::from_f64(0.3);
        if aligned && lasted >= R::from_f64(UPDATE_S) {
            self.update();
        } else if !aligned && lasted >= R::from_f64(ALIGN_S) && self.quiet.is_known() {
            self.align();
        }
        if gap { Err(UnitFault::Gap) } else { Ok(()) }
    }

    /// Says that a sample of this step was left out, as of an angular rate that is missing for a while: what
    /// happened is not known, and position is not valid from here to the next rest.
    pub fn interrupt(&mut self, step_s: R) {
        if step_s >= R::default() && step_s.is_finite() {
            // A sample is not left out at a rest: it moves.
            self.moved = true;
            self.age_s += step_s;
            self.since_rest_s += step_s;
            self.lose(step_s);
        }
    }

    /// Nobody knows what happened in a gap. Before it has moved that costs nothing: all begins anew.
    fn lose(&mut self, step_s: R) {
        self.valid = false;
        if self.begun && !self.moved {
            self.begun = false;
            self.aligned = false;
        }
        self.quiet.lose();
        self.group = Group::default();
        let step = step_s.to_f64();
        for i in 0..3 {
            self.cov.add(PHI, i, R::from_f64(0.25 * step.min(10.0)));
            self.cov.add(VELOCITY, i, R::from_f64(4.0 * step.min(1e3)));
            self.cov.add(POSITION, i, R::from_f64(4.0 * step.min(1e3)));
        }
    }

    fn is_at_origin(&self) -> bool {
        self.begun && self.valid && !self.moved && self.quiet.is_rest()
    }

    fn part(&self, at: Block) -> Vector<R> {
        core::array::from_fn(|i| self.mean[at.0 + i])
    }

    fn put(&mut self, at: Block, value: Vector<R>) {
        for (i, v) in value.into_iter().enumerate() {
            self.mean[at.0 + i] = v;
        }
    }

    /// Attitude, velocity and position over one sample: equation (82).
    fn strapdown(&mut self, force: Vector<R>, sample: &UnitSample<R>, step: R) {
        let before = self.gyroscope;
        let measured = self.measured_rate(sample.rate_rad_s, step);
        let state = self.part(OMEGA);
        let by = match measured {
            Some(rate) => {
                // A rate is that at its time stamp: between two it changes evenly.
                let known = before.on && before.out_s == R::default();
                let last = sub(if known { before.last } else { rate }, state);
                self.rate = sub(rate, state);
                let half = R::from_f64(0.5);
                let mean = scale(add(last, self.rate), half * step);
                let cone = scale(
                    cross(last, self.rate),
                    step * step * R::from_f64(1.0 / 12.0),
                );
                let bend = sub(sub(rate, before.last), before.change);
                if known {
                    self.gyroscope.change = sub(rate, before.last);
                    self.group.bends += dot(bend, bend) * step * step;
                }
                self.group.rated += step;
                self.group.turned = add(self.group.turned, mean);
                add(mean, cone)
            }
            None => {
                self.rate = state;
                scale(state, step)
            }
        };
        self.attitude = product(&self.attitude, &turn(by));
        let gravity = R::from_f64(self.config.gravity_mps2);
        let walk2 = self.angle_walk2();
        self.quiet.carry(measured.map(|_| by), step, walk2, gravity);
        let turned = times(&self.attitude, sub(force, self.part(BIAS)));
        let mut acceleration = turned;
        acceleration[2] -= R::from_f64(self.config.gravity_mps2);
        let half = R::from_f64(0.5);
        let gained = scale(add(acceleration, self.last_force), half * step);
        let velocity = self.part(VELOCITY);
        let moved = scale(add(velocity, scale(gained, half)), step);
        self.put(POSITION, add(self.part(POSITION), moved));
        self.put(VELOCITY, add(velocity, gained));
        let jump = sub(acceleration, self.last_force);
        self.group.jumps += dot(jump, jump) * step * step;
        self.group.apart += self.apart.see(jump) * step * step;
        self.last_force = acceleration;
        self.group.force = add(self.group.force, turned);
        self.group.count += R::from_f64(1.0);
        self.group.time_s += step;
        if let Some(field) = sample.field_ut {
            self.group.field = add(self.group.field, times(&self.attitude, field));
            self.group.fields += R::from_f64(1.0);
        }
    }

    /// The angular rate that is measured, the last one through a short failure. After that the rate is a
    /// state, and when it comes back its bias is again.
    fn measured_rate(&mut self, rate: Option<Vector<R>>, step: R) -> Option<Vector<R>> {
        let nothing = R::default();
        if let Some(rate) = rate {
            if !self.gyroscope.on {
                self.gyroscope.on = true;
                let unknown = R::from_f64(BIAS_RAD_S * BIAS_RAD_S);
                let variance = self.gyroscope.bias2.take().unwrap_or(unknown);
                self.know_rate(self.gyroscope.bias, variance);
            }
            self.gyroscope.last = rate;
            self.gyroscope.out_s = nothing;
            return Some(rate);
        }
        if !self.gyroscope.on {
            return None;
        }
        self.gyroscope.out_s += step;
        let (out, last) = (self.gyroscope.out_s, self.gyroscope.last);
        let usual = self.manner.turn();
        if out > R::from_f64(GAP_S) {
            self.gyroscope.on = false;
            self.gyroscope.bias = self.part(OMEGA);
            self.know_rate(zero(), usual * usual);
            return None;
        }
        // It may have changed by as much as it was.
        let variance = usual * usual + dot(last, last) * R::from_f64(1.0 / 3.0);
        for i in 0..3 {
            self.cov.add(PHI, i, (out + out) * step * variance);
        }
        Some(last)
    }

    /// Makes the state of the angular rate, or of its bias, another one.
    fn know_rate(&mut self, mean: Vector<R>, variance: R) {
        self.put(OMEGA, mean);
        for i in 0..3 {
            self.cov.know(OMEGA.0 + i);
            self.cov.add(OMEGA, i, variance);
        }
    }

    /// Where the unit is now.
    pub fn state(&self) -> UnitState<R> {
        // Position moves on every sample, its covariance with the group that is under way.
        let ahead = self.group.time_s;
        let sd = |at: Block| {
            self.cov
                .variance(at)
                .map(|v| if v > R::default() { v.sqrt() } else { v })
        };
        let (pp, pv, vv) = (
            self.cov.block(POSITION, POSITION),
            self.cov.block(POSITION, VELOCITY),
            self.cov.block(VELOCITY, VELOCITY),
        );
        let unseen = self.unseen.after(ahead);
        let assumed = self.config.zupt == Zupt::Assumed;
        // What a constant matrix of the accelerometer does is no noise: it grows with the way, and rests do not tell it.
        let mut more = self.turned.way2();
        let velocity = self.part(VELOCITY);
        let mut faster = if self.gyroscope.on {
            turned::spread(dot(velocity, velocity))
        } else {
            [R::default(); 3]
        };
        if assumed {
            more = add(more, unseen.way2());
            faster = add(faster, unseen.speed2());
        }
        let position_covariance = core::array::from_fn(|i| {
            core::array::from_fn(|j| {
                let known = pp[i][j] + ahead * (pv[i][j] + pv[j][i]) + ahead * ahead * vv[i][j];
                if i == j { known + more[i] } else { known }
            })
        });
        let speed2 = add(self.cov.variance(VELOCITY), faster);
        let velocity_sd_mps = speed2.map(|v| if v > R::default() { v.sqrt() } else { v });
        let mut state = UnitState {
            position_m: self.part(POSITION),
            velocity_mps: self.part(VELOCITY),
            quaternion: quaternion(&self.attitude),
            rate_rad_s: self.rate,
            position_covariance,
            velocity_sd_mps,
            attitude_sd_rad: sd(PHI),
            since_rest_s: self.since_rest_s,
            resting: self.quiet.is_rest() && !self.doubted,
            unseen_mps: self.unseen_mps(),
            unseen_m: unseen.way_sd_m(),
            pushed: self.quiet.pushed(),
            valid: self.valid,
            at_origin: self.is_at_origin(),
            disturbed: self.disturbed,
            even: self.even,
            holes: self.holes,
            innovation: self.manner.innovation(),
            rise_mps2: self.rise(),
        };
        let means = [state.position_m, state.velocity_mps, state.rate_rad_s];
        let deviations = state
            .position_covariance
            .iter()
            .chain([&state.velocity_sd_mps]);
        let finite = all_finite(self.attitude.iter().chain(&means).chain(deviations));
        state.valid &= finite;
        state.at_origin &= finite;
        state
    }

    fn rise(&self) -> [(R, R); 3] {
        let known = self.config.drift.map_or([0.0; 3], |d| d.rise_mps2);
        let (learnt, variance) = (self.part(RISE), self.cov.variance(RISE));
        core::array::from_fn(|i| (R::from_f64(known[i]) + learnt[i], variance[i].sqrt()))
    }
}
