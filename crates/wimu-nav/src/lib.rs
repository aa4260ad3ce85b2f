#![doc = include_str!("../README.md")]
#![no_std]
#![forbid(unsafe_code)]

pub mod array;
pub mod drift;
pub mod filter;
pub mod navigator;
pub mod process;
mod real;
mod rotation;
pub mod sensor;
pub mod slide;
pub mod state;
pub mod stationarity;
pub mod unit;
mod unseen;
mod vector;
mod zupt;

/// Standard gravity, m/s² (3rd CGPM, 1901).
pub const GRAVITY_MPS2: f64 = 9.80665;

pub use real::Real;
pub use zupt::Zupt;
