//! Strapdown integration: angular rate and specific force are measured. Equations (113) to (116).
//!
//! Sensor models, in the body frame, with white noise n:
//!
//! ```text
//! f_measured = (1 + M_f) f + b_f + n_f
//! ω_measured = (1 + M_ω) ω + b_ω + n_ω,  late by τ:  C_true = C exp(ω τ)
//! ```

use nalgebra::{Matrix3, Rotation3, SMatrix, Vector3};

use super::{Process, Transition};
use crate::state::{ATTITUDE, Block, Layout, POSITION, Role, State, VELOCITY};

/// Errors of an accelerometer and a gyroscope, all as standard deviations. The defaults are those of consumer MEMS
/// sensors after a calibration of the accelerometer.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub struct ImuErrors {
    /// Noise of the accelerometer, m/s²/√Hz: rests of consumer MEMS recordings.
    pub accelerometer_noise: f64,
    /// Noise of the gyroscope, rad/s/√Hz: rests of consumer MEMS recordings.
    pub gyroscope_noise: f64,
    /// Bias of the accelerometer, m/s².
    pub accelerometer_bias: f64,
    /// Random walk of the accelerometer's bias, m/s²/√s: chosen on BROAD (score_navigation).
    pub accelerometer_bias_walk: f64,
    /// Bias of the gyroscope, rad/s: 1 deg/s at turn-on (datasheets), rounded up.
    pub gyroscope_bias: f64,
    /// Random walk of the gyroscope's bias, rad/s/√s: chosen on BROAD (score_navigation).
    pub gyroscope_bias_walk: f64,
    /// Scale factor and misalignment, rad, of the accelerometer.
    pub accelerometer_matrix: [f64; 2],
    /// Scale factor and misalignment, rad, of the gyroscope.
    pub gyroscope_matrix: [f64; 2],
    /// Delay of the gyroscope after the accelerometer, s: measured on BROAD.
    pub delay_s: f64,
    /// Deviation of a sample's time, s.
    pub time_s: f64,
}

impl Default for ImuErrors {
    fn default() -> Self {
        Self {
            accelerometer_noise: 0.005,
            gyroscope_noise: 2.5e-4,
            accelerometer_bias: 0.1,
            accelerometer_bias_walk: 3e-4,
            gyroscope_bias: 0.02,
            gyroscope_bias_walk: 2e-4,
            accelerometer_matrix: [0.005, 0.003],
            gyroscope_matrix: [0.01, 0.005],
            delay_s: 0.002,
            time_s: 0.0,
        }
    }
}

/// Standard deviations of the elements of a sensor matrix, by rows.
fn elements([scale, misalignment]: [f64; 2]) -> [f64; 9] {
    core::array::from_fn(|k| if k % 4 == 0 { scale } else { misalignment })
}

/// States of the strapdown model beside attitude, velocity and position.
#[derive(Clone, Copy, Debug)]
pub struct StrapdownBlocks {
    /// Bias of the gyroscope, rad/s, body frame.
    pub gyroscope_bias: Block<3>,
    /// Bias of the accelerometer, m/s², body frame.
    pub accelerometer_bias: Block<3>,
    /// M_f, by rows: considered, or estimated.
    pub accelerometer_matrix: Option<Block<9>>,
    /// M_ω, by rows: considered, or estimated.
    pub gyroscope_matrix: Option<Block<9>>,
    /// τ, s: considered.
    pub delay: Option<Block<1>>,
}

impl StrapdownBlocks {
    /// Claims the biases: six states.
    pub fn claim(layout: &mut Layout, errors: &ImuErrors) -> Self {
        Self {
            gyroscope_bias: layout.claim(Role::Estimated, [errors.gyroscope_bias; 3]),
            accelerometer_bias: layout.claim(Role::Estimated, [errors.accelerometer_bias; 3]),
            accelerometer_matrix: None,
            gyroscope_matrix: None,
            delay: None,
        }
    }

    /// Claims both sensor matrices, in a role, and the delay, unless they are known: up to 19 more.
    #[must_use]
    pub fn consider(self, layout: &mut Layout, errors: &ImuErrors, role: Role) -> Self {
        Self {
            accelerometer_matrix: layout.claim_unknown(role, elements(errors.accelerometer_matrix)),
            gyroscope_matrix: layout.claim_unknown(role, elements(errors.gyroscope_matrix)),
            delay: layout.claim_unknown(Role::Considered, [errors.delay_s]),
            ..self
        }
    }
}

/// A step between two samples.
#[derive(Clone, Copy, Debug)]
pub struct Strapdown<'a> {
    /// Its states.
    pub blocks: &'a StrapdownBlocks,
    /// Errors of the sensors.
    pub errors: &'a ImuErrors,
    /// Gravity, m/s².
    pub gravity_mps2: f64,
    /// Mean specific force of the step, m/s², body frame.
    pub force_mps2: Vector3<f64>,
    /// Mean angular rate of the step, rad/s, body frame.
    pub rate_rad_s: Vector3<f64>,
    /// Length of the step, s.
    pub step_s: f64,
}

/// The derivative of C M x with respect to the nine elements of M, by rows.
pub(crate) fn by_elements(c: &Matrix3<f64>, x: &Vector3<f64>) -> SMatrix<f64, 3, 9> {
    SMatrix::from_fn(|r, k| c[(r, k / 3)] * x[k % 3])
}

impl Process for Strapdown<'_> {
    /// First order in the step, except for the position. The effect of the considered states on the position within the
    /// step, of second order, is left out.
    fn propagate(&self, state: &mut State, transition: &mut Transition) {
        let (dt, half) = (self.step_s, 0.5);
        let mut force = self.force_mps2 - state.get(self.blocks.accelerometer_bias);
        let mut rate = self.rate_rad_s - state.get(self.blocks.gyroscope_bias);
        // Zero where they are considered.
        let matrix = |block| Matrix3::from_row_slice(state.get::<9>(block).as_slice());
        if let Some(block) = self.blocks.accelerometer_matrix {
            force -= matrix(block) * force;
        }
        if let Some(block) = self.blocks.gyroscope_matrix {
            rate -= matrix(block) * rate;
        }
        let middle = *(state.attitude * Rotation3::new(rate * (dt * half))).matrix();
        let force_nav = middle * force;
        let acceleration = force_nav - Vector3::z() * self.gravity_mps2;

        let velocity = state.get(VELOCITY);
        let position = state.get(POSITION) + (velocity + acceleration * (dt * half)) * dt;
        state.set(POSITION, position);
        state.set(VELOCITY, velocity + acceleration * dt);
        state.attitude *= Rotation3::new(rate * dt);

        let tilt = force_nav.cross_matrix() * -dt;
        transition.add(ATTITUDE, self.blocks.gyroscope_bias, middle * -dt);
        transition.add(VELOCITY, ATTITUDE, tilt);
        transition.add(VELOCITY, self.blocks.accelerometer_bias, middle * -dt);
        transition.add(POSITION, VELOCITY, Matrix3::identity() * dt);
        transition.add(POSITION, ATTITUDE, tilt * (dt * half));
        transition.add(POSITION, self.blocks.accelerometer_bias, middle * (-dt * dt * half));
        if let Some(block) = self.blocks.accelerometer_matrix {
            transition.add(VELOCITY, block, by_elements(&middle, &force) * -dt);
        }
        if let Some(block) = self.blocks.gyroscope_matrix {
            transition.add(ATTITUDE, block, by_elements(&middle, &rate) * -dt);
        }
        if let Some(block) = self.blocks.delay {
            transition.add(VELOCITY, block, tilt * middle * rate);
        }
        let square = |deviation: f64| deviation * deviation * dt;
        let jitter = acceleration.norm() * self.errors.time_s;
        transition.add_noise(ATTITUDE, square(self.errors.gyroscope_noise));
        transition.add_noise(VELOCITY, square(self.errors.accelerometer_noise) + jitter * jitter);
        transition.add_noise(self.blocks.gyroscope_bias, square(self.errors.gyroscope_bias_walk));
        let walk = square(self.errors.accelerometer_bias_walk);
        transition.add_noise(self.blocks.accelerometer_bias, walk);
    }
}
