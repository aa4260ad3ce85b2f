//! Overlapping Allan deviation of a sensor at rest.

mod terms;

use alloc::format;
use alloc::vec::Vec;

use wimu_model::STANDARD_GRAVITY_MPS2;

use crate::orientation::axis_name;
use crate::{Reason, Refusal, UnitHint};

/// Number of averaging times: 1, 2, 4, … samples.
const POINTS: usize = 29;
/// Beginnings of clusters in the length of a cluster, at most.
const OVERLAP: usize = 8;
/// Smallest number of samples.
const FEWEST: usize = 500;
/// Largest χ² per degree of freedom of a noise model.
const MOST_MISFIT: f64 = 5.0;
/// Smallest degrees of freedom of a point.
const LEAST_EDF: f64 = 4.0;
/// Largest variance of a second at rest, relative to the geometric mean.
const MOST_BURST: f64 = 20.0;

/// Limits of a quantity at rest.
#[derive(Clone, Copy, Debug)]
struct Limits {
    /// Largest difference between the means of two seconds, drift included.
    wander: f64,
    /// Largest noise, rms in a second.
    noise: f64,
}

/// Specific force, m/s²: 20 mg, 50 mg.
const FORCE: Limits = Limits { wander: 0.2, noise: 0.5 };
/// Angular rate, rad/s: the change of the offset over 30 K (L3GD20 datasheet, 0.04 °/s/K), and three times the noise of
/// a noisy consumer gyroscope at its full bandwidth (L3G4200D datasheet, 0.03 °/s/√Hz at 800 Hz).
const RATE: Limits = Limits { wander: 0.02, noise: 0.05 };

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

/// Cluster length of the k-th averaging time, samples.
fn cluster(place: usize) -> f64 {
    (1_u64 << place) as f64
}

/// Allan deviation of a stream of samples at rest, and the noise model fitted to it. Equations (52)
/// and (53) of docs/reference/equations.
///
/// Averaging times are 1, 2, 4, 8, … samples. Clusters start at every sample up to 8 samples,
/// beyond at every eighth of their length, which loses less than 1 % of the information.
///
/// ```
/// use wimu_calib::AllanVariance;
///
/// let mut allan = AllanVariance::new(100.0);
/// for k in 0..20_000_u64 {
///     // Nearly white noise of 0.02 m/s² a sample: 0.002 m/s/√s at 100 Hz.
///     let noise = |k: u64| 0.0693 * (((k * k * 7919 + k * 104_729) % 20_011) as f64 / 20_011.0 - 0.5);
///     allan.push([noise(k), noise(k + 70_001), 9.81 + noise(k + 350_003)]);
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
    limits: Limits,
    /// Whether the mean output must be gravity.
    shows_gravity: bool,
    /// The first sample, and all minus it.
    origin: [f64; 3],
    samples: Vec<[f64; 3]>,
    /// Where a run of samples without a gap begins.
    starts: Vec<usize>,
}

impl AllanVariance {
    /// A computation for samples of an accelerometer at `rate_hz`; a rate that is not positive and finite counts as 1
    /// Hz.
    pub fn new(rate_hz: f64) -> Self {
        Self::within(rate_hz, FORCE, true)
    }

    /// The same for a gyroscope: rad/s wherever m/s² is written here.
    pub fn of_gyroscope(rate_hz: f64) -> Self {
        Self::within(rate_hz, RATE, false)
    }

    fn within(rate_hz: f64, limits: Limits, shows_gravity: bool) -> Self {
        let mut new = Self {
            rate_hz: 1.0,
            limits,
            shows_gravity,
            origin: [0.0; 3],
            samples: Vec::new(),
            starts: Vec::new(),
        };
        new.set_rate(rate_hz);
        new
    }

    /// Replaces the rate, Hz, by one that is known better.
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
        if self.samples.is_empty() {
            self.origin = sample_mps2;
            self.starts.push(0);
        }
        let off = [0, 1, 2].map(|axis: usize| sample_mps2[axis] - self.origin[axis]);
        self.samples.push(off);
    }

    /// Marks missing samples: no cluster spans them.
    pub fn gap(&mut self) {
        self.starts.push(self.samples.len());
        self.starts.dedup();
    }

    /// Number of samples.
    pub fn samples(&self) -> u64 {
        self.samples.len() as u64
    }

    /// The runs of samples without a gap.
    fn runs(&self) -> impl Iterator<Item = &[[f64; 3]]> {
        self.starts.iter().enumerate().filter_map(|(k, start)| {
            let end = self.starts.get(k + 1).copied().unwrap_or(self.samples.len());
            self.samples.get(*start..end)
        })
    }

    fn longest_run(&self) -> usize {
        self.runs().map(<[_]>::len).max().unwrap_or(0)
    }

    /// σ²(τ) of each averaging time, as far as there are clusters.
    fn variances(&self) -> Vec<[f64; 3]> {
        let mut sums = [([0.0; 3], 0.0); POINTS];
        for run in self.runs() {
            let mut sum = [0.0; 3];
            let mut running = alloc::vec![sum];
            running.extend(run.iter().map(|off| {
                sum = [0, 1, 2].map(|axis: usize| sum[axis] + off[axis]);
                sum
            }));
            for (place, (squares, count)) in sums.iter_mut().enumerate() {
                let length = 1 << place;
                let mut first = 0;
                while let Some(last) = running.get(first + 2 * length) {
                    let (middle, begin) = (running[first + length], running[first]);
                    for axis in 0..3 {
                        let apart = (last[axis] - middle[axis]) - (middle[axis] - begin[axis]);
                        squares[axis] += apart * apart;
                    }
                    *count += 1.0;
                    first += (length / OVERLAP).max(1);
                }
            }
        }
        let known = sums.into_iter().enumerate().take_while(|(_, (_, count))| *count > 0.0);
        let variance = |(place, (squares, count)): (usize, ([f64; 3], f64))| {
            let length = cluster(place);
            squares.map(|sum| sum / (2.0 * count * length * length))
        };
        known.map(variance).collect()
    }

    /// Degrees of freedom of an averaging time in white, flicker and random-walk noise.
    fn dof(&self, place: usize) -> [f64; 3] {
        terms::degrees_of_freedom(self.longest_run() as f64, cluster(place))
    }

    /// The curve, shortest averaging time first, as far as the points have enough degrees of
    /// freedom.
    pub fn points(&self) -> impl Iterator<Item = AllanPoint> + '_ {
        self.variances().into_iter().enumerate().filter_map(|(place, variance)| {
            let edf = self.dof(place).into_iter().fold(f64::INFINITY, f64::min);
            (edf >= LEAST_EDF).then(|| AllanPoint {
                tau_s: cluster(place) / self.rate_hz,
                deviation_mps2: variance.map(libm::sqrt),
                edf,
            })
        })
    }

    /// Time of a motion, s, and the axis, from blocks of one second.
    fn moved(&self) -> Option<(f64, usize)> {
        let length = (self.rate_hz as usize).max(16);
        let blocks = || self.runs().flat_map(|run| run.chunks_exact(length));
        let n = length as f64;
        (0..3).find_map(|axis| {
            let mean = |block: &[[f64; 3]]| block.iter().map(|off| off[axis]).sum::<f64>() / n;
            let (mut noisiest, mut logarithms, mut count) = ((0.0, 0.0), 0.0, 0.0);
            let (mut least, mut largest) = ((f64::INFINITY, 0.0), (f64::NEG_INFINITY, 0.0));
            for (k, block) in blocks().enumerate() {
                let (at_s, mean) = ((k as f64 + 0.5) * n / self.rate_hz, mean(block));
                let squares = block.iter().map(|off| (off[axis] - mean) * (off[axis] - mean));
                let variance = (squares.sum::<f64>() / n).max(1e-8);
                if variance > noisiest.0 {
                    noisiest = (variance, at_s);
                }
                if mean < least.0 {
                    least = (mean, at_s);
                }
                if mean > largest.0 {
                    largest = (mean, at_s);
                }
                logarithms += libm::log(variance);
                count += 1.0;
            }
            // The lower bound is for axes with mostly constant output.
            let usual = libm::exp(logarithms / f64::max(count, 1.0)).max(1e-5);
            let most = (MOST_BURST * usual).min(self.limits.noise * self.limits.noise);
            if noisiest.0 > most {
                return Some((noisiest.1, axis));
            }
            (largest.0 - least.0 > self.limits.wander).then(|| (largest.1.max(least.1), axis))
        })
    }

    /// The noise model of X, Y and Z.
    ///
    /// # Errors
    /// [`Refusal`] when there are too few samples, the mean output is not gravity in m/s², the
    /// sensor was not at rest, or an axis is dead.
    pub fn result(&self) -> Result<[AxisNoise; 3], Refusal> {
        let (have, need) = (self.longest_run(), FEWEST);
        if have < need {
            let text = format!(
                "{have} samples at rest without a gap, {need} are needed: record for longer; ten minutes give the noise \
                 density, an hour or more the bias instability"
            );
            return Err(Refusal::new(Reason::TooFew { have, need }, text));
        }
        let count = self.samples.len() as f64;
        let mean = |axis: usize| {
            self.origin[axis] + self.samples.iter().map(|off| off[axis]).sum::<f64>() / count
        };
        let squares: f64 = (0..3).map(|axis| mean(axis) * mean(axis)).sum();
        let mean_mps2 = libm::sqrt(squares);
        let hint = UnitHint::of(mean_mps2, STANDARD_GRAVITY_MPS2);
        let moved = self.moved();
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
        let curve: Vec<AllanPoint> = self.points().collect();
        let [x, y, z] = [0, 1, 2].map(|axis| self.axis(axis, &curve));
        Ok([x?, y?, z?])
    }

    fn axis(&self, axis: usize, curve: &[AllanPoint]) -> Result<AxisNoise, Refusal> {
        let points: Vec<terms::Point> = curve
            .iter()
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
        let pairs = self.samples.windows(2);
        let steps =
            pairs.map(|pair| (pair[1][axis] - pair[0][axis]).abs()).filter(|step| *step > 0.0);
        let step_mps2 = steps.fold(f64::INFINITY, f64::min);
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
