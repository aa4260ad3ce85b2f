//! What the tests of wimu share.
//!
//! - [`Random`]: seeded random numbers, the same on every machine.
//! - [`trials`]: how many draws a statistical test takes in this lane.
//! - [`Coverage`]: whether a counted fraction is compatible with its target, from both sides.
//! - [`figure`]: prints a measured figure, and records it in a campaign.

mod coverage;
mod figure;
mod lane;
mod random;

pub use coverage::Coverage;
pub use figure::figure;
pub use lane::{Lane, trials};
pub use random::{Random, spread};
