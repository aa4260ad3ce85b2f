#![doc = include_str!("../README.md")]
#![no_std]
#![forbid(unsafe_code)]

mod bus;
mod driver;
mod error;
mod fifo;
mod registers;
mod self_test;
mod settings;

pub use bus::{Address, Bus, I2cBus, SpiBus};
pub use driver::Lsm6dso;
pub use error::Error;
pub use fifo::{Batch, FifoFault, Sample};
pub use self_test::SelfTest;
pub use settings::{AccelerationRange, AngularRateRange, Power, Rate, Setup};
