#![doc = include_str!("../README.md")]
#![no_std]
#![forbid(unsafe_code)]

mod bus;
mod driver;
mod registers;
mod settings;

pub use bus::{Address, I2cBus};
pub use driver::{Adxl345, FifoLevel};
pub use settings::{DataFormat, Fifo, Interrupts, Justify, Range, Rate, Resolution, Setup};
pub use wimu_registers::{Bus, Error, SpiBus};
