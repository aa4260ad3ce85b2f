#![doc = include_str!("../README.md")]
#![no_std]
#![forbid(unsafe_code)]

mod estimate;
mod finder;
mod gravity;
mod input;
mod least_squares;
mod multi_position;
mod orientation;
mod parameter;
mod pose;
mod quality;
mod reference;
mod refusal;
mod six_position;

pub use estimate::{Covariance, Deviations, Estimate, Method};
pub use finder::{Noise, PoseFinder, find_poses};
pub use gravity::{Gravity, GravityError};
pub use multi_position::{Model, multi_position};
pub use orientation::{Face, Orientation};
pub use parameter::{Parameter, Parameters};
pub use pose::Pose;
pub use reference::{AxisTransfer, Line, NoiseRatio, ReferenceTransfer, Transfer, TransferRefusal};
pub use refusal::{Refusal, UnitHint};
pub use six_position::{Placement, PlacementError, six_position, six_position_labelled};
