//! Whether innovations are as large as their covariance says: the a-posteriori variance factor and its global test (K.-R.
//! Koch, "Parameter Estimation and Hypothesis Testing in Linear Models", 2nd ed. 1999), beside the test of the worst single
//! innovation (W. Baarda, "A testing procedure for use in geodetic networks", 1968): a sum dilutes one fault. Equation
//! (189).
//!
//! ```
//! use wimu_nav::consistency::Consistency;
//!
//! let mut rests = Consistency::new();
//! for _ in 0..20 {
//!     rests.see(3.0, 3);
//! }
//! assert_eq!(rests.variance_factor(), 1.0);
//! rests.see(300.0, 3);
//! assert_eq!(rests.variance_factor(), 100.0);
//! ```

/// Probability of a false alarm of either test.
const FALSE_ALARM: f64 = 1e-4;

/// Normalised innovations of an interval.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Consistency {
    statistic: f64,
    dof: usize,
    checks: usize,
    /// The least probable innovation: its standard score, and its square over its degrees of freedom.
    worst: Option<(f64, f64)>,
}

impl Default for Consistency {
    fn default() -> Self {
        Self::new()
    }
}

impl Consistency {
    /// Of no innovation.
    pub fn new() -> Self {
        Self { statistic: 0.0, dof: 0, checks: 0, worst: None }
    }

    /// Takes a normalised innovation squared with its degrees of freedom. One that is not a number is left out.
    pub fn see(&mut self, statistic: f64, dof: usize) {
        if !statistic.is_finite() || dof == 0 {
            return;
        }
        let of_dof = dof as f64;
        self.statistic += statistic;
        self.dof += dof;
        self.checks += 1;
        let score = score(statistic, of_dof);
        if self.worst.is_none_or(|(worst, _)| score > worst) {
            self.worst = Some((score, statistic / of_dof));
        }
    }

    /// Takes those of another interval.
    pub fn merge(&mut self, other: &Self) {
        self.statistic += other.statistic;
        self.dof += other.dof;
        self.checks += other.checks;
        let least = [self.worst, other.worst].into_iter().flatten();
        self.worst = least.reduce(|a, b| if b.0 > a.0 { b } else { a });
    }

    /// Number of innovations.
    pub fn checks(&self) -> usize {
        self.checks
    }

    /// Mean square of the normalised innovations, with their degrees of freedom; `None` without one.
    pub fn mean_square(&self) -> Option<(f64, usize)> {
        (self.dof > 0).then(|| (self.statistic / (self.dof as f64), self.dof))
    }

    /// What the covariance must be multiplied by: 1 where neither test fails, else the larger of the mean square of all and
    /// of the worst innovation.
    pub fn variance_factor(&self) -> f64 {
        let one = 1.0;
        let Some((worst, ratio)) = self.worst else {
            return one;
        };
        let dof = self.dof as f64;
        let level = FALSE_ALARM;
        let is_improbable = |score: f64, level: f64| score > one && tail(score) < level;
        let mut factor = one;
        if is_improbable(score(self.statistic, dof), level) {
            factor = factor.max(self.statistic / dof);
        }
        if is_improbable(worst, level / (self.checks as f64)) {
            factor = factor.max(ratio);
        }
        factor
    }
}

/// Standard score of a χ² value (E. B. Wilson and M. M. Hilferty, "The distribution of chi-square", 1931).
fn score(statistic: f64, dof: f64) -> f64 {
    let spread = (2.0 / 9.0) / dof;
    (libm::cbrt(statistic / dof) - (1.0 - spread)) / libm::sqrt(spread)
}

/// Probability of a larger standard score; above 3 it is at most 9 % too large (Mills).
fn tail(score: f64) -> f64 {
    libm::exp(-score * score * 0.5) / (score * 2.506_628_274_631)
}
