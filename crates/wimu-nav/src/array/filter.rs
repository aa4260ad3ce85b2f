//! Inertial navigation with an array alone: the error-state filter with the process and the measurement of a rigid array, and
//! a hypothesis for each sign of the angular rate. Equations (96), (97), (102).

mod start;

use nalgebra::{Matrix3, UnitQuaternion, Vector3};

use super::available::{Array, SensorBits};
use super::geometry::{Geometry, GeometryError};
use super::noise::{Level, Noise};
use super::rest::RestTest;
use super::solver::{ArraySolver, Linear};
use super::state::{ArrayConfig, ArrayFault, ArrayState};
use crate::filter::Filter;
use crate::mixture::Mixture;
use crate::navigator::{HIDDEN_VELOCITY, Rests};
use crate::process::{ArrayForce, RigidArray, RigidArrayBlocks};
use crate::sensor::{ArrayNoise, Prior, ReducedArray};
use crate::state::{ATTITUDE, Block, Layout, POSITION, Role, VELOCITY};

/// Hypotheses.
const MOST: usize = 4;
/// Hypotheses whose rotation differs by less than this many variances are merged.
const SAME: f64 = 1.0;
/// Roots further than this many variances from the predicted angular rate are not tried.
const REACH: f64 = 60.0;
/// Degrees of freedom of Student's t.
const FREEDOM: f64 = 10.0;
/// Normalised innovation squared above which no hypothesis fits, and deviation of the angular rate then, rad/s.
const LOST: f64 = 300.0;
const LOST_RATE: f64 = 20.0;
/// Samples further apart are a gap, s.
const GAP_S: f64 = 0.25;
/// Deviations of angular rate, rad/s, and angular acceleration, rad/s², of a start, and after a gap.
const START_ROTATION: [f64; 2] = [10.0, 100.0];

/// Means for the alignment.
#[derive(Clone, Copy, Debug)]
struct Alignment {
    force: Vector3<f64>,
    time_s: f64,
    count: f64,
}

impl Alignment {
    const EMPTY: Self = Self { force: Vector3::new(0.0, 0.0, 0.0), time_s: 0.0, count: 0.0 };
}

/// The filter of one array: angular rate and acceleration, attitude, velocity, position and biases, with a hypothesis for
/// each root of the angular rate until the data decide.
///
/// ```
/// use wimu_nav::array::{ArrayConfig, ArrayFilter, Axis, Geometry};
///
/// // Four triads at alternate corners of a cube, 2 cm from its centre, with 0.01 m/s² of noise.
/// let corners = [[1.0, 1.0, 1.0], [1.0, -1.0, -1.0], [-1.0, 1.0, -1.0], [-1.0, -1.0, 1.0_f64]];
/// let triads = corners.map(|corner| Axis::triad(corner.map(|c| 0.0115 * c), 0.01));
/// let geometry = Geometry::new(triads.into_iter().flatten(), 3)?;
/// let mut filter = ArrayFilter::new(geometry, ArrayConfig::default())?;
/// // At rest, z up.
/// for k in 0..200 {
///     let noise = |axis: usize| 0.003 * ((7 * k + 5 * axis) % 11) as f64 - 0.015;
///     let sample: [f64; 12] = core::array::from_fn(|axis| if axis % 3 == 2 { 9.80665 + noise(axis) } else { noise(axis) });
///     filter.push(0.01, &sample).unwrap();
/// }
/// let state = filter.state();
/// assert!(state.valid && state.resting && state.position_sd_m() < 0.05);
/// # Ok::<(), wimu_nav::array::GeometryError>(())
/// ```
#[derive(Clone, Debug)]
pub struct ArrayFilter {
    config: ArrayConfig,
    array: Array,
    blocks: RigidArrayBlocks,
    hidden: Block<3>,
    layout: Layout,
    mixture: Option<Mixture<MOST>>,
    level: Level,
    rest_test: RestTest,
    align: Alignment,
    absent: SensorBits,
    /// The sample before and the variance of its specific force, for the first half of a step.
    last: Option<(Linear, Noise)>,
    /// Low-passed direction of the specific force: the effect of scale factors changes with it.
    direction: Vector3<f64>,
    /// Times since the last rest, the last velocity update, and since updates of a rest fail, s.
    since_rest_s: f64,
    since_update_s: f64,
    failing_s: f64,
    since_zero_s: f64,
    resting: bool,
    started: bool,
    moving_start: bool,
    still_start: bool,
    valid: bool,
    lost: bool,
    recoveries: u32,
    /// Factor of the covariance by the last innovation, equation (102).
    surprise: f64,
}

impl ArrayFilter {
    /// A filter without samples.
    ///
    /// # Errors
    /// As [`Array::new`].
    pub fn new(geometry: Geometry, config: ArrayConfig) -> Result<Self, GeometryError> {
        let array = Array::new(geometry)?;
        let mut layout = Layout::new([0.0; 3], 0.0, 0.0);
        let solver = array.solver();
        let lever = solver.rate_error(config.place_sd_m);
        let blocks = RigidArrayBlocks::claim(&mut layout, START_ROTATION, lever);
        let hidden = match config.rests {
            Rests::ConstantVelocity => HIDDEN_VELOCITY,
            _ => 0.0,
        };
        let hidden = layout.claim(Role::Considered, [hidden; 3]);
        Ok(Self {
            rest_test: RestTest::new(&config, solver),
            config,
            array,
            blocks,
            hidden,
            layout,
            mixture: None,
            level: Level::new(),
            align: Alignment::EMPTY,
            absent: 0,
            last: None,
            direction: Vector3::zeros(),
            since_rest_s: 0.0,
            since_update_s: 0.0,
            failing_s: 0.0,
            since_zero_s: 0.0,
            resting: false,
            started: false,
            moving_start: false,
            still_start: true,
            valid: false,
            lost: false,
            recoveries: 0,
            surprise: 1.0,
        })
    }

    /// The solver of the sensors that are in use now.
    pub fn solver(&self) -> &ArraySolver {
        self.array.solver()
    }

    /// Rests whose velocity failed its test until they were certain: the covariance was scaled there, and the path since the
    /// rest before is outside of what was reported.
    pub fn recoveries(&self) -> u32 {
        self.recoveries
    }

    /// Takes one sample: the outputs of all axes, m/s², those without one not finite, `step_s` seconds after the one before.
    /// Returns the sensors that were left out.
    ///
    /// # Errors
    /// [`ArrayFault`].
    pub fn push(&mut self, step_s: f64, output_mps2: &[f64]) -> Result<SensorBits, ArrayFault> {
        let late = self.started && step_s <= 0.0;
        if !step_s.is_finite() || step_s < 0.0 || late {
            return Err(ArrayFault::NoTime);
        }
        self.started = true;
        self.since_rest_s += step_s;
        self.since_update_s += step_s;
        let gap = step_s > GAP_S;
        let reduced = self.array.reduce(output_mps2);
        if gap || reduced.is_err() {
            self.interrupt(step_s, gap);
        }
        let (linear, absent) = reduced.map_err(ArrayFault::Blind)?;
        if absent != self.absent {
            self.absent = absent;
            self.begin_biases(true);
        }
        self.take(if gap { 0.0 } else { step_s }, output_mps2, &linear);
        self.restart_if_diverged();
        if gap { Err(ArrayFault::Gap) } else { Ok(absent) }
    }

    fn take(&mut self, step: f64, output: &[f64], linear: &Linear) {
        let [bias, _] = self.bias_variances();
        let solver = self.array.solver();
        let noise = self.level.excess.max(1.0);
        let at_rest = self.rest_test.push(solver, linear, step, [bias, noise]);
        let rate =
            self.best().map_or(Vector3::zeros(), |filter| filter.state.get(self.blocks.rate()));
        let away = self.rest_test.away;
        let noise = self.level.push(&self.config, solver, step, output, linear, [rate, away]);
        if self.mixture.is_none() || (self.moving_start && at_rest) {
            self.align(step, linear, at_rest);
            return;
        }
        self.predict(step, linear, &noise);
        self.update_rotation(linear, &noise);
        self.integrate(step, linear, &noise);
        self.last = Some((*linear, noise));
        // Without updates at rests, the one that it begins with is part of the alignment.
        self.still_start &= at_rest;
        if at_rest && (self.config.rests != Rests::Ignored || self.still_start) {
            self.rest(step);
        } else {
            (self.resting, self.failing_s) = (false, 0.0);
        }
        if let Some(mixture) = &mut self.mixture {
            mixture.merge(self.blocks.rotation, SAME);
        }
    }

    /// To be called after the mean differences of the sensors at a rest were removed: the biases of angular acceleration and
    /// z are then those of the start.
    pub fn residual_biases_taken_off(&mut self) {
        self.begin_biases(false);
    }

    fn predict(&mut self, step: f64, linear: &Linear, noise: &Noise) {
        let [own, common] = self.bias_variances();
        let c = &self.config;
        let solver = self.array.solver();
        // Scale factors act as a bias that changes with the direction of the specific force: correlation angle 1 rad.
        let slow = self.rest_test.slow;
        let angle = self.direction.angle(&slow);
        self.direction = slow;
        let angle = if self.resting || !angle.is_finite() { 0.0 } else { angle };
        let scale = (c.scale * c.gravity_mps2) * (c.scale * c.gravity_mps2);
        let part = scale / solver.variance_mps2() / own;
        let decay = 1.0 - part * (1.0 - libm::exp(-angle));
        let grown = 1.0 - decay * decay;
        let walk = c.bias_walk * c.bias_walk * step / solver.variance_mps2();
        let rotation = RigidArray {
            blocks: &self.blocks,
            solver,
            acceleration_walk: noise.acceleration_walk,
            rate_walk: noise.rate_walk,
            bias_decay: decay,
            bias_variance: own * grown + walk,
            common_variance: common * grown,
            step_s: step,
        };
        let (linear, noise) = self.last.as_ref().map_or((linear, noise), |(l, n)| (l, n));
        let force = force(&self.config, &self.blocks, solver, step, linear, noise);
        for filter in self.mixture.iter_mut().flat_map(Mixture::filters_mut) {
            let attitude_covariance = filter.covariance(ATTITUDE);
            filter.predict(&(ArrayForce { attitude_covariance, ..force }, rotation));
        }
    }

    /// Velocity and position over the second half of a step.
    fn integrate(&mut self, step: f64, linear: &Linear, noise: &Noise) {
        let solver = self.array.solver();
        let force = force(&self.config, &self.blocks, solver, step, linear, noise);
        for filter in self.mixture.iter_mut().flat_map(Mixture::filters_mut) {
            let attitude_covariance = filter.covariance(ATTITUDE);
            filter.predict(&ArrayForce { attitude_covariance, ..force });
        }
    }

    /// Update of every hypothesis with every root of the sample that is within its reach. Where none fits, the rotation
    /// before the sample is not known.
    fn update_rotation(&mut self, linear: &Linear, noise: &Noise) {
        if self.update_with_roots(linear, noise, LOST) <= LOST {
            return;
        }
        let [rate, acceleration] = [LOST_RATE * LOST_RATE, self.level.activity + 1.0];
        let wider = [rate, rate, rate, acceleration, acceleration, acceleration];
        for filter in self.mixture.iter_mut().flat_map(Mixture::filters_mut) {
            filter.add_variance(self.blocks.rotation, wider);
        }
        self.update_with_roots(linear, noise, f64::INFINITY);
    }

    /// Returns the normalised innovation squared of the most probable hypothesis.
    fn update_with_roots(&mut self, linear: &Linear, noise: &Noise, limit: f64) -> f64 {
        let Some(mixture) = &mut self.mixture else {
            return 0.0;
        };
        let solver = self.array.solver();
        let sample = ReducedArray {
            blocks: &self.blocks,
            solver,
            linear,
            noise: ArrayNoise { factor: noise.factor, fast: noise.fast },
            at_rad_s: Vector3::zeros(),
        };
        let mut roots = None;
        let found = mixture.update(FREEDOM, limit, |filter, put| {
            let Some(prior) = Prior::of(filter, &sample) else {
                return;
            };
            let mut all = heapless::Vec::<Vector3<f64>, 12>::new();
            let mut refine = |start: Vector3<f64>| {
                let root = prior.maximum(&sample, start);
                if let Some(root) = root.filter(|r| all.iter().all(|a| prior.distance(a, r) > 0.01))
                {
                    let _ = all.push(root);
                    put(ReducedArray { at_rad_s: root, ..sample });
                }
                root
            };
            let own = refine(prior.rate_rad_s).unwrap_or(prior.rate_rad_s);
            let near = |rate: &Vector3<f64>| prior.distance(rate, &prior.rate_rad_s) < REACH;
            if !near(&-own) && solver.rank() == 6 {
                return;
            }
            refine(-own);
            let roots = roots.get_or_insert_with(|| solver.roots_of(linear));
            for root in roots.iter() {
                let root = root.rate_rad_s;
                if near(&root) {
                    refine(root);
                }
            }
        });
        let freedom = solver.rank() as f64 + 3.0;
        let statistic = found.map_or(0.0, |innovation| innovation.statistic);
        self.surprise = ((FREEDOM + statistic) / (FREEDOM + freedom)).max(1.0);
        statistic
    }

    fn best(&self) -> Option<&Filter> {
        let components = self.mixture.as_ref()?.components();
        components.first().map(|c| &c.filter)
    }

    /// The angular rates that are possible, rad/s, each with its probability, the most probable first.
    pub fn hypotheses(&self) -> impl Iterator<Item = (f64, [f64; 3])> {
        let components = self.mixture.iter().flat_map(|m| m.components());
        components.map(|c| (libm::exp(c.log_weight), c.filter.state.get(self.blocks.rate()).into()))
    }

    /// What is known now: equation (102).
    pub fn state(&self) -> ArrayState {
        let Some(mixture) = &self.mixture else {
            return ArrayState::unknown();
        };
        let all = mixture.moments();
        let state = &all.state;
        let c = state.attitude.matrix();
        let [rate, turn] = [self.blocks.rate(), self.blocks.acceleration()];
        let velocity = state.get(VELOCITY);
        let acceleration = self.last.as_ref().map_or(Vector3::zeros(), |(linear, _)| {
            c * linear.force_mps2() - Vector3::z() * self.config.gravity_mps2
        });
        let time = self.config.time_sd_s;
        let at_time = |block: Block<3>, change: Vector3<f64>, factor: f64| -> [[f64; 3]; 3] {
            let late = change * time;
            (all.covariance(block) * factor + late * late.transpose()).into()
        };
        let quaternion = UnitQuaternion::from_rotation_matrix(&state.attitude);
        let mut result = ArrayState {
            rate_rad_s: state.get(rate).into(),
            rate_covariance: at_time(rate, state.get(turn), self.surprise),
            angular_acceleration_rad_s2: state.get(turn).into(),
            quaternion: [quaternion.w, quaternion.i, quaternion.j, quaternion.k],
            attitude_covariance: at_time(ATTITUDE, c * state.get(rate), 1.0),
            velocity_mps: velocity.into(),
            velocity_covariance: at_time(VELOCITY, acceleration, 1.0),
            position_m: state.get(POSITION).into(),
            position_covariance: at_time(POSITION, velocity, 1.0),
            certainty: mixture.certainty(),
            since_rest_s: self.since_rest_s,
            resting: self.resting,
            valid: self.valid,
        };
        result.valid &= result.is_finite();
        result
    }
}

/// Half a step of velocity and position with a sample.
fn force<'a>(
    config: &ArrayConfig,
    blocks: &'a RigidArrayBlocks,
    solver: &'a ArraySolver,
    step: f64,
    linear: &'a Linear,
    noise: &Noise,
) -> ArrayForce<'a> {
    let own = config.force_noise_mps2 * config.force_noise_mps2;
    ArrayForce {
        blocks,
        solver,
        linear,
        gravity_mps2: config.gravity_mps2,
        noise_factor: noise.factor,
        force_variance: own + noise.vibration,
        step_s: step * 0.5,
        attitude_covariance: Matrix3::zeros(),
    }
}
