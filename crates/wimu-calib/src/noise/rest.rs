//! Whether a sensor was at rest while its noise was measured.

/// A second at rest has a mean this near to that of any other, m/s²: 20 mg, drift included.
const MOST_WANDER_MPS2: f64 = 0.2;
/// A second at rest has no more than this many times the usual variance.
const MOST_BURST: f64 = 20.0;
/// More than this is no noise, m/s² rms in a second.
const MOST_NOISE_MPS2: f64 = 0.5;

/// Whether the sensor was at rest: seconds compared with each other.
#[derive(Clone, Debug)]
pub(super) struct Rest {
    rate_hz: f64,
    /// Samples of a block.
    length: u32,
    filled: u32,
    blocks: u64,
    sum: [f64; 3],
    squares: [f64; 3],
    /// Least and largest block mean, and when.
    least: [f64; 3],
    largest: [(f64, f64); 3],
    least_at: [f64; 3],
    /// Σ of the logarithm of the blocks' variances; the largest, and when.
    logarithms: [f64; 3],
    noisiest: [(f64, f64); 3],
    samples: u64,
}

impl Rest {
    pub(super) fn new(rate_hz: f64) -> Self {
        Self {
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

    /// When it moved, s, and which axis.
    pub(super) fn moved(&self) -> Option<(f64, usize)> {
        (0..3).find_map(|axis| {
            let usual = libm::exp(self.logarithms[axis] / self.blocks.max(1) as f64);
            let (variance, when) = self.noisiest[axis];
            // The allowance is for axes that say the same most of the time.
            if variance > MOST_BURST * usual.max(1e-5)
                || variance > MOST_NOISE_MPS2 * MOST_NOISE_MPS2
            {
                return Some((when, axis));
            }
            let (largest, when) = self.largest[axis];
            (largest - self.least[axis] > MOST_WANDER_MPS2)
                .then_some((when.max(self.least_at[axis]), axis))
        })
    }
}
