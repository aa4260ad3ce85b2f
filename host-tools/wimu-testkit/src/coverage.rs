//! Counted fractions against their targets.

use std::fmt;
use std::ops::{AddAssign, RangeInclusive};

use crate::figure;

/// Deviations of a binomial count beyond which chance is not the explanation: 4 σ, two-sided 6·10⁻⁵.
const DEVIATIONS: f64 = 4.0;

/// How often something held.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Coverage {
    inside: usize,
    total: usize,
}

impl Coverage {
    /// Counts one more trial.
    pub fn count(&mut self, held: bool) {
        self.inside += usize::from(held);
        self.total += 1;
    }

    /// How many trials there were.
    pub fn total(self) -> usize {
        self.total
    }

    /// The counted fraction, 0..1; NaN without a trial.
    pub fn fraction(self) -> f64 {
        self.inside as f64 / self.total as f64
    }

    /// Whether the true fraction can lie in `range`: the count departs from the nearest edge by no more
    /// than chance explains. With few trials the test is wide, with many it is the range itself.
    pub fn can_be(self, range: RangeInclusive<f64>) -> bool {
        let total = self.total as f64;
        let nearest = self.fraction().clamp(*range.start(), *range.end());
        let sd = (nearest * (1.0 - nearest) * total).sqrt();
        self.total > 0 && (self.inside as f64 - nearest * total).abs() <= DEVIATIONS * sd + 0.5
    }

    /// Asserts [`can_be`](Self::can_be).
    ///
    /// # Panics
    /// When chance does not explain the count.
    #[track_caller]
    pub fn assert_can_be(self, range: RangeInclusive<f64>, what: &str) {
        let target = percent(&range);
        assert!(self.can_be(range), "{what}: {self}, expected {target}");
    }
}

/// Records the counted fractions of several kinds, the least to the largest, as the figure of a claim.
/// It is met where each is within `target` itself, chance or not.
pub fn coverage_figure(claim: &str, kinds: &[Coverage], target: RangeInclusive<f64>) {
    let fractions = || kinds.iter().map(|kind| 100.0 * kind.fraction());
    let least = fractions().fold(f64::INFINITY, f64::min);
    let most = fractions().fold(f64::NEG_INFINITY, f64::max);
    let trials: usize = kinds.iter().map(|kind| kind.total).sum();
    let [low, high] = [least, most].map(|value| format!("{value:.1}"));
    let measured = match low == high {
        true => format!("{low} % of {trials}"),
        false => format!("{low} to {high} % of {trials}"),
    };
    let met = kinds.iter().all(|kind| target.contains(&kind.fraction()));
    figure(claim, measured, &percent(&target), met);
}

fn percent(range: &RangeInclusive<f64>) -> String {
    let (low, high) = (100.0 * range.start(), 100.0 * range.end());
    let text = |value: f64| format!("{value:.1}").trim_end_matches(".0").to_owned();
    match (low > 0.0, high < 100.0) {
        (false, false) => "any".into(),
        (false, true) if high == 0.0 => "none".into(),
        (false, true) => format!("at most {} %", text(high)),
        (true, false) if low == 100.0 => "all".into(),
        (true, false) => format!("at least {} %", text(low)),
        (true, true) => format!("{} to {} %", text(low), text(high)),
    }
}

/// Whether chance explains that the root mean square of `draws` normal numbers, over what it is expected
/// to be, is outside `range`: its relative standard deviation is 1/√(2n).
pub fn rms_ratio_can_be(ratio: f64, draws: usize, range: RangeInclusive<f64>) -> bool {
    let chance = DEVIATIONS / (2.0 * draws as f64).sqrt();
    (range.start() * (1.0 - chance)..=range.end() * (1.0 + chance)).contains(&ratio)
}

impl AddAssign for Coverage {
    fn add_assign(&mut self, more: Self) {
        self.inside += more.inside;
        self.total += more.total;
    }
}

impl FromIterator<bool> for Coverage {
    fn from_iter<I: IntoIterator<Item = bool>>(all: I) -> Self {
        let mut coverage = Self::default();
        all.into_iter().for_each(|held| coverage.count(held));
        coverage
    }
}

impl fmt::Display for Coverage {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(out, "{:.1} % of {}", 100.0 * self.fraction(), self.total)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn counted(inside: usize, total: usize) -> Coverage {
        Coverage { inside, total }
    }

    #[test]
    fn a_count_is_refused_from_both_sides_and_the_more_sharply_the_more_trials() {
        for (inside, total, held) in [
            (19, 20, true),
            (13, 20, false),
            (9500, 10_000, true),
            (9150, 10_000, false),
            (9850, 10_000, false),
        ] {
            assert_eq!(counted(inside, total).can_be(0.93..=0.97), held, "{inside} of {total}");
        }
        assert!(!Coverage::default().can_be(0.0..=1.0));
        assert!(counted(0, 20).can_be(0.0..=0.0) && !counted(1, 20).can_be(0.0..=0.0));
        assert!(counted(20, 20).can_be(1.0..=1.0) && !counted(19, 20).can_be(1.0..=1.0));
    }

    #[test]
    fn a_root_mean_square_is_refused_from_both_sides_and_the_more_sharply_the_more_draws() {
        for (ratio, draws, held) in [
            (1.4, 20, true),
            (0.5, 20, true),
            (1.7, 20, false),
            (0.3, 20, false),
            (1.02, 5000, true),
            (1.05, 5000, false),
            (0.95, 5000, false),
        ] {
            let found = rms_ratio_can_be(ratio, draws, 1.0..=1.0);
            assert_eq!(found, held, "{ratio} of {draws}");
        }
    }

    #[test]
    fn a_target_is_written_in_words() {
        for (range, words) in [
            (0.93..=0.97, "93 to 97 %"),
            (0.0..=0.005, "at most 0.5 %"),
            (0.9..=1.0, "at least 90 %"),
            (0.0..=0.0, "none"),
            (1.0..=1.0, "all"),
        ] {
            assert_eq!(percent(&range), words);
        }
    }
}
