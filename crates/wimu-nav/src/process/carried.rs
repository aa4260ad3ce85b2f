//! A body that is carried, without a gyroscope: angular rate and acceleration are states. Equation (125).
//!
//! The angular rate, body frame, is a first-order Gauss–Markov process. The velocity, navigation frame, is a damped
//! oscillator:
//!
//! ```text
//! dv/dt = a,   da/dt = −2 ζ ω₀ a − ω₀² v + w
//! ```
//!
//! The motion of a hand has no acceleration power at frequency zero. A Gauss–Markov acceleration has it, and the filter
//! then takes a tilt for an acceleration. White noise of density 4 ζ ω₀ σ² keeps the acceleration at the variance σ²
//! (A. Papoulis, "Probability, Random Variables, and Stochastic Processes", second-order systems).

use nalgebra::{Matrix3, Rotation3};

use super::{Process, Transition};
use crate::state::{ATTITUDE, Block, Layout, POSITION, Role, State, VELOCITY};

/// Natural frequency ω₀, rad/s, and damping ratio ζ of the velocity: chosen on BROAD (score_navigation).
const FREQUENCY: f64 = 8.0;
const DAMPING: f64 = 0.5;
/// Random walk of the position in motion, m/√s: displacements slower than the oscillator. Chosen on simulated journeys
/// with steps and stops (score_navigation).
const WANDER: f64 = 0.15;
/// Correlation time of the angular rate, s: chosen on BROAD (score_navigation).
const RATE_TIME_S: f64 = 0.1;

/// States beside attitude, velocity and position.
#[derive(Clone, Copy, Debug)]
pub struct CarriedBlocks {
    /// Angular rate, rad/s, body frame.
    pub angular_rate: Block<3>,
    /// Acceleration, m/s², navigation frame.
    pub acceleration: Block<3>,
    /// Constant velocity of the body on which the oscillator moves, m/s, navigation frame.
    pub constant_velocity: Option<Block<3>>,
}

impl CarriedBlocks {
    /// Claims both: six states, with their initial deviations, rad/s and m/s².
    pub fn claim(layout: &mut Layout, rate_rad_s: f64, acceleration_mps2: f64) -> Self {
        Self {
            angular_rate: layout.claim(Role::Estimated, [rate_rad_s; 3]),
            acceleration: layout.claim(Role::Estimated, [acceleration_mps2; 3]),
            constant_velocity: None,
        }
    }
}

/// A step.
#[derive(Clone, Copy, Debug)]
pub struct Carried<'a> {
    /// Its states.
    pub blocks: &'a CarriedBlocks,
    /// Stationary standard deviation of the acceleration, m/s², a component.
    pub acceleration_mps2: f64,
    /// Stationary standard deviation of the angular rate, rad/s, a component.
    pub rate_rad_s: f64,
    /// Whether the unit is at rest.
    pub at_rest: bool,
    /// Length of the step, s.
    pub step_s: f64,
}

impl Process for Carried<'_> {
    fn propagate(&self, state: &mut State, transition: &mut Transition) {
        let (dt, one) = (self.step_s, 1.0);
        let CarriedBlocks { angular_rate, acceleration, constant_velocity } = *self.blocks;
        let damping = (2.0 * DAMPING * FREQUENCY) * dt;
        let spring = (FREQUENCY * FREQUENCY) * dt;
        let decay = libm::exp(-dt / RATE_TIME_S);

        transition.add(ATTITUDE, angular_rate, state.attitude.matrix() * dt);
        transition.add(VELOCITY, acceleration, Matrix3::identity() * dt);
        transition.add(POSITION, VELOCITY, Matrix3::identity() * dt);
        transition.add(POSITION, acceleration, Matrix3::identity() * (dt * dt * 0.5));
        transition.add(angular_rate, angular_rate, Matrix3::identity() * (decay - one));
        transition.add(acceleration, VELOCITY, Matrix3::identity() * -spring);
        transition.add(acceleration, acceleration, Matrix3::identity() * -damping);
        let square = |deviation: f64| deviation * deviation;
        transition.add_noise(angular_rate, square(self.rate_rad_s) * (one - square(decay)));
        transition.add_noise(acceleration, square(self.acceleration_mps2) * damping * 2.0);
        if let Some(constant) = constant_velocity {
            transition.add(POSITION, constant, Matrix3::identity() * dt);
        }
        if !self.at_rest {
            transition.add_noise(POSITION, (WANDER * WANDER) * dt);
        }

        let (v, a, rate) = (state.get(VELOCITY), state.get(acceleration), state.get(angular_rate));
        let position = state.get(POSITION) + (v + a * (dt * 0.5)) * dt;
        state.attitude *= Rotation3::new(rate * dt);
        state.set(POSITION, position);
        state.set(VELOCITY, v + a * dt);
        state.set(acceleration, a * (one - damping) - v * spring);
        state.set(angular_rate, rate * decay);
    }
}
