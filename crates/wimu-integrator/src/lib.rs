#![doc = include_str!("../README.md")]
#![no_std]
#![forbid(unsafe_code)]

#[cfg(test)]
extern crate std;

mod attitude;
mod compass;
mod integrator;
mod rotation;
mod segment;
mod state;
mod stillness;

pub use compass::{Compass, FieldMean, MagneticHeading};
pub use integrator::{Integrator, Navigation, Transition};
pub use rotation::Rotation;
pub use segment::Segment;
pub use state::{Config, ConfigError, Flags, Phase, State, StateError};
pub use stillness::{Run, STILL_SHIFT_MPS2, STILL_SPREAD_MPS2, Window, window_steps};
