//! What the tests of wimu share.
//!
//! - [`Random`]: seeded random numbers, the same on every machine.
//! - [`trials`]: how many draws a statistical test takes in this lane.
//! - [`Coverage`]: whether a counted fraction is compatible with its target, from both sides;
//!   [`rms_ratio_can_be`] the same of a root mean square. [`coverage_figure`] records fractions.
//! - [`figure`]: prints a measured figure, and records it in a campaign.

mod coverage;
mod figure;
mod lane;
mod random;

pub use coverage::{Coverage, coverage_figure, rms_ratio_can_be};
pub use figure::figure;
pub use lane::{Lane, trials};
pub use random::{Random, spread};
