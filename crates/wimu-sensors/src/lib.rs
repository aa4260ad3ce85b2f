#![doc = include_str!("../README.md")]
#![no_std]
#![forbid(unsafe_code)]

mod adxl345;
mod bus;
mod lsm303agr;
mod lsm6dso;
mod mpu6050;

pub use adxl345::Adxl345;
pub use bus::{Bus, I2cBus, SpiBus, SpiRead};
pub use lsm6dso::{Lsm6ds3trC, Lsm6dso};
pub use lsm303agr::Lsm303agr;
pub use mpu6050::Mpu6050;

/// The temperature of ST's sensors: 1/256 °C per LSB, relative to 25 °C.
fn temperature(bytes: [u8; 2]) -> wimu_model::CentiCelsius {
    let centi = 2500 + i32::from(i16::from_le_bytes(bytes)) * 100 / 256;
    wimu_model::CentiCelsius(centi as i16)
}
