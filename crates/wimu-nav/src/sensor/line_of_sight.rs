//! Ranges with and without line of sight: equation (163).

use core::f64::consts::{LN_2, PI, SQRT_2};

/// Density of a range that neither model explains, such as one far too short, 1/m: it keeps the weight finite.
const OUTLIER_DENSITY: f64 = 1e-6;
/// Least weight of a range: its noise is at most a hundred times its deviation.
const LEAST_WEIGHT: f64 = 1e-4;

/// Mixture of a Gaussian error and one with an excess: without line of sight the signal takes a longer path, and the excess
/// is exponentially distributed (S. Gezici and others, "Localization via ultra-wideband radios", IEEE Signal Process. Mag.
/// 22(4), 2005).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NonLineOfSight {
    /// Probability that a range has no line of sight. Zero: every range has the same weight.
    pub probability: f64,
    /// Mean of the excess, m.
    pub mean_m: f64,
}

/// How a range fits both models.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LineOfSight {
    /// Measured minus predicted range, m.
    pub innovation_m: f64,
    /// Its variance under line of sight, m².
    pub variance_m2: f64,
    /// Probability of line of sight given the range, at least 10⁻⁴: the noise of the range is divided by it.
    pub weight: f64,
    /// Logarithm of the density of the innovation.
    pub log_likelihood: f64,
}

impl NonLineOfSight {
    /// The probability of line of sight given an innovation, m, and its variance under line of sight, m².
    pub fn weigh(&self, innovation_m: f64, variance_m2: f64) -> LineOfSight {
        let found = |weight: f64, log_likelihood| LineOfSight {
            innovation_m,
            variance_m2,
            weight: weight.max(LEAST_WEIGHT),
            log_likelihood,
        };
        let deviation = libm::sqrt(variance_m2);
        let z = innovation_m / deviation;
        let log_direct = -0.5 * (z * z + libm::log(2.0 * PI * variance_m2));
        if self.probability <= 0.0 {
            return found(1.0, log_direct);
        }
        let ratio = deviation / self.mean_m;
        let log_excess = 0.5 * ratio * ratio - innovation_m / self.mean_m + log_normal(z - ratio)
            - libm::log(self.mean_m);
        let direct = (1.0 - self.probability) * libm::exp(log_direct);
        let excess = self.probability * libm::exp(log_excess) + OUTLIER_DENSITY;
        found(direct / (direct + excess), libm::log(direct + excess))
    }
}

/// Logarithm of the standard normal distribution function.
fn log_normal(z: f64) -> f64 {
    if z > -6.0 {
        return libm::log(libm::erfc(-z / SQRT_2)) - LN_2;
    }
    // Asymptotic expansion (M. Abramowitz and I. A. Stegun, "Handbook of Mathematical Functions", 26.2.12): the next term
    // is below 3e-4.
    let inverse = 1.0 / (z * z);
    let series = 1.0 - inverse * (1.0 - 3.0 * inverse);
    -0.5 * z * z - libm::log(-z) - 0.5 * libm::log(2.0 * PI) + libm::log(series)
}
