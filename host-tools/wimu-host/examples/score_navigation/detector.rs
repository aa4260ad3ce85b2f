//! Stationarity detector: the SHOE likelihood ratio over a centred window (Skog et al., "Zero-velocity detection: an
//! algorithm evaluation", IEEE Trans. Biomed. Eng. 57, 2010).
//!
//! T = 1/W Σ ( |f − g f̄/|f̄||² / σ_f² + |ω|² / σ_ω² ). A sum of squares about a fixed vector is the sum about the mean
//! plus the square of the mean's offset, so T = var f / σ_f² + (|f̄| − g)² / σ_f² + var ω / σ_ω² + |ω̄|² / σ_ω². The
//! offsets are errors that are constant at a rest (bias, scale factor); they have standard deviations of their own.

use nalgebra::Vector3;
use wimu_model::STANDARD_GRAVITY_MPS2;

/// Settings of the detector.
#[derive(Clone, Copy, Debug)]
pub struct Detector {
    /// Length of the window W, samples, odd.
    pub window: usize,
    /// Standard deviation of the specific force about its mean, m/s², a component.
    pub force_noise: f64,
    /// Standard deviation of the mean's departure from gravity, m/s².
    pub force_offset: f64,
    /// Standard deviation of the angular rate about its mean, rad/s, a component.
    pub rate_noise: f64,
    /// Standard deviation of the mean angular rate, rad/s.
    pub rate_offset: f64,
    /// The unit is at rest where the statistic is below this.
    pub threshold: f64,
}

impl Detector {
    /// Foot: window and deviations as published with the pyshoe recordings, threshold as in the issue.
    pub const FOOT: Self = Self {
        window: 5,
        force_noise: 0.00098,
        force_offset: 0.00098,
        rate_noise: 8.726_646_3e-5,
        rate_offset: 8.726_646_3e-5,
        threshold: 3.5e7,
    };

    /// Hand and robot: the settings of the Python reference, chosen there on three BROAD recordings.
    pub const HAND: Self = Self {
        window: 35,
        force_noise: 0.06,
        force_offset: 0.113,
        rate_noise: 0.006,
        rate_offset: 0.0204,
        threshold: 12.0,
    };

    /// Whether the unit is at rest at each sample: never where the window does not fit.
    pub fn detect(&self, force: &[Vector3<f64>], rate: &[Vector3<f64>]) -> Vec<bool> {
        let half = self.window / 2;
        let mut at_rest = vec![false; force.len()];
        let windows = force.windows(self.window).zip(rate.windows(self.window));
        for (k, (force, rate)) in windows.enumerate() {
            at_rest[k + half] = self.statistic(force, rate) < self.threshold;
        }
        at_rest
    }

    /// T of one window.
    pub fn statistic(&self, force: &[Vector3<f64>], rate: &[Vector3<f64>]) -> f64 {
        let (mean_force, force_variance) = moments(force);
        let (mean_rate, rate_variance) = moments(rate);
        let offset = mean_force.norm() - STANDARD_GRAVITY_MPS2;
        force_variance / self.force_noise.powi(2)
            + (offset / self.force_offset).powi(2)
            + rate_variance / self.rate_noise.powi(2)
            + mean_rate.norm_squared() / self.rate_offset.powi(2)
    }
}

/// Mean, and variance summed over the components.
fn moments(samples: &[Vector3<f64>]) -> (Vector3<f64>, f64) {
    let count = samples.len() as f64;
    let mean = samples.iter().sum::<Vector3<f64>>() / count;
    let squares: f64 = samples.iter().map(|s| (s - mean).norm_squared()).sum();
    (mean, squares / count)
}
