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

use wimu_node::FifoSensor;
use wimu_sensors::{I2cBus, Lsm6dso};

use crate::bridge::BridgeI2c;
use crate::clock::BoardTimer;
use crate::data_ready::DataReady;

type Chip = Lsm6dso<I2cBus<BridgeI2c>>;
type Sensor = FifoSensor<Chip, DataReady, BoardTimer>;

fn sensor(i2c: BridgeI2c, line: DataReady) -> Sensor {
    Sensor::new(Chip::new(I2cBus { i2c, address: Chip::ADDRESS }), line, BoardTimer)
}
