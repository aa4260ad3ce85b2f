#![doc = include_str!("../README.md")]
#![forbid(unsafe_code)]

pub mod attitude;
pub mod board;
pub mod bridge;
pub mod clock;
pub mod faults;
pub mod i2c;
pub mod lsm303agr;
pub mod motion;
pub mod pipe;
#[cfg(unix)]
pub mod qemu;
mod random;
pub mod scenario;
pub mod scene;
pub mod server;
pub mod source;
pub mod storage;
pub mod truth;
