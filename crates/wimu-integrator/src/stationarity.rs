//! Stationarity detector on windows of samples: equation (9) of docs/reference/equations.

use wimu_model::{PeriodNs, SpecificForceQ16, root};

use crate::segment::Segment;

/// Largest standard deviation of the samples of a window at rest, root of the variance summed over
/// the axes, m/s².
///
/// Noise of an LSM303AGR in high resolution: 0.03 m/s² at 100 Hz, 0.10 at 1344 Hz.
pub const REST_SD_MPS2: f64 = SPREAD_LSB as f64 / 1024.0;

/// Largest difference between the means of windows of a rest, per axis, m/s², in addition to twice
/// the standard error.
pub const REST_MEAN_TOLERANCE_MPS2: f64 = SHIFT_LSB as f64 / 65536.0;

/// Number of windows of a rest in the attitude of the previous rest: 0.5 s.
pub(crate) const REST_WINDOWS: u16 = 4;
/// Number of windows of a rest in another attitude, which the slow crest of a motion resembles: 2
/// s.
pub(crate) const TURNED_REST_WINDOWS: u16 = 16;
/// Number of windows (16 s) after which the sums of a rest are halved, so that a drifting bias is
/// followed.
pub(crate) const LONGEST_RUN: u16 = 128;

/// [`REST_SD_MPS2`], 2⁻¹⁰ m/s².
const SPREAD_LSB: u64 = 128;
/// 2⁻¹⁶ m/s².
const SHIFT_LSB: u64 = 1638;
/// 2⁻¹⁶ m/s².
const HALF_G_LSB: u64 = 321_344;
/// Limit of the difference from the first sample of a window, 2⁻¹⁰ m/s²: 16 m/s², certainly not at
/// rest. Its square fits 32 bits.
const FAR_LSB: i32 = 1 << 14;

/// Number of steps of a window at `period`: 0.125 s, 8 to 1024.
pub fn window_steps(period: PeriodNs) -> u16 {
    (125_000_000 / period.0.max(1)).clamp(8, 1024) as u16
}

/// Statistics of the samples of the current window.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Window {
    /// The segment at the start of the window.
    pub start: Segment,
    /// Number of samples.
    pub samples: u16,
    /// The window's first sample, 2⁻¹⁶ m/s².
    pub reference: [i32; 3],
    /// Sum of the samples minus the reference, 2⁻¹⁰ m/s².
    pub sum: [i32; 3],
    /// Sum of their squares over all axes, 2⁻²⁰ m²/s⁴.
    pub squares: u64,
}

impl Window {
    /// A window that starts at the end of `segment`.
    pub(crate) fn starting_at(segment: &Segment) -> Self {
        Self { start: *segment, ..Self::default() }
    }

    /// Adds a sample; returns the number of samples.
    #[inline]
    pub(crate) fn add(&mut self, force: SpecificForceQ16) -> u16 {
        if self.samples == 0 {
            self.reference = force.0;
        }
        for axis in 0..3 {
            let away = force.0[axis].wrapping_sub(self.reference[axis]) >> 6;
            let away = away.clamp(-FAR_LSB, FAR_LSB);
            self.sum[axis] = self.sum[axis].wrapping_add(away);
            self.squares = self.squares.wrapping_add((away * away) as u64);
        }
        self.samples = self.samples.saturating_add(1);
        self.samples
    }

    /// n² times the summed variance of the axes, 2⁻²⁰ m²/s⁴: n Σx² − (Σx)².
    fn scatter(&self) -> u64 {
        let of_mean: u64 = self.sum.iter().map(|&sum| u64::from(sum.unsigned_abs()).pow(2)).sum();
        (self.squares * u64::from(self.samples)).saturating_sub(of_mean)
    }

    /// Whether the variance is small and the mean, from Σ (f_k + f_k+1) of this window, can be
    /// gravity: free fall and a dead sensor have a small variance, too.
    pub(crate) fn is_quiet(&self, total: [i64; 3]) -> bool {
        let n = u64::from(self.samples.max(1));
        // Clamped values are out of range already.
        let mean = |sum: i64| (sum / (2 * n as i64)).unsigned_abs().min(4 * HALF_G_LSB);
        let square: u64 = total.iter().map(|&sum| mean(sum).pow(2)).sum();
        self.scatter() <= (SPREAD_LSB * n).pow(2)
            && (HALF_G_LSB.pow(2)..=(3 * HALF_G_LSB).pow(2)).contains(&square)
    }

    /// Largest difference between Σ (f_k + f_k+1) of two windows of a rest.
    pub(crate) fn tolerance(&self) -> u64 {
        let n = u64::from(self.samples.max(1));
        // Twice the standard error of the mean is 2 √(scatter / n³); the sum is 2n times the mean,
        // and 2⁶ takes 2⁻¹⁰ to 2⁻¹⁶ m/s².
        2 * n * SHIFT_LSB + 4 * 64 * root::isqrt(self.scatter() / n)
    }
}

/// Successive quiet windows with equal means.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Run {
    /// Number of windows, at least one.
    pub windows: u16,
    /// Σ (f_k + f_k+1) over all of them but the latest, 2⁻¹⁶ m/s².
    pub sum: [i64; 3],
    /// Σ (f_k + f_k+1) over the latest window, in which motion may have begun, 2⁻¹⁶ m/s².
    pub latest: [i64; 3],
    /// The segment at the end of the first window.
    pub start: Segment,
}

impl Run {
    /// A run of one window that ends at the end of `segment`.
    pub(crate) fn starting_with(total: [i64; 3], segment: &Segment) -> Self {
        Self { windows: 1, sum: [0; 3], latest: total, start: *segment }
    }

    /// Whether a window with this sum has the mean of the run.
    pub(crate) fn agrees(&self, total: [i64; 3], tolerance: u64) -> bool {
        let windows = u64::from(self.windows.max(1));
        (0..3).all(|axis| {
            let mean = (self.sum[axis].saturating_add(self.latest[axis])) / windows as i64;
            total[axis].abs_diff(mean) <= tolerance
        })
    }

    /// The run with one more window.
    pub(crate) fn with(mut self, total: [i64; 3]) -> Self {
        for axis in 0..3 {
            self.sum[axis] = self.sum[axis].saturating_add(self.latest[axis]);
        }
        if self.windows >= LONGEST_RUN {
            self.sum = self.sum.map(|sum| sum / 2);
            self.windows = LONGEST_RUN / 2;
        }
        self.latest = total;
        self.windows += 1;
        self
    }

    /// Mean specific force over all windows but the latest, 2⁻³² m/s².
    pub(crate) fn mean(&self, window_steps: u16) -> [i64; 3] {
        let steps = 2 * i64::from(self.windows.saturating_sub(1).max(1)) * i64::from(window_steps);
        self.sum.map(|sum| (sum << 16).checked_div(steps).unwrap_or(0))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Σ (f_k + f_k+1) of 64 samples of gravity.
    const G: [i64; 3] = [0, 0, 2 * 64 * 642_689];

    fn window_of(samples: impl Iterator<Item = i32>) -> Window {
        let mut window = Window::default();
        for z in samples {
            window.add(SpecificForceQ16([0, 0, z]));
        }
        window
    }

    #[test]
    fn a_spread_at_the_limit_is_quiet_and_one_above_is_not() {
        let limit = (REST_SD_MPS2 * 65536.0) as i32;
        let swing = |amplitude: i32| {
            window_of((0..64).map(move |k| if k % 2 == 0 { amplitude } else { -amplitude }))
        };
        assert!(swing(limit).is_quiet(G));
        assert!(!swing(limit + limit / 50).is_quiet(G));
    }

    #[test]
    fn the_most_violent_window_does_not_overflow() {
        let window = window_of((0..64).map(|k| if k % 2 == 0 { -(1 << 29) } else { 1 << 29 }));
        assert!(!window.is_quiet(G));
    }
}
