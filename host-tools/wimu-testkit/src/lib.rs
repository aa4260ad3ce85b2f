//! What the tests of wimu share.
//!
//! - [`Random`]: seeded random numbers, the same on every machine.
//! - [`trials`], [`draws`]: how many draws a statistical test takes in this lane; [`cases`] the same of a property.
//! - [`Coverage`]: whether a counted fraction is compatible with its target, from both sides; [`rms_ratio_can_be`] and
//!   [`assert_median_can_be`] the same of a root mean square and of a median. Chance crosses a bound with a probability of
//!   10⁻⁶ ([`binomial_quantile`]). [`coverage_figure`] records fractions.
//! - [`figure`]: prints a measured figure, and records it in a campaign.

mod coverage;
mod figure;
mod lane;
mod random;

pub use coverage::{
    Coverage, assert_median_can_be, binomial_quantile, coverage_figure, rms_ratio_can_be,
};
pub use figure::figure;
pub use lane::{Lane, cases, draws, trials};
pub use random::{Random, spread};
