#![doc = include_str!("../README.md")]
#![forbid(unsafe_code)]

pub mod calibration;
pub mod client;
pub mod csv;
pub mod dataset;
pub mod decode;
mod error;
pub mod export;
mod link_url;
pub mod navigation;
pub mod reading;
pub mod record;
pub mod recorder;
pub mod recording;
pub mod replay;
pub mod report;
pub mod transport;

pub use error::{ErrorCode, HostError, Result};
pub use link_url::{DEFAULT_BAUD, Input, LinkUrl};
