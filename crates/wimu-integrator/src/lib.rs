#![doc = include_str!("../README.md")]
#![no_std]
#![forbid(unsafe_code)]

#[cfg(test)]
extern crate std;

mod attitude;
mod compass;
mod inertial;
mod integrator;
mod rotation;
mod segment;
mod state;
mod stationarity;

pub use compass::{FieldMean, MagneticHeading};
pub use inertial::{Gyroscope, Inertial, RotationState, Saturation};
pub use integrator::{Integrator, Navigation, Transition};
pub use rotation::Rotation;
pub use segment::Segment;
pub use state::{Config, ConfigError, Flags, Phase, State, StateError};
pub use stationarity::{REST_MEAN_TOLERANCE_MPS2, REST_SD_MPS2, Run, Window, window_steps};
