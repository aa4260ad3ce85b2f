#![doc = include_str!("../README.md")]
#![no_std]
#![forbid(unsafe_code)]

mod bus;
mod driver;
mod fifo;
mod registers;
mod settings;

pub use bus::{Address, I2cBus};
pub use driver::{Lsm6dso, Model};
pub use fifo::{Batch, FifoFault, Sample};
pub use settings::{AccelerationRange, AngularRateRange, Power, Rate, Setup};
pub use wimu_registers::{Bus, Error, SpiBus};
