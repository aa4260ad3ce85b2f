//! Result of the fit of an array, and its test of agreement: equation (101).

use nalgebra::{DMatrix, DVector};
use wimu_model::geometry::Geometry;

use super::fit::{Layout, PER_AXIS, axes_with, solve_all};
use super::motion::{Body, nominal};
use super::moving::{Current, for_each, point};
use super::size::SizeTest;
use super::{ArrayData, ArrayPrior};
use crate::{Reason, Refusal};

/// Samples in motion count for the agreement where the sensors differ by this many times their noise, and by this, m/s².
const NOISES: f64 = 10.0;
const LEAST_MPS2: f64 = 0.3;
/// Fewer samples do not decide.
const LEAST_SAMPLES: usize = 50;

/// How well the outputs of a moving array agree with the motion of one rigid body.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Agreement<const M: usize> {
    /// Samples in which the sensors differ by far more than their noise; with fewer than 50 nothing is tested.
    pub samples: usize,
    /// Degrees of freedom of a sample.
    pub degrees: usize,
    /// Mean χ² per degree of freedom, each sample with its weight in the fit; 1 for the noise that the geometry states.
    pub chi_square: f64,
    /// Mean fraction of the variance among the sensors that no motion explains, 0 to about 1.
    pub unexplained: f64,
    /// Root of `chi_square` in m/s² per axis.
    pub residual_mps2: f64,
    /// Fraction of the residual variance of each sensor, in their order.
    pub fractions: [f64; M],
    /// Bounds of the size of the geometry over that of the array; `None` with too few samples in motion.
    pub size: Option<[f64; 2]>,
}

impl<const M: usize> Agreement<M> {
    /// The sensor with the largest residual (from 0).
    pub fn worst(&self) -> usize {
        let all = self.fractions.iter().enumerate();
        all.max_by(|a, b| a.1.total_cmp(b.1)).map_or(0, |(sensor, _)| sensor)
    }
}

/// Maximum-a-posteriori estimate of an array.
#[derive(Clone, Debug)]
pub struct ArrayEstimate<const M: usize> {
    pub(super) layout: Layout,
    /// In their own units.
    pub(super) values: DVector<f64>,
    pub(super) covariance: DMatrix<f64>,
    /// Test of agreement with the motion of a rigid body.
    pub agreement: Agreement<M>,
}

impl<const M: usize> ArrayEstimate<M> {
    fn with_sd(&self, index: usize) -> (f64, f64) {
        let variance = self.covariance.get((index, index)).copied().unwrap_or(f64::NAN);
        (self.values.get(index).copied().unwrap_or(0.0), libm::sqrt(variance.max(0.0)))
    }

    /// Bias of an axis and its standard deviation, m/s².
    pub fn bias_mps2(&self, axis: usize) -> (f64, f64) {
        self.with_sd(PER_AXIS * axis)
    }

    /// What the matrix adds to the direction of an axis, body axes, with standard deviations.
    pub fn matrix(&self, axis: usize) -> [(f64, f64); 3] {
        core::array::from_fn(|i| self.with_sd(PER_AXIS * axis + 1 + i))
    }

    /// Offset of an axis from its position in the geometry, m, body axes, with standard deviations.
    pub fn offset_m(&self, axis: usize) -> [(f64, f64); 3] {
        core::array::from_fn(|i| self.with_sd(PER_AXIS * axis + 4 + i))
    }

    /// Delay of a sensor and its standard deviation, s.
    pub fn delay_s(&self, sensor: usize) -> (f64, f64) {
        self.with_sd(self.layout.delay(sensor))
    }

    /// Standard deviation of the differences of a kind of unknown between the axes, root mean square: without what all
    /// axes have in common.
    fn relative_sd(&self, kind: core::ops::Range<usize>, used: &dyn Fn(usize) -> bool) -> f64 {
        let axes = || (0..self.layout.axes).filter(|a| used(a / self.layout.group));
        let count = axes().count().max(1) as f64;
        let of_kind = |i: usize| {
            let at = |a: usize| PER_AXIS * a + i;
            // Axes that point alike share an error: those of the same number in their sensor.
            let same = |a: usize, b: usize| a % self.layout.group == b % self.layout.group;
            let alike = |a: usize| axes().filter(move |b| same(a, *b));
            axes()
                .map(|a| {
                    let n = alike(a).count().max(1) as f64;
                    let common: f64 = alike(a).map(|b| self.covariance[(at(a), at(b))]).sum();
                    self.covariance[(at(a), at(a))] - common / n
                })
                .sum::<f64>()
                / count
        };
        let kinds = kind.len().max(1) as f64;
        libm::sqrt((kind.map(of_kind).sum::<f64>() / kinds).max(0.0))
    }

    /// Standard deviation of an entry of the matrix against those of the other sensors, rms over the sensors in use.
    pub fn matrix_sd(&self, used: &dyn Fn(usize) -> bool) -> f64 {
        self.relative_sd(1..4, used)
    }

    /// Standard deviation of a coordinate of a position against those of the other sensors, m, rms over the sensors in use.
    pub fn position_sd_m(&self, used: &dyn Fn(usize) -> bool) -> f64 {
        self.relative_sd(4..7, used)
    }
}

/// Fits an array to a recording: bias, matrix row and position of each axis, delay of each sensor.
///
/// `usable` says which sensors (from 0) take part; unknowns of the others keep their prior. Directions and positions are
/// those of `geometry`, body axes; its noise weighs the samples. Where no sample is in motion only bias and matrix are
/// estimated.
///
/// # Errors
/// [`Refusal`]: input that is not finite, axes that do not determine a motion, no data.
pub fn fit_array<const M: usize>(
    geometry: &Geometry<M>,
    usable: impl Fn(usize) -> bool,
    data: &ArrayData<'_, M>,
    prior: &ArrayPrior,
) -> Result<ArrayEstimate<M>, Refusal> {
    let positive = |v: f64| v > 0.0 && v.is_finite();
    let sds = [prior.bias_mps2, prior.matrix, prior.position_m, prior.delay_s];
    let sound = sds.into_iter().all(positive) && positive(data.period_s);
    let repeatability = prior.repeatability_mps2;
    if !(sound && repeatability >= 0.0 && repeatability.is_finite()) {
        let text = "prior deviations, sample period and times have to be positive and finite";
        return Err(Refusal::new(Reason::Input { index: 0 }, text));
    }
    if data.outputs_mps2.is_empty() || data.times_s.len() != data.outputs_mps2.len() {
        let text = "there is neither a rest nor a sample in motion: record both";
        return Err(Refusal::new(Reason::TooFew { have: 0, need: 1 }, text));
    }
    solve_all(geometry, &usable, data, prior)
}

pub(super) fn agreement<const M: usize>(
    geometry: &Geometry<M>,
    usable: &dyn Fn(usize) -> bool,
    data: &ArrayData<'_, M>,
    values: &DVector<f64>,
) -> Agreement<M> {
    let layout = Layout::of(geometry);
    let start = nominal(geometry, usable);
    let value = |i: usize| values[i];
    let delays = layout.delays(&value);
    let current = Current { layout, delays: &delays };
    let mut found = Agreement {
        samples: 0,
        degrees: 0,
        chi_square: 0.0,
        unexplained: 0.0,
        residual_mps2: 0.0,
        fractions: [0.0; M],
        size: None,
    };
    let mut size = SizeTest::default();
    let Some(body) = Body::new(axes_with(&start, layout, &value)) else {
        return found;
    };
    found.degrees = body.degrees();
    let weights = || body.axes.iter().map(|a| a.weight * a.weight);
    let variance = body.used as f64 / weights().sum::<f64>();
    let least = (LEAST_MPS2 * LEAST_MPS2 / variance).max(NOISES * NOISES);
    if found.degrees == 0 {
        return found;
    }
    let mut weights_sum = 0.0;
    for_each(data, |k| {
        let Some(point) = point(data, k, &current, &body) else {
            return;
        };
        size.push(data.times_s[k], data.period_s, point.reduced.rate.as_ref());
        let apart = apart(&point.output, &body, layout);
        if apart < least {
            return;
        }
        let unexplained = &point.reduced.unexplained;
        let left = unexplained.norm_squared() / found.degrees as f64;
        found.samples += 1;
        let weight = 1.0 / left.max(1.0);
        weights_sum += weight;
        found.chi_square += weight * left;
        found.unexplained += left / apart;
        for (a, value) in unexplained.iter().enumerate().take(layout.axes) {
            found.fractions[a / layout.group.max(1)] += value * value / apart;
        }
    });
    found.size = size.bounds();
    if found.samples < LEAST_SAMPLES {
        found.samples = 0;
        return found;
    }
    let count = found.samples as f64;
    found.chi_square /= weights_sum;
    found.unexplained /= count;
    found.residual_mps2 = libm::sqrt(found.chi_square * variance);
    let all = found.fractions.iter().sum::<f64>().max(f64::MIN_POSITIVE);
    found.fractions = found.fractions.map(|f| f / all);
    found
}

/// Variance among the axes of the same number in their sensors, over that of the noise.
fn apart<const M: usize>(
    output: &nalgebra::SVector<f64, M>,
    body: &Body<M>,
    layout: Layout,
) -> f64 {
    let group = layout.group.max(1);
    let (mut sum, mut degrees) = (0.0, 0.0);
    for number in 0..group {
        let axes = || (number..layout.axes).step_by(group).filter(|a| body.axes[*a].weight > 0.0);
        let count = axes().count() as f64;
        let mean = axes().map(|a| output[a]).sum::<f64>() / count;
        let squares: f64 = axes().map(|a| (output[a] - mean) * (output[a] - mean)).sum();
        if count > 1.0 && group > 1 {
            sum += squares;
            degrees += count - 1.0;
        }
    }
    if degrees > 0.0 { sum / degrees } else { 0.0 }
}
