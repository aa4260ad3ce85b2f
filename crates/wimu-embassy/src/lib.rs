#![doc = include_str!("../README.md")]
#![no_std]
#![forbid(unsafe_code)]

#[cfg(test)]
extern crate std;

mod flash;
mod identity;
mod light;
mod packets;
mod start;
mod supervisor;
mod tasks;

pub use embassy_executor;
pub use embassy_sync::blocking_mutex::raw::CriticalSectionRawMutex as Mutex;
pub use flash::BlockingFlash;
pub use identity::hello;
pub use light::attend;
pub use packets::{PacketLink, PacketReader, PacketWriter};
pub use start::{Start, StartRecord};
pub use supervisor::{LIMITS_US, Supervisor, supervise};
pub use {wimu_link, wimu_node};
