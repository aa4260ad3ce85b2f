#![doc = include_str!("../README.md")]
#![no_std]
#![forbid(unsafe_code)]

#[cfg(test)]
extern crate std;

mod bus;
mod control;
mod data_ready;
mod fifo;
mod fifo_sensor;
#[cfg(feature = "flash-store")]
mod flash_store;
mod link;
mod mounting;
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

pub use bus::{BusError, TimeoutBus};
pub use control::Control;
pub use data_ready::DataReady;
pub use fifo::{FifoState, SensorFifo};
pub use fifo_sensor::{FifoChip, FifoLevel, FifoRead, FifoSensor, Range, Rate, Setup};
#[cfg(feature = "flash-store")]
pub use flash_store::{FlashLayout, FlashStore, PageFlash};
pub use link::{LinkReader, LinkWriter, NoLink};
pub use mounting::{Axis, Mounting};
pub use node::{Board, NearestRate, Node};
pub use pair::Pair;
pub use polled::{Polled, PolledPlanner, ReadCounts};
pub use sampler::Sampler;
pub use secondary::Secondary;
pub use sensor::InertialSensor;
pub use shared::{Health, LINKS, Shared};
pub use store::{Key, MAX_RECORD, Store, StoreFault, line_rate};
pub use timer::Timer;
