//! Accelerometers at several places of one rigid body: angular rate, angular acceleration and
//! specific force without a gyroscope.
//!
//! [`Geometry`] says where they are, [`ArraySolver`] takes one sample of all of them, and
//! [`Array`] does so while leaving out those that are dead or saturated. [`track`] follows the angular
//! rate through a recording.

mod geometry;
mod monitor;
mod solver;
mod track;

pub use geometry::{Axis, Geometry, GeometryError, Triad};
pub use monitor::{Array, Dropped, Update};
pub use solver::{ArraySolver, Hypothesis, Linear, Roots, Solution};
pub use track::{Observation, Spread, Step, Track, track};
