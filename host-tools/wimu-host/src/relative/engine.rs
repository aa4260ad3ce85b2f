//! The filter of the relative motion of two units.

use nalgebra::{Matrix3, Rotation3, Vector3};
use wimu_nav::filter::{Filter, Gate};
use wimu_nav::process::{ImuErrors, Relative, RelativeBlocks, Unmeasured};
use wimu_nav::sensor::{CommonAxis, CommonPoint};
use wimu_nav::state::{ATTITUDE, Block, Layout, Role};

use super::Hinge;
use super::pair::Step;

/// Standard deviation of a lever arm, m, a component: units are mounted within about half a metre of the joint.
const LEVER_ARM_M: f64 = 0.3;
/// Standard deviation of the relative velocity at the start, m/s.
const VELOCITY_MPS: f64 = 1.0;
/// Standard deviation of the attitude at a start hypothesis, rad: half of the distance between two of them.
pub(super) const START_RAD: f64 = std::f64::consts::PI / 8.0;
/// The joint is used once in this time, s.
const JOINT_S: f64 = 0.05;
/// Play of the joint, m, and of the hinge, rad, 1 σ.
const PLAY_M: f64 = 0.01;
const PLAY_RAD: f64 = 0.0175;
/// Deviation of a sample's time, s: rows that repeat a sample.
const TIME_S: f64 = 0.002;

/// What is known of both units.
#[derive(Clone, Copy, Debug)]
pub(super) struct Model {
    pub hinge: Option<Hinge>,
    /// Standard deviation of the biases of the accelerometers, m/s².
    pub bias_mps2: f64,
}

/// Attitude after a step.
#[derive(Clone, Copy, Debug)]
pub(super) struct Pose {
    pub time_s: f64,
    pub step_s: f64,
    /// Axes of the second unit to those of the first.
    pub attitude: Rotation3<f64>,
    /// rad², axes of the first unit.
    pub covariance: Matrix3<f64>,
    /// Angular rates without bias, rad/s, each in its axes.
    pub rate_rad_s: [Vector3<f64>; 2],
    pub measured: bool,
}

/// A run of the filter.
pub(super) struct Run {
    pub poses: Vec<Pose>,
    pub log_likelihood: f64,
    /// Normalised innovation squared of the joint over its degrees of freedom, mean.
    pub joint_nis: f64,
    /// Position of the joint from each unit, m.
    pub lever_arms_m: [Vector3<f64>; 2],
}

struct Blocks {
    motion: RelativeBlocks,
    arms: [Block<3>; 2],
    axes: [Block<3>; 2],
}

/// The filter on its way.
pub(super) struct Engine {
    filter: Filter,
    blocks: Blocks,
    model: Model,
    errors: ImuErrors,
    since_joint_s: f64,
    log_likelihood: f64,
    /// Sums of the normalised innovations squared of the joint, and of their degrees of freedom.
    joint: [f64; 2],
}

/// Runs the filter from a rotation at the start.
pub(super) fn run(steps: &[Step], start: Rotation3<f64>, model: &Model) -> Run {
    let mut engine = Engine::new(start, model);
    let poses = steps.iter().map(|step| engine.step(step)).collect();
    Run {
        poses,
        log_likelihood: engine.log_likelihood,
        joint_nis: engine.joint_nis(),
        lever_arms_m: engine.lever_arms_m(),
    }
}

impl Engine {
    pub(super) fn new(start: Rotation3<f64>, model: &Model) -> Self {
        let mut errors = ImuErrors::default();
        errors.accelerometer_bias = model.bias_mps2;
        errors.time_s = TIME_S;
        let (filter, blocks) = begun(start, model, &errors);
        Self {
            filter,
            blocks,
            model: *model,
            errors,
            since_joint_s: JOINT_S,
            log_likelihood: 0.0,
            joint: [0.0; 2],
        }
    }

    pub(super) fn step(&mut self, step: &Step) -> Pose {
        let (filter, blocks) = (&mut self.filter, &self.blocks);
        predict(filter, step, blocks, &self.errors);
        self.since_joint_s += step.step_s;
        if self.since_joint_s >= JOINT_S && step.measured {
            self.since_joint_s = 0.0;
            let point = CommonPoint { lever_arms: blocks.arms, deviation_m: PLAY_M };
            let found = filter.update(&point, Gate::Open);
            self.log_likelihood += found.log_likelihood;
            self.joint[0] += found.statistic;
            self.joint[1] += found.dof as f64;
            if self.model.hinge.is_some() {
                let axis = CommonAxis { axes: blocks.axes, deviation_rad: PLAY_RAD };
                self.log_likelihood += filter.update(&axis, Gate::Open).log_likelihood;
            }
        }
        let rate =
            |k: usize| step.rate_rad_s[k] - filter.state.get(blocks.motion.gyroscope_bias[k]);
        Pose {
            time_s: step.time_s,
            step_s: step.step_s,
            attitude: filter.state.attitude,
            covariance: filter.covariance(ATTITUDE),
            rate_rad_s: [rate(0), rate(1)],
            measured: step.measured && filter.is_sound(),
        }
    }

    /// Whether its numbers are finite and its covariance is one.
    pub(super) fn is_sound(&self) -> bool {
        self.filter.is_sound()
    }

    /// Normalised innovation squared of the joint over its degrees of freedom, mean.
    pub(super) fn joint_nis(&self) -> f64 {
        self.joint[0] / self.joint[1]
    }

    /// Position of the joint from each unit, m.
    pub(super) fn lever_arms_m(&self) -> [Vector3<f64>; 2] {
        self.blocks.arms.map(|arm| self.filter.state.get(arm))
    }
}

fn begun(start: Rotation3<f64>, model: &Model, errors: &ImuErrors) -> (Filter, Blocks) {
    let mut layout = Layout::new([START_RAD; 3], VELOCITY_MPS, 2.0 * LEVER_ARM_M);
    let motion = RelativeBlocks::claim(&mut layout, errors);
    let arms = [
        layout.claim(Role::Estimated, [LEVER_ARM_M; 3]),
        layout.claim(Role::Estimated, [LEVER_ARM_M; 3]),
    ];
    let axes = [layout.claim(Role::Considered, [0.0; 3]), layout.claim(Role::Considered, [0.0; 3])];
    let mut filter = Filter::new(&layout, start);
    if let Some(hinge) = &model.hinge {
        for (k, block) in axes.into_iter().enumerate() {
            let (axis, variance) = (Vector3::from(hinge.axes[k]), hinge.sd_rad[k].powi(2));
            filter.state.set(block, axis);
            // The axis is a unit vector: its error is across it.
            let across = Matrix3::identity() - axis * axis.transpose();
            filter.set_covariance(block, &(across * variance));
        }
    }
    (filter, Blocks { motion, arms, axes })
}

fn predict(filter: &mut Filter, step: &Step, blocks: &Blocks, errors: &ImuErrors) {
    let step_s = step.step_s;
    if !step.measured {
        return filter.predict(&Unmeasured { step_s, since_s: 0.0 });
    }
    let motion = Relative {
        step_s,
        force_mps2: step.force_mps2,
        rate_rad_s: step.rate_rad_s,
        blocks: &blocks.motion,
        errors,
    };
    filter.predict(&motion);
}
