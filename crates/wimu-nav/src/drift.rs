//! How the bias settles after switching on: equation (85), its parameters from a recording at rest.

/// A bias that settles after switching on (Barshan & Durrant-Whyte): ε(t) = C1 (1 − e^(−t/T)) + C2.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Drift {
    /// C1 of each axis, m/s².
    pub rise_mps2: [f64; 3],
    /// C2 of each axis, m/s².
    pub start_mps2: [f64; 3],
    /// T, s.
    pub time_s: f64,
    /// Standard deviation of C1, m/s².
    pub rise_sd_mps2: [f64; 3],
}

impl Drift {
    /// ε at `time_s` after switching on, m/s².
    pub fn at(&self, time_s: f64) -> [f64; 3] {
        let share = 1.0 - libm::exp(-time_s / self.time_s);
        core::array::from_fn(|i| self.rise_mps2[i] * share + self.start_mps2[i])
    }

    /// The same drift of a sensor whose bias was calibrated when it had settled: C2 = −C1.
    #[must_use]
    pub fn settling(self) -> Self {
        Self {
            start_mps2: self.rise_mps2.map(|c| -c),
            ..self
        }
    }

    /// ∂ε/∂C1 at `time_s` for a settled sensor's calibration: −e^(−t/T).
    pub(crate) fn share(&self, time_s: f64) -> f64 {
        -libm::exp(-time_s / self.time_s)
    }
}

/// What a recording at rest says about [`Drift`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DriftFit {
    /// The parameters; C2 holds what gravity shows at that attitude, too.
    pub drift: Drift,
    /// Standard deviation of C2, m/s².
    pub start_sd_mps2: [f64; 3],
    /// Standard deviation of T, s.
    pub time_sd_s: f64,
    /// What is left of the means over a 256th of the recording and more, m/s² rms.
    pub rms_mps2: f64,
}

/// Why there is no [`DriftFit`].
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub enum DriftError {
    /// Fewer than 64 samples, or no time between them.
    TooShort,
    /// No axis drifts by 3 standard deviations.
    NoDrift,
    /// The time constant is not seen: the recording does not go on until the bias has settled.
    NotSettled,
    /// It moved: the mean force changes by this much, m/s².
    Moved(f64),
}

impl core::fmt::Display for DriftError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::TooShort => f.write_str(
                "fewer than 64 samples at rest: record from the switching on, for minutes",
            ),
            Self::NoDrift => f.write_str(
                "no axis drifts by three standard deviations: there is nothing to correct",
            ),
            Self::NotSettled => f.write_str(
                "the bias has not settled at the end of the recording: let it go on for longer",
            ),
            Self::Moved(change) => write!(
                f,
                "the mean force changes by {change:.2} m/s²: the unit must stay at rest"
            ),
        }
    }
}

impl core::error::Error for DriftError {}

/// Means that a recording is brought to, at most.
const BLOCKS: usize = 256;
/// A drift larger than this is motion, m/s².
const MOVED_MPS2: f64 = 1.0;

/// Takes a recording at rest, of any length, sample by sample.
#[derive(Clone, Debug)]
pub struct DriftEstimator {
    /// Sum of times and forces, and how many.
    blocks: [([f64; 4], f64); BLOCKS],
    used: usize,
    width: u64,
    under_way: ([f64; 4], u64),
    first_s: Option<f64>,
}

impl Default for DriftEstimator {
    fn default() -> Self {
        Self::new()
    }
}

impl DriftEstimator {
    /// Without samples.
    pub fn new() -> Self {
        Self {
            blocks: [([0.0; 4], 0.0); BLOCKS],
            used: 0,
            width: 1,
            under_way: ([0.0; 4], 0),
            first_s: None,
        }
    }

    /// Takes a sample, m/s², at `time_s`; the first is at the switching on. What is not finite is left out.
    pub fn push(&mut self, time_s: f64, force_mps2: [f64; 3]) {
        if !(time_s.is_finite() && force_mps2.iter().all(|f| f.is_finite())) {
            return;
        }
        let first = *self.first_s.get_or_insert(time_s);
        let values = [time_s - first, force_mps2[0], force_mps2[1], force_mps2[2]];
        for (sum, value) in self.under_way.0.iter_mut().zip(values) {
            *sum += value;
        }
        self.under_way.1 += 1;
        if self.under_way.1 < self.width {
            return;
        }
        if self.used == BLOCKS {
            // Two blocks become one; from here on a block takes twice as many samples.
            for k in 0..BLOCKS / 2 {
                let (a, b) = (self.blocks[2 * k], self.blocks[2 * k + 1]);
                let sum = core::array::from_fn(|i| a.0[i] + b.0[i]);
                self.blocks[k] = (sum, a.1 + b.1);
            }
            self.used = BLOCKS / 2;
            self.width *= 2;
            return;
        }
        if let Some(place) = self.blocks.get_mut(self.used) {
            *place = (self.under_way.0, self.under_way.1 as f64);
            self.used += 1;
        }
        self.under_way = ([0.0; 4], 0);
    }

    /// Fits T and, for each axis, C1 and C2 by least squares: T by a grid over its logarithm and
    /// Newton's steps, C1 and C2 linearly. Deviations take neighbouring residuals' correlation into
    /// account.
    ///
    /// # Errors
    /// [`DriftError`].
    pub fn fit(&self) -> Result<DriftFit, DriftError> {
        let blocks = self.blocks.get(..self.used).unwrap_or_default();
        let mean = |k: usize| -> [f64; 4] { blocks[k].0.map(|sum| sum / blocks[k].1) };
        if blocks.len() < 64 || mean(blocks.len() - 1)[0] <= 0.0 {
            return Err(DriftError::TooShort);
        }
        let last = mean(blocks.len() - 1)[0];
        let rest = |log: f64| solve(blocks, libm::exp(log)).map_or(f64::INFINITY, |s| s.rest);
        // T from the time of four blocks to the recording's length.
        let (low, high) = (libm::log(4.0 * last / blocks.len() as f64), libm::log(last));
        let at = |step: i32| low + (high - low) * f64::from(step) / 40.0;
        let best = (0..=40).fold(0, |best, k| {
            if rest(at(k)) < rest(at(best)) {
                k
            } else {
                best
            }
        });
        if best == 40 {
            // It could as well be a straight line.
            let solved = solve(blocks, libm::exp(at(40))).ok_or(DriftError::TooShort)?;
            return Err(self.unsettled(&solved, blocks.len()));
        }
        let (mut a, mut b) = (at(best - 1), at(best + 1));
        for _ in 0..60 {
            let (c, d) = (a + 0.382 * (b - a), a + 0.618 * (b - a));
            if rest(c) < rest(d) { b = d } else { a = c }
        }
        let time_s = libm::exp(0.5 * (a + b));
        let solved = solve(blocks, time_s).ok_or(DriftError::TooShort)?;
        let moved = solved.rise.iter().fold(0.0_f64, |m, r| m.max(r.abs()));
        if moved > MOVED_MPS2 {
            return Err(DriftError::Moved(moved));
        }
        // Residuals, their variance and how neighbours hang together.
        let (mut square, mut product) = ([0.0; 3], [0.0; 3]);
        let mut before = [0.0; 3];
        // Information about T of all axes together, given C1 and C2.
        let mut information = 0.0;
        for k in 0..blocks.len() {
            let m = mean(k);
            let share = 1.0 - libm::exp(-m[0] / time_s);
            for i in 0..3 {
                let residual = m[i + 1] - solved.rise[i] * share - solved.start[i];
                square[i] += residual * residual;
                product[i] += residual * before[i];
                before[i] = residual;
            }
        }
        let degrees = blocks.len() as f64 - 3.0;
        let variance: [f64; 3] = core::array::from_fn(|i| {
            let correlation = (product[i] / square[i].max(1e-300)).clamp(0.0, 0.95);
            square[i] / degrees * (1.0 + correlation) / (1.0 - correlation)
        });
        // ∂ε/∂T less what C1 and C2 can take of it.
        let (slope, of_rise, of_start) = solved.slope(blocks, time_s);
        for i in 0..3 {
            information += solved.rise[i] * solved.rise[i] * slope / variance[i].max(1e-300);
        }
        let time_sd_s = 1.0 / libm::sqrt(information.max(1e-300));
        let deviation = |own: f64, through: f64, i: usize| {
            libm::sqrt(variance[i] * own + (through * solved.rise[i] * time_sd_s).powi2())
        };
        let rise_sd_mps2 = core::array::from_fn(|i| deviation(solved.rise_variance, of_rise, i));
        let start_sd_mps2 = core::array::from_fn(|i| deviation(solved.start_variance, of_start, i));
        // Whether there is a drift at all is asked with T given.
        let seen = (0..3)
            .any(|i| solved.rise[i].abs() > 3.0 * libm::sqrt(variance[i] * solved.rise_variance));
        if !seen {
            return Err(DriftError::NoDrift);
        }
        if time_sd_s > time_s {
            return Err(DriftError::NotSettled);
        }
        Ok(DriftFit {
            drift: Drift {
                rise_mps2: solved.rise,
                start_mps2: solved.start,
                time_s,
                rise_sd_mps2,
            },
            start_sd_mps2,
            time_sd_s,
            rms_mps2: libm::sqrt(square.iter().sum::<f64>() / (3.0 * degrees)),
        })
    }

    /// A line fits as well: is it one, or is there nothing?
    fn unsettled(&self, solved: &Solved, count: usize) -> DriftError {
        let variance = solved.rest / (3.0 * (count as f64 - 2.0));
        let sd = libm::sqrt(variance * solved.rise_variance);
        let most = solved.rise.iter().fold(0.0_f64, |m, r| m.max(r.abs()));
        if most > MOVED_MPS2 {
            DriftError::Moved(most)
        } else if most > 3.0 * sd {
            DriftError::NotSettled
        } else {
            DriftError::NoDrift
        }
    }
}

trait Square {
    fn powi2(self) -> f64;
}

impl Square for f64 {
    fn powi2(self) -> f64 {
        self * self
    }
}

/// C1 and C2 for a given T.
struct Solved {
    rise: [f64; 3],
    start: [f64; 3],
    /// Sum of the squared residuals.
    rest: f64,
    /// Their variances in units of that of a block.
    rise_variance: f64,
    start_variance: f64,
}

fn solve(blocks: &[([f64; 4], f64)], time_s: f64) -> Option<Solved> {
    let n = blocks.len() as f64;
    let (mut x, mut xx) = (0.0, 0.0);
    let (mut y, mut xy, mut yy) = ([0.0; 3], [0.0; 3], 0.0);
    // From the first block's mean: gravity's square would hide the drift's.
    let origin = blocks.first()?;
    for (sum, count) in blocks {
        let share = 1.0 - libm::exp(-sum[0] / count / time_s);
        x += share;
        xx += share * share;
        for i in 0..3 {
            let value = sum[i + 1] / count - origin.0[i + 1] / origin.1;
            y[i] += value;
            xy[i] += share * value;
            yy += value * value;
        }
    }
    let determinant = n * xx - x * x;
    if determinant.is_nan() || determinant <= 1e-9 * n * n {
        return None;
    }
    let rise: [f64; 3] = core::array::from_fn(|i| (n * xy[i] - x * y[i]) / determinant);
    let start: [f64; 3] = core::array::from_fn(|i| (y[i] - rise[i] * x) / n);
    let explained: f64 = (0..3).map(|i| rise[i] * xy[i] + start[i] * y[i]).sum();
    Some(Solved {
        rise,
        start: core::array::from_fn(|i| start[i] + origin.0[i + 1] / origin.1),
        rest: (yy - explained).max(0.0),
        rise_variance: n / determinant,
        start_variance: xx / determinant,
    })
}

impl Solved {
    /// Σ s², with s = ∂(1 − e^(−t/T))/∂T less its part along (1 − e^(−t/T)) and 1; and how C1 and C2, as
    /// shares of C1, move with T.
    fn slope(&self, blocks: &[([f64; 4], f64)], time_s: f64) -> (f64, f64, f64) {
        let n = blocks.len() as f64;
        let terms = |(sum, count): &([f64; 4], f64)| {
            let t = sum[0] / count;
            let decay = libm::exp(-t / time_s);
            (1.0 - decay, -t / (time_s * time_s) * decay)
        };
        let (mut x, mut xx, mut s, mut xs) = (0.0, 0.0, 0.0, 0.0);
        for block in blocks {
            let (share, slope) = terms(block);
            x += share;
            xx += share * share;
            s += slope;
            xs += share * slope;
        }
        let determinant = n * xx - x * x;
        let along = (n * xs - x * s) / determinant;
        let level = (s - along * x) / n;
        let left = blocks
            .iter()
            .map(|block| {
                let (share, slope) = terms(block);
                (slope - along * share - level).powi2()
            })
            .sum();
        (left, along, level)
    }
}
