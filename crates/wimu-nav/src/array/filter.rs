//! Inertial navigation with an array alone: equations (71) to (76) and (96) to (98), (104), (105).

mod candidates;
mod errors;
mod predict;
mod rest;
mod state;

use core::fmt;

use errors::{Strayed, Swing};
pub use state::ArrayState;

use super::geometry::{Geometry, GeometryError};
use super::hypothesis::{Hypothesis, POSITION, STATES, VELOCITY, r};
use super::monitor::{Array, Dropped};
use super::solver::{ArraySolver, Linear};
use crate::unseen::Unseen;
use crate::{Real, Zupt};

/// Hypotheses kept from sample to sample.
const MOST: usize = 4;
/// Samples over which the excess is remembered.
const EXCESS_SAMPLES: f64 = 5.0;
/// A pause longer than this is a gap: what happened in it is not known.
const GAP_S: f64 = 0.25;

/// How an array is used.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ArrayConfig {
    /// Local gravity, m/s².
    pub gravity_mps2: f64,
    /// What a stillness is taken for: zero velocity and zero angular rate. Accelerometers cannot tell it from uniform
    /// motion, nor an array from a slow turn about the vertical.
    pub zupt: Zupt,
    /// Output at which an axis saturates, m/s².
    pub range_mps2: f64,
    /// Standard deviation of each axis's bias, m/s².
    pub bias_mps2: f64,
    /// Standard deviation of the bias that all sensors share, m/s², on each axis of the body besides: where what the
    /// sensors differ by at rest was taken off them, their mean bias is left.
    pub common_bias_mps2: f64,
    /// Random walk of the biases, m/s² per √s.
    pub bias_walk: f64,
    /// Standard deviation of each axis's sensitivity, as a share, and of its direction, rad: as the body turns, this
    /// share of what gravity changes by becomes a bias.
    pub scale: f64,
    /// The same of the error that all sensors share besides: of what their mean shows.
    pub common_scale: f64,
    /// How well each place is known, m, along each axis.
    pub place_sd_m: f64,
    /// How well the times of the sensors among each other are known, s.
    pub delay_sd_s: f64,
    /// Error of s that the outputs do not show (scale, vibration), m/s² in each sample.
    pub force_noise_mps2: f64,
    /// How well the time is known to which a sample belongs, s: a chip's low pass delays it by 1 to 2 ms.
    pub time_sd_s: f64,
}

impl Default for ArrayConfig {
    fn default() -> Self {
        Self {
            gravity_mps2: 9.80665,
            zupt: Zupt::Assumed,
            range_mps2: 155.0,
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

/// What was wrong with a sample. The filter goes on.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub enum ArrayFault {
    /// Too few sensors are left for ω̇ and s: the angular rate is carried on, the position is not
    /// valid until the next rest.
    Blind(GeometryError),
    /// Time went back, stood still or is not finite: the sample was left out.
    NoTime,
    /// Longer than 0.25 s since the sample before: the position is not valid until the next rest.
    Gap,
}

impl fmt::Display for ArrayFault {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Blind(why) => write!(out, "too few sensors can be used: {why}"),
            Self::NoTime => {
                out.write_str("time did not go on: the sample was left out; check its time")
            }
            Self::Gap => out.write_str(
                "no sample for 0.25 s: the position is not valid until the body rests again",
            ),
        }
    }
}

impl core::error::Error for ArrayFault {}

/// Second moments of an even turn about the vertical that no rest would have shown: of its rate, (rad/s)², of what it
/// turned by, rad², and of that with the way that is off by it, m rad.
#[derive(Clone, Copy, Debug, Default)]
struct HiddenTurn {
    rate2: f64,
    both: f64,
    angle2: f64,
    way: [f64; 3],
}

/// With ZUPT off: what a rate that may be none turns the attitude by, rad, and speed, m/s, and way, m, that this brings.
#[derive(Clone, Copy, Debug, Default)]
struct Wandered {
    angle: f64,
    speed: f64,
    way: f64,
}

/// The filter of one array: ω, ω̇, attitude, velocity, position and biases, with every root of ω kept
/// as a hypothesis of its own until the data decide.
///
/// About 32 kB in f64 and 17 kB in f32, and twice that on the stack while it works: for a host or a
/// large microcontroller.
///
/// ```
/// use wimu_nav::array::{ArrayConfig, ArrayFilter, Geometry};
///
/// let board = Geometry::eight_triads_board(0.02, 0.005, 0.01)?;
/// let mut filter = ArrayFilter::<f32, 24>::new(board, ArrayConfig::default())?;
/// // At rest, z up.
/// for k in 0..200 {
///     let noise = if k % 2 == 0 { 0.01 } else { -0.01 };
///     let sample = core::array::from_fn(|axis| if axis % 3 == 2 { 9.80665 + noise } else { noise });
///     filter.push(0.01, &sample).unwrap();
/// }
/// let state = filter.state();
/// assert!(state.valid && state.resting && state.position_sd_m() < 0.05);
/// # Ok::<(), wimu_nav::array::GeometryError>(())
/// ```
#[derive(Clone, Debug)]
pub struct ArrayFilter<R, const M: usize> {
    config: ArrayConfig,
    array: Array<R, M>,
    hypotheses: [Option<Hypothesis<R>>; MOST],
    /// Sensors left out when the biases were last begun.
    dropped: Dropped,
    excess: f64,
    /// Mean square of ω̇.
    activity: f64,
    /// The output before, and the mean square of what an output changes by, (m/s² per s)².
    last: Option<[R; M]>,
    jerk: f64,
    swing: Swing<R>,
    align: ([R; 3], f64, f64, f64),
    /// s low-passed, what the last sample is away from it, and the mean since it is quiet, of so much.
    slow_force: [R; 3],
    away: [R; 3],
    quiet_mean: [R; 3],
    mean_s: f64,
    settled: [R; 3],
    quiet_s: f64,
    /// The last step, s.
    step_s: f64,
    since_rest_s: f64,
    strayed: Strayed,
    unseen: Unseen<R>,
    /// Velocity as a rest began, and the way that was taken off with it since, m/s and m.
    taken_off: ([R; 3], [R; 3]),
    hidden_turn: HiddenTurn,
    wandered: Wandered,
    started: bool,
    valid: bool,
    /// It began without a rest, and none has come yet.
    moving_start: bool,
    /// It began with a rest, and that lasts.
    still_start: bool,
    /// How long it rests by now, and the mean square of the speed at which it may move evenly instead, where
    /// that is likely.
    rested_s: f64,
    doubt_mps2: f64,
    unseen_mps: f64,
    doubtful: u32,
    astray: u32,
    /// What the last sample says of the covariance: 1, or more where it fits badly.
    surprise: f64,
}

impl<R: Real, const M: usize> ArrayFilter<R, M> {
    /// A filter that has seen nothing.
    ///
    /// # Errors
    /// As [`Array::new`].
    pub fn new(geometry: Geometry<M>, config: ArrayConfig) -> Result<Self, GeometryError> {
        Ok(Self {
            array: Array::new(geometry, r(config.range_mps2))?,
            config,
            hypotheses: [None; MOST],
            dropped: Dropped::default(),
            excess: 1.0,
            activity: 0.0,
            last: None,
            jerk: 0.0,
            swing: Swing::at([R::default(); 3]),
            align: ([R::default(); 3], 0.0, 0.0, 0.0),
            slow_force: [R::default(); 3],
            away: [R::default(); 3],
            quiet_mean: [R::default(); 3],
            mean_s: 0.0,
            settled: [R::default(); 3],
            step_s: 0.0,
            quiet_s: 0.0,
            since_rest_s: 0.0,
            strayed: Strayed::default(),
            unseen: Unseen::default(),
            taken_off: ([R::default(); 3], [R::default(); 3]),
            hidden_turn: HiddenTurn::default(),
            wandered: Wandered::default(),
            started: false,
            valid: false,
            moving_start: false,
            still_start: false,
            rested_s: 0.0,
            doubt_mps2: 0.0,
            unseen_mps: 0.0,
            doubtful: 0,
            astray: 0,
            surprise: 1.0,
        })
    }

    /// The solver of the sensors that are in use now.
    pub fn solver(&self) -> &ArraySolver<R, M> {
        self.array.solver()
    }

    /// Takes one sample: the outputs of all axes, m/s², `step_s` seconds after the one before.
    /// Returns the sensors that were left out.
    ///
    /// # Errors
    /// [`ArrayFault`].
    pub fn push(&mut self, step_s: f64, output_mps2: &[R; M]) -> Result<Dropped, ArrayFault> {
        let late = self.started && step_s <= 0.0;
        if !step_s.is_finite() || step_s < 0.0 || late {
            return Err(ArrayFault::NoTime);
        }
        self.started = true;
        let gap = step_s > GAP_S;
        self.since_rest_s += step_s;
        let step = step_s.min(GAP_S);
        let reduced = self.array.reduce(output_mps2);
        if gap {
            self.pause(step_s);
        }
        match reduced {
            Ok((linear, dropped)) => {
                if dropped != self.dropped {
                    self.dropped = dropped;
                    self.forget_biases();
                }
                self.take(step, output_mps2, &linear);
                if gap {
                    return Err(ArrayFault::Gap);
                }
                Ok(dropped)
            }
            Err(why) => {
                self.valid = false;
                self.quiet_s = 0.0;
                self.carry(step);
                Err(ArrayFault::Blind(why))
            }
        }
    }

    fn take(&mut self, step: f64, output: &[R; M], linear: &Linear<R>) {
        self.step_s = step;
        // Centripetal acceleration is nothing where a rest is looked for.
        let force = [linear.theta[3], linear.theta[4], linear.theta[5]];
        self.judge_rest(step, force, linear);
        let noise = self.weigh(step, output, linear);
        if self.hypotheses[0].is_none() {
            self.align_with(step, force);
            return;
        }
        if self.moving_start && self.resting() {
            self.begin_at_rest();
        }
        let swung = self.swung(force);
        self.predict(step, &noise, swung);
        self.update(linear, &noise);
        for hypothesis in self.hypotheses.iter_mut().flatten() {
            hypothesis.advance(step, linear, self.array.solver(), &noise, &self.config);
        }
        self.stray(step);
        self.hide(step);
        if self.resting() && self.config.zupt.is_on() {
            self.doubt_rest(step);
            self.rest(step);
            self.strayed = Strayed::default();
        } else {
            self.rested_s = 0.0;
            self.doubt_mps2 = 0.0;
            // The alignment lasts as long as the stillness that it began in: of velocity that says nothing more.
            self.still_start &= self.resting();
            if self.still_start {
                self.measure_rest(step, false);
                self.strayed = Strayed::default();
            }
        }
        self.merge();
    }

    /// Sets position (m), velocity (m/s) and their standard deviations from outside.
    pub fn set_start(&mut self, position_m: [R; 3], velocity_mps: [R; 3], sd: [f64; 2]) {
        for hypothesis in self.hypotheses.iter_mut().flatten() {
            for i in 0..3 {
                let pairs = [
                    (POSITION, position_m, sd[0]),
                    (VELOCITY, velocity_mps, sd[1]),
                ];
                for (at, value, sd) in pairs {
                    for k in 0..STATES {
                        hypothesis.cov[at + i][k] = R::default();
                        hypothesis.cov[k][at + i] = R::default();
                    }
                    hypothesis.mean[at + i] = value[i];
                    hypothesis.cov[at + i][at + i] = r(sd * sd);
                }
            }
        }
        self.since_rest_s = 0.0;
    }

    /// To be called where what the sensors differ by at a rest was just taken off them: the biases of ω̇ and z begin
    /// anew.
    pub fn residual_biases_taken_off(&mut self) {
        for hypothesis in self.hypotheses.iter_mut().flatten() {
            hypothesis.begin_biases(self.array.solver(), &self.config, false);
        }
        self.swing = Swing::at(self.slow_force);
    }
}
