#![doc = include_str!("../README.md")]
#![no_std]
#![forbid(unsafe_code)]

// One unit.
pub mod navigator;
pub mod stationarity;

// The error-state filter that it is made of.
pub mod filter;
pub mod process;
pub mod sensor;
pub mod state;

// Many accelerometers on one body.
pub mod array;

// The one-unit filter of `wimu navigate`, until it uses the navigator.
pub mod drift;
pub mod slide;
pub mod unit;

mod real;
mod rotation;
mod unseen;
mod vector;
mod zupt;

/// Standard gravity, m/s² (3rd CGPM, 1901).
pub const GRAVITY_MPS2: f64 = 9.80665;

/// Vectors, matrices and rotations of the interface.
pub use nalgebra;
pub use real::Real;
pub use zupt::Zupt;
