//! Constant velocity with white acceleration: equation (160) (Bar-Shalom, Li and Kirubarajan, "Estimation with Applications
//! to Tracking and Navigation", 2001, section 6.2.2).

use nalgebra::{Matrix3, RealField, Vector3};

use super::{Process, Transition};
use crate::rotation::real;
use crate::state::{POSITION, State, VELOCITY};

/// A step of a body whose acceleration is white noise: for sensors of position without inertial data.
#[derive(Clone, Copy, Debug)]
pub struct ConstantVelocity<R> {
    /// Power spectral density of the acceleration in east, north and up, m²/s³. Zero where the body does not move.
    pub density: Vector3<R>,
    /// Length of the step, s.
    pub step_s: R,
}

impl<R: RealField + Copy, const N: usize> Process<R, N> for ConstantVelocity<R> {
    fn propagate(&self, state: &mut State<R, N>, transition: &mut Transition<R, N>) {
        let dt = self.step_s;
        let moved = state.get(POSITION) + state.get(VELOCITY) * dt;
        state.set(POSITION, moved);
        transition.add(POSITION, VELOCITY, Matrix3::identity() * dt);
        let noise = Matrix3::from_diagonal(&self.density) * dt;
        transition.add_covariance(VELOCITY, VELOCITY, noise);
        transition.add_covariance(POSITION, VELOCITY, noise * (dt * real(0.5)));
        transition.add_covariance(POSITION, POSITION, noise * (dt * dt / real(3.0)));
    }
}
