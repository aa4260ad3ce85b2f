//! Guided calibration of a live board: which pose is next, what was captured, the result and its push. A screen or a
//! page shows its [`GuidedView`].

mod capture;
mod plan;
mod session;

pub use capture::Hold;
pub use plan::{Plan, Uncertainty};
pub use session::{DEFAULT_FILE, Guided, GuidedView, push};
