#![doc = include_str!("../README.md")]
#![forbid(unsafe_code)]

pub mod alignment;
pub mod allan;
pub mod apply;
pub mod array;
pub mod calibration;
pub mod chart;
pub mod client;
pub mod clock;
pub mod compare;
pub mod csv;
pub mod decode;
pub mod digits;
mod error;
pub mod export;
pub mod finding;
pub mod formats;
pub mod hand_eye;
pub mod history;
pub mod html;
pub mod inertial;
pub mod keys;
mod link_url;
pub mod live;
pub mod localization;
pub mod mcap_file;
pub mod monitor;
pub mod motion;
pub mod navigation;
mod output_file;
pub mod plural;
pub mod progress;
pub mod recorder;
pub mod recording;
pub mod replay;
pub mod ros;
mod standard_input;
mod stats;
pub mod stream;
pub mod transport;
pub mod units;
pub mod walk;

pub use error::{ErrorCode, HostError, Result};
pub use link_url::{DEFAULT_BAUD, Input, LinkUrl};
pub use output_file::OutputFile;
pub use standard_input::StandardInput;
