//! Simple processes: unknown motion, biases and other slow errors.

use nalgebra::{Matrix3, SMatrix, Vector3};

use super::{Process, Transition};
use crate::state::{ATTITUDE, Block, POSITION, State, VELOCITY};

/// First-order Gauss–Markov process, equation (127) (A. Gelb, "Applied Optimal Estimation", 1974, section 2.2): a step of a
/// vector that decays towards zero and is driven by noise, dx/dt = −x/τ + w.
#[derive(Clone, Copy, Debug)]
pub struct GaussMarkov<const W: usize = 3> {
    /// Its states.
    pub block: Block<W>,
    /// Stationary standard deviation of a component.
    pub deviation: f64,
    /// Correlation time τ, s.
    pub time_s: f64,
    /// Length of the step, s.
    pub step_s: f64,
}

impl<const W: usize> Process for GaussMarkov<W> {
    fn propagate(&self, state: &mut State, transition: &mut Transition) {
        let decay = libm::exp(-self.step_s / self.time_s);
        let decayed = state.get(self.block) * decay;
        state.set(self.block, decayed);
        let change = SMatrix::<f64, W, W>::identity() * (decay - 1.0);
        transition.add(self.block, self.block, change);
        transition.add_noise(self.block, self.deviation * self.deviation * (1.0 - decay * decay));
    }
}

/// A step of a random walk, such as that of a bias.
#[derive(Clone, Copy, Debug)]
pub struct RandomWalk<const W: usize = 3> {
    /// Its states.
    pub block: Block<W>,
    /// Density of the noise, unit of the states/√s.
    pub density: f64,
    /// Length of the step, s.
    pub step_s: f64,
}

impl<const W: usize> Process for RandomWalk<W> {
    fn propagate(&self, _: &mut State, transition: &mut Transition) {
        transition.add_noise(self.block, self.density * self.density * self.step_s);
    }
}

/// A step of a body whose acceleration is white noise, equation (160): for sensors of position without inertial data
/// (Bar-Shalom, Li and Kirubarajan, "Estimation with Applications to Tracking and Navigation", 2001, section 6.2.2).
#[derive(Clone, Copy, Debug)]
pub struct ConstantVelocity {
    /// Power spectral density of the acceleration in east, north and up, m²/s³. Zero where the body does not move.
    pub density: Vector3<f64>,
    /// Length of the step, s.
    pub step_s: f64,
}

impl Process for ConstantVelocity {
    fn propagate(&self, state: &mut State, transition: &mut Transition) {
        let dt = self.step_s;
        let moved = state.get(POSITION) + state.get(VELOCITY) * dt;
        state.set(POSITION, moved);
        transition.add(POSITION, VELOCITY, Matrix3::identity() * dt);
        let noise = Matrix3::from_diagonal(&self.density) * dt;
        transition.add_covariance(VELOCITY, VELOCITY, noise);
        transition.add_covariance(POSITION, VELOCITY, noise * (dt * 0.5));
        transition.add_covariance(POSITION, POSITION, noise * (dt * dt / 3.0));
    }
}

/// A step with a constant acceleration beside that of another process: the error of gravity in a frame that is not level,
/// such as that of surveyed anchors. Equation (168).
#[derive(Clone, Copy, Debug)]
pub struct AccelerationOffset {
    /// The acceleration, m/s², navigation frame.
    pub block: Block<3>,
    /// Length of the step, s.
    pub step_s: f64,
}

impl Process for AccelerationOffset {
    fn propagate(&self, state: &mut State, transition: &mut Transition) {
        let dt = self.step_s;
        let half = dt * dt * 0.5;
        let acceleration = state.get(self.block);
        state.set(POSITION, state.get(POSITION) + acceleration * half);
        state.set(VELOCITY, state.get(VELOCITY) + acceleration * dt);
        transition.add(VELOCITY, self.block, Matrix3::identity() * dt);
        transition.add(POSITION, self.block, Matrix3::identity() * half);
    }
}

/// Standard deviations of acceleration, m/s², and angular rate, rad/s, a component: brisk hand motion (BROAD, fast).
const ACCELERATION: f64 = 5.0;
const RATE: f64 = 2.0;

/// Time after which they have changed, s: that of a gesture or a step.
const CONSTANT_S: f64 = 1.0;

/// A step of unknown acceleration and angular rate, which are constant for a second: steps that follow one another are as
/// uncertain as one of their length. Equation (128).
#[derive(Clone, Copy, Debug)]
pub struct Unmeasured {
    /// Length of the step, s.
    pub step_s: f64,
    /// Time without samples before it, s.
    pub since_s: f64,
}

impl Process for Unmeasured {
    fn propagate(&self, state: &mut State, transition: &mut Transition) {
        let dt = self.step_s;
        let moved = state.get(POSITION) + state.get(VELOCITY) * dt;
        state.set(POSITION, moved);
        transition.add(POSITION, VELOCITY, Matrix3::identity() * dt);
        // (since + dt)² − since²
        let square_s = dt * (dt + self.since_s.min(CONSTANT_S) * 2.0);
        transition.add_noise(ATTITUDE, square_s * (RATE * RATE));
        transition.add_noise(VELOCITY, square_s * (ACCELERATION * ACCELERATION));
        let quarter = 0.25 * ACCELERATION * ACCELERATION;
        transition.add_noise(POSITION, square_s * dt * dt * quarter);
    }
}
