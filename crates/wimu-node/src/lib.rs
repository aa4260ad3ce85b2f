#![doc = include_str!("../README.md")]
#![no_std]
#![forbid(unsafe_code)]

#[cfg(test)]
extern crate std;

mod adxl345;
mod bus;
mod control;
mod data_ready;
mod fifo;
#[cfg(feature = "flash-store")]
mod flash_store;
mod link;
mod lsm303agr;
mod lsm6dso;
mod mounting;
mod mpu6050;
mod node;
mod pair;
mod polled;
mod queue;
mod sample;
mod sampler;
mod secondary;
pub mod sensor;
mod shared;
mod slot;
mod store;
mod timer;

pub use adxl345::Adxl345;
pub use bus::{BusError, TimeoutBus};
pub use control::Control;
pub use data_ready::DataReady;
pub use fifo::{FifoState, SensorFifo};
#[cfg(feature = "flash-store")]
pub use flash_store::{FlashLayout, FlashStore, PageFlash};
pub use link::{LinkReader, LinkWriter, NoLink};
pub use lsm6dso::{Lsm6ds3trC, Lsm6dso};
pub use lsm303agr::Lsm303agr;
pub use mounting::{Axis, Mounting};
pub use mpu6050::Mpu6050;
pub use node::{Board, NearestRate, Node};
pub use pair::Pair;
pub use polled::{Polled, PolledPlanner, ReadCounts};
pub use sampler::Sampler;
pub use secondary::Secondary;
pub use sensor::InertialSensor;
pub use shared::{Health, LINKS, Shared};
pub use store::{Key, MAX_RECORD, Store, StoreFault, line_rate};
pub use timer::Timer;
pub use {wimu_adxl345, wimu_lsm6dso, wimu_mpu6050};
