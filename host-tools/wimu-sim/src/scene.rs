//! The environment of the sensor: motion, gravity, the Earth's field, temperature.

use std::cell::RefCell;
use std::rc::Rc;

use wimu_model::STANDARD_GRAVITY_MPS2;

use crate::attitude::Attitude;
use crate::motion::{Motion, Sequence};

/// The true state of the body at one time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BodyState {
    /// Specific force, m/s², body axes; at rest it is +g upward. Equation (30).
    pub specific_force_mps2: [f64; 3],
    /// Magnetic flux density, nT, body axes, before the sensor's hard and soft iron.
    pub magnetic_field_nt: [f64; 3],
    /// Position, m, east-north-up, from where the scene began.
    pub position_m: [f64; 3],
    /// Velocity, m/s, east-north-up.
    pub velocity_mps: [f64; 3],
    /// Acceleration, m/s², east-north-up.
    pub acceleration_mps2: [f64; 3],
    /// Body axes against east-north-up.
    pub attitude: Attitude,
    /// Angular rate against east-north-up, rad/s, body axes. The Earth's rotation is not simulated.
    pub angular_rate_radps: [f64; 3],
    /// Temperature of the sensor, °C.
    pub temperature_c: f64,
}

/// Constant conditions.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct World {
    /// Local gravity, m/s², downward.
    pub gravity_mps2: f64,
    /// The Earth's magnetic flux density, nT, east-north-up.
    pub field_enu_nt: [f64; 3],
    /// Temperature of the sensor over time.
    pub temperature: Temperature,
}

impl Default for World {
    /// Standard gravity, 20 µT north and 44 µT down, 25 °C.
    fn default() -> Self {
        Self {
            gravity_mps2: STANDARD_GRAVITY_MPS2,
            field_enu_nt: [0.0, 20_000.0, -44_000.0],
            temperature: Temperature::Constant(25.0),
        }
    }
}

/// Temperature over time, °C.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Temperature {
    /// Constant.
    Constant(f64),
    /// Linear between two times, s, the second after the first.
    Ramp {
        /// °C up to `start_s`.
        from_c: f64,
        /// °C from `end_s`.
        to_c: f64,
        /// When it begins to change, s.
        start_s: f64,
        /// When it has changed, s.
        end_s: f64,
    },
    /// A step.
    Step {
        /// °C before `at_s`.
        before_c: f64,
        /// °C from `at_s`.
        after_c: f64,
        /// When it changes, s.
        at_s: f64,
    },
}

impl Temperature {
    /// °C at `time_s`.
    pub fn at(&self, time_s: f64) -> f64 {
        match *self {
            Self::Constant(celsius) => celsius,
            Self::Ramp { from_c, to_c, start_s, end_s } => {
                let fraction = (time_s - start_s) / (end_s - start_s);
                from_c + (to_c - from_c) * fraction.clamp(0.0, 1.0)
            }
            Self::Step { before_c, after_c, at_s } => {
                if time_s < at_s {
                    before_c
                } else {
                    after_c
                }
            }
        }
    }
}

/// A world and the motions played in it; clones share the motions, so that a test can add one
/// while the sensor runs, and get the truth at any time.
#[derive(Clone, Debug)]
pub struct Scene {
    world: World,
    played: Rc<RefCell<Sequence>>,
}

impl Scene {
    /// The body rests level at the origin until a motion is played.
    pub fn new(world: World) -> Self {
        Self { world, played: Rc::default() }
    }

    /// Plays `motion` from `start_s` on, s on the simulation's clock, or from the end of the last one
    /// if that is later, after a smooth rotation to its first attitude. Returns when the
    /// motion begins, s.
    pub fn play(&self, start_s: f64, motion: Rc<dyn Motion>) -> f64 {
        self.played.borrow_mut().push_at(start_s, motion)
    }

    /// End of everything played so far, s; 0 if nothing was.
    pub fn end_s(&self) -> f64 {
        self.played.borrow().duration()
    }

    /// The true state at `time_s` on the simulation's clock, past or future.
    pub fn state(&self, time_s: f64) -> BodyState {
        let pose = self.played.borrow().pose(time_s);
        let [east, north, up] = pose.acceleration_mps2;
        let force_enu = [east, north, up + self.world.gravity_mps2];
        BodyState {
            specific_force_mps2: pose.attitude.to_body(force_enu),
            magnetic_field_nt: pose.attitude.to_body(self.world.field_enu_nt),
            position_m: pose.position_m,
            velocity_mps: pose.velocity_mps,
            acceleration_mps2: pose.acceleration_mps2,
            attitude: pose.attitude,
            angular_rate_radps: pose.angular_rate_radps,
            temperature_c: self.world.temperature.at(time_s),
        }
    }
}
