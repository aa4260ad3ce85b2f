//! Constant acceleration in the navigation frame: equation (168).

use nalgebra::{Matrix3, RealField};

use super::{Process, Transition};
use crate::rotation::real;
use crate::state::{Block, POSITION, State, VELOCITY};

/// A step with a constant acceleration beside that of another process: the error of gravity in a frame that is not level,
/// such as that of surveyed anchors.
#[derive(Clone, Copy, Debug)]
pub struct AccelerationOffset<R> {
    /// The acceleration, m/s², navigation frame.
    pub block: Block<3>,
    /// Length of the step, s.
    pub step_s: R,
}

impl<R: RealField + Copy, const N: usize> Process<R, N> for AccelerationOffset<R> {
    fn propagate(&self, state: &mut State<R, N>, transition: &mut Transition<R, N>) {
        let dt = self.step_s;
        let half = dt * dt * real(0.5);
        let acceleration = state.get(self.block);
        state.set(POSITION, state.get(POSITION) + acceleration * half);
        state.set(VELOCITY, state.get(VELOCITY) + acceleration * dt);
        transition.add(VELOCITY, self.block, Matrix3::identity() * dt);
        transition.add(POSITION, self.block, Matrix3::identity() * half);
    }
}
