//! Several accelerometers on one body: where they are, their calibration from the rests in a
//! recording or as it is stored, what the recording says about their places and delays, and the body's
//! motion.

mod calibration;
mod delays;
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

pub use calibration::{ArrayCalibration, SensorFit};
pub(crate) use delays::corrected_delays;
pub use fit::{Agreement, RefineOptions, Refinement, refine};
pub use geometry::{ArrayGeometry, ArraySensor};
pub use motion::{ArrayBody, ArrayMotion};
pub use presets::preset;
pub use recording::{ArrayRecording, Board, BoardOptions};
pub use rests::EvenTurn;
pub use single::{SingleAxis, navigated_axes};
pub use stored::{CalibratedArray, calibrate_array};
