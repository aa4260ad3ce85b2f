//! Overlapping Allan deviation of a sensor at rest, computed sample by sample.

mod rest;
mod terms;

use alloc::format;
use alloc::vec::Vec;

use rest::{Limits, Rest};
use wimu_model::STANDARD_GRAVITY_MPS2;

use crate::orientation::axis_name;
use crate::{Reason, Refusal, input};

/// Number of levels, an octave of averaging time each.
const LEVELS: usize = 26;
/// Cluster length of a level, in its steps; a cluster begins at every step.
const LENGTH: usize = 8;
/// Number of values of the running sum that a level needs.
const KEPT: usize = 2 * LENGTH + 1;
/// Number of averaging times: 1, 2 and 4 samples, then one per level.
const POINTS: usize = 3 + LEVELS;
/// Smallest number of samples.
const FEWEST: u64 = 500;
/// Largest χ² per degree of freedom of a noise model.
const MOST_MISFIT: f64 = 5.0;
/// Smallest degrees of freedom of a point.
const LEAST_EDF: f64 = 4.0;

/// One averaging time of an Allan deviation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AllanPoint {
    /// τ, s.
    pub tau_s: f64,
    /// σ(τ) of X, Y, Z, m/s².
    pub deviation_mps2: [f64; 3],
    /// Degrees of freedom of σ²(τ): the smallest of white, flicker and random-walk noise.
    pub edf: f64,
}

impl AllanPoint {
    /// Standard deviation of σ(τ) per σ(τ).
    pub fn relative_sd(&self) -> f64 {
        1.0 / libm::sqrt(2.0 * self.edf)
    }
}

/// A value and its standard deviation, 1 σ.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Measured {
    /// The value.
    pub value: f64,
    /// Its standard deviation, in the same unit.
    pub sd: f64,
}

impl Measured {
    /// 95 % confidence interval. The squared value is distributed as χ² with ½ (value/sd)² degrees
    /// of freedom, so the interval is asymmetric. Equation (53).
    pub fn interval_95(&self) -> [f64; 2] {
        let freedom = 0.5 * (self.value / self.sd) * (self.value / self.sd);
        if freedom.is_nan() || freedom < 1.0 {
            return [0.0, self.value.max(0.0) + 1.96 * self.sd];
        }
        // Wilson-Hilferty approximation of χ² per degree of freedom.
        let spread = 2.0 / (9.0 * freedom);
        [1.96, -1.96].map(|z| {
            let root = (1.0 - spread + z * libm::sqrt(spread)).max(1e-3);
            self.value / libm::sqrt(root * root * root)
        })
    }
}

/// Noise of an axis: σ²(τ) = N²/τ + (2 ln 2/π) B² + K² τ/3.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AxisNoise {
    /// N, velocity random walk, m/s/√s. √2 N is the one-sided noise density of datasheets,
    /// m/s²/√Hz.
    pub velocity_random_walk: Measured,
    /// B, bias instability, m/s²; `None` if the recording is too short to separate it from the
    /// other terms.
    pub bias_instability_mps2: Option<Measured>,
    /// K, acceleration random walk, m/s²/√s; `None` if not significant.
    pub acceleration_random_walk: Option<Measured>,
    /// Smallest σ(τ), m/s²: the limit of averaging.
    pub floor_mps2: f64,
    /// Averaging time of `floor_mps2`, s.
    pub floor_tau_s: f64,
    /// χ² per degree of freedom of the fitted curve: 1 if the model holds. Much more indicates
    /// vibration, repeated samples or drift, and the terms are rough.
    pub misfit: f64,
    /// Shortest averaging time of the fit, s, if the output is low-pass filtered to half its rate
    /// or less, or samples are repeated.
    pub white_from_s: Option<f64>,
    /// σ(τ) of the shortest τ, m/s².
    pub sample_sd_mps2: f64,
    /// Quantisation step of the output, m/s²: one count, if it is in counts.
    pub step_mps2: f64,
}

impl AxisNoise {
    /// Whether the noise model fits: hum and vibration do not.
    pub fn is_noise(&self) -> bool {
        self.misfit <= MOST_MISFIT
    }

    /// Whether the quantisation step exceeds the noise: the terms then describe quantisation.
    pub fn is_coarse(&self) -> bool {
        self.step_mps2 > self.sample_sd_mps2
    }

    /// One-sided noise density √2 N, m/s²/√Hz, as datasheets give it.
    pub fn noise_density(&self) -> Measured {
        let root = core::f64::consts::SQRT_2;
        Measured {
            value: root * self.velocity_random_walk.value,
            sd: root * self.velocity_random_walk.sd,
        }
    }
}

/// The latest values of the running sum at one level, every 2^level-th sample.
type Level = heapless::Deque<[f64; 3], KEPT>;

/// Second difference of the running sum over the latest two clusters of `m` steps.
fn second_difference(level: &Level, m: usize) -> Option<[f64; 3]> {
    let back = |by: usize| level.get(level.len().checked_sub(1 + by)?);
    let (last, middle, first) = (back(0)?, back(m)?, back(2 * m)?);
    Some([0, 1, 2].map(|axis: usize| {
        let (late, early) = (last[axis] - middle[axis], middle[axis] - first[axis]);
        late - early
    }))
}

/// Second differences of one averaging time.
#[derive(Clone, Copy, Debug)]
struct Squares {
    /// Sum of their squares.
    sum: [f64; 3],
    count: u64,
}

impl Squares {
    const ZERO: Self = Self { sum: [0.0; 3], count: 0 };

    fn take(&mut self, difference: [f64; 3]) {
        for (sum, d) in self.sum.iter_mut().zip(difference) {
            *sum += d * d;
        }
        self.count += 1;
    }
}

/// Cluster length of the k-th averaging time, samples.
fn cluster(place: usize) -> u64 {
    1 << place
}

/// Allan deviation of a stream of samples at rest, and the noise model fitted to it. Equations (52)
/// and (53) of docs/reference/equations.
///
/// Averaging times are 1, 2, 4, 8, … samples. Clusters start at every sample up to 8 samples,
/// beyond at every eighth of their length, which loses less than 1 % of the information. Memory (13
/// KB) and the cost per sample are fixed.
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
/// # Ok::<(), wimu_calib::Refusal>(())
/// ```
#[derive(Clone, Debug)]
pub struct AllanVariance {
    rate_hz: f64,
    /// Whether the mean output must be gravity.
    shows_gravity: bool,
    origin: Option<[f64; 3]>,
    /// Running sum of the samples minus the first.
    sum: [f64; 3],
    /// Number of samples, and of those since the latest gap.
    samples: u64,
    run: u64,
    longest_run: u64,
    levels: [Level; LEVELS],
    /// By averaging time.
    squares: [Squares; POINTS],
    rest: Rest,
    /// Sum of all samples minus the first.
    total: [f64; 3],
    /// The previous sample, and the smallest change from one to the next.
    last: [f64; 3],
    step: [f64; 3],
}

impl AllanVariance {
    /// A computation for samples of an accelerometer at `rate_hz`; a rate that is not positive and finite counts as 1
    /// Hz.
    pub fn new(rate_hz: f64) -> Self {
        Self::within(rate_hz, Limits::FORCE, true)
    }

    /// The same for a gyroscope: rad/s wherever m/s² is written here.
    pub fn of_gyroscope(rate_hz: f64) -> Self {
        Self::within(rate_hz, Limits::RATE, false)
    }

    fn within(rate_hz: f64, limits: Limits, shows_gravity: bool) -> Self {
        let rate_hz = if rate_hz.is_finite() && rate_hz > 0.0 { rate_hz } else { 1.0 };
        Self {
            rate_hz,
            shows_gravity,
            origin: None,
            sum: [0.0; 3],
            samples: 0,
            run: 0,
            longest_run: 0,
            levels: [const { Level::new() }; LEVELS],
            squares: [Squares::ZERO; POINTS],
            rest: Rest::new(rate_hz, limits),
            total: [0.0; 3],
            last: [0.0; 3],
            step: [f64::INFINITY; 3],
        }
    }

    /// Replaces the rate, Hz, by one that is known better; it should be near the first one, by which the length of the blocks
    /// was chosen that show whether the sensor was at rest.
    pub fn set_rate(&mut self, rate_hz: f64) {
        if rate_hz.is_finite() && rate_hz > 0.0 {
            self.rate_hz = rate_hz;
        }
    }

    /// Adds the next sample, m/s². One that is not finite counts as a gap.
    pub fn push(&mut self, sample_mps2: [f64; 3]) {
        if !sample_mps2.iter().all(|axis| axis.abs() < 1e6) {
            return self.gap();
        }
        let origin = *self.origin.get_or_insert(sample_mps2);
        if self.run == 0 {
            self.start();
        }
        let off: [f64; 3] = core::array::from_fn(|axis| sample_mps2[axis] - origin[axis]);
        for axis in 0..3 {
            self.sum[axis] += off[axis];
            self.total[axis] += off[axis];
            let step = (off[axis] - self.last[axis]).abs();
            if step > 0.0 && step < self.step[axis] {
                self.step[axis] = step;
            }
        }
        self.last = off;
        self.samples += 1;
        self.run += 1;
        self.longest_run = self.longest_run.max(self.run);
        self.rest.take(off);
        self.keep();
    }

    /// Marks missing samples: no cluster spans them.
    pub fn gap(&mut self) {
        self.run = 0;
        self.rest.gap();
    }

    /// Number of samples.
    pub fn samples(&self) -> u64 {
        self.samples
    }

    fn start(&mut self) {
        self.sum = [0.0; 3];
        for level in &mut self.levels {
            level.clear();
        }
        self.keep();
    }

    fn keep(&mut self) {
        for (octave, level) in self.levels.iter_mut().enumerate() {
            if self.run & ((1 << octave) - 1) != 0 {
                break;
            }
            if level.is_full() {
                level.pop_front();
            }
            let _ = level.push_back(self.sum);
            let shorter: &[usize] = if octave == 0 { &[1, 2, 4] } else { &[] };
            let first = if octave == 0 { 0 } else { octave + 3 };
            for (m, squares) in
                shorter.iter().copied().chain([LENGTH]).zip(self.squares.iter_mut().skip(first))
            {
                if let Some(difference) = second_difference(level, m) {
                    squares.take(difference);
                }
            }
        }
    }

    fn variance(&self, place: usize) -> Option<[f64; 3]> {
        let all = self.squares.get(place)?;
        let length = cluster(place) as f64;
        let n = all.count as f64;
        (all.count > 0).then(|| all.sum.map(|sum| sum / (2.0 * n * length * length)))
    }

    /// Degrees of freedom of an averaging time in white, flicker and random-walk noise.
    fn dof(&self, place: usize) -> [f64; 3] {
        terms::degrees_of_freedom(self.longest_run as f64, cluster(place) as f64)
    }

    /// The curve, shortest averaging time first, as far as the points have enough degrees of
    /// freedom.
    pub fn points(&self) -> impl Iterator<Item = AllanPoint> + '_ {
        (0..POINTS).filter_map(|place| {
            let length = cluster(place) as f64;
            let edf = self.dof(place).into_iter().fold(f64::INFINITY, f64::min);
            let variance = self.variance(place).filter(|_| edf >= LEAST_EDF)?;
            Some(AllanPoint {
                tau_s: length / self.rate_hz,
                deviation_mps2: variance.map(libm::sqrt),
                edf,
            })
        })
    }

    /// The noise model of X, Y and Z.
    ///
    /// # Errors
    /// [`Refusal`] when there are too few samples, the mean output is not gravity in m/s², the
    /// sensor was not at rest, or an axis is dead.
    pub fn result(&self) -> Result<[AxisNoise; 3], Refusal> {
        if self.longest_run < FEWEST {
            let (have, need) = (self.longest_run as usize, FEWEST as usize);
            let text = format!(
                "{have} samples at rest without a gap, {need} are needed: record for longer; ten minutes give the noise \
                 density, an hour or more the bias instability"
            );
            return Err(Refusal::new(Reason::TooFew { have, need }, text));
        }
        let mean = |axis: usize| {
            let origin = self.origin.map_or(0.0, |origin| origin[axis]);
            origin + self.total[axis] / self.samples.max(1) as f64
        };
        let squares: f64 = (0..3).map(|axis| mean(axis) * mean(axis)).sum();
        let mean_mps2 = libm::sqrt(squares);
        let hint = input::unit(mean_mps2, STANDARD_GRAVITY_MPS2);
        let moved = self.rest.moved();
        // A rotated sensor has a short mean in any unit; in too large a unit noise looks like
        // motion.
        let is_large = mean_mps2 > STANDARD_GRAVITY_MPS2;
        if let Some(hint) = hint.filter(|_| self.shows_gravity && (is_large || moved.is_none())) {
            return Err(Refusal::unit("mean output", mean_mps2, hint));
        }
        if let Some((at_s, axis)) = moved {
            let text = format!(
                "the sensor was not at rest: axis {} moved about {at_s:.0} s after the start; leave it on a firm floor, and \
                 record again or cut that part out",
                axis_name(axis)
            );
            return Err(Refusal::new(Reason::Moved { index: at_s as usize }, text));
        }
        let [x, y, z] = [0, 1, 2].map(|axis| self.axis(axis));
        Ok([x?, y?, z?])
    }

    fn axis(&self, axis: usize) -> Result<AxisNoise, Refusal> {
        let points: Vec<terms::Point> = self
            .points()
            .enumerate()
            .map(|(place, point)| terms::Point {
                tau_s: point.tau_s,
                variance: point.deviation_mps2[axis] * point.deviation_mps2[axis],
                dof: self.dof(place),
            })
            .collect();
        if !points.iter().all(|point| point.variance > 0.0) {
            return Err(dead(axis));
        }
        let fitted = terms::fit(&points).ok_or_else(|| dead(axis))?;
        let [Some(white), flicker, walk] = fitted.terms else { return Err(dead(axis)) };
        let lowest = points.iter().min_by(|a, b| a.variance.total_cmp(&b.variance));
        let floor = lowest.ok_or_else(|| dead(axis))?;
        let sample_sd_mps2 = libm::sqrt(points[0].variance);
        let step_mps2 = self.step[axis];
        Ok(AxisNoise {
            velocity_random_walk: white,
            bias_instability_mps2: flicker,
            acceleration_random_walk: walk,
            floor_mps2: libm::sqrt(floor.variance),
            floor_tau_s: floor.tau_s,
            misfit: fitted.misfit,
            white_from_s: fitted.white_from_s,
            sample_sd_mps2,
            step_mps2,
        })
    }
}

fn dead(axis: usize) -> Refusal {
    let text = format!(
        "axis {} has constant output: it is dead or saturated, or its noise is below one count; choose a smaller range or a \
         higher resolution",
        axis_name(axis)
    );
    Refusal::new(Reason::Axis { axis, clipped: false }, text)
}
