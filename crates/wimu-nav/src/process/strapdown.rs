//! Strapdown integration: angular rate and specific force are measured. Equations (113) to (116).
//!
//! Sensor models, in the body frame, with white noise n:
//!
//! ```text
//! f_measured = (1 + M_f) f + b_f + n_f
//! ω_measured = (1 + M_ω) ω + b_ω + n_ω,  late by τ:  C_true = C exp(ω τ)
//! ```

use nalgebra::{Matrix3, RealField, Rotation3, SMatrix, Vector3};

use super::{Process, Transition};
use crate::rotation::real;
use crate::state::{ATTITUDE, Block, Layout, LayoutFull, POSITION, Role, State, VELOCITY};

/// Errors of an accelerometer and a gyroscope, all as standard deviations. The defaults are those of consumer MEMS
/// sensors after a calibration of the accelerometer.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub struct ImuErrors<R> {
    /// Noise of the accelerometer, m/s²/√Hz: rests of consumer MEMS recordings.
    pub accelerometer_noise: R,
    /// Noise of the gyroscope, rad/s/√Hz: rests of consumer MEMS recordings.
    pub gyroscope_noise: R,
    /// Bias of the accelerometer, m/s².
    pub accelerometer_bias: R,
    /// Random walk of the accelerometer's bias, m/s²/√s: chosen on BROAD (score_navigation).
    pub accelerometer_bias_walk: R,
    /// Bias of the gyroscope, rad/s: 1 deg/s at turn-on (datasheets), rounded up.
    pub gyroscope_bias: R,
    /// Random walk of the gyroscope's bias, rad/s/√s: chosen on BROAD (score_navigation).
    pub gyroscope_bias_walk: R,
    /// Scale factor and misalignment, rad, of the accelerometer.
    pub accelerometer_matrix: [R; 2],
    /// Scale factor and misalignment, rad, of the gyroscope.
    pub gyroscope_matrix: [R; 2],
    /// Delay of the gyroscope after the accelerometer, s: measured on BROAD.
    pub delay_s: R,
    /// Deviation of a sample's time, s.
    pub time_s: R,
}

impl<R: RealField> Default for ImuErrors<R> {
    fn default() -> Self {
        Self {
            accelerometer_noise: real(0.005),
            gyroscope_noise: real(2.5e-4),
            accelerometer_bias: real(0.1),
            accelerometer_bias_walk: real(3e-4),
            gyroscope_bias: real(0.02),
            gyroscope_bias_walk: real(2e-4),
            accelerometer_matrix: [real(0.005), real(0.003)],
            gyroscope_matrix: [real(0.01), real(0.005)],
            delay_s: real(0.002),
            time_s: real(0.0),
        }
    }
}

/// Standard deviations of the elements of a sensor matrix, by rows.
fn elements<R: RealField + Copy>([scale, misalignment]: [R; 2]) -> [R; 9] {
    core::array::from_fn(|k| if k % 4 == 0 { scale } else { misalignment })
}

/// Sensor matrices and delay of the strapdown model: considered, or matrices that are estimated.
#[derive(Clone, Copy, Debug)]
pub struct ConsideredBlocks {
    /// M_f, by rows.
    pub accelerometer_matrix: Block<9>,
    /// M_ω, by rows.
    pub gyroscope_matrix: Block<9>,
    /// τ, s.
    pub delay: Block<1>,
}

/// States of the strapdown model beside attitude, velocity and position.
#[derive(Clone, Copy, Debug)]
pub struct StrapdownBlocks {
    /// Bias of the gyroscope, rad/s, body frame.
    pub gyroscope_bias: Block<3>,
    /// Bias of the accelerometer, m/s², body frame.
    pub accelerometer_bias: Block<3>,
    /// Sensor matrices and delay, where they are considered.
    pub considered: Option<ConsideredBlocks>,
}

impl StrapdownBlocks {
    /// Claims the biases: six states.
    ///
    /// # Errors
    /// [`LayoutFull`].
    pub fn claim<R: RealField + Copy, const N: usize>(
        layout: &mut Layout<R, N>,
        errors: &ImuErrors<R>,
    ) -> Result<Self, LayoutFull> {
        Ok(Self {
            gyroscope_bias: layout.claim(Role::Estimated, [errors.gyroscope_bias; 3])?,
            accelerometer_bias: layout.claim(Role::Estimated, [errors.accelerometer_bias; 3])?,
            considered: None,
        })
    }

    /// Claims both sensor matrices, in a role, and the delay as a considered state: 19 more.
    ///
    /// # Errors
    /// [`LayoutFull`].
    pub fn consider<R: RealField + Copy, const N: usize>(
        mut self,
        layout: &mut Layout<R, N>,
        errors: &ImuErrors<R>,
        role: Role,
    ) -> Result<Self, LayoutFull> {
        self.considered = Some(ConsideredBlocks {
            accelerometer_matrix: layout.claim(role, elements(errors.accelerometer_matrix))?,
            gyroscope_matrix: layout.claim(role, elements(errors.gyroscope_matrix))?,
            delay: layout.claim(Role::Considered, [errors.delay_s])?,
        });
        Ok(self)
    }
}

/// A step between two samples.
#[derive(Clone, Copy, Debug)]
pub struct Strapdown<'a, R> {
    /// Its states.
    pub blocks: &'a StrapdownBlocks,
    /// Errors of the sensors.
    pub errors: &'a ImuErrors<R>,
    /// Gravity, m/s².
    pub gravity_mps2: R,
    /// Mean specific force of the step, m/s², body frame.
    pub force_mps2: Vector3<R>,
    /// Mean angular rate of the step, rad/s, body frame.
    pub rate_rad_s: Vector3<R>,
    /// Length of the step, s.
    pub step_s: R,
}

/// The derivative of C M x with respect to the nine elements of M, by rows.
pub(crate) fn by_elements<R: RealField + Copy>(c: &Matrix3<R>, x: &Vector3<R>) -> SMatrix<R, 3, 9> {
    SMatrix::from_fn(|r, k| c[(r, k / 3)] * x[k % 3])
}

impl<R: RealField + Copy, const N: usize> Process<R, N> for Strapdown<'_, R> {
    /// First order in the step, except for the position. The effect of the considered states on the position within the
    /// step, of second order, is left out.
    fn propagate(&self, state: &mut State<R, N>, transition: &mut Transition<R, N>) {
        let (dt, half) = (self.step_s, real::<R>(0.5));
        let mut force = self.force_mps2 - state.get(self.blocks.accelerometer_bias);
        let mut rate = self.rate_rad_s - state.get(self.blocks.gyroscope_bias);
        if let Some(matrices) = &self.blocks.considered {
            // Zero where they are considered.
            let matrix = |block| Matrix3::from_row_slice(state.get::<9>(block).as_slice());
            force -= matrix(matrices.accelerometer_matrix) * force;
            rate -= matrix(matrices.gyroscope_matrix) * rate;
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
        if let Some(considered) = &self.blocks.considered {
            let by_force = by_elements(&middle, &force) * -dt;
            let by_rate = by_elements(&middle, &rate) * -dt;
            transition.add(VELOCITY, considered.accelerometer_matrix, by_force);
            transition.add(ATTITUDE, considered.gyroscope_matrix, by_rate);
            transition.add(VELOCITY, considered.delay, tilt * middle * rate);
        }
        let square = |deviation: R| deviation * deviation * dt;
        let jitter = acceleration.norm() * self.errors.time_s;
        transition.add_noise(ATTITUDE, square(self.errors.gyroscope_noise));
        transition.add_noise(VELOCITY, square(self.errors.accelerometer_noise) + jitter * jitter);
        transition.add_noise(self.blocks.gyroscope_bias, square(self.errors.gyroscope_bias_walk));
        let walk = square(self.errors.accelerometer_bias_walk);
        transition.add_noise(self.blocks.accelerometer_bias, walk);
    }
}
