//! Relative motion of two units, integrated without gravity or a navigation frame. Equations (190) to (192).
//!
//! The axes of the first unit replace the navigation frame: [`ATTITUDE`] is the rotation from the second unit's axes to the
//! first's, [`VELOCITY`] and [`POSITION`] are those of the second unit from the first, in the first's axes. Gravity acts on
//! both and cancels.

use nalgebra::{Matrix3, Rotation3, Vector3};

use super::{ImuErrors, Process, Transition};
use crate::state::{ATTITUDE, Block, Layout, POSITION, Role, State, VELOCITY};

/// States of the relative motion beside attitude, velocity and position; of the first and the second unit, each in its axes.
#[derive(Clone, Copy, Debug)]
pub struct RelativeBlocks {
    /// Biases of the gyroscopes, rad/s.
    pub gyroscope_bias: [Block<3>; 2],
    /// Biases of the accelerometers, m/s².
    pub accelerometer_bias: [Block<3>; 2],
    /// Scale errors of the gyroscopes, considered.
    pub gyroscope_scale: [Block<3>; 2],
}

impl RelativeBlocks {
    /// Claims 18 states.
    pub fn claim(layout: &mut Layout, errors: &ImuErrors) -> Self {
        let mut two = |role, deviation: f64| {
            [layout.claim(role, [deviation; 3]), layout.claim(role, [deviation; 3])]
        };
        Self {
            gyroscope_bias: two(Role::Estimated, errors.gyroscope_bias),
            accelerometer_bias: two(Role::Estimated, errors.accelerometer_bias),
            gyroscope_scale: two(Role::Considered, errors.gyroscope_matrix[0]),
        }
    }
}

/// A step: means over it, of the first and the second unit, each in its axes.
#[derive(Clone, Copy, Debug)]
pub struct Relative<'a> {
    /// Length of the step, s.
    pub step_s: f64,
    /// Measured specific forces, m/s².
    pub force_mps2: [Vector3<f64>; 2],
    /// Measured angular rates, rad/s.
    pub rate_rad_s: [Vector3<f64>; 2],
    /// States of the relative motion.
    pub blocks: &'a RelativeBlocks,
    /// Errors of each unit.
    pub errors: &'a ImuErrors,
}

impl Process for Relative<'_> {
    fn propagate(&self, state: &mut State, transition: &mut Transition) {
        let dt = self.step_s;
        let one = Matrix3::identity();
        let rate = [0, 1].map(|k| self.rate_rad_s[k] - state.get(self.blocks.gyroscope_bias[k]));
        let force =
            [0, 1].map(|k| self.force_mps2[k] - state.get(self.blocks.accelerometer_bias[k]));
        let to_first = *state.attitude.matrix();
        let half = rate.map(|rate| Rotation3::new(rate * (dt * 0.5)));
        let second = to_first * (half[1] * force[1]);
        let acceleration = second - half[0] * force[0];
        let (velocity, position) = (state.get(VELOCITY), state.get(POSITION));
        let back = Rotation3::new(rate[0] * -dt);
        let turned = *back.matrix();
        state.attitude = back * state.attitude * Rotation3::new(rate[1] * dt);
        let moved = position + (velocity + acceleration * (dt * 0.5)) * dt;
        state.set(POSITION, turned * moved);
        state.set(VELOCITY, turned * (velocity + acceleration * dt));

        for block in [ATTITUDE, VELOCITY, POSITION] {
            transition.add(block, block, turned - one);
        }
        transition.add(VELOCITY, ATTITUDE, second.cross_matrix() * -dt);
        transition.add(POSITION, VELOCITY, turned * dt);
        let [first_force, second_force] = self.blocks.accelerometer_bias;
        transition.add(VELOCITY, first_force, one * dt);
        transition.add(VELOCITY, second_force, to_first * -dt);
        // An error of the first unit's rate turns all vectors in its axes.
        let scale = [0, 1].map(|k| Matrix3::from_diagonal(&rate[k]));
        let by_rate = [one * dt, to_first * -dt];
        for k in 0..2 {
            transition.add(ATTITUDE, self.blocks.gyroscope_bias[k], by_rate[k]);
            transition.add(ATTITUDE, self.blocks.gyroscope_scale[k], by_rate[k] * scale[k]);
        }
        for (block, vector) in [(VELOCITY, velocity), (POSITION, position)] {
            let carried = vector.cross_matrix() * -dt;
            transition.add(block, self.blocks.gyroscope_bias[0], carried);
            transition.add(block, self.blocks.gyroscope_scale[0], carried * scale[0]);
        }
        let square = |deviation: f64| deviation * deviation * dt;
        let jitter = acceleration.norm() * self.errors.time_s;
        transition.add_noise(ATTITUDE, 2.0 * square(self.errors.gyroscope_noise));
        let white = 2.0 * square(self.errors.accelerometer_noise);
        transition.add_noise(VELOCITY, white + jitter * jitter);
        for k in 0..2 {
            let walks = [self.errors.gyroscope_bias_walk, self.errors.accelerometer_bias_walk];
            transition.add_noise(self.blocks.gyroscope_bias[k], square(walks[0]));
            transition.add_noise(self.blocks.accelerometer_bias[k], square(walks[1]));
        }
    }
}
