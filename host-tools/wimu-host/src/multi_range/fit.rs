//! A coarse accelerometer relative to a finer one: error model, delay and clock.

use nalgebra::{Matrix2, Matrix3, Vector2, Vector3};
use wimu_nav::sensor::{Reading, Transfer, TransferModel};

use crate::lag::{Search, lag};
use crate::series::{Interp, Ns, Series};
use crate::stats::quantile;

/// Before: bias, m/s² (± 150 mg, ADXL345 datasheet), and elements of the matrix (1 σ).
pub(super) const BIAS_MPS2: f64 = 1.5;
pub(super) const MATRIX: f64 = 0.05;
/// The same of the delay, s (half of a sample period at 100 Hz), and of the rate of the clock.
const DELAY_S: f64 = 0.005;
const DRIFT: f64 = 200e-6;
/// Largest delay that is searched, s.
const SEARCH_S: f64 = 2.0;
/// Least correlation of the magnitudes at a delay.
const CORRELATION: f64 = 0.5;
/// Error of an interpolated value next to a kink, over the second difference of the samples.
const UNRESOLVED: f64 = 0.1;
/// Fewest pairs of samples of a fit.
const FEWEST: usize = 50;
const PASSES: u32 = 8;
/// A change of the delay below this, s, ends the fit.
const EXACT_S: f64 = 1e-6;
/// Samples of a mean.
const BLOCK: usize = 8;
/// Samples of a window in which noise is measured.
const WINDOW: usize = 32;

/// What is known of the finer side at its times.
pub(super) struct Fine<'a> {
    pub times: &'a [Ns],
    pub readings: &'a [[Reading; 3]],
    /// Variance of a sample, m²/s⁴.
    pub noise: [f64; 3],
}

/// Delay of a clock: a sample with the time stamp t was taken at t − `delay_s` − `drift` (t − `middle_s`).
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Clock {
    pub delay_s: f64,
    pub drift: f64,
    pub delay_sd_s: f64,
    pub drift_sd: f64,
    middle: Ns,
}

/// The coarse accelerometer relative to the finer side.
pub(super) struct Fit {
    pub model: TransferModel,
    pub clock: Clock,
    /// Variance of a sample, m²/s⁴.
    pub noise: [f64; 3],
    /// Mean square of the residuals over their expectation.
    pub misfit: f64,
    /// Residuals as a fraction of the motion's variance.
    pub unexplained: f64,
}

impl Clock {
    fn lag_s(&self, time: Ns) -> f64 {
        self.delay_s + self.drift * time.since_s(self.middle)
    }

    /// The samples at the times at which they were taken.
    pub fn corrected(&self, coarse: &Series<Vector3<f64>>) -> Series<Vector3<f64>> {
        coarse.retimed(|time| time.after_s(-self.lag_s(*time)))
    }

    /// Variance of the time of a sample, s².
    pub fn variance(&self, time: Ns) -> f64 {
        self.delay_sd_s.powi(2) + (self.drift_sd * time.since_s(self.middle)).powi(2)
    }
}

impl Fine<'_> {
    /// The specific force at a sample where no axis is saturated there or next to it: a filter behind a saturated input
    /// distorts the neighbours.
    fn clean(&self, k: usize) -> Option<Vector3<f64>> {
        let around = self.readings.get(k.checked_sub(1)?..k + 2)?;
        let is_measured = |reading: &Reading| matches!(reading, Reading::Measured(..));
        around.as_flattened().iter().all(is_measured).then_some(())?;
        Some(self.value(k))
    }

    fn value(&self, k: usize) -> Vector3<f64> {
        self.readings[k].map(value).into()
    }

    /// Length of the second difference at a sample, m/s²; not of the first and the last.
    fn bend(&self, k: usize) -> f64 {
        (self.value(k + 1) - 2.0 * self.value(k) + self.value(k - 1)).norm()
    }

    /// Change of the specific force at a sample, m/s³; zero at the ends. Saturated neighbours are at their limit.
    pub fn jerk(&self, k: usize) -> Vector3<f64> {
        if k == 0 || k + 1 >= self.times.len() {
            return Vector3::zeros();
        }
        let change = self.value(k + 1) - self.value(k - 1);
        let jerk = change / self.times[k + 1].since_s(self.times[k - 1]);
        jerk.map(|axis| if axis.is_finite() { axis } else { 0.0 })
    }

    /// Fits the model and the clock of `coarse`; `None` with too few samples in common.
    pub fn fit(&self, coarse: &Series<Vector3<f64>>, mut noise: [f64; 3]) -> Option<Fit> {
        let (first, last) = (*self.times.first()?, *self.times.last()?);
        let mut clock = Clock {
            middle: first.after_s(0.5 * last.since_s(first)),
            delay_s: self.search(coarse),
            ..Clock::default()
        };
        let start_s = clock.delay_s;
        for pass in 1.. {
            let pairs = self.pairs(&clock.corrected(coarse), &noise);
            if pairs.len() < FEWEST {
                break;
            }
            let model = self.model(&pairs)?;
            let left = |pair: &Pair| pair.coarse - model.bias_mps2 - model.matrix * pair.fine;
            let squares = pairs.iter().map(|pair| left(pair).norm_squared() / pair.variance);
            let misfit = squares.sum::<f64>() / (3 * pairs.len()) as f64;
            let slope = |pair: &Pair| (model.matrix * self.jerk(pair.k), left(pair));
            let change_s =
                self.step(&mut clock, start_s, misfit, pairs.iter().map(|p| (p, slope(p))))?;
            if change_s < EXACT_S || pass == PASSES {
                let motion = variance(pairs.iter().map(|pair| pair.coarse));
                let residual = variance(pairs.iter().map(left));
                for (axis, noise) in noise.iter_mut().enumerate() {
                    *noise = noise.max(self.quiet(&pairs, left, axis));
                }
                return Some(Fit {
                    model,
                    clock,
                    noise,
                    misfit,
                    unexplained: residual / motion.max(residual),
                });
            }
        }
        None
    }

    /// The model from means of a few samples: their noise is small beside the motion.
    fn model(&self, pairs: &[Pair]) -> Option<TransferModel> {
        let noise = self.noise.iter().sum::<f64>() / 3.0;
        let mut sums = Transfer::new(BIAS_MPS2, MATRIX);
        for block in pairs.chunks(BLOCK) {
            let (mut fine, mut coarse) = (Vector3::zeros(), Vector3::zeros());
            let (mut weights, mut squares) = (0.0, 0.0);
            for pair in block {
                let weight = 1.0 / pair.variance;
                fine += pair.fine * weight;
                coarse += pair.coarse * weight;
                weights += weight;
                squares += weight * weight;
            }
            let noise = noise * squares / (weights * weights);
            sums.push(&(fine / weights), &(coarse / weights), 1.0 / weights, noise);
        }
        sums.model()
    }

    /// A Gauss-Newton step of delay and drift: the residual is −A f′ (δ + ε u), u the time from the middle over half of the
    /// duration. Returns its size, s.
    fn step<'p>(
        &self,
        clock: &mut Clock,
        start_s: f64,
        misfit: f64,
        pairs: impl Iterator<Item = (&'p Pair, (Vector3<f64>, Vector3<f64>))>,
    ) -> Option<f64> {
        let half_s = clock.middle.since_s(*self.times.first()?).max(1e-3);
        let [p, q] = [DELAY_S, DRIFT * half_s].map(|sd| 1.0 / (sd * sd));
        let mut normal = Matrix2::new(p, 0.0, 0.0, q);
        let mut right = Vector2::new(p * (start_s - clock.delay_s), -q * clock.drift * half_s);
        for (pair, (slope, left)) in pairs {
            let row = Vector2::new(1.0, self.times[pair.k].since_s(clock.middle) / half_s);
            normal += row * row.transpose() * (slope.norm_squared() / pair.variance);
            right -= row * (slope.dot(&left) / pair.variance);
        }
        let covariance = normal.try_inverse()?;
        let step = covariance * right;
        clock.delay_s += step.x;
        clock.drift += step.y / half_s;
        clock.delay_sd_s = (covariance.m11 * misfit.max(1.0)).sqrt();
        clock.drift_sd = (covariance.m22 * misfit.max(1.0)).sqrt() / half_s;
        Some(step.amax())
    }

    /// Variance of the coarse side's residuals in quiet times, without that of the finer side.
    fn quiet(&self, pairs: &[Pair], left: impl Fn(&Pair) -> Vector3<f64>, axis: usize) -> f64 {
        let window = |window: &[Pair]| {
            let squares = window.iter().map(|pair| left(pair)[axis].powi(2));
            squares.sum::<f64>() / window.len() as f64
        };
        quartile(pairs.chunks_exact(WINDOW).map(window)) - self.noise[axis]
    }

    fn pairs(&self, coarse: &Series<Vector3<f64>>, noise: &[f64; 3]) -> Vec<Pair> {
        let both = (0..3).map(|axis| self.noise[axis] + noise[axis]);
        let noise = both.sum::<f64>() / 3.0;
        let sampled = coarse.on(self.times.iter().copied(), Interp::Cubic).enumerate();
        let pairs = sampled.filter_map(|(k, at)| {
            let at = at.filter(|at| !at.flags.is_saturated())?;
            Some(Pair {
                k,
                fine: self.clean(k)?,
                coarse: at.value,
                variance: noise + at.error * at.error + (UNRESOLVED * self.bend(k)).powi(2),
            })
        });
        pairs.collect()
    }

    /// The delay with the largest correlation of both magnitudes, s; 0 where they do not correlate.
    fn search(&self, coarse: &Series<Vector3<f64>>) -> f64 {
        let rows = (1..self.times.len()).filter_map(|k| Some((self.times[k], self.clean(k)?)));
        let fine = Series::of(rows.map(|(time, force)| (time, force.norm())));
        let coarse = coarse.map(Vector3::norm);
        let overlap_s = FEWEST as f64 * fine.period_s().max(coarse.period_s());
        let found = lag(&fine, &coarse, &Search { around_s: 0.0, reach_s: SEARCH_S, overlap_s });
        found.filter(|lag| lag.correlation > CORRELATION).map_or(0.0, |lag| -lag.offset_s)
    }
}

/// A sample of both.
struct Pair {
    k: usize,
    fine: Vector3<f64>,
    coarse: Vector3<f64>,
    /// Of the difference of an axis, m²/s⁴.
    variance: f64,
}

/// The value of a reading, or its limit; NaN of none.
pub(super) fn value(reading: Reading) -> f64 {
    match reading {
        Reading::Measured(value, _) | Reading::AtLeast(value) | Reading::AtMost(value) => value,
        Reading::Missing => f64::NAN,
    }
}

/// Variance of the noise of each axis, m²/s⁴: by second differences in the quietest quarter of the windows, and at least that
/// of the step of the output.
pub(super) fn noise(values: &[Vector3<f64>], step_mps2: f64) -> [f64; 3] {
    std::array::from_fn(|axis| {
        let window = |window: &[Vector3<f64>]| {
            let bend = |v: &[Vector3<f64>]| v[0][axis] - 2.0 * v[1][axis] + v[2][axis];
            let squares = window.windows(3).map(|v| bend(v).powi(2) / 6.0);
            squares.sum::<f64>() / (WINDOW - 2) as f64
        };
        let found = quartile(values.chunks_exact(WINDOW).map(window));
        found.max(step_mps2 * step_mps2 / 12.0).max(1e-8)
    })
}

fn quartile(values: impl Iterator<Item = f64>) -> f64 {
    quantile(values.filter(|value| value.is_finite()), 4).unwrap_or(0.0)
}

/// Trace of the covariance.
fn variance(values: impl Iterator<Item = Vector3<f64>> + Clone) -> f64 {
    let count = values.clone().count().max(1) as f64;
    let mean = values.clone().sum::<Vector3<f64>>() / count;
    values.map(|value| (value - mean).norm_squared()).sum::<f64>() / count
}

/// Angle of the rotation in a matrix, deg; `None` where it mirrors.
pub(super) fn rotation_deg(matrix: &Matrix3<f64>) -> Option<f64> {
    let svd = matrix.svd(true, true);
    let rotation = svd.u? * svd.v_t?;
    let cosine = 0.5 * (rotation.trace() - 1.0);
    (matrix.determinant() > 0.0).then(|| cosine.clamp(-1.0, 1.0).acos().to_degrees())
}
