#![doc = include_str!("../README.md")]
#![no_std]
#![forbid(unsafe_code)]

mod alignment;
mod choice;
mod covariance;
mod datasheet;
mod design;
mod estimate;
mod evidence;
mod finder;
mod force;
mod gravity;
mod input;
mod knowledge;
mod least_squares;
mod linear;
mod magnetometer;
mod model;
mod multi_position;
mod noise;
mod orientation;
mod outliers;
mod parameter;
mod pose;
mod quality;
mod reference;
mod refusal;
mod scalar;
mod self_check;
mod session;
mod shared;
mod six_position;
mod student;
mod terms;
mod turn;
mod unfitted;
mod visits;
mod weights;

pub use alignment::{
    AlignmentEstimate, AlignmentRefusal, KnownDirection, align, align_f32, straight_move,
    straight_move_f32,
};
pub use choice::{best_model, best_model_f32};
pub use covariance::Covariance;
pub use datasheet::{Datasheet, Finding, Limit, Quantity, Verdict};
pub use design::Guide;
pub use estimate::{Deviations, Drift, Estimate, Method, Misplaced, TermDeviations};
pub use finder::{Noise, PoseFinder, find_poses};
pub use gravity::{Gravity, GravityError};
pub use magnetometer::{
    Disturbed, MagneticEstimate, MagneticPose, MagneticRefusal, MirroredAxes, magnetometer,
    magnetometer_f32,
};
pub use model::{Model, MultiPosition};
pub use multi_position::{
    multi_position, multi_position_f32, multi_position_with, multi_position_with_f32,
};
pub use noise::{AllanPoint, AllanVariance, AxisNoise, Measured, NoiseRefusal, stops_at_limit};
pub use orientation::{Face, Instruction, Orientation};
pub use parameter::{Parameter, Parameters};
pub use pose::Pose;
pub use reference::{
    AxisTransfer, Line, NoiseFrom, NoiseRatio, ReferenceTransfer, Transfer, TransferRefusal,
};
pub use refusal::{Refusal, UnitHint};
pub use scalar::Scalar;
pub use self_check::{Ageing, Check, SelfCheck};
pub use session::{Phase, Session};
pub use six_position::{
    Placement, PlacementError, six_position, six_position_f32, six_position_labelled,
    six_position_labelled_f32,
};
pub use terms::{Term, Terms};
pub use turn::{four_angle, four_angle_f32, three_angle, three_angle_f32};
pub use weights::Rejected;
