//! Several accelerometers on one body: where they are, their calibration from the rests in a
//! recording or as it is stored, what the recording says about their places and delays, and the body's
//! motion.

mod calibration;
mod fit;
mod geometry;
mod health;
mod motion;
mod outputs;
mod presets;
mod recording;
mod rests;
mod single;
mod stored;
mod survey;

pub use calibration::{ArrayCalibration, SensorFit};
pub use fit::{Agreement, RefineOptions, Refinement, refine};
pub use geometry::{ArrayGeometry, ArraySensor};
pub use motion::{ArrayBody, ArrayMotion};
pub use presets::preset;
pub use recording::{ArrayRecording, Board, BoardOptions};
pub use rests::EvenTurn;
pub use single::{SingleAxis, navigated_axes};
pub use stored::{CalibratedArray, calibrate_array};
pub(crate) use survey::repaired;
