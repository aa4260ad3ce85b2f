//! Noise of a sensor at rest: overlapping Allan deviation, while samples arrive.

use core::fmt;

use nalgebra::{Cholesky, SMatrix, SVector};

/// Octaves of averaging time.
const LEVELS: usize = 26;
/// Clusters of a level, in its steps: a cluster of 8 steps begins at each.
const LENGTH: usize = 8;
/// Values of the running sum that a level needs.
const KEPT: usize = 2 * LENGTH + 1;
/// Points of a curve: 1, 2 and 4 samples, then one a level.
const POINTS: usize = 3 + LEVELS;
/// Most blocks of time that sums are kept for; two become one when they are full.
const BLOCKS: usize = 24;
/// Fewest samples.
const FEWEST: u64 = 500;
/// A point with fewer degrees of freedom says too little.
const LEAST_EDF: f64 = 4.0;
/// A second at rest has a mean this near to that of any other, m/s²: 20 mg, drift included.
const MOST_WANDER_MPS2: f64 = 0.2;
/// A second at rest has no more than this many times the usual variance.
const MOST_BURST: f64 = 20.0;
/// More than this is no noise, m/s² rms in a second.
const MOST_NOISE_MPS2: f64 = 0.5;
/// 2 ln 2 / π: flicker noise of B² has this Allan variance.
const FLICKER: f64 = 0.441_271_200_305_303_2;
/// A term is there when it lowers χ² by more than this.
const WORTH: f64 = 10.0;

/// One averaging time of an Allan deviation.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct AllanPoint {
    /// τ, s.
    pub tau_s: f64,
    /// σ(τ) of X, Y, Z, m/s².
    pub deviation_mps2: [f64; 3],
    /// Degrees of freedom of σ²(τ): the fewest of white, flicker and random-walk noise.
    pub edf: f64,
}

impl AllanPoint {
    /// Standard deviation of σ(τ) per σ(τ).
    pub fn relative_sd(&self) -> f64 {
        1.0 / libm::sqrt(2.0 * self.edf)
    }
}

/// A number and its standard deviation, 1 σ.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Measured {
    /// The number.
    pub value: f64,
    /// Its standard deviation, in the same unit.
    pub sd: f64,
}

/// Noise of an axis: σ²(τ) = 3Q²/τ² + N²/τ + (2 ln 2/π) B² + K² τ/3.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct AxisNoise {
    /// N, velocity random walk, m/s/√s. √2 N is the one-sided noise density of datasheets,
    /// m/s²/√Hz.
    pub velocity_random_walk: Measured,
    /// B, bias instability, m/s²; `None` where the recording is too short to see it under the
    /// other terms.
    pub bias_instability_mps2: Option<Measured>,
    /// K, acceleration random walk, m/s²/√s; `None` where it is not seen.
    pub acceleration_random_walk: Option<Measured>,
    /// Q, quantisation or vibration at short times, m/s; `None` where it is not seen.
    pub quantisation_mps: Option<Measured>,
    /// Least σ(τ), m/s²: what averaging can do.
    pub floor_mps2: f64,
    /// The τ that it is at, s.
    pub floor_tau_s: f64,
}

impl AxisNoise {
    /// One-sided noise density √2 N, m/s²/√Hz, as datasheets give it.
    pub fn noise_density(&self) -> Measured {
        let root = core::f64::consts::SQRT_2;
        Measured {
            value: root * self.velocity_random_walk.value,
            sd: root * self.velocity_random_walk.sd,
        }
    }
}

/// Why a recording tells no noise.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum NoiseRefusal {
    /// Too few samples.
    TooShort {
        /// How many there are.
        have: u64,
        /// How many are needed.
        need: u64,
    },
    /// The sensor was not at rest.
    NotAtRest {
        /// When, s from the first sample.
        at_s: f64,
        /// 0 = X.
        axis: usize,
    },
    /// An axis says the same all the time.
    Dead {
        /// 0 = X.
        axis: usize,
    },
}

impl fmt::Display for NoiseRefusal {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let name = |axis: usize| ["X", "Y", "Z"].get(axis).copied().unwrap_or("?");
        match *self {
            Self::TooShort { have, need } => write!(
                out,
                "{have} samples at rest without a gap, {need} are needed: record for longer; ten \
                 minutes tell the noise density, an hour or more the bias instability"
            ),
            Self::NotAtRest { at_s, axis } => write!(
                out,
                "the sensor was not at rest: axis {} moved about {at_s:.0} s after the start; leave \
                 it on a firm floor, and record again or cut that part out",
                name(axis)
            ),
            Self::Dead { axis } => write!(
                out,
                "axis {} says the same all the time: it is dead or saturated, or its noise is below \
                 one count; choose a smaller range or a higher resolution",
                name(axis)
            ),
        }
    }
}

impl core::error::Error for NoiseRefusal {}

/// Every 2^level-th value of the running sum, the latest few.
#[derive(Clone, Copy, Debug)]
struct Level {
    kept: [[f64; 3]; KEPT],
    next: usize,
    /// How many are kept.
    held: usize,
}

impl Level {
    const EMPTY: Self = Self {
        kept: [[0.0; 3]; KEPT],
        next: 0,
        held: 0,
    };

    fn take(&mut self, sum: [f64; 3]) {
        if let Some(place) = self.kept.get_mut(self.next) {
            *place = sum;
        }
        self.next = (self.next + 1) % KEPT;
        self.held = (self.held + 1).min(KEPT);
    }

    /// Second difference of the sum over the latest two clusters of `m` steps.
    fn difference(&self, m: usize) -> Option<[f64; 3]> {
        let back = |by: usize| self.kept.get((self.next + KEPT - 1 - by) % KEPT);
        let (last, middle, first) = (back(0)?, back(m)?, back(2 * m)?);
        (self.held > 2 * m)
            .then(|| core::array::from_fn(|axis| last[axis] - 2.0 * middle[axis] + first[axis]))
    }
}

/// Second differences of one averaging time in one block of time.
#[derive(Clone, Copy, Debug)]
struct Squares {
    /// Σ of their squares.
    sum: [f64; 3],
    count: f64,
}

impl Squares {
    const ZERO: Self = Self {
        sum: [0.0; 3],
        count: 0.0,
    };

    fn take(&mut self, difference: [f64; 3]) {
        for (sum, d) in self.sum.iter_mut().zip(difference) {
            *sum += d * d;
        }
        self.count += 1.0;
    }

    fn add(&mut self, other: &Self) {
        for (sum, other) in self.sum.iter_mut().zip(other.sum) {
            *sum += other;
        }
        self.count += other.count;
    }
}

/// Samples of a cluster of the point at `place`.
fn cluster(place: usize) -> u64 {
    1 << place
}

/// The Allan deviation of a stream of samples at rest, and the noise it shows. Equations (52) and
/// (53) of docs/EQUATIONS.md.
///
/// Averaging times are 1, 2, 4, 8, … samples. Clusters begin at every sample up to 8 samples, and
/// beyond at every eighth of their length, which says as much to within a percent. Standard
/// deviations come from leaving out one block of time after the other. Memory is fixed, 40 KB, and
/// so is the cost of a sample.
///
/// ```
/// use wimu_calib::AllanVariance;
///
/// let mut allan = AllanVariance::new(100.0);
/// # let mut state = 1_u64;
/// # let mut noise = || {
/// #     (0..12).map(|_| {
/// #         state = state.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
/// #         (state >> 11) as f64 / (1_u64 << 53) as f64 - 0.5
/// #     }).sum::<f64>()
/// # };
/// for _ in 0..20_000 {
///     // White noise of 0.02 m/s² a sample: 0.002 m/s/√s at 100 Hz.
///     allan.push([0.02 * noise(), 0.02 * noise(), 9.81 + 0.02 * noise()]);
/// }
/// let noise = allan.result()?;
/// let walk = noise[0].velocity_random_walk;
/// assert!((walk.value - 0.002).abs() < 4.0 * walk.sd && walk.sd < 0.0001);
/// assert!(allan.points().next().is_some_and(|p| (p.deviation_mps2[0] - 0.02).abs() < 0.001));
/// # Ok::<(), wimu_calib::NoiseRefusal>(())
/// ```
#[derive(Clone, Debug)]
pub struct AllanVariance {
    rate_hz: f64,
    origin: Option<[f64; 3]>,
    /// Σ of the samples less the first.
    sum: [f64; 3],
    /// Samples in all, and since the latest gap.
    samples: u64,
    run: u64,
    longest_run: u64,
    levels: [Level; LEVELS],
    /// By block of time.
    blocks: [[Squares; POINTS]; BLOCKS],
    /// Block being filled, how many samples it has, and how many it takes.
    block: usize,
    filled: u64,
    length: u64,
    rest: Rest,
}

impl AllanVariance {
    /// For samples at `rate_hz`; a rate that is not positive and finite counts as 1 Hz.
    pub fn new(rate_hz: f64) -> Self {
        let rate_hz = if rate_hz.is_finite() && rate_hz > 0.0 {
            rate_hz
        } else {
            1.0
        };
        Self {
            rate_hz,
            origin: None,
            sum: [0.0; 3],
            samples: 0,
            run: 0,
            longest_run: 0,
            levels: [Level::EMPTY; LEVELS],
            blocks: [[Squares::ZERO; POINTS]; BLOCKS],
            block: 0,
            filled: 0,
            length: 16,
            rest: Rest::new(rate_hz),
        }
    }

    /// Takes the next sample, m/s². One that is not finite is a gap.
    pub fn push(&mut self, sample_mps2: [f64; 3]) {
        if !sample_mps2.iter().all(|axis| axis.abs() < 1e6) {
            return self.gap();
        }
        let origin = *self.origin.get_or_insert(sample_mps2);
        if self.run == 0 {
            self.start();
        }
        let off: [f64; 3] = core::array::from_fn(|axis| sample_mps2[axis] - origin[axis]);
        for (sum, off) in self.sum.iter_mut().zip(off) {
            *sum += off;
        }
        self.samples += 1;
        self.run += 1;
        self.longest_run = self.longest_run.max(self.run);
        self.rest.take(off);
        self.keep();
    }

    /// Samples are missing here: no cluster spans it.
    pub fn gap(&mut self) {
        self.run = 0;
        self.rest.gap();
    }

    /// Samples taken.
    pub fn samples(&self) -> u64 {
        self.samples
    }

    fn start(&mut self) {
        self.sum = [0.0; 3];
        for level in &mut self.levels {
            level.held = 0;
        }
        self.keep();
    }

    fn keep(&mut self) {
        if self.filled == self.length {
            self.filled = 0;
            self.block += 1;
        }
        if self.block == BLOCKS {
            for k in 0..BLOCKS {
                let block = core::mem::replace(&mut self.blocks[k], [Squares::ZERO; POINTS]);
                for (place, squares) in self.blocks[k / 2].iter_mut().zip(&block) {
                    place.add(squares);
                }
            }
            self.block = BLOCKS / 2;
            self.length *= 2;
        }
        self.filled += 1;
        let Some(block) = self.blocks.get_mut(self.block) else {
            return;
        };
        for (octave, level) in self.levels.iter_mut().enumerate() {
            if self.run & ((1 << octave) - 1) != 0 {
                break;
            }
            level.take(self.sum);
            let shorter: &[usize] = if octave == 0 { &[1, 2, 4] } else { &[] };
            let first = if octave == 0 { 0 } else { octave + 3 };
            for (m, squares) in shorter
                .iter()
                .copied()
                .chain([LENGTH])
                .zip(block.iter_mut().skip(first))
            {
                if let Some(difference) = level.difference(m) {
                    squares.take(difference);
                }
            }
        }
    }

    /// Variance of the point at `place` over all blocks but one.
    fn variance(&self, place: usize, without: Option<usize>) -> Option<[f64; 3]> {
        let mut all = Squares::ZERO;
        for (k, block) in self.blocks.iter().enumerate() {
            if Some(k) != without {
                all.add(block.get(place)?);
            }
        }
        let length = cluster(place) as f64;
        (all.count > 0.0).then(|| all.sum.map(|sum| sum / (2.0 * all.count * length * length)))
    }

    /// The curve, shortest averaging time first, as far as it says something.
    pub fn points(&self) -> impl Iterator<Item = AllanPoint> + '_ {
        (0..POINTS).filter_map(|place| {
            let length = cluster(place) as f64;
            let edf = fewest_edf(self.longest_run as f64, length);
            let variance = self.variance(place, None).filter(|_| edf >= LEAST_EDF)?;
            Some(AllanPoint {
                tau_s: length / self.rate_hz,
                deviation_mps2: variance.map(libm::sqrt),
                edf,
            })
        })
    }

    /// The noise of X, Y and Z.
    ///
    /// # Errors
    /// [`NoiseRefusal`] when there are too few samples, the sensor was not at rest, or an axis is
    /// dead.
    pub fn result(&self) -> Result<[AxisNoise; 3], NoiseRefusal> {
        if self.longest_run < FEWEST {
            return Err(NoiseRefusal::TooShort {
                have: self.longest_run,
                need: FEWEST,
            });
        }
        if let Some((at_s, axis)) = self.rest.moved() {
            return Err(NoiseRefusal::NotAtRest { at_s, axis });
        }
        let [x, y, z] = [0, 1, 2].map(|axis| self.axis(axis));
        Ok([x?, y?, z?])
    }

    fn axis(&self, axis: usize) -> Result<AxisNoise, NoiseRefusal> {
        let mut curve = Curve {
            points: [Point::default(); POINTS],
            used: 0,
        };
        let (mut floor_mps2, mut floor_tau_s) = (f64::INFINITY, 0.0);
        for (place, point) in curve.points.iter_mut().zip(self.points()) {
            let deviation = point.deviation_mps2[axis];
            if deviation <= 0.0 || deviation.is_nan() {
                return Err(NoiseRefusal::Dead { axis });
            }
            *place = Point {
                tau_s: point.tau_s,
                variance: deviation * deviation,
                weight: point.edf / 2.0,
                expected: deviation * deviation,
            };
            curve.used += 1;
            if deviation < floor_mps2 {
                (floor_mps2, floor_tau_s) = (deviation, point.tau_s);
            }
        }
        let (set, terms, formal) = curve.fit().ok_or(NoiseRefusal::Dead { axis })?;
        // The same terms and weights without one block of time each.
        let blocks = self.block + 1;
        let (mut mean, mut squares) = ([0.0; 4], [0.0; 4]);
        for without in 0..blocks {
            let mut less = curve;
            for (place, point) in less.points.iter_mut().take(curve.used).enumerate() {
                if let Some(variance) = self.variance(place, Some(without)) {
                    point.variance = variance[axis];
                }
            }
            let roots = less.solve(set).map_or([0.0; 4], |(terms, _)| {
                terms.map(|term| libm::sqrt(term.max(0.0)))
            });
            for k in 0..4 {
                let before = roots[k] - mean[k];
                mean[k] += before / (without + 1) as f64;
                squares[k] += before * (roots[k] - mean[k]);
            }
        }
        let share = (blocks - 1) as f64 / blocks as f64;
        let term = |k: usize| {
            (set >> k & 1 == 1).then(|| {
                let value = libm::sqrt(terms[k]);
                let sd = libm::sqrt(share * squares[k]);
                Measured {
                    value,
                    sd: sd.max(formal[k] / (2.0 * value)),
                }
            })
        };
        // A term that could as well be zero was not seen.
        let seen = |k: usize| term(k).filter(|m| m.value > 3.0 * m.sd);
        Ok(AxisNoise {
            velocity_random_walk: term(1).unwrap_or(Measured {
                value: 0.0,
                sd: floor_mps2 * libm::sqrt(floor_tau_s),
            }),
            bias_instability_mps2: seen(2),
            acceleration_random_walk: seen(3),
            quantisation_mps: seen(0),
            floor_mps2,
            floor_tau_s,
        })
    }
}

/// Degrees of freedom of σ²(τ) of `n` samples in clusters of `m`: the fewest of white, flicker and
/// random-walk noise.
fn fewest_edf(n: f64, m: f64) -> f64 {
    if n < 3.0 * m {
        return 0.0;
    }
    let white = (1.5 * (n - 1.0) / m - 2.0 * (n - 2.0) / n) * 4.0 * m * m / (4.0 * m * m + 5.0);
    let flicker = if m < 1.5 {
        2.0 * (n - 2.0) * (n - 2.0) / (2.3 * n - 4.9)
    } else {
        1.25 * n * n / (m * (n + 3.0 * m))
    };
    let less = n - 1.0;
    let walk =
        (n - 2.0) / m * (less * less - 3.0 * m * less + 4.0 * m * m) / ((n - 3.0) * (n - 3.0));
    white.min(flicker).min(walk)
}

/// A point of a curve.
#[derive(Clone, Copy, Default)]
struct Point {
    tau_s: f64,
    variance: f64,
    /// Degrees of freedom / 2.
    weight: f64,
    /// What the variance is thought to be, for its weight.
    expected: f64,
}

#[derive(Clone, Copy)]
struct Curve {
    points: [Point; POINTS],
    used: usize,
}

/// What Q², N², B² and K² add to the Allan variance at τ: equation (53).
fn shares(tau_s: f64) -> [f64; 4] {
    [3.0 / (tau_s * tau_s), 1.0 / tau_s, FLICKER, tau_s / 3.0]
}

fn total(terms: &[f64; 4], tau_s: f64) -> f64 {
    terms.iter().zip(shares(tau_s)).map(|(t, x)| t * x).sum()
}

impl Curve {
    fn points(&self) -> impl Iterator<Item = &Point> {
        self.points.iter().take(self.used)
    }

    /// The terms of `set`, the others 0, by weighted linear least squares; and their standard
    /// deviations were the points independent.
    fn solve(&self, set: u32) -> Option<([f64; 4], [f64; 4])> {
        let inside = |k: usize| set >> k & 1 == 1;
        let mut information = SMatrix::<f64, 4, 4>::zeros();
        let mut right = SVector::<f64, 4>::zeros();
        for point in self.points() {
            // As a share of the noise to be expected, which spans decades.
            let x = SVector::<f64, 4>::from_fn(|k, _| {
                let share = shares(point.tau_s)[k] / point.expected;
                if inside(k) { share } else { 0.0 }
            });
            information.ger(point.weight, &x, &x, 1.0);
            right.axpy(point.weight * point.variance / point.expected, &x, 1.0);
        }
        for k in (0..4).filter(|k| !inside(*k)) {
            information[(k, k)] = 1.0;
        }
        let scale = information.diagonal().map(|d| 1.0 / libm::sqrt(d));
        let scaled =
            SMatrix::<f64, 4, 4>::from_fn(|r, c| information[(r, c)] * scale[r] * scale[c]);
        let factor = Cholesky::new(scaled)?;
        let terms = factor
            .solve(&right.component_mul(&scale))
            .component_mul(&scale);
        let inverse = factor.inverse();
        let terms = core::array::from_fn(|k| if inside(k) { terms[k] } else { 0.0 });
        let sd = core::array::from_fn(|k| scale[k] * libm::sqrt(inverse[(k, k)]));
        Some((terms, sd))
    }

    fn chi_square(&self, terms: &[f64; 4]) -> f64 {
        self.points()
            .map(|point| {
                let off = (point.variance - total(terms, point.tau_s)) / point.expected;
                point.weight * off * off
            })
            .sum()
    }

    /// Of all sets of terms with N and none below zero, the one with least χ² + 10 per term.
    /// Weights are by what was fitted the round before: a point that happens to be low would weigh
    /// too much by itself.
    fn fit(&mut self) -> Option<(u32, [f64; 4], [f64; 4])> {
        let mut best = None;
        for _ in 0..8 {
            let mut least = f64::INFINITY;
            for set in (0_u32..16).filter(|set| set >> 1 & 1 == 1) {
                let Some((terms, sd)) = self.solve(set) else {
                    continue;
                };
                if (0..4).any(|k| set >> k & 1 == 1 && terms[k] <= 0.0) {
                    continue;
                }
                let penalised = self.chi_square(&terms) + WORTH * f64::from(set.count_ones());
                if penalised < least {
                    least = penalised;
                    best = Some((set, terms, sd));
                }
            }
            let (_, terms, _) = best?;
            let used = self.used;
            for point in self.points.iter_mut().take(used) {
                point.expected = total(&terms, point.tau_s);
            }
        }
        best
    }
}

/// Whether the sensor was at rest: seconds compared with each other.
#[derive(Clone, Debug)]
struct Rest {
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
    fn new(rate_hz: f64) -> Self {
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

    fn gap(&mut self) {
        self.filled = 0;
        self.sum = [0.0; 3];
        self.squares = [0.0; 3];
    }

    fn take(&mut self, off: [f64; 3]) {
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
            let mean = self.sum[axis] / n;
            let variance = (self.squares[axis] / n - mean * mean).max(1e-8);
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
    fn moved(&self) -> Option<(f64, usize)> {
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
