//! Several accelerometers on one body: where they are, their calibration from the rests in a recording or as it is stored,
//! and the body's motion.

mod agreement;
mod calibration;
mod directions;
mod geometry;
mod health;
mod motion;
mod outputs;
mod rests;
mod samples;
mod size;
mod stored;

pub use agreement::Agreement;
pub use calibration::{ArrayCalibration, SensorFit};
pub use geometry::{ArrayGeometry, ArraySensor};
pub use motion::ArrayBody;
pub use rests::EvenTurn;
pub use samples::{Array, ArrayUnit};
pub use stored::{CalibratedArray, calibrate_array};
