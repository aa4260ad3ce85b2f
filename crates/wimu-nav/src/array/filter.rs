//! Inertial navigation with an array alone: the error-state filter with the process and the measurement of a rigid array, and
//! a hypothesis for each sign of the angular rate. Equations (96) to (98), (102).

use nalgebra::{Matrix1, Matrix3, Rotation3, SMatrix, UnitQuaternion, Vector3};

use super::geometry::{Geometry, GeometryError};
use super::monitor::{Array, Dropped};
use super::noise::{Level, Noise};
use super::rest::RestTest;
use super::solver::{ArraySolver, Linear, Roots};
use super::state::{ArrayConfig, ArrayFault, ArrayState};
use crate::Real;
use crate::filter::{Filter, Gate};
use crate::mixture::Mixture;
use crate::navigator::Rests;
use crate::process::{ArrayForce, RigidArray, RigidArrayBlocks, Unmeasured};
use crate::rotation::{level, real};
use crate::sensor::{ArrayNoise, Prior, ReducedArray, Velocity, Zero};
use crate::state::{ATTITUDE, Block, Layout, POSITION, Role, VELOCITY};

/// Attitude, velocity, position (9), rotation (6), biases (12), lever arms (3), constant velocity at rests (3).
const STATES: usize = 33;
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
/// Time of the alignment, s.
const ALIGN_S: f64 = 0.5;
/// Start in motion: deviations of velocity, m/s, and tilt, rad.
const MOVING_VELOCITY: f64 = 10.0;
const MOVING_TILT: f64 = 1.0;
/// Deviations of angular rate, rad/s, and angular acceleration, rad/s², of a start, and after a gap.
const START_ROTATION: [f64; 2] = [10.0, 100.0];
/// At a rest, as means of half a second: velocity, m/s; angular rate, rad/s; angular acceleration, rad/s².
const REST_SPEED: f64 = 0.01;
const REST_ROTATION: [f64; 2] = [0.02, 0.1];
const REST_S: f64 = 0.5;
const ZERO_INTERVAL_S: f64 = 0.05;
/// As for one unit: interval of the velocity updates, and how long a rest fails its test before it is certain, s.
const REST_INTERVAL_S: f64 = 0.25;
const CERTAIN_REST_S: f64 = 1.5;
/// The same where rests are stated to be rests, s.
const STATED_REST_S: f64 = 0.25;
const HIDDEN_VELOCITY: f64 = 0.1;
/// Variance of an unknown heading, rad²: a uniform distribution.
const HEADING_UNKNOWN: f64 = 3.29;
/// Speed beyond which the filter has diverged, m/s, and deviation of the position then, m, as for one unit.
const DIVERGED_SPEED: f64 = 300.0;
const LOST_POSITION: f64 = 1e4;

/// Means for the alignment.
#[derive(Clone, Copy, Debug)]
struct Alignment {
    force: Vector3<f64>,
    time_s: f64,
    count: f64,
    rest: bool,
}

impl Alignment {
    const EMPTY: Self = Self {
        force: Vector3::new(0.0, 0.0, 0.0),
        time_s: 0.0,
        count: 0.0,
        rest: false,
    };
}

/// The filter of one array: angular rate and acceleration, attitude, velocity, position and biases, with a hypothesis for
/// each root of the angular rate until the data decide.
///
/// About 36 kB in f64 and 19 kB in f32, and as much on the stack: for a host or a large microcontroller.
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
    blocks: RigidArrayBlocks,
    hidden: Block<3>,
    layout: Layout<R, STATES>,
    mixture: Option<Mixture<R, STATES, MOST>>,
    level: Level<M>,
    rest_test: RestTest,
    align: Alignment,
    dropped: Dropped,
    /// The sample before and the variance of its specific force, for the first half of a step.
    last: Option<(Linear<R>, Noise)>,
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

impl<R: Real, const M: usize> ArrayFilter<R, M> {
    /// A filter without samples.
    ///
    /// # Errors
    /// As [`Array::new`].
    pub fn new(geometry: Geometry<M>, config: ArrayConfig) -> Result<Self, GeometryError> {
        let array = Array::<R, M>::new(geometry, real(config.range_mps2))?;
        let mut layout = Layout::new([R::zero(); 3], R::zero(), R::zero());
        let solver = array.solver();
        let lever = libm::sqrt(lever_variance(solver, &config));
        let full = |_| GeometryError::TooFew { have: 0, need: 6 };
        let blocks = RigidArrayBlocks::claim(&mut layout, START_ROTATION.map(real), real(lever))
            .map_err(full)?;
        let hidden = match config.rests {
            Rests::ConstantVelocity => HIDDEN_VELOCITY,
            _ => 0.0,
        };
        let hidden = layout
            .claim(Role::Considered, [real(hidden); 3])
            .map_err(full)?;
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
            dropped: Dropped::default(),
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
    pub fn solver(&self) -> &ArraySolver<R, M> {
        self.array.solver()
    }

    /// Rests whose velocity failed its test until they were certain: the covariance was scaled there, and the path since the
    /// rest before is outside of what was reported.
    pub fn recoveries(&self) -> u32 {
        self.recoveries
    }

    /// Takes one sample: the outputs of all axes, m/s², `step_s` seconds after the one before. Returns the sensors that were
    /// left out.
    ///
    /// # Errors
    /// [`ArrayFault`].
    pub fn push(&mut self, step_s: f64, output_mps2: &[R; M]) -> Result<Dropped, ArrayFault> {
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
        let (linear, dropped) = reduced.map_err(ArrayFault::Blind)?;
        if dropped != self.dropped {
            self.dropped = dropped;
            self.begin_biases(true);
        }
        self.take(if gap { 0.0 } else { step_s }, output_mps2, &linear);
        self.restart_if_diverged();
        if gap {
            Err(ArrayFault::Gap)
        } else {
            Ok(dropped)
        }
    }

    fn take(&mut self, step: f64, output: &[R; M], linear: &Linear<R>) {
        let [bias, _] = self.bias_variances();
        let solver = self.array.solver();
        let noise = self.level.excess.max(1.0);
        let at_rest = self.rest_test.push(solver, linear, step, [bias, noise]);
        let rate = self.best().map_or(Vector3::zeros(), |filter| {
            filter.state.get(self.blocks.rate()).map(R::to_f64)
        });
        let away = self.rest_test.away;
        let noise = self
            .level
            .push(&self.config, solver, step, output, linear, [rate, away]);
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
            mixture.merge(self.blocks.rotation, real(SAME));
        }
    }

    /// Alignment with the mean specific force; after a start in motion with that of the first rest.
    fn align(&mut self, step: f64, linear: &Linear<R>, at_rest: bool) {
        let align = &mut self.align;
        align.force += Vector3::from_fn(|i, _| linear.theta[3 + i].to_f64());
        align.time_s += step;
        align.count += 1.0;
        align.rest = at_rest;
        if align.time_s < ALIGN_S && !self.moving_start || align.count < 2.0 && !at_rest {
            return;
        }
        let force = if at_rest {
            self.rest_test.force()
        } else {
            align.force / align.count
        };
        self.align = Alignment::EMPTY;
        if let Some(attitude) = level(&force, None) {
            self.begin(
                Rotation3::from_matrix_unchecked(attitude.matrix().map(real)),
                &force,
                at_rest,
            );
        }
    }

    fn begin(&mut self, attitude: Rotation3<R>, force: &Vector3<f64>, rest: bool) {
        let g = self.config.gravity_mps2;
        let [own, common] = self.bias_variances();
        let bias = own * self.array.solver().covariance()[3][3] + common;
        let excess = force.norm() - g;
        let (tilt, velocity) = match rest {
            true => ((bias + excess * excess / 4.0) / (g * g) + 1e-6, 1e-6),
            false => (MOVING_TILT * MOVING_TILT, MOVING_VELOCITY * MOVING_VELOCITY),
        };
        let diagonal = |variance: f64| Matrix3::from_diagonal_element(real::<R>(variance));
        let mut filter = Filter::new(&self.layout, attitude);
        let tilt = Matrix3::from_diagonal(&Vector3::new(tilt, tilt, 1e-8).map(real));
        filter.set_covariance(ATTITUDE, &tilt);
        filter.set_covariance(VELOCITY, &diagonal(velocity));
        if self.lost {
            filter.set_covariance(POSITION, &diagonal(LOST_POSITION * LOST_POSITION));
        }
        self.mixture = Some(Mixture::new(filter));
        self.begin_biases(true);
        self.direction = *force;
        self.last = None;
        self.moving_start = !rest;
        self.valid = rest;
        if rest {
            self.since_rest_s = 0.0;
        }
    }

    /// Variances of the bias of an axis, in units of what the geometry declares for its noise, and of the bias that all
    /// sensors share, (m/s²)².
    fn bias_variances(&self) -> [f64; 2] {
        let c = &self.config;
        let square = |x: f64| x * x;
        let variance = self.array.solver().variance_mps2().to_f64();
        [
            (square(c.bias_mps2) + square(c.scale * c.gravity_mps2)) / variance,
            square(c.common_bias_mps2) + square(c.common_scale * c.gravity_mps2),
        ]
    }

    /// Biases as before the first sample; those of the specific force where `all`.
    fn begin_biases(&mut self, all: bool) {
        let [own, common] = self.bias_variances();
        let (own, common) = (real::<R>(own), real::<R>(common));
        let solver = self.array.solver();
        let covariance = solver.covariance();
        let mut theta = SMatrix::<R, 6, 6>::from_fn(|i, j| real::<R>(covariance[i][j]) * own);
        for i in 3..6 {
            theta[(i, i)] += common;
        }
        let rank = solver.rank();
        let z =
            SMatrix::<R, 6, 6>::from_fn(|i, j| if i == j && i < rank { own } else { R::zero() });
        let RigidArrayBlocks { bias, z_bias, .. } = self.blocks;
        let first = bias.part::<3, 0>();
        for filter in self.mixture.iter_mut().flat_map(Mixture::filters_mut) {
            if all {
                filter.set_covariance(bias, &theta);
                filter.state.set(bias, nalgebra::SVector::zeros());
            } else {
                filter.set_covariance(first, &theta.fixed_view::<3, 3>(0, 0).into_owned());
                filter.state.set(first, Vector3::zeros());
            }
            filter.set_covariance(z_bias, &z);
            filter.state.set(z_bias, nalgebra::SVector::zeros());
        }
    }

    /// To be called after the mean differences of the sensors at a rest were removed: the biases of angular acceleration and
    /// z are then those of the start.
    pub fn residual_biases_taken_off(&mut self) {
        self.begin_biases(false);
    }

    fn predict(&mut self, step: f64, linear: &Linear<R>, noise: &Noise) {
        let [own, common] = self.bias_variances();
        let c = &self.config;
        let solver = self.array.solver();
        // Scale factors act as a bias that changes with the direction of the specific force: correlation angle 1 rad.
        let slow = self.rest_test.slow;
        let angle = self.direction.angle(&slow);
        self.direction = slow;
        let angle = if self.resting || !angle.is_finite() {
            0.0
        } else {
            angle
        };
        let scale = (c.scale * c.gravity_mps2) * (c.scale * c.gravity_mps2);
        let part = scale / solver.variance_mps2().to_f64() / own;
        let decay = 1.0 - part * (1.0 - libm::exp(-angle));
        let grown = 1.0 - decay * decay;
        let walk = c.bias_walk * c.bias_walk * step / solver.variance_mps2().to_f64();
        let rotation = RigidArray {
            blocks: &self.blocks,
            solver,
            acceleration_walk: real(noise.acceleration_walk),
            rate_walk: real(noise.rate_walk),
            bias_decay: real(decay),
            bias_variance: real(own * grown + walk),
            common_variance: real(common * grown),
            step_s: real(step),
        };
        let (linear, noise) = self.last.as_ref().map_or((linear, noise), |(l, n)| (l, n));
        let force = ArrayForce {
            blocks: &self.blocks,
            solver,
            linear,
            gravity_mps2: real(c.gravity_mps2),
            noise_factor: real(noise.factor),
            force_variance: real(c.force_noise_mps2 * c.force_noise_mps2 + noise.vibration),
            step_s: real(step * 0.5),
            attitude_covariance: Matrix3::zeros(),
        };
        for filter in self.mixture.iter_mut().flat_map(Mixture::filters_mut) {
            let attitude_covariance = filter.covariance(ATTITUDE);
            filter.predict(&(
                ArrayForce {
                    attitude_covariance,
                    ..force
                },
                rotation,
            ));
        }
    }

    /// Velocity and position over the second half of a step.
    fn integrate(&mut self, step: f64, linear: &Linear<R>, noise: &Noise) {
        let c = &self.config;
        let force = ArrayForce {
            blocks: &self.blocks,
            solver: self.array.solver(),
            linear,
            gravity_mps2: real(c.gravity_mps2),
            noise_factor: real(noise.factor),
            force_variance: real(c.force_noise_mps2 * c.force_noise_mps2 + noise.vibration),
            step_s: real(step * 0.5),
            attitude_covariance: Matrix3::zeros(),
        };
        for filter in self.mixture.iter_mut().flat_map(Mixture::filters_mut) {
            let attitude_covariance = filter.covariance(ATTITUDE);
            filter.predict(&ArrayForce {
                attitude_covariance,
                ..force
            });
        }
    }

    /// Update of every hypothesis with every root of the sample that is within its reach. Where none fits, the rotation
    /// before the sample is not known.
    fn update_rotation(&mut self, linear: &Linear<R>, noise: &Noise) {
        if self.update_with_roots(linear, noise, LOST) <= LOST {
            return;
        }
        let [rate, acceleration] = [
            real::<R>(LOST_RATE * LOST_RATE),
            real(self.level.activity + 1.0),
        ];
        let wider = [rate, rate, rate, acceleration, acceleration, acceleration];
        for filter in self.mixture.iter_mut().flat_map(Mixture::filters_mut) {
            filter.add_variance(self.blocks.rotation, wider);
        }
        self.update_with_roots(linear, noise, f64::INFINITY);
    }

    /// Returns the normalised innovation squared of the most probable hypothesis.
    fn update_with_roots(&mut self, linear: &Linear<R>, noise: &Noise, limit: f64) -> f64 {
        let Some(mixture) = &mut self.mixture else {
            return 0.0;
        };
        let solver = self.array.solver();
        let sample = ReducedArray {
            blocks: &self.blocks,
            solver,
            linear,
            noise: ArrayNoise {
                factor: real(noise.factor),
                fast: real(noise.fast),
            },
            at_rad_s: Vector3::zeros(),
        };
        let mut roots = None;
        let found = mixture.update(real(FREEDOM), real(limit), |filter, put| {
            let Some(prior) = Prior::of(filter, &sample) else {
                return;
            };
            let mut all = heapless::Vec::<Vector3<R>, 12>::new();
            let mut refine = |start: Vector3<R>| {
                let root = prior.maximum(&sample, start);
                if let Some(root) =
                    root.filter(|r| all.iter().all(|a| prior.distance(a, r) > real(0.01)))
                {
                    let _ = all.push(root);
                    put(ReducedArray {
                        at_rad_s: root,
                        ..sample
                    });
                }
                root
            };
            let own = refine(prior.rate_rad_s).unwrap_or(prior.rate_rad_s);
            let near = |rate: &Vector3<R>| prior.distance(rate, &prior.rate_rad_s) < real(REACH);
            if !near(&-own) && solver.roots() == Roots::Two {
                return;
            }
            refine(-own);
            let roots = roots.get_or_insert_with(|| solver.roots_of(linear));
            for root in roots.hypotheses() {
                let root = Vector3::from(root.rate_rad_s);
                if near(&root) {
                    refine(root);
                }
            }
        });
        let freedom = solver.rank() as f64 + 3.0;
        let statistic = found.map_or(0.0, |innovation| innovation.statistic.to_f64());
        self.surprise = ((FREEDOM + statistic) / (FREEDOM + freedom)).max(1.0);
        statistic
    }

    /// Zero velocity and rotation at what looks like a rest. One whose velocity fails its test is constant velocity; it is a
    /// rest if it goes on failing, as for one unit.
    fn rest(&mut self, step: f64) {
        if !self.resting {
            self.failing_s += step;
        }
        if self.since_update_s >= REST_INTERVAL_S
            && let Some(mixture) = &mut self.mixture
        {
            self.since_update_s = 0.0;
            let zero = Velocity::zero(real(REST_SPEED), Some(self.hidden));
            let innovation = mixture.update_each(real(FREEDOM), Gate::ChiSquare, &zero);
            self.resting = innovation.is_some_and(|i| i.accepted);
            let certain = match self.config.rests {
                Rests::ZeroVelocity => STATED_REST_S,
                _ => CERTAIN_REST_S,
            };
            if !self.resting && self.failing_s >= certain {
                self.begin_again();
                self.resting = true;
            }
        }
        if self.resting {
            self.failing_s = 0.0;
            self.since_rest_s = 0.0;
            self.valid = true;
            // The mean over half a second, shared among the updates in it.
            self.since_zero_s += step;
            if self.since_zero_s < ZERO_INTERVAL_S {
                return;
            }
            let slower = libm::sqrt((REST_S / self.since_zero_s).max(1.0));
            self.since_zero_s = 0.0;
            let [rate, acceleration] = REST_ROTATION.map(|d| real::<R>(d * slower));
            let zero = Zero {
                block: self.blocks.rotation,
                deviation: [rate, rate, rate, acceleration, acceleration, acceleration],
            };
            if let Some(mixture) = &mut self.mixture {
                mixture.update_each(real(FREEDOM), Gate::Open, &zero);
            }
        }
    }

    /// At a rest that is certain, and whose velocity failed its test: the linearisation does not hold. Attitude, velocity,
    /// rotation and biases begin again, the position is uncertain by the velocity times the time since the last rest.
    fn begin_again(&mut self) {
        let Some(mixture) = &self.mixture else {
            return;
        };
        let before = mixture.moments();
        let attitude = before.state.attitude;
        let force = self.rest_test.force().map(real::<R>);
        let up = attitude * force;
        let levelled =
            Rotation3::rotation_between(&up, &Vector3::z()).unwrap_or(Rotation3::identity());
        let heading = before.covariance(ATTITUDE)[(2, 2)].to_f64()
            + libm::pow(levelled.angle().to_f64(), 2.0);
        let moved = before.state.get(VELOCITY) * real::<R>(self.since_rest_s);
        let position =
            before.covariance(POSITION) + Matrix3::from_diagonal(&moved.component_mul(&moved));
        self.begin(levelled * attitude, &self.rest_test.force(), true);
        self.recoveries = self.recoveries.saturating_add(1);
        for filter in self.mixture.iter_mut().flat_map(Mixture::filters_mut) {
            filter.state.set(POSITION, before.state.get(POSITION));
            filter.set_covariance(POSITION, &position);
            let heading = Matrix1::new(real::<R>(heading.min(HEADING_UNKNOWN)));
            filter.set_covariance(ATTITUDE.part::<1, 2>(), &heading);
        }
    }

    /// Time without a usable sample. After a gap the rotation is unknown.
    fn interrupt(&mut self, step: f64, gap: bool) {
        self.valid = false;
        self.resting = false;
        self.surprise = 1.0;
        self.last = None;
        let step_s = real::<R>(step.min(1e3));
        let solver = self.array.solver();
        let rotation = RigidArray {
            blocks: &self.blocks,
            solver,
            acceleration_walk: real(self.level.activity),
            rate_walk: R::zero(),
            bias_decay: R::one(),
            bias_variance: R::zero(),
            common_variance: R::zero(),
            step_s,
        };
        let [rate, acceleration] = START_ROTATION.map(|d| real::<R>(d * d));
        let unknown = [rate, rate, rate, acceleration, acceleration, acceleration];
        let unknown = SMatrix::<R, 6, 6>::from_diagonal(&unknown.into());
        for filter in self.mixture.iter_mut().flat_map(Mixture::filters_mut) {
            filter.predict(&Unmeasured { step_s });
            if gap {
                filter.set_covariance(self.blocks.rotation, &unknown);
            } else {
                filter.predict(&rotation);
            }
        }
    }

    /// Where a number is not finite, or the speed not possible, velocity and position are unknown until the next rest. The
    /// rotation continues if it is finite.
    fn restart_if_diverged(&mut self) {
        let Some(mixture) = &mut self.mixture else {
            return;
        };
        let sound = mixture.components().iter().all(|c| c.filter.is_sound());
        let slow =
            |filter: &Filter<R, STATES>| filter.state.get(VELOCITY).norm() < real(DIVERGED_SPEED);
        if sound && mixture.components().iter().all(|c| slow(&c.filter)) {
            return;
        }
        (self.valid, self.resting, self.lost, self.moving_start) = (false, false, true, true);
        if !sound {
            self.mixture = None;
            self.level = Level::new();
            return;
        }
        let diagonal = |d: f64| Matrix3::from_diagonal_element(real::<R>(d * d));
        for filter in mixture.filters_mut() {
            filter.state.set(VELOCITY, Vector3::zeros());
            filter.set_covariance(ATTITUDE, &diagonal(MOVING_TILT));
            filter.set_covariance(VELOCITY, &diagonal(MOVING_VELOCITY));
            filter.set_covariance(POSITION, &diagonal(LOST_POSITION));
        }
    }

    fn best(&self) -> Option<&Filter<R, STATES>> {
        let components = self.mixture.as_ref()?.components();
        components.first().map(|c| &c.filter)
    }

    /// The angular rates that are possible, rad/s, each with its probability, the most probable first.
    pub fn hypotheses(&self) -> impl Iterator<Item = (R, [R; 3])> {
        let components = self.mixture.iter().flat_map(|m| m.components());
        components.map(|c| {
            (
                c.log_weight.exp(),
                c.filter.state.get(self.blocks.rate()).into(),
            )
        })
    }

    /// What is known now: equation (102).
    pub fn state(&self) -> ArrayState<R> {
        let Some(mixture) = &self.mixture else {
            return ArrayState::unknown();
        };
        let all = mixture.moments();
        let state = &all.state;
        let c = state.attitude.matrix();
        let [rate, turn] = [self.blocks.rate(), self.blocks.acceleration()];
        let velocity = state.get(VELOCITY);
        let acceleration = self.last.as_ref().map_or(Vector3::zeros(), |(linear, _)| {
            let force = Vector3::from_fn(|i, _| linear.theta[3 + i]);
            c * force - Vector3::z() * real::<R>(self.config.gravity_mps2)
        });
        let time = real::<R>(self.config.time_sd_s);
        let at_time = |block: Block<3>, change: Vector3<R>, factor: f64| -> [[R; 3]; 3] {
            let late = change * time;
            (all.covariance(block) * real::<R>(factor) + late * late.transpose()).into()
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
            since_rest_s: real(self.since_rest_s),
            resting: self.resting,
            valid: self.valid,
        };
        result.valid &= result.is_finite();
        result
    }
}

/// Variance of a component of e: relative error of the angular rate by errors of the lever arms, equation (105).
fn lever_variance<R: Real, const M: usize>(
    solver: &ArraySolver<R, M>,
    config: &ArrayConfig,
) -> f64 {
    let covariance = solver.covariance();
    let arms = (0..3).map(|i| covariance[i][i]).sum::<f64>() / 3.0;
    let place = config.place_sd_m;
    place * place * arms / solver.variance_mps2().to_f64()
}
