//! Readings of an axis by accelerometers of different full scale, merged by likelihood: equations (220) and (221).

/// What an axis of an accelerometer says about the specific force, m/s².
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum Reading {
    /// A value and its variance.
    Measured(f64, f64),
    /// Saturated: the specific force is at least this.
    AtLeast(f64),
    /// Saturated: the specific force is at most this.
    AtMost(f64),
    /// Nothing.
    #[default]
    Missing,
}

impl Reading {
    /// A value with its variance, of an axis that is saturated at ± `rail` and beyond; not finite is missing.
    pub fn new(value: f64, variance: f64, rail: f64) -> Self {
        match value {
            v if !v.is_finite() || variance.is_nan() || variance <= 0.0 => Self::Missing,
            v if v >= rail => Self::AtLeast(rail),
            v if v <= -rail => Self::AtMost(-rail),
            v => Self::Measured(v, variance),
        }
    }

    /// Both together: inverse-variance weights (220), and the moments of a truncated normal distribution where one is
    /// saturated (221).
    #[must_use]
    pub fn merge(self, other: Self) -> Self {
        match (self, other) {
            (Self::Missing, known) | (known, Self::Missing) => known,
            (Self::Measured(a, p), Self::Measured(b, q)) => {
                Self::Measured((a * q + b * p) / (p + q), p * q / (p + q))
            }
            (Self::Measured(value, variance), Self::AtLeast(bound))
            | (Self::AtLeast(bound), Self::Measured(value, variance)) => {
                let (shift, variance) = above(bound - value, variance);
                Self::Measured(value + shift, variance)
            }
            (Self::Measured(value, variance), Self::AtMost(bound))
            | (Self::AtMost(bound), Self::Measured(value, variance)) => {
                let (shift, variance) = above(value - bound, variance);
                Self::Measured(value - shift, variance)
            }
            (Self::AtLeast(a), Self::AtLeast(b)) => Self::AtLeast(a.max(b)),
            (Self::AtMost(a), Self::AtMost(b)) => Self::AtMost(a.min(b)),
            // They contradict each other.
            _ => Self::Missing,
        }
    }
}

/// Mean and variance of a normal distribution about 0, truncated to values above `bound`: (221).
fn above(bound: f64, variance: f64) -> (f64, f64) {
    let deviation = libm::sqrt(variance);
    let a = bound / deviation;
    // Beyond 6 deviations the series of Mills' ratio is exact to 1 %.
    let hazard = if a > 6.0 {
        a + 1.0 / a
    } else {
        let density = libm::exp(-0.5 * a * a) * 0.398_942_280_401_432_7;
        density / (0.5 * libm::erfc(a * core::f64::consts::FRAC_1_SQRT_2))
    };
    let left = (1.0 + hazard * (a - hazard)).clamp(1e-3, 1.0);
    (deviation * hazard, variance * left)
}
