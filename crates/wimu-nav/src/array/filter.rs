//! Inertial navigation with an array alone: equations (71) to (76) and (96) to (98), (104), (105).

mod errors;
mod rest;

use core::fmt;

use errors::{Strayed, Swing};

use super::geometry::{Geometry, GeometryError};
use super::hypothesis::{
    Candidate, FORCE_BIAS, Hypothesis, MEASURED, Noise, OMEGA, PHI, POSITION, STATES, TURN,
    TURN_BIAS, TURNING, VELOCITY, View, WEIGHT_FREEDOM, Z_BIAS, block, couple, dot, part,
    quaternion, r, scaled_identity,
};
use super::matrix::{product, rotation, times};
use super::monitor::{Array, Dropped};
use super::solver::{ArraySolver, Linear, Roots};
use crate::unseen::Unseen;
use crate::{Real, Zupt};

/// Hypotheses kept from sample to sample.
const MOST: usize = 4;
/// Those that a sample may bring: each one's own, its opposite and all roots of the sample.
const CANDIDATES: usize = MOST * 6;

/// A hypothesis less likely than the best by this factor is given up, as a logarithm.
const GIVEN_UP: f64 = 20.0;

/// χ² from which on no hypothesis can be right, and how far ω may then be from what was thought, rad/s.
const LOST: f64 = 300.0;
const LOST_RATE_RAD_S: f64 = 20.0;
/// Share of the sample's own excess in its noise, the rest is that of the samples before it.
const OWN_SHARE: f64 = 0.8;
/// Samples over which the excess is remembered.
const EXCESS_SAMPLES: f64 = 5.0;
/// An excess up to this is noise, more of it is vibration.
const EXCESS_OF_NOISE: f64 = 2.0;
/// How long the size of ω̇ is remembered, s.
const ACTIVITY_S: f64 = 0.25;
/// ω̇ changes by 4 times its size in √s: a motion is another one after 1/16 s.
const TURN_WALK: f64 = 4.0;
/// A body at rest may begin to turn, rad/s² per √s.
const TURN_WALK_AT_REST: f64 = 20.0;
/// Part of ω̇ that lasts for one sample only.
const TURN_FAST: f64 = 0.2;
/// ω̇ of a vibration, and how far ω strays with it in √s, in units of vibration / arm.
const VIBRATION_TURN: f64 = 1.5;
const VIBRATION_RATE: f64 = 0.2;
/// Noise of ω̇ that is always there, rad/s².
const TURN_NOISE: f64 = 1.0;

/// The part of a hidden turn's variance across the vertical: what holds the array on its circle tilts it.
const ASIDE: f64 = 0.04;

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

/// What is known after a sample. Means and covariances are those of all hypotheses together, each
/// with its probability.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ArrayState<R> {
    /// ω, rad/s, body axes.
    pub rate_rad_s: [R; 3],
    /// Its covariance, (rad/s)². It grows at rest where no ZUPT is made: an array knows nothing of ω
    /// there.
    pub rate_covariance: [[R; 3]; 3],
    /// ω̇ without what lasts for one sample only, rad/s², body axes.
    pub angular_acceleration_rad_s2: [R; 3],
    /// Body to navigation axes (east-north-up; heading is that of the body at the start), W X Y Z.
    pub quaternion: [R; 4],
    /// Covariance of the attitude, turns about east, north and up, rad².
    pub attitude_covariance: [[R; 3]; 3],
    /// Velocity of the sensors' centre, m/s.
    pub velocity_mps: [R; 3],
    /// Its covariance, (m/s)².
    pub velocity_covariance: [[R; 3]; 3],
    /// Position of the sensors' centre, m.
    pub position_m: [R; 3],
    /// Its covariance, m².
    pub position_covariance: [[R; 3]; 3],
    /// Probability of the likeliest hypothesis: 1 where nothing is ambiguous.
    pub certainty: R,
    /// Seconds since velocity was last known to be zero (or given), or since the first sample.
    pub since_rest_s: R,
    /// Whether it is at rest now.
    pub resting: bool,
    /// The fastest even motion that would have looked like the rests, m/s: three standard deviations of the speed before
    /// one was taken for zero velocity.
    pub unseen_mps: R,
    /// How far even motion that no rest would have shown may have taken it, one standard deviation in space, m; it is in
    /// the covariance with [`Zupt::Assumed`]. 0 with ZUPT off.
    pub unseen_m: R,
    /// False before the first alignment, and after a gap or a start in motion until the next rest: position
    /// begins there.
    pub valid: bool,
}

impl<R: Real> ArrayState<R> {
    /// Standard deviation of the position in space, m.
    pub fn position_sd_m(&self) -> R {
        let p = &self.position_covariance;
        (p[0][0] + p[1][1] + p[2][2]).abs().sqrt()
    }
}

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

    /// The angular rates that are still possible, rad/s, each with its probability: the likeliest
    /// first, more than one while the data do not decide.
    pub fn hypotheses(&self) -> impl Iterator<Item = (R, [R; 3])> {
        self.hypotheses
            .iter()
            .flatten()
            .map(|h| (r(libm::exp(h.weight)), part(&h.mean, OMEGA)))
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
        let update = self.array.update(output_mps2);
        if gap {
            self.pause(step_s);
        }
        let linear = match &update {
            Ok(update) => Some(update.linear),
            Err(_) => None,
        };
        if let Ok(update) = &update
            && update.dropped != self.dropped
        {
            self.dropped = update.dropped;
            self.forget_biases();
        }
        match linear {
            Some(linear) => self.take(step, output_mps2, &linear),
            None => {
                self.valid = false;
                self.quiet_s = 0.0;
                self.carry(step);
            }
        }
        match update {
            Err(why) => Err(ArrayFault::Blind(why)),
            Ok(_) if gap => Err(ArrayFault::Gap),
            Ok(update) => Ok(update.dropped),
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
        let scaled = self.scaled(force);
        self.predict(step, &noise, scaled);
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
        }
        self.merge();
    }

    /// The sample's noise from its excess, equation (76), and the size of ω̇.
    fn weigh(&mut self, step: f64, output: &[R; M], linear: &Linear<R>) -> Noise<R> {
        let declared = self.declared(step, output);
        let solver = self.array.solver();
        // Where the sensors do not show their own excess, it is what was declared.
        let own = solver
            .excess(output, linear)
            .map_or_else(
                || 1.0 + declared / solver.variance_mps2().to_f64(),
                |e| e.to_f64(),
            )
            .min(1e9);
        let steadied = OWN_SHARE * own + (1.0 - OWN_SHARE) * self.excess;
        self.excess += (own - self.excess) / EXCESS_SAMPLES;
        let variance = solver.variance_mps2().to_f64();
        let factor = steadied.max(1.0);
        let vibration = variance * (steadied - EXCESS_OF_NOISE).max(0.0);
        let covariance = solver.covariance();
        let [x, y, z, ..] = linear.theta.map(|v| v.to_f64());
        let seen = (x * x + y * y + z * z) / 3.0;
        let noise = (0..3).map(|i| covariance[i][i]).sum::<f64>() / 3.0 * factor;
        let size = (seen - 2.0 * noise).max(0.0);
        self.activity += (size - self.activity) * (step / ACTIVITY_S).min(1.0);
        let arm = solver.arm_m();
        let fast = TURN_NOISE * TURN_NOISE
            + TURN_FAST * TURN_FAST * self.activity
            + VIBRATION_TURN * VIBRATION_TURN * vibration / (arm * arm);
        Noise {
            factor: r(factor),
            fast: r(fast),
            vibration: r(vibration),
        }
    }

    /// What a pause does to what is known.
    fn pause(&mut self, step_s: f64) {
        self.valid = false;
        self.quiet_s = 0.0;
        let step = step_s.min(1e3);
        for hypothesis in self.hypotheses.iter_mut().flatten() {
            for i in 0..3 {
                let mut add = |at: usize, variance: f64| {
                    hypothesis.cov[at + i][at + i] += r(variance);
                };
                add(PHI, 0.25 * step.min(10.0));
                add(VELOCITY, 4.0 * step);
                add(POSITION, 4.0 * step);
                add(OMEGA, 100.0);
                add(TURN, 1e4);
            }
        }
    }

    /// A sample without a usable output: ω goes on as it was.
    fn carry(&mut self, step: f64) {
        self.surprise = 1.0;
        let noise = Noise {
            factor: r(1.0),
            fast: r(1.0),
            vibration: r(self.array.solver().variance_mps2().to_f64() * self.excess),
        };
        self.predict(step, &noise, 0.0);
        for hypothesis in self.hypotheses.iter_mut().flatten() {
            // As little is known of the acceleration as a hand's motion has of it.
            for i in 0..3 {
                let (v, p) = (VELOCITY + i, POSITION + i);
                hypothesis.cov[v][v] += r(2500.0 * step * step);
                hypothesis.mean[p] += hypothesis.mean[v] * r(step);
            }
            couple(
                &mut hypothesis.cov,
                POSITION,
                VELOCITY,
                &scaled_identity(r(step)),
            );
        }
        self.merge();
    }

    /// ω and ω̇ one step ahead, and attitude with them: equation (96).
    fn predict(&mut self, step: f64, noise: &Noise<R>, scaled: f64) {
        let arm = self.array.solver().arm_m();
        let walk = TURN_WALK_AT_REST * TURN_WALK_AT_REST + TURN_WALK * TURN_WALK * self.activity;
        let stray = VIBRATION_RATE * VIBRATION_RATE * noise.vibration.to_f64() / (arm * arm);
        let bias = (self.config.bias_walk * self.config.bias_walk * step + scaled)
            / self.array.solver().variance_mps2().to_f64();
        let rank = self.array.solver().rank();
        let covariance = *self.array.solver().covariance();
        // Sensitivities times 2 g at most.
        let g = self.config.gravity_mps2;
        let most = 4.0 * g * g * self.config.scale * self.config.scale;
        let kept = r::<R>(if most > 0.0 {
            libm::sqrt((1.0 - scaled / most).max(0.0))
        } else {
            1.0
        });
        for hypothesis in self.hypotheses.iter_mut().flatten() {
            let dt = r::<R>(step);
            let half = r::<R>(0.5 * step);
            let turn = part(&hypothesis.mean, TURN);
            let rate = part(&hypothesis.mean, OMEGA);
            let by: [R; 3] = core::array::from_fn(|i| (rate[i] + turn[i] * half) * dt);
            let attitude = hypothesis.attitude;
            hypothesis.attitude = product(&attitude, &rotation(by));
            if kept < r(1.0) {
                hypothesis.forget_part(kept);
            }
            let cov = &mut hypothesis.cov;
            couple(cov, PHI, OMEGA, &attitude.map(|row| row.map(|v| v * dt)));
            couple(
                cov,
                PHI,
                TURN,
                &attitude.map(|row| row.map(|v| v * dt * half)),
            );
            couple(cov, OMEGA, TURN, &scaled_identity(dt));
            for i in 0..3 {
                hypothesis.mean[OMEGA + i] += turn[i] * dt;
                let (w, t) = (OMEGA + i, TURN + i);
                let cube = step * step * step;
                cov[PHI + i][PHI + i] += r(stray * cube / 3.0 + walk * cube * step * step / 20.0);
                cov[w][w] += r(walk * step * step * step / 3.0 + stray * step);
                cov[w][t] += r(walk * step * step / 2.0);
                cov[t][w] += r(walk * step * step / 2.0);
                cov[t][t] += r(walk * step);
                for j in 0..3 {
                    let with_rate = stray * step * step / 2.0 + walk * cube * step / 8.0;
                    let crossed = attitude[i][j] * r(with_rate);
                    cov[PHI + i][OMEGA + j] += crossed;
                    cov[OMEGA + j][PHI + i] += crossed;
                    let crossed = attitude[i][j] * r(walk * cube / 6.0);
                    cov[PHI + i][TURN + j] += crossed;
                    cov[TURN + j][PHI + i] += crossed;
                    cov[TURN_BIAS + i][TURN_BIAS + j] += r(bias * covariance[i][j]);
                    cov[FORCE_BIAS + i][FORCE_BIAS + j] += r(bias * covariance[3 + i][3 + j]);
                }
            }
            for i in 0..rank.min(6) {
                cov[Z_BIAS + i][Z_BIAS + i] += r(bias);
            }
        }
    }

    /// Every hypothesis meets every root: equation (97).
    fn update(&mut self, linear: &Linear<R>, noise: &Noise<R>) {
        let mut measured = [R::default(); MEASURED];
        measured[..3].copy_from_slice(&linear.theta[..3]);
        measured[3..].copy_from_slice(&linear.z);
        let mut candidates = self.candidates(linear, &measured, noise);
        let misfit = |all: &[Option<Candidate<R>>]| {
            let found = all.iter().flatten().map(|c| c.misfit);
            found.fold(f64::INFINITY, f64::min)
        };
        if misfit(&candidates) > LOST {
            // None of the histories can be right: every root is possible again.
            for hypothesis in self.hypotheses.iter_mut().flatten() {
                for i in 0..3 {
                    hypothesis.cov[OMEGA + i][OMEGA + i] += r(LOST_RATE_RAD_S * LOST_RATE_RAD_S);
                    hypothesis.cov[TURN + i][TURN + i] += r(self.activity + 1.0);
                }
            }
            candidates = self.candidates(linear, &measured, noise);
        }
        candidates.sort_unstable_by(|a, b| {
            let weight = |c: &Option<Candidate<R>>| c.map_or(f64::NEG_INFINITY, |c| c.weight);
            weight(b).total_cmp(&weight(a))
        });
        let Some(Some(best)) = candidates.first() else {
            return;
        };
        let least = best.weight - GIVEN_UP;
        let freedom = self.array.solver().rank() as f64 + 3.0;
        self.surprise = ((WEIGHT_FREEDOM + best.misfit) / (WEIGHT_FREEDOM + freedom)).max(1.0);
        let solver = self.array.solver();
        let before = self.hypotheses;
        self.hypotheses = [None; MOST];
        let mut slots = self.hypotheses.iter_mut();
        for candidate in candidates.iter().flatten().filter(|c| c.weight > least) {
            let Some(Some(parent)) = before.get(candidate.parent) else {
                continue;
            };
            if let Some(next) = parent.measured(solver, &measured, noise, candidate)
                && let Some(slot) = slots.next()
            {
                *slot = Some(next);
            }
        }
        if self.hypotheses[0].is_none() {
            self.hypotheses = before;
        }
    }

    /// What each hypothesis makes of a sample: its own, its opposite, and where the plane of an array
    /// mirrors them, the roots of the sample.
    fn candidates(
        &self,
        linear: &Linear<R>,
        measured: &[R; MEASURED],
        noise: &Noise<R>,
    ) -> [Option<Candidate<R>>; CANDIDATES] {
        let solver = self.array.solver();
        let mut roots = None;
        let mut candidates: [Option<Candidate<R>>; CANDIDATES] = [None; CANDIDATES];
        let mut count = 0;
        for (parent, hypothesis) in self.hypotheses.iter().enumerate() {
            let Some(hypothesis) = hypothesis else {
                continue;
            };
            let Some(view) = View::of(hypothesis, solver, noise) else {
                continue;
            };
            let mut put = |start: [R; TURNING]| {
                let found = view.refine(solver, measured, start)?;
                let candidate = Candidate {
                    parent,
                    turning: found.turning,
                    weight: hypothesis.weight + found.weight,
                    misfit: found.misfit,
                };
                let twin = candidates.iter_mut().flatten().find(|other| {
                    other.parent == parent && view.apart(&other.turning, &found.turning) < 0.01
                });
                if let Some(twin) = twin {
                    if candidate.weight > twin.weight {
                        *twin = candidate;
                    }
                } else if let Some(slot) = candidates.get_mut(count) {
                    *slot = Some(candidate);
                    count += 1;
                }
                Some(found.turning)
            };
            let mut start = put(view.mean).unwrap_or(view.mean);
            for w in start.iter_mut().take(3) {
                *w = -*w;
            }
            if !view.within_reach(&start) && solver.roots() == Roots::Two {
                continue;
            }
            put(start);
            let roots = roots.get_or_insert_with(|| solver.roots_of(linear));
            for root in roots.hypotheses() {
                start[..3].copy_from_slice(&root.rate_rad_s);
                if view.within_reach(&start) {
                    put(start);
                }
            }
        }
        candidates
    }

    /// Probabilities that add to 1, and hypotheses that have become the same as one.
    fn merge(&mut self) {
        for i in 0..MOST {
            for j in i + 1..MOST {
                let (Some(a), Some(b)) = (self.hypotheses[i], self.hypotheses[j]) else {
                    continue;
                };
                if a.same(&b) {
                    self.hypotheses[i] = Some(a.joined(&b));
                    self.hypotheses[j] = None;
                }
            }
        }
        let weight = |h: &Option<Hypothesis<R>>| h.map_or(f64::NEG_INFINITY, |h| h.weight);
        self.hypotheses
            .sort_unstable_by(|a, b| weight(b).total_cmp(&weight(a)));
        let most = weight(&self.hypotheses[0]);
        for slot in &mut self.hypotheses {
            if weight(slot) < most - GIVEN_UP {
                *slot = None;
            }
        }
        let sum: f64 = self
            .hypotheses
            .iter()
            .flatten()
            .map(|h| libm::exp(h.weight - most))
            .sum();
        let total = most + libm::log(sum);
        for hypothesis in self.hypotheses.iter_mut().flatten() {
            hypothesis.weight -= total;
        }
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

    /// What is known now.
    pub fn state(&self) -> ArrayState<R> {
        let zero = [R::default(); 3];
        let none = [zero; 3];
        let mut state = ArrayState {
            rate_rad_s: zero,
            rate_covariance: none,
            angular_acceleration_rad_s2: zero,
            quaternion: [r(1.0), R::default(), R::default(), R::default()],
            attitude_covariance: none,
            velocity_mps: zero,
            velocity_covariance: none,
            position_m: zero,
            position_covariance: none,
            certainty: R::default(),
            since_rest_s: r(self.since_rest_s),
            resting: self.resting(),
            unseen_mps: r(self.unseen_mps),
            unseen_m: self.unseen.way_sd_m(),
            valid: self.valid,
        };
        let mut all: Option<Hypothesis<R>> = None;
        for hypothesis in self.hypotheses.iter().flatten() {
            all = Some(match all {
                Some(all) => all.joined(hypothesis),
                None => *hypothesis,
            });
        }
        let (Some(all), Some(best)) = (all, &self.hypotheses[0]) else {
            return state;
        };
        let (rate, turn) = (part(&all.mean, OMEGA), part(&all.mean, TURN));
        let velocity = part(&all.mean, VELOCITY);
        // Equation (102).
        let at_time = |at: usize, change: [R; 3], surprise: f64| {
            let (scale, late) = (r::<R>(surprise), r::<R>(self.config.time_sd_s));
            let mut covariance = block(&all.cov, at, at);
            for (i, row) in covariance.iter_mut().enumerate() {
                for (j, value) in row.iter_mut().enumerate() {
                    *value = *value * scale + change[i] * late * change[j] * late;
                }
            }
            covariance
        };
        state.rate_rad_s = rate;
        state.rate_covariance = at_time(OMEGA, turn, self.surprise);
        // Equation (105).
        let size = r::<R>(self.size_variance()) * dot(&rate, &rate);
        let none = r::<R>(self.may_be_none(&all));
        for (i, row) in state.rate_covariance.iter_mut().enumerate() {
            row[i] += size;
            for (value, other) in row.iter_mut().zip(rate) {
                *value += none * rate[i] * other;
            }
        }
        state.angular_acceleration_rad_s2 = turn;
        state.quaternion = quaternion(&all.attitude);
        state.attitude_covariance = at_time(PHI, times(&all.attitude, &rate), 1.0);
        state.velocity_mps = velocity;
        state.velocity_covariance = at_time(VELOCITY, all.acceleration, 1.0);
        state.position_m = part(&all.mean, POSITION);
        state.position_covariance = at_time(POSITION, velocity, 1.0);
        state.certainty = r(libm::exp(best.weight));
        if !self.config.zupt.is_on() {
            let Wandered { angle, speed, way } = self.wandered;
            for i in 0..2 {
                state.attitude_covariance[i][i] += r(angle * angle);
                state.velocity_covariance[i][i] += r(speed * speed);
                state.position_covariance[i][i] += r(way * way);
            }
        }
        if self.config.zupt == Zupt::Assumed {
            // Equation (103).
            let (speed2, way2) = (self.unseen.speed2(), self.unseen.way2());
            for i in 0..3 {
                state.velocity_covariance[i][i] += speed2[i];
                state.position_covariance[i][i] += way2[i];
            }
            state.attitude_covariance[2][2] += r(self.hidden_turn.angle2);
            let rate2 = r::<R>(self.hidden_turn.rate2);
            let up = all.attitude[2];
            for (i, row) in state.rate_covariance.iter_mut().enumerate() {
                row[i] += rate2 * r(ASIDE);
                for (value, b) in row.iter_mut().zip(up) {
                    *value += rate2 * up[i] * b;
                }
            }
        }
        state
    }

    /// To be called where what the sensors differ by at a rest was just taken off them: the biases of ω̇ and z begin
    /// anew.
    pub fn residual_biases_taken_off(&mut self) {
        for hypothesis in self.hypotheses.iter_mut().flatten() {
            hypothesis.begin_biases(self.array.solver(), &self.config, false);
        }
        self.swing = Swing::at(self.slow_force);
    }

    /// Samples at rests where velocity or attitude were wrong by far more than their covariance said: zero as
    /// long as places, sensitivity and noise are this array's.
    pub fn astray(&self) -> u32 {
        self.astray
    }

    /// Rests at which the speed was not likely to be zero: it may have gone on evenly, and the position is as
    /// uncertain as that.
    pub fn doubtful(&self) -> u32 {
        self.doubtful
    }

    /// Biases of the likeliest hypothesis and their standard deviations: of ω̇ (rad/s²), of s (m/s²),
    /// and of [`Linear::z`] (in its units): the common six and those residual ones that rotation shows.
    pub fn biases(&self) -> [(R, R); 12] {
        let mut out = [(R::default(), R::default()); 12];
        if let Some(best) = &self.hypotheses[0] {
            for (k, (value, sd)) in out.iter_mut().enumerate() {
                let at = TURN_BIAS + k;
                *value = best.mean[at];
                *sd = best.cov[at][at].abs().sqrt();
            }
        }
        out
    }
}
