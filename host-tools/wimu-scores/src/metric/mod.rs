//! The figures of each metric.

mod bodies;
mod path;
mod simulated;
mod vehicle;

use crate::case::Case;
use crate::manifest::{Metric, Source};
use crate::score::Score;
use crate::table::Result;

/// Scores an estimator on a recording.
pub fn score(case: &Case, source: Source) -> Result<Score> {
    match case.entry.metric {
        Metric::Windows => path::windows(case, source),
        Metric::Track => path::track(case, source),
        Metric::Walk => path::walk(case, source),
        Metric::Ranges => path::ranges(case, source),
        Metric::Outages => vehicle::outages(case, source),
        Metric::Starts => vehicle::starts(case, source),
        Metric::Rate => bodies::rate(case, source),
        Metric::Angle => bodies::angle(case, source),
        Metric::HandEye => bodies::hand_eye(case),
        Metric::MultiRange => simulated::multi_range(case, source),
        Metric::Journeys => simulated::journeys(case, source),
    }
}
