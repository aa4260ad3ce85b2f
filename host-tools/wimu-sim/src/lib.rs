#![doc = include_str!("../README.md")]
#![forbid(unsafe_code)]

pub mod adxl345;
pub mod attitude;
pub mod board;
mod chip;
pub mod clock;
pub mod faults;
pub mod i2c;
pub mod icm42688;
pub mod lsm303agr;
pub mod lsm6dso;
pub mod motion;
pub mod mpu6050;
pub mod multi_range;
mod part;
pub mod pipe;
mod random;
mod sampling;
pub mod scenario;
pub mod scene;
pub mod sensor;
pub mod server;
pub mod source;
pub mod spi;
pub mod storage;
pub mod truth;
pub mod walk;
