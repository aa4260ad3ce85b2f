#![doc = include_str!("../README.md")]
#![no_std]
#![forbid(unsafe_code)]

pub mod array;
mod real;
pub mod slide;
pub mod unit;

pub use real::Real;
