#![doc = include_str!("../README.md")]
#![no_std]
#![forbid(unsafe_code)]

extern crate alloc;

// One unit.
pub mod navigator;
pub mod stance;
pub mod stationarity;

// The error-state filter that it is made of.
pub mod consistency;
pub mod filter;
pub mod mixture;
pub mod process;
pub mod sensor;
pub mod smoother;
pub mod state;

// Many accelerometers on one body.
pub mod array;

mod rotation;

/// Standard gravity, m/s² (3rd CGPM, 1901).
pub const GRAVITY_MPS2: f64 = 9.80665;

/// Vectors, matrices and rotations of the interface.
pub use nalgebra;
