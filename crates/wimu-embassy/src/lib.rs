#![doc = include_str!("../README.md")]
#![no_std]
#![forbid(unsafe_code)]

#[cfg(test)]
extern crate std;

mod identity;
mod start;
mod tasks;

pub use embassy_executor;
pub use embassy_sync::blocking_mutex::raw::CriticalSectionRawMutex as Mutex;
pub use identity::hello;
pub use start::{Start, StartRecord};
pub use {wimu_link, wimu_node};
