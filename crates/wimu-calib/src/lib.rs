#![doc = include_str!("../README.md")]
#![no_std]
#![forbid(unsafe_code)]

extern crate alloc;

mod alignment;
mod array;
mod combined;
mod covariance;
mod design;
mod ellipsoid;
mod estimate;
mod finder;
mod fit;
mod force;
mod gravity;
mod gyroscope;
mod input;
mod least_squares;
mod magnetometer;
mod magnitude;
mod multi_position;
mod nested;
mod noise;
mod orientation;
mod outliers;
mod parameter;
mod placement;
mod pose;
mod quality;
mod reference;
mod refusal;
mod self_check;
mod session;
mod set;
mod six_position;
mod student;
mod terms;
mod turn;
mod visits;
mod weights;

pub use alignment::{AlignmentEstimate, KnownDirection, align, straight_move};
pub use array::{ArrayEstimate, ArrayPrior, ArraySensorEstimate, calibrate_array};
pub use combined::{Combined, combine};
pub use covariance::Covariance;
pub use design::Guide;
pub use estimate::{Drift, Estimate, Sides};
pub use finder::{PoseFinder, find_poses};
pub use gravity::Gravity;
pub use gyroscope::{
    AccelerometerCalibration, GyroscopeEstimate, GyroscopeSession, SixAxisSample, TurnFault,
};
pub use magnetometer::{MagneticEstimate, MagneticPose, magnetometer};
pub use multi_position::{MultiPosition, multi_position};
pub use nested::{Nested, TestedPose, Unexplained};
pub use noise::{AllanPoint, AllanVariance, AxisNoise, Measured};
pub use orientation::{Face, Orientation};
pub use parameter::{Parameter, Parameters};
pub use placement::Placement;
pub use pose::Pose;
pub use reference::{AxisTransfer, Line, NoiseFrom, ReferenceTransfer, Transfer};
pub use refusal::{Reason, Refusal, UnitHint};
pub use self_check::{Ageing, Check, SelfCheck};
pub use session::{Phase, Session};
pub use six_position::six_position;
pub use terms::{Term, Terms};
pub use turn::{four_angle, three_angle};
pub(crate) use weights::{POSE_SCATTER_DOF, POSE_SCATTER_MPS2};
