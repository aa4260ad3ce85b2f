//! The same board with an LSM6DSO: accelerometer and gyroscope.

#![no_std]
#![no_main]

mod bridge;
mod clock;
mod data_ready;
mod interrupts;
mod lockstep;
mod log;
mod node;
mod register;
mod semihosting;
mod store;
mod uart;
mod watchdog;

use wimu_node::Lsm6dso;
use wimu_node::wimu_lsm6dso::{Address, I2cBus};

use crate::bridge::BridgeI2c;
use crate::clock::BoardTimer;
use crate::data_ready::DataReady;

type Sensor = Lsm6dso<I2cBus<BridgeI2c>, DataReady, BoardTimer>;

fn sensor(i2c: BridgeI2c, line: DataReady) -> Sensor {
    let address = Address::Low;
    Sensor::new(I2cBus { i2c, address }, line, BoardTimer)
}
