//! Time without samples: equation (128).

use nalgebra::{Matrix3, RealField};

use super::{Process, Transition};
use crate::rotation::real;
use crate::state::{ATTITUDE, POSITION, State, VELOCITY};

/// Standard deviations of acceleration, m/s², and angular rate, rad/s, a component: brisk hand motion (BROAD, fast).
const ACCELERATION: f64 = 5.0;
const RATE: f64 = 2.0;

/// A step of unknown, constant acceleration and angular rate.
#[derive(Clone, Copy, Debug)]
pub struct Unmeasured<R> {
    /// Length of the step, s.
    pub step_s: R,
}

impl<R: RealField + Copy, const N: usize> Process<R, N> for Unmeasured<R> {
    fn propagate(&self, state: &mut State<R, N>, transition: &mut Transition<R, N>) {
        let dt = self.step_s;
        let moved = state.get(POSITION) + state.get(VELOCITY) * dt;
        state.set(POSITION, moved);
        transition.add(POSITION, VELOCITY, Matrix3::identity() * dt);
        let square = |x: R| x * x;
        transition.add_noise(ATTITUDE, square(dt * real(RATE)));
        transition.add_noise(VELOCITY, square(dt * real(ACCELERATION)));
        transition.add_noise(POSITION, square(dt * dt * real(0.5 * ACCELERATION)));
    }
}
