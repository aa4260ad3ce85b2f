//! Several accelerometers on one body: where they are, their calibration from the rests in a
//! recording or as it is stored, what the recording says about their places and delays, and the body's
//! motion.

mod agreement;
mod calibration;
mod departures;
mod geometry;
mod health;
mod motion;
mod places;
mod presets;
mod recording;
mod refine;
mod rests;
mod single;
mod stored;
mod survey;

pub use agreement::Agreement;
pub use calibration::ArrayCalibration;
pub use geometry::{ArrayGeometry, ArraySensor};
pub use motion::{ArrayMotion, angular_rate, navigated};
pub use presets::preset;
pub use recording::{ArrayRecording, Board, BoardOptions};
pub use refine::{RefineOptions, Refinement, refine};
pub use rests::EvenTurn;
pub use single::{SingleAxis, navigated_axes};
pub use stored::{CalibratedArray, calibrate_array};
pub(crate) use survey::repaired;
pub use survey::{Survey, surveyed};
