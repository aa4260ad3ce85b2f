#![doc = include_str!("../README.md")]
#![no_std]
#![forbid(unsafe_code)]

pub mod array;
pub mod drift;
mod real;
pub mod slide;
pub mod unit;
mod unseen;
mod vector;
mod zupt;

pub use real::Real;
pub use zupt::Zupt;
