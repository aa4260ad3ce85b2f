//! wimu on QEMU's mps2-an386: pins, clocks, interrupts and `main`. Everything else is in `wimu-node`.
//!
//! UART0 is the wireless link, UART1 the cable, UART2 leads to the sensor, UART3 carries `defmt`
//! logs. The flash is the memory at 0x2100_0000, which QEMU keeps in a file. Command line: `free-running`, time
//! from the machine's timers, or `lockstep`, time from the host that simulates the sensor;
//! `power-loss=WORDS` ends the machine after as many written words of flash; `slow-flash=CYCLES` delays each
//! written word; `panic=MS`, `stuck=MS` and `overflow=MS` make the sensor's driver fail at a time.

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
use wimu_sensors::Lsm303agr;

use crate::bridge::BridgeI2c;
use crate::clock::BoardTimer;
use crate::data_ready::DataReady;

type Sensor = FifoSensor<Lsm303agr<BridgeI2c>, DataReady, BoardTimer>;

fn sensor(i2c: BridgeI2c, line: DataReady) -> Sensor {
    Sensor::new(Lsm303agr::new(i2c), line, BoardTimer)
}
