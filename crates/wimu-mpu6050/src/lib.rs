#![doc = include_str!("../README.md")]
#![no_std]
#![forbid(unsafe_code)]

mod driver;
mod settings;

pub use driver::{FifoLevel, Mpu6050, Sample};
pub use settings::{AccelerationRange, Address, AngularRateRange, Model, Setup};
pub use wimu_registers::{Bus, Error, SpiBus};

/// The chip on an I²C bus, up to 400 kHz. On SPI, mode 0 or 3, registers are accessed up to 1 MHz.
pub type I2cBus<I> = wimu_registers::I2cBus<I, Address>;
