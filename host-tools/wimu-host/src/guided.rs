//! Guided calibration of a live board: which pose is next, what was captured, the result and its push. A screen or a
//! page shows its [`GuidedView`].

mod poses;
mod session;

pub use poses::{Guidance, LivePoses, News, Plan, Uncertainty};
pub use session::{DEFAULT_FILE, Guided, GuidedView, Hold, MORE, poses_file, push, unit};
