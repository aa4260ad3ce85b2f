#![doc = include_str!("../README.md")]
#![no_std]
#![forbid(unsafe_code)]

mod bus;
mod driver;
mod error;
mod registers;
mod self_test;
mod settings;

pub use bus::{Address, Bus, I2cBus, SpiBus};
pub use driver::{Adxl345, FifoLevel};
pub use error::Error;
pub use self_test::SelfTest;
pub use settings::{DataFormat, Fifo, Interrupts, Justify, Range, Rate, Resolution, Setup};
