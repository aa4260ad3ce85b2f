//! How long a position can be used, and what its rests assume.

use super::{InertialPath, PathPoint};
use crate::motion::gap_s;

/// How long a position can be used.
#[derive(Clone, Copy, Debug, PartialEq)]
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

/// What is taken for rests in a path, and what that assumes.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Stillness {
    /// How many there are, and for how long, s.
    pub rests: usize,
    /// For how long in all, s.
    pub lasted_s: f64,
    /// The largest speed at which the unit might have been moved evenly there and that would not show, m/s.
    pub unseen_mps: f64,
    /// How far even motion may have taken it by the end, one standard deviation in space, m: with [`Zupt::Assumed`](super::Zupt::Assumed) it
    /// is in the covariance.
    pub unseen_m: f64,
}

impl InertialPath {
    /// When the standard deviation of the position first passes `limit_m`, or the position is lost by a
    /// gap or a move that is none; `None` when it never does.
    pub fn horizon(&self, limit_m: f64) -> Option<Horizon> {
        let known = self.points.get(self.origin..)?;
        let start = known.iter().position(|p| p.valid).unwrap_or(0);
        let known = &known[start..];
        // Not valid below the limit that is set for the path: lost.
        let lost = |p: &PathPoint| !p.valid && p.sd_m() <= self.limit_m;
        // Not a number counts as passed.
        let end = known
            .iter()
            .position(|p| p.sd_m().is_nan() || p.sd_m() > limit_m || lost(p))?;
        let at_s = known[end].time_s;
        // Nobody knows whether it moved in a gap, or time jumped.
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

    /// What is taken for rests: `None` with ZUPT off, or where the method does not tell.
    pub fn stillness(&self) -> Option<Stillness> {
        let mut found = Stillness::default();
        for pair in self.points.windows(2) {
            let (before, now) = (&pair[0], &pair[1]);
            let Some(speed) = now.unseen_mps else {
                continue;
            };
            let step = now.time_s - before.time_s;
            if !before.resting || found.rests == 0 {
                found.rests += 1;
            }
            found.lasted_s += step;
            found.unseen_mps = found.unseen_mps.max(speed);
            found.unseen_m = self.points.last().map_or(0.0, |p| p.unseen_m);
        }
        (found.rests > 0).then_some(found)
    }
}
