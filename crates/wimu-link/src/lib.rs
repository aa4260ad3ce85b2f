#![doc = include_str!("../README.md")]
#![no_std]
#![forbid(unsafe_code)]

#[cfg(test)]
extern crate std;

pub mod auth;
pub mod batch;
mod bits;
pub mod frame;
pub mod hello;
pub mod message;
#[cfg(feature = "auth")]
pub mod requester;
pub mod responder;
pub mod stream;
#[cfg(feature = "auth")]
pub mod tag;

pub use batch::Batch;
pub use frame::{
    Deframer, EncodeError, Frame, FrameError, Kind, MAX_BODY, MAX_FRAME, WIRE_VERSION,
};
pub use hello::{Hello, LinkRole, WhoAreYou, WriteAccess};
pub use message::{Answer, Command, Reply, Request, Settings, Telemetry};
#[cfg(feature = "auth")]
pub use requester::Requester;
pub use responder::Responder;
pub use wimu_model::checksum::crc_32c;
