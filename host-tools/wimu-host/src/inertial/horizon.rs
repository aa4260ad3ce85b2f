//! How long a position can be used, and its rests.

use super::unit::median_step_s;
use super::{InertialPath, PathPoint};
use crate::plural::counted;
use crate::{Code, Problem};

/// A longer pause between samples is a gap: in s, or in median steps.
const LEAST_GAP_S: f64 = 0.25;
const GAP_STEPS: f64 = 4.0;

/// A pause between samples beyond this is a gap, s.
pub(super) fn gap_s(times_s: &[f64]) -> f64 {
    LEAST_GAP_S.max(GAP_STEPS * median_step_s(times_s))
}

/// Pauses longer than `gap_s` between times, s, at which there is a sample or a range.
pub(crate) fn gaps(times_s: &[f64], what: &str, gap_s: f64) -> Option<Problem> {
    let pauses = times_s.windows(2).map(|pair| [pair[0], pair[1]]);
    let gaps: Vec<[f64; 2]> = pauses.filter(|[from, to]| to - from > gap_s).collect();
    let longest = gaps.iter().max_by(|a, b| (a[1] - a[0]).total_cmp(&(b[1] - b[0])))?;
    let [from, to] = *longest;
    let text = format!(
        "{} without a {what}, the longest of {:.1} s: σ grows there",
        counted(gaps.len(), "time"),
        to - from
    );
    Some(Code::Rate.note(text).between(from, to))
}

/// How long a position can be used.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct Horizon {
    /// Seconds that the unit moved from the origin on: rests do not count, as far as they are
    /// taken for zero velocity, nor do gaps and jumps of time.
    pub moving_s: f64,
    /// When it ends, s, as in the file.
    pub at_s: f64,
    /// Seconds since the end of the last rest before, where there is one.
    pub since_rest_s: Option<f64>,
    /// Whether it ends for another reason than the limit: after a gap, or a move that is none.
    pub lost: bool,
}

/// The rests of a path.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct RestTimes {
    /// How many there are.
    pub rests: usize,
    /// Their length in all, s.
    pub lasted_s: f64,
}

impl InertialPath {
    /// When the standard deviation of the position from the samples up to then first passes `limit_m`, or the position is
    /// lost by a gap or a move that is none; `None` when it never does.
    pub fn horizon(&self, limit_m: f64) -> Option<Horizon> {
        let known = self.points.get(self.origin..)?;
        let start = known.iter().position(|p| p.valid).unwrap_or(0);
        let known = &known[start..];
        // Not valid below the limit that is set for the path: lost.
        let lost = |p: &PathPoint| !p.valid && p.sd_m() <= self.limit_m;
        // Not a number counts as passed.
        let end = known
            .iter()
            .position(|p| p.filtered_sd_m.is_nan() || p.filtered_sd_m > limit_m || lost(p))?;
        let at_s = known[end].time_s;
        // It is unknown whether it moved in a gap, or time jumped.
        let times_s: Vec<f64> = self.points.iter().map(|p| p.time_s).collect();
        let gap_s = gap_s(&times_s);
        let goes_on = |w: &&[PathPoint]| w[1].time_s - w[0].time_s <= gap_s;
        let moving = known[..=end].windows(2).filter(goes_on);
        let moving = moving.filter(|w| !w[1].resting);
        let rest = known[..end].iter().rfind(|p| p.resting);
        Some(Horizon {
            // The sum of none is −0.
            moving_s: moving.map(|w| w[1].time_s - w[0].time_s).sum::<f64>() + 0.0,
            at_s,
            since_rest_s: rest.map(|p| at_s - p.time_s),
            lost: lost(&known[end]),
        })
    }

    /// After how many seconds of motion that is: [`Horizon::moving_s`].
    pub fn horizon_s(&self, limit_m: f64) -> Option<f64> {
        Some(self.horizon(limit_m)?.moving_s)
    }

    /// The rests at which zero velocity was used.
    pub fn rests(&self) -> RestTimes {
        let mut found = RestTimes::default();
        let mut resting = false;
        for pair in self.points.windows(2).filter(|pair| pair[1].resting) {
            found.rests += usize::from(!pair[0].resting || !resting);
            found.lasted_s += pair[1].time_s - pair[0].time_s;
            resting = true;
        }
        found
    }
}
