#![doc = include_str!("../README.md")]
#![no_std]
#![forbid(unsafe_code)]

#[cfg(test)]
extern crate std;

mod board;
#[cfg(feature = "time")]
mod clock;
mod flash;
mod identity;
mod light;
mod packets;
mod start;
mod supervisor;
mod tasks;
#[cfg(feature = "usb")]
mod usb;

#[cfg(feature = "time")]
pub use clock::BoardTimer;
pub use embassy_executor;
pub use embassy_sync::blocking_mutex::raw::CriticalSectionRawMutex as Mutex;
pub use flash::BlockingFlash;
pub use identity::hello;
pub use light::attend;
pub use packets::{PacketLink, PacketReader, PacketWriter};
pub use start::{Start, StartRecord};
pub use supervisor::{LIMITS_US, Supervisor, supervise, without_limit};
#[cfg(feature = "usb")]
pub use usb::{UsbIdentity, UsbMemory, run_usb};
pub use {wimu_link, wimu_node};
