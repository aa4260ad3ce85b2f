//! Accelerometers at several places of one rigid body: angular rate, angular acceleration and
//! specific force without a gyroscope.
//!
//! [`Geometry`] says where they are, [`ArraySolver`] takes one sample of all of them, and
//! [`Array`] does so while leaving out those without an output. [`ArrayFilter`] navigates
//! with them.

mod available;
mod filter;
mod geometry;
mod noise;
mod rest;
mod solver;
mod state;

pub use available::{Array, SensorBits};
pub use filter::ArrayFilter;
pub use geometry::{Axis, Geometry, GeometryError};
pub use solver::{ArraySolver, Hypothesis, Linear};
pub use state::{ArrayConfig, ArrayFault, ArrayState};
