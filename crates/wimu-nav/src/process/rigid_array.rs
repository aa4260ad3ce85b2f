//! A rigid body with several accelerometers: angular rate and angular acceleration are states, the specific force is
//! measured. Equation (96).
//!
//! The angular acceleration is a random walk (white-noise jerk: Y. Bar-Shalom, X. R. Li, T. Kirubarajan, "Estimation with
//! Applications to Tracking and Navigation", 2001, section 6.2.3). The errors of the sensors act on the closed form of a
//! sample, equations (71) and (72), as biases of θ and z, and as an error of the size of the array.

use nalgebra::{Matrix3, Rotation3, Vector3};

use super::{Process, Transition};
use crate::array::{ArraySolver, Linear};
use crate::state::{ATTITUDE, Block, Layout, POSITION, Role, State, VELOCITY};

/// Correlation time of the second-order error of the specific force, s: a second of motion between rests, chosen on
/// simulated journeys (array_journeys).
const SECOND_ORDER_S: f64 = 1.0;

/// States of an array beside attitude, velocity and position.
#[derive(Clone, Copy, Debug)]
pub struct RigidArrayBlocks {
    /// Angular rate, rad/s, and angular acceleration, rad/s², body frame.
    pub rotation: Block<6>,
    /// Biases of [`Linear::theta`]: rad/s², m/s².
    pub bias: Block<6>,
    /// Biases of [`Linear::z`].
    pub z_bias: Block<6>,
    /// Effect e of errors of the lever arms, considered: the sensors show ω + |ω| e, equation (105).
    pub lever: Block<3>,
}

impl RigidArrayBlocks {
    /// Claims 21 states, with the initial standard deviations of the rotation, rad/s and rad/s², and of e. Those of
    /// the biases are zero: [`set_covariance`](crate::filter::Filter::set_covariance) gives them.
    pub fn claim(layout: &mut Layout, [rate, acceleration]: [f64; 2], lever: f64) -> Self {
        let rotation = [rate, rate, rate, acceleration, acceleration, acceleration];
        Self {
            rotation: layout.claim(Role::Estimated, rotation),
            bias: layout.claim(Role::Estimated, [0.0; 6]),
            z_bias: layout.claim(Role::Estimated, [0.0; 6]),
            lever: layout.claim(Role::Considered, [lever; 3]),
        }
    }

    /// Angular rate, rad/s.
    pub fn rate(&self) -> Block<3> {
        self.rotation.part::<3, 0>()
    }

    /// Angular acceleration, rad/s².
    pub fn acceleration(&self) -> Block<3> {
        self.rotation.part::<3, 3>()
    }
}

/// Rotation over a step, and the drift of the biases.
#[derive(Clone, Copy, Debug)]
pub struct RigidArray<'a> {
    /// Its states.
    pub blocks: &'a RigidArrayBlocks,
    /// Closed form of a sample.
    pub solver: &'a ArraySolver,
    /// Density of the noise of the angular acceleration, (rad/s²)²/s.
    pub acceleration_walk: f64,
    /// Density of the noise of the angular rate, (rad/s)²/s.
    pub rate_walk: f64,
    /// Factor by which the biases decay, and what is added to their variance: of an axis in units of its noise variance, and
    /// of the specific force besides, (m/s²)².
    pub bias_decay: f64,
    /// See [`bias_decay`](Self::bias_decay).
    pub bias_variance: f64,
    /// See [`bias_decay`](Self::bias_decay).
    pub common_variance: f64,
    /// Length of the step, s.
    pub step_s: f64,
}

impl RigidArray<'_> {
    fn propagate_rotation(&self, state: &mut State, transition: &mut Transition) {
        let (dt, one) = (self.step_s, Matrix3::identity());
        let (rate, acceleration) = (self.blocks.rate(), self.blocks.acceleration());
        let c = *state.attitude.matrix();
        transition.add(ATTITUDE, rate, c * dt);
        transition.add(ATTITUDE, acceleration, c * (dt * dt * 0.5));
        transition.add(rate, acceleration, one * dt);
        // White noise of both, integrated over the step.
        let (walk, jerk) = (self.rate_walk * dt, self.acceleration_walk * dt);
        let term = |matrix: Matrix3<f64>, of_rate: f64, of_acceleration: f64| {
            matrix * (walk * of_rate + jerk * dt * dt * of_acceleration)
        };
        transition.add_covariance(ATTITUDE, ATTITUDE, term(one * (dt * dt), 1.0 / 3.0, 0.05));
        transition.add_covariance(ATTITUDE, rate, term(c * dt, 0.5, 0.125));
        transition.add_covariance(ATTITUDE, acceleration, c * (jerk * dt * dt * (1.0 / 6.0)));
        transition.add_covariance(rate, rate, term(one, 1.0, 1.0 / 3.0));
        transition.add_covariance(rate, acceleration, one * (jerk * dt * 0.5));
        transition.add_noise(acceleration, jerk);

        let (w, a) = (state.get(rate), state.get(acceleration));
        state.attitude *= Rotation3::new((w + a * (dt * 0.5)) * dt);
        state.set(rate, w + a * dt);
    }

    fn propagate_biases(&self, state: &mut State, transition: &mut Transition) {
        let RigidArrayBlocks { bias, z_bias, .. } = *self.blocks;
        let (first, second) = (bias.part::<3, 0>(), bias.part::<3, 3>());
        if self.bias_decay < 1.0 {
            let lost = Matrix3::identity() * (self.bias_decay - 1.0);
            for block in [first, second, z_bias.part::<3, 0>(), z_bias.part::<3, 3>()] {
                transition.add(block, block, lost);
                state.set(block, state.get(block) * self.bias_decay);
            }
        }
        let covariance = self.solver.covariance() * self.bias_variance;
        let part = |row, column| covariance.fixed_view::<3, 3>(row, column).into_owned();
        transition.add_covariance(first, first, part(0, 0));
        transition.add_covariance(first, second, part(0, 3));
        transition.add_covariance(second, second, part(3, 3));
        transition.add_noise(second, self.common_variance);
        for k in 0..self.solver.rank().min(6) {
            transition.add_noise_at(z_bias, k, self.bias_variance);
        }
    }
}

impl Process for RigidArray<'_> {
    fn propagate(&self, state: &mut State, transition: &mut Transition) {
        self.propagate_rotation(state, transition);
        self.propagate_biases(state, transition);
    }
}

/// Velocity and position over half an interval between samples, from the specific force at one end: both halves are the
/// trapezoidal rule.
#[derive(Clone, Copy, Debug)]
pub struct ArrayForce<'a> {
    /// Its states.
    pub blocks: &'a RigidArrayBlocks,
    /// Closed form of a sample.
    pub solver: &'a ArraySolver,
    /// The sample.
    pub linear: &'a Linear,
    /// Gravity, m/s².
    pub gravity_mps2: f64,
    /// Variance of the sample in units of what the geometry declares.
    pub noise_factor: f64,
    /// Variance of the specific force besides, a component, (m/s²)².
    pub force_variance: f64,
    /// Half the interval between two samples, s.
    pub step_s: f64,
    /// Covariance of the attitude error, rad²: the mean specific force is smaller than that of the mean attitude.
    pub attitude_covariance: Matrix3<f64>,
}

impl Process for ArrayForce<'_> {
    fn propagate(&self, state: &mut State, transition: &mut Transition) {
        let (dt, half) = (self.step_s, 0.5);
        let bias = self.blocks.bias.part::<3, 3>();
        let rate = state.get(self.blocks.rate());
        let (theta, slope) = self.solver.expected_theta(&rate);
        let force = self.linear.force_mps2() - theta.fixed_rows::<3>(3) - state.get(bias);
        let c = *state.attitude.matrix();
        // Mean of C f to second order of the attitude error, equation (124); the deviation of that term is its size.
        let p = &self.attitude_covariance;
        let second = (p - Matrix3::identity() * p.trace()) * (c * force) * half;
        let acceleration = c * force + second - Vector3::z() * self.gravity_mps2;
        let velocity = state.get(VELOCITY);
        let moved = state.get(POSITION) + (velocity + acceleration * (dt * half)) * dt;
        state.set(POSITION, moved);
        state.set(VELOCITY, velocity + acceleration * dt);

        let by_rate = slope.fixed_rows::<3>(3);
        transition.add(POSITION, VELOCITY, Matrix3::identity() * dt);
        transition.add(VELOCITY, ATTITUDE, (c * force).cross_matrix() * -dt);
        transition.add(VELOCITY, bias, c * -dt);
        transition.add(VELOCITY, self.blocks.rate(), c * by_rate * -dt);
        // The noise of a sample acts in two halves: half the variance of a full step in each.
        let declared = self.solver.covariance().fixed_view::<3, 3>(3, 3) * self.noise_factor;
        let noise = declared + Matrix3::from_diagonal_element(self.force_variance);
        let noise = c * noise * c.transpose() * (dt * dt * 2.0);
        let noise = noise + second * second.transpose() * (dt * SECOND_ORDER_S);
        transition.add_covariance(VELOCITY, VELOCITY, noise);
    }
}
