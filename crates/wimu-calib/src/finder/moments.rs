//! Moments of samples, and the noise of a sensor at rest that they show.

use crate::Pose;

/// Stationarity threshold: variance of a window over the smallest one seen.
const VARIANCE_RATIO: f64 = 9.0;
/// Stationarity threshold: largest squared departure of a block mean over the smallest variance of
/// block means seen.
const SCATTER_RATIO: f64 = 60.0;
/// Upper bounds at rest before the noise is known, (m/s²)²: the variance (0.17 m/s² rms per axis),
/// and the squared departure of a block mean (1.2° of gravity).
const QUIET_VARIANCE: f64 = 0.09;
const QUIET_DEPARTURE: f64 = 0.04;
/// The same bounds relative to the sample-to-sample noise, which motion hardly affects: variance,
/// and squared departure of a block mean over the variance of a mean. The largest departure of
/// thousands of blocks is 8 times that variance.
const VARIANCE_PER_NOISE: f64 = 6.0;
const DEPARTURE_PER_NOISE: f64 = 10.0;
/// Largest sample-to-sample noise at rest over three axes, (m/s²)²: 0.32 m/s² rms per axis.
const MOST_NOISE: f64 = 0.3;

/// Noise of a sensor at rest, estimated from its output.
///
/// Scale of the stationarity detector of `PoseFinder`: the smallest values
/// over windows as long as the shortest hold.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Noise {
    /// Smallest variance of a window, summed over the axes, (m/s²)².
    pub(super) variance: f64,
    /// Smallest variance of the block means of a window, summed over the axes, (m/s²)².
    pub(super) scatter: f64,
    /// Smallest sample-to-sample variance of a window, half the mean squared difference, summed
    /// over the axes, (m/s²)².
    pub(super) new: f64,
    /// Smallest step of the output, m/s²: one count, where the output is in counts.
    pub(super) step: f64,
}

impl Noise {
    pub(super) const NOTHING_SEEN: Self = Self {
        variance: f64::INFINITY,
        scatter: f64::INFINITY,
        new: f64::INFINITY,
        step: f64::INFINITY,
    };

    /// Quantisation step of the output, m/s²; 0 if none was found.
    pub(super) fn step(&self) -> f64 {
        if self.step < 1.0 { self.step } else { 0.0 }
    }

    /// Bound on the quantisation variance, over three axes, (m/s²)².
    pub(super) fn rounding(&self) -> f64 {
        self.step() * self.step() / 4.0
    }

    pub(super) fn most_variance(&self) -> f64 {
        let seen = VARIANCE_RATIO * self.variance.max(self.rounding());
        seen.min(QUIET_VARIANCE.max(VARIANCE_PER_NOISE * self.new.min(MOST_NOISE)))
    }

    /// Largest squared departure of the mean of a block of this many samples. The bound for noisy
    /// sensors applies only if noise explains the variance of the block means.
    pub(super) fn most_departure(&self, block_samples: u32, explains: bool) -> f64 {
        let seen = SCATTER_RATIO * self.scatter.max(self.rounding());
        let of_a_mean = self.new.min(MOST_NOISE) / f64::from(block_samples);
        let noisy = if explains { DEPARTURE_PER_NOISE * of_a_mean } else { 0.0 };
        seen.min(QUIET_DEPARTURE.max(noisy))
    }
}

/// Count, mean and summed squared deviations of samples.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Moments {
    pub(super) samples: u32,
    pub(super) mean: [f64; 3],
    pub(super) squares: [f64; 3],
    /// Squared differences of successive samples, summed over the axes.
    pub(super) differences: f64,
    celsius: f64,
    celsius_samples: u32,
    pub(super) first: u64,
}

impl Moments {
    /// Adds a sample, with the squared difference from the one before.
    pub(super) fn add(&mut self, output: [f64; 3], difference: f64, celsius: Option<f64>) {
        self.samples += 1;
        let share = 1.0 / f64::from(self.samples);
        for axis in 0..3 {
            let off = output[axis] - self.mean[axis];
            self.mean[axis] += off * share;
            self.squares[axis] += off * (output[axis] - self.mean[axis]);
        }
        self.differences += difference;
        if let Some(celsius) = celsius {
            self.celsius += celsius;
            self.celsius_samples += 1;
        }
    }

    pub(super) fn merge(&mut self, other: &Self) {
        if self.samples == 0 {
            *self = *other;
            return;
        }
        let (n, m) = (f64::from(self.samples), f64::from(other.samples));
        for axis in 0..3 {
            let apart = other.mean[axis] - self.mean[axis];
            self.mean[axis] += apart * m / (n + m);
            self.squares[axis] += other.squares[axis] + apart * apart * n * m / (n + m);
        }
        self.samples = self.samples.saturating_add(other.samples);
        self.differences += other.differences;
        self.celsius += other.celsius;
        self.celsius_samples = self.celsius_samples.saturating_add(other.celsius_samples);
    }

    /// Variance of a sample summed over the axes.
    pub(super) fn variance(&self) -> f64 {
        self.squares.iter().sum::<f64>() / f64::from(self.samples.saturating_sub(1).max(1))
    }

    pub(super) fn departure(&self, from: &[f64; 3]) -> f64 {
        (0..3).map(|axis| self.mean[axis] - from[axis]).map(|apart| apart * apart).sum()
    }

    /// Quantisation error of the mean: equation (59).
    pub(super) fn pose(&self, rate_hz: f64, noise: &Noise) -> Pose {
        let freedom = f64::from(self.samples.saturating_sub(1).max(1));
        let step = noise.step() * noise.step();
        Pose {
            mean_mps2: self.mean,
            sd_mps2: self.squares.map(|s| libm::sqrt(s / freedom)),
            rounding_sd_mps2: self
                .squares
                .map(|s| libm::sqrt((step / 12.0 - s / freedom / 3.0).max(0.0))),
            samples: self.samples,
            temperature_c: (self.celsius_samples > 0)
                .then(|| self.celsius / f64::from(self.celsius_samples)),
            first_sample: self.first,
            time_s: (self.first as f64 + 0.5 * f64::from(self.samples)) / rate_hz,
        }
    }
}
