//! Counted fractions against their targets.

use std::fmt;
use std::ops::RangeInclusive;

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
        let (low, high) = (100.0 * range.start(), 100.0 * range.end());
        assert!(
            self.can_be(range),
            "{what}: {self}, expected {low:.1} to {high:.1} %"
        );
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
            assert_eq!(
                counted(inside, total).can_be(0.93..=0.97),
                held,
                "{inside} of {total}"
            );
        }
        assert!(!Coverage::default().can_be(0.0..=1.0));
    }
}
