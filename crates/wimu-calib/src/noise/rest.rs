//! Check that the sensor was at rest during a noise measurement.

/// Largest variance of a second at rest, relative to the geometric mean.
const MOST_BURST: f64 = 20.0;

/// Limits of a quantity at rest.
#[derive(Clone, Copy, Debug)]
pub(super) struct Limits {
    /// Largest difference between the means of two seconds, drift included.
    wander: f64,
    /// Largest noise, rms in a second.
    noise: f64,
}

impl Limits {
    /// Specific force, m/s²: 20 mg, 50 mg.
    pub(super) const FORCE: Self = Self { wander: 0.2, noise: 0.5 };
    /// Angular rate, rad/s: the change of the offset over 30 K (L3GD20 datasheet, 0.04 °/s/K), and three times the noise of
    /// a noisy consumer gyroscope at its full bandwidth (L3G4200D datasheet, 0.03 °/s/√Hz at 800 Hz).
    pub(super) const RATE: Self = Self { wander: 0.02, noise: 0.05 };
}

/// Statistics of blocks of one second.
#[derive(Clone, Debug)]
pub(super) struct Rest {
    limits: Limits,
    rate_hz: f64,
    /// Block length, samples.
    length: u32,
    filled: u32,
    blocks: u64,
    sum: [f64; 3],
    squares: [f64; 3],
    /// Smallest and largest block mean, and their times.
    least: [f64; 3],
    largest: [(f64, f64); 3],
    least_at: [f64; 3],
    /// Sum of the logarithms of the block variances; the largest variance, and its time.
    logarithms: [f64; 3],
    noisiest: [(f64, f64); 3],
    samples: u64,
}

impl Rest {
    pub(super) fn new(rate_hz: f64, limits: Limits) -> Self {
        Self {
            limits,
            rate_hz,
            length: (rate_hz as u32).max(16),
            filled: 0,
            blocks: 0,
            sum: [0.0; 3],
            squares: [0.0; 3],
            least: [f64::INFINITY; 3],
            largest: [(f64::NEG_INFINITY, 0.0); 3],
            least_at: [0.0; 3],
            logarithms: [0.0; 3],
            noisiest: [(0.0, 0.0); 3],
            samples: 0,
        }
    }

    pub(super) fn gap(&mut self) {
        self.filled = 0;
        self.sum = [0.0; 3];
        self.squares = [0.0; 3];
    }

    pub(super) fn take(&mut self, off: [f64; 3]) {
        self.samples += 1;
        for axis in 0..3 {
            self.sum[axis] += off[axis];
            self.squares[axis] += off[axis] * off[axis];
        }
        self.filled += 1;
        if self.filled < self.length {
            return;
        }
        let n = f64::from(self.length);
        let at = (self.samples as f64 - n / 2.0) / self.rate_hz;
        for axis in 0..3 {
            let (sum, squares) = (self.sum[axis], self.squares[axis]);
            let mean = sum / n;
            let variance = (squares / n - mean * mean).max(1e-8);
            if mean < self.least[axis] {
                (self.least[axis], self.least_at[axis]) = (mean, at);
            }
            if mean > self.largest[axis].0 {
                self.largest[axis] = (mean, at);
            }
            if variance > self.noisiest[axis].0 {
                self.noisiest[axis] = (variance, at);
            }
            self.logarithms[axis] += libm::log(variance);
        }
        self.blocks += 1;
        self.gap();
    }

    /// Time of a motion, s, and the axis.
    pub(super) fn moved(&self) -> Option<(f64, usize)> {
        (0..3).find_map(|axis| {
            let usual = libm::exp(self.logarithms[axis] / self.blocks.max(1) as f64);
            let (variance, when) = self.noisiest[axis];
            // The lower bound is for axes with mostly constant output.
            if variance > MOST_BURST * usual.max(1e-5)
                || variance > self.limits.noise * self.limits.noise
            {
                return Some((when, axis));
            }
            let (largest, when) = self.largest[axis];
            (largest - self.least[axis] > self.limits.wander)
                .then_some((when.max(self.least_at[axis]), axis))
        })
    }
}
