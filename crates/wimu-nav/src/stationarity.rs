//! Stationarity detector: generalised likelihood ratio of "at rest" over a window, equation (129) (SHOE; I. Skog, P.
//! Händel, J.-O. Nilsson, J. Rantakokko, "Zero-velocity detection: an algorithm evaluation", IEEE Trans. Biomed. Eng. 57,
//! 2010).
//!
//! ```text
//! T = 1/W Σ |f − g u|² / σ_f² + |ω|² / σ_ω²,   u = mean(f) / |mean(f)|
//! ```
//!
//! A sum of squares about a fixed vector is the sum about the mean plus the square of the mean's offset. The offsets are
//! constant errors of the sensors at rest (bias, scale factor), so they have standard deviations of their own:
//!
//! ```text
//! T = var f / σ_f² + (|mean f| − g)² / σ_F² + var ω / σ_ω² + |mean ω|² / σ_Ω²
//! ```

use nalgebra::Vector3;

/// Settings of the detector. The defaults were chosen on BROAD (score_navigation).
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub struct RestLimits {
    /// Length of the window, s.
    pub window_s: f64,
    /// Standard deviation of the specific force about its mean, m/s², a component.
    pub force_mps2: f64,
    /// Standard deviation of the mean's departure from gravity, m/s².
    pub force_offset_mps2: f64,
    /// Standard deviation of the angular rate about its mean, rad/s, a component.
    pub rate_rad_s: f64,
    /// Standard deviation of the mean angular rate, rad/s.
    pub rate_offset_rad_s: f64,
    /// At rest where T is below this, for each sensor: its expectation is 3 to 4 for an accelerometer and a gyroscope.
    pub threshold: f64,
    /// Gravity, m/s².
    pub gravity_mps2: f64,
}

impl RestLimits {
    /// For [`stances`](crate::stance::stances) of a foot: 2 m/s², 10 °/s. Window and ratio of the deviations are those of
    /// B. Wagstaff, V. Peretroukhin, J. Kelly, "Robust data-driven zero-velocity detection for foot-mounted inertial
    /// navigation", IEEE Sensors J. 20, 2020.
    pub fn foot() -> Self {
        Self {
            window_s: 0.025,
            force_mps2: 1.96,
            force_offset_mps2: 1.96,
            rate_rad_s: 0.1745,
            rate_offset_rad_s: 0.1745,
            threshold: 1.0,
            gravity_mps2: crate::GRAVITY_MPS2,
        }
    }

    /// For a vehicle whose engine may run: chosen on one drive of a car (score_localization).
    pub fn vehicle() -> Self {
        Self {
            window_s: 1.0,
            force_mps2: 0.1,
            force_offset_mps2: 0.2,
            rate_rad_s: 0.03,
            rate_offset_rad_s: 0.03,
            threshold: 10.0,
            gravity_mps2: crate::GRAVITY_MPS2,
        }
    }

    /// Without a gyroscope: half the terms, half the threshold. An accelerometer sees the start of a motion only if its
    /// noise, m/s², a component, is known: 1.5 times it is used, if that is less than the default.
    #[must_use]
    pub fn without_gyroscope(mut self, noise_mps2: f64) -> Self {
        self.threshold *= 0.5;
        let known = noise_mps2 * 1.5;
        if known < self.force_mps2 && known > 0.0 {
            self.force_mps2 = known;
        }
        self
    }
}

impl Default for RestLimits {
    fn default() -> Self {
        Self {
            window_s: 0.25,
            force_mps2: 0.06,
            force_offset_mps2: 0.113,
            rate_rad_s: 0.006,
            rate_offset_rad_s: 0.0204,
            threshold: 12.0,
            gravity_mps2: crate::GRAVITY_MPS2,
        }
    }
}

/// Parts of a window. Sums slide part by part, so that no rounding error accumulates.
const PARTS: usize = 5;

/// Count, sums and sums of squares of samples.
#[derive(Clone, Copy, Debug)]
struct Sums {
    count: f64,
    time_s: f64,
    force: Vector3<f64>,
    force_squares: f64,
    rate: Vector3<f64>,
    rate_squares: f64,
}

impl Sums {
    fn zero() -> Self {
        let zero = 0.0;
        Self {
            count: zero,
            time_s: zero,
            force: Vector3::zeros(),
            force_squares: zero,
            rate: Vector3::zeros(),
            rate_squares: zero,
        }
    }

    fn add(&mut self, other: &Self) {
        self.count += other.count;
        self.time_s += other.time_s;
        self.force += other.force;
        self.force_squares += other.force_squares;
        self.rate += other.rate;
        self.rate_squares += other.rate_squares;
    }
}

/// The detector, sample by sample. The answer is that of the window that ends with the sample: a caller who can wait
/// pushes samples [`lag_s`](Self::lag_s) ahead and so has the answer of a centred window.
#[derive(Clone, Debug)]
pub struct RestDetector {
    settings: RestLimits,
    parts: [Sums; PARTS],
    current: Sums,
    /// Parts that are filled.
    filled: usize,
    statistic: Option<f64>,
}

impl RestDetector {
    /// A detector without samples.
    pub fn new(settings: RestLimits) -> Self {
        Self {
            settings,
            parts: [Sums::zero(); PARTS],
            current: Sums::zero(),
            filled: 0,
            statistic: None,
        }
    }

    /// Time from the middle to the end of the window, s.
    pub fn lag_s(&self) -> f64 {
        self.settings.window_s * 0.5
    }

    /// T of the last full window.
    pub fn statistic(&self) -> Option<f64> {
        self.statistic
    }

    /// Adds a sample, m/s² and rad/s, and the time since the sample before. Returns whether the unit is at rest. A sample
    /// that is not finite ends a rest.
    pub fn push(&mut self, force: &Vector3<f64>, rate: Option<&Vector3<f64>>, step_s: f64) -> bool {
        let finite = |v: &Vector3<f64>| v.iter().all(|x| x.is_finite());
        if !finite(force) || !rate.is_none_or(finite) || step_s > self.settings.window_s {
            *self = Self::new(self.settings);
            return false;
        }
        let none = Vector3::zeros();
        let rate = rate.unwrap_or(&none);
        self.current.add(&Sums {
            count: 1.0,
            time_s: step_s,
            force: *force,
            force_squares: force.norm_squared(),
            rate: *rate,
            rate_squares: rate.norm_squared(),
        });
        // Half a sample early, so that rounding of the times does not lengthen a part by one.
        if self.current.time_s + step_s * 0.5 >= self.settings.window_s / (PARTS as f64) {
            self.slide();
        }
        self.is_at_rest()
    }

    /// Whether the last full window looks like a rest.
    pub fn is_at_rest(&self) -> bool {
        self.statistic.is_some_and(|statistic| statistic < self.settings.threshold)
    }

    /// Replaces the oldest part by the current one.
    fn slide(&mut self) {
        self.parts.rotate_left(1);
        self.parts[PARTS - 1] = self.current;
        self.filled = (self.filled + 1).min(PARTS);
        self.current = Sums::zero();
        if self.filled == PARTS {
            self.statistic = Some(self.evaluate());
        }
    }

    fn evaluate(&self) -> f64 {
        let mut sums = Sums::zero();
        for part in &self.parts {
            sums.add(part);
        }
        let square = |x: f64| x * x;
        let (force, rate) = (sums.force / sums.count, sums.rate / sums.count);
        let force_variance = sums.force_squares / sums.count - force.norm_squared();
        let rate_variance = sums.rate_squares / sums.count - rate.norm_squared();
        let offset = force.norm() - self.settings.gravity_mps2;
        force_variance / square(self.settings.force_mps2)
            + square(offset / self.settings.force_offset_mps2)
            + rate_variance / square(self.settings.rate_rad_s)
            + square(rate.norm() / self.settings.rate_offset_rad_s)
    }
}
