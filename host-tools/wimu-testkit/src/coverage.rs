//! Counted fractions against their targets.

use std::fmt;
use std::iter::Sum;
use std::ops::{AddAssign, RangeInclusive};

use crate::figure;

/// Probability with which chance alone crosses a bound, at each of its ends.
const CHANCE: f64 = 1e-6;
/// Deviations of a normal number that chance crosses as often: Φ⁻¹(1 − 10⁻⁶).
const DEVIATIONS: f64 = 4.7534;

/// Quantile of the binomial distribution: the least count k of `draws` draws, each with probability `p`, for which P(X ≤ k)
/// reaches `probability`.
pub fn binomial_quantile(draws: usize, p: f64, probability: f64) -> usize {
    if p <= 0.0 || p >= 1.0 {
        return if p <= 0.0 { 0 } else { draws };
    }
    let (mut log_mass, mut sum) = (draws as f64 * (-p).ln_1p(), 0.0);
    for k in 0..draws {
        sum += log_mass.exp();
        if sum >= probability {
            return k;
        }
        log_mass += ((draws - k) as f64 / (k + 1) as f64 * p / (1.0 - p)).ln();
    }
    draws
}

/// The fewest draws of which a fault that lowers a fraction from `right` to `wrong` fails [`Coverage::can_be`] in 99 of 100
/// runs.
pub fn fewest_draws(right: f64, wrong: f64) -> usize {
    let fails = |&draws: &usize| {
        binomial_quantile(draws, wrong, 0.99) < binomial_quantile(draws, right, CHANCE)
    };
    (1..).find(fails).expect("a fault lowers the fraction")
}

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

    /// Whether the true fraction can lie in `range`: chance crosses the bound with a probability of 10⁻⁶ at an edge, less within.
    /// With few trials the test is wide, with many it is the range itself.
    pub fn can_be(self, range: RangeInclusive<f64>) -> bool {
        let least = binomial_quantile(self.total, *range.start(), CHANCE);
        let least_outside = binomial_quantile(self.total, 1.0 - range.end(), CHANCE);
        self.total > 0 && self.inside >= least && self.total - self.inside >= least_outside
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
    let measured = if low == high {
        format!("{low} % of {trials}")
    } else {
        format!("{low} to {high} % of {trials}")
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

/// Whether the root mean square of `draws` normal numbers, over what it is expected to be, can lie in `range`: chance crosses
/// the bound with a probability of 10⁻⁶ at each end. The quantiles of χ² are those of Wilson and Hilferty (1931).
pub fn rms_ratio_can_be(ratio: f64, draws: usize, range: RangeInclusive<f64>) -> bool {
    let variance = 2.0 / (9.0 * draws as f64);
    let quantile =
        |deviations: f64| (1.0 - variance + deviations * variance.sqrt()).max(0.0).powf(1.5);
    (range.start() * quantile(-DEVIATIONS)..=range.end() * quantile(DEVIATIONS)).contains(&ratio)
}

/// Asserts that the median of a quantity can lie in `range`: at most half of `values` are below its start, at least half
/// below its end, but for chance.
///
/// # Panics
/// When chance does not explain the values.
#[track_caller]
pub fn assert_median_can_be(values: &[f64], range: RangeInclusive<f64>, what: &str) {
    let below = |end: f64| values.iter().map(|value| *value < end).collect::<Coverage>();
    below(*range.start()).assert_can_be(0.0..=0.5, &format!("{what}, below {}", range.start()));
    below(*range.end()).assert_can_be(0.5..=1.0, &format!("{what}, below {}", range.end()));
}

impl AddAssign for Coverage {
    fn add_assign(&mut self, more: Self) {
        self.inside += more.inside;
        self.total += more.total;
    }
}

impl Sum for Coverage {
    fn sum<I: Iterator<Item = Self>>(all: I) -> Self {
        all.fold(Self::default(), |mut sum, coverage| {
            sum += coverage;
            sum
        })
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
    fn quantiles_are_those_of_the_distribution() {
        // R: qbinom(q, n, p).
        for (draws, p, probability, expected) in [
            (20, 0.5, 0.5, 10),
            (20, 0.95, 1e-6, 12),
            (100, 0.01, 0.99, 4),
            (1000, 0.93, 1e-6, 889),
            (20_000, 0.93, 0.5, 18_600),
            (7, 0.0, 0.5, 0),
            (7, 1.0, 0.5, 7),
        ] {
            let found = binomial_quantile(draws, p, probability);
            assert_eq!(found, expected, "{draws} {p} {probability}");
        }
    }

    #[test]
    fn a_count_is_refused_from_both_sides_and_the_more_sharply_the_more_trials() {
        for (inside, total, held) in [
            (19, 20, true),
            (11, 20, true),
            (10, 20, false),
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
            (1.8, 20, true),
            (0.4, 20, true),
            (1.9, 20, false),
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
