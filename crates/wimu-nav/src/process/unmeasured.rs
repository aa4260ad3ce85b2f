//! Time without samples: equation (128).

use nalgebra::{Matrix3, RealField};

use super::{Process, Transition};
use crate::rotation::real;
use crate::state::{ATTITUDE, POSITION, State, VELOCITY};

/// Standard deviations of acceleration, m/s², and angular rate, rad/s, a component: brisk hand motion (BROAD, fast).
const ACCELERATION: f64 = 5.0;
const RATE: f64 = 2.0;

/// Time after which they have changed, s: that of a gesture or a step.
const CONSTANT_S: f64 = 1.0;

/// A step of unknown acceleration and angular rate, which are constant for a second: steps that follow one another are as
/// uncertain as one of their length.
#[derive(Clone, Copy, Debug)]
pub struct Unmeasured<R> {
    /// Length of the step, s.
    pub step_s: R,
    /// Time without samples before it, s.
    pub since_s: R,
}

impl<R: RealField + Copy, const N: usize> Process<R, N> for Unmeasured<R> {
    fn propagate(&self, state: &mut State<R, N>, transition: &mut Transition<R, N>) {
        let dt = self.step_s;
        let moved = state.get(POSITION) + state.get(VELOCITY) * dt;
        state.set(POSITION, moved);
        transition.add(POSITION, VELOCITY, Matrix3::identity() * dt);
        // (since + dt)² − since²
        let square_s = dt * (dt + self.since_s.min(real(CONSTANT_S)) * real(2.0));
        transition.add_noise(ATTITUDE, square_s * real(RATE * RATE));
        transition.add_noise(VELOCITY, square_s * real(ACCELERATION * ACCELERATION));
        let quarter = real::<R>(0.25 * ACCELERATION * ACCELERATION);
        transition.add_noise(POSITION, square_s * dt * dt * quarter);
    }
}
