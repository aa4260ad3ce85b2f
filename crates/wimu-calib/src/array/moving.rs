//! Samples in motion in the fit: they must be those of one rigid body, equation (99).

use nalgebra::SVector;

use super::ArrayData;
use super::fit::{Layout, Row, Sums};
use super::motion::{Body, Reduced};

/// Least spacing of the samples between which outputs are interpolated and differentiated, s: below, noise
/// outweighs the change of a hand-held motion.
const SPACING_S: f64 = 0.01;
/// A sample counts as moving from this |ω|² (rad²/s²) or |ω̇| (rad/s²) on: at 1 cm 0.25 m/s², far above a bias drift.
const LEAST_TURN: f64 = 25.0;
/// Or from this mean square change of the outputs on, over the variance of a difference.
const LEAST_CHANGE: f64 = 9.0;
/// Errors of the samples within this time count as correlated, s.
const BLOCK_S: f64 = 0.25;

/// Current values of the unknowns that samples in motion need beside those of the axes.
pub(super) struct Current<'a, const M: usize> {
    pub layout: Layout,
    pub delays: &'a [f64; M],
}

/// Fourth-order Lagrange interpolation from five samples.
struct Interpolated<const M: usize> {
    /// Outputs at their times less the delays.
    value: SVector<f64, M>,
    /// Their derivatives by time; 0 where those of a sensor are within their noise and show no delay.
    change: SVector<f64, M>,
    /// Variance of the noise over that of a sample, and half its derivative by time; 0 for axes that are not used.
    gain: SVector<f64, M>,
    slope: SVector<f64, M>,
    /// Mean square derivative of the outputs over the variance of its noise.
    moves: f64,
}

/// Factors of the five samples in the interpolated value, and in its derivative by `u`, in spacings from the third.
fn lagrange(u: f64) -> [[f64; 5]; 2] {
    let at = |i: usize| {
        let first = [1.0, -8.0, 0.0, 8.0, -1.0][i] / 12.0;
        let second = [-1.0, 16.0, -30.0, 16.0, -1.0][i] / 12.0;
        let third = [-1.0, 2.0, 0.0, -2.0, 1.0][i] / 2.0;
        let fourth = [1.0, -4.0, 6.0, -4.0, 1.0][i];
        let here = if i == 2 { 1.0 } else { 0.0 };
        [
            here + u * (first + u * (second / 2.0 + u * (third / 6.0 + u * fourth / 24.0))),
            first + u * (second + u * (third / 2.0 + u * fourth / 6.0)),
        ]
    };
    [core::array::from_fn(|i| at(i)[0]), core::array::from_fn(|i| at(i)[1])]
}

fn dot(a: &[f64; 5], b: &[f64; 5]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

impl<const M: usize> Interpolated<M> {
    /// `None` where samples are missing.
    fn at(
        data: &ArrayData<'_, M>,
        k: usize,
        current: &Current<'_, M>,
        body: &Body<M>,
    ) -> Option<Self> {
        let apart = libm::fmax(libm::round(SPACING_S / data.period_s), 1.0) as usize;
        let spacing = apart as f64 * data.period_s;
        let mut found = Self {
            value: SVector::zeros(),
            change: SVector::zeros(),
            gain: SVector::zeros(),
            slope: SVector::zeros(),
            moves: 0.0,
        };
        let group = current.layout.group.max(1);
        for first in (0..current.layout.axes).step_by(group) {
            let axes = first..(first + group).min(current.layout.axes);
            let used = || axes.clone().filter(|a| body.axes[*a].weight > 0.0);
            let count = used().count();
            if count == 0 {
                continue;
            }
            let delay = *current.delays.get(first / group)?;
            let shift = libm::round(delay / data.period_s);
            let rows = stencil(data, k as f64 - shift, apart, spacing)?;
            let [value, change] = lagrange((shift * data.period_s - delay) / spacing);
            let variance = dot(&change, &change);
            let mut square = 0.0;
            for a in used() {
                let samples = rows.map(|row| row[a]);
                let difference = dot(&change, &samples);
                found.value[a] = dot(&value, &samples);
                found.change[a] = difference / spacing;
                found.gain[a] = dot(&value, &value);
                found.slope[a] = dot(&value, &change) / spacing;
                square += difference * difference * body.axes[a].weight * body.axes[a].weight;
            }
            found.moves += square / variance / body.used as f64;
            // The square of noise alone would count as information about the delay.
            if square <= LEAST_CHANGE * variance * count as f64 {
                used().for_each(|a| (found.change[a], found.slope[a]) = (0.0, 0.0));
            }
        }
        Some(found)
    }
}

/// Five rows around `base`, `apart` rows from each other, where their times are even.
fn stencil<'a, const M: usize>(
    data: &ArrayData<'a, M>,
    base: f64,
    apart: usize,
    spacing: f64,
) -> Option<[&'a [f64; M]; 5]> {
    if !(0.0..data.times_s.len() as f64).contains(&base) || apart > data.times_s.len() {
        return None;
    }
    let first = (base as usize).checked_sub(2 * apart)?;
    let lasted = data.times_s.get(first + 4 * apart)? - data.times_s.get(first)?;
    let even = libm::fabs(lasted / (4.0 * spacing) - 1.0) < 0.1;
    if !even {
        return None;
    }
    let row = |i: usize| data.outputs_mps2.get(first + i * apart);
    Some([row(0)?, row(1)?, row(2)?, row(3)?, row(4)?])
}

/// A reduced sample and the derivatives of its model by the unknowns.
#[derive(Clone)]
pub(super) struct Point<const M: usize> {
    pub reduced: Reduced<M>,
    rows: [Row; M],
    /// Outputs without bias, whitened.
    pub output: SVector<f64, M>,
    gain: SVector<f64, M>,
    slope: SVector<f64, M>,
}

/// Sample `k` where the body moves and all axes in use have an output.
pub(super) fn point<const M: usize>(
    data: &ArrayData<'_, M>,
    k: usize,
    current: &Current<'_, M>,
    body: &Body<M>,
) -> Option<Point<M>> {
    let found = Interpolated::at(data, k, current, body)?;
    let output = SVector::<f64, M>::from_fn(|a, _| {
        (found.value[a] - body.axes[a].bias_mps2 - body.axes[a].drift_mps2) * body.axes[a].weight
    });
    let reduced = body.reduce(&output)?;
    // |S|² = 2 |ω̇|² + 2 |ω|⁴ for a rotation.
    let turns = reduced.tensor.norm_squared() > 2.0 * LEAST_TURN * LEAST_TURN;
    if !(turns || found.moves > LEAST_CHANGE) {
        return None;
    }
    let mut rows = [Row::zeros(); M];
    for (a, axis) in body.axes.iter().enumerate() {
        let w = axis.weight;
        let force = (reduced.force_mps2 + reduced.tensor * axis.r) * w;
        let position = reduced.tensor.tr_mul(&axis.m) * w;
        rows[a] = Row::from([
            w,
            force.x,
            force.y,
            force.z,
            position.x,
            position.y,
            position.z,
            w,
            found.change[a] * w,
        ]);
    }
    Some(Point { reduced, rows, output, gain: found.gain, slope: found.slope })
}

/// ρ(s) for the mean square s of `degrees` residuals of unit variance, and its weight: a sample whose variance is unknown
/// above 1.
fn robust(square: f64, degrees: f64) -> (f64, f64) {
    let s = square / degrees;
    if s > 1.0 { (degrees * (1.0 + libm::log(s)), 1.0 / s) } else { (square, 1.0) }
}

/// Adds all samples in motion.
pub(super) fn add<const M: usize>(
    body: &Body<M>,
    current: &Current<'_, M>,
    data: &ArrayData<'_, M>,
    sums: &mut Sums<'_>,
) {
    let mut block = f64::NEG_INFINITY;
    for_each(data, |k| {
        let time = data.times_s[k];
        if time - block > BLOCK_S {
            sums.end_block();
            block = time;
        }
        if !k.is_multiple_of(data.stride.max(1)) {
            return;
        }
        if let Some(point) = point(data, k, current, body) {
            add_sample(&point, current.layout, sums);
        }
    });
    sums.end_block();
}

/// Calls `each` for the samples outside rests.
pub(super) fn for_each<const M: usize>(data: &ArrayData<'_, M>, mut each: impl FnMut(usize)) {
    let mut rests = data.rests.iter().peekable();
    for k in 0..data.outputs_mps2.len().min(data.times_s.len()) {
        while rests.next_if(|(first, count)| first.saturating_add(*count) <= k).is_some() {}
        if rests.peek().is_none_or(|(first, _)| k < *first) {
            each(k);
        }
    }
}

fn add_sample<const M: usize>(point: &Point<M>, layout: Layout, sums: &mut Sums<'_>) {
    let reduced = &point.reduced;
    if reduced.degrees == 0 {
        return;
    }
    let explained = reduced.explained.transpose();
    let left = |a: usize| 1.0 - explained.column(a).norm_squared();
    let sum = |of: &SVector<f64, M>| (0..layout.axes).map(|a| of[a] * left(a)).sum::<f64>();
    // Interpolation averages noise: χ² of noise alone is not that of the samples, and depends on the delays.
    let expected = sum(&point.gain);
    let degrees = reduced.degrees as f64;
    let square = reduced.residual.norm_squared() / expected;
    let (cost, weight) = robust(square * degrees, degrees);
    sums.cost += cost;
    let weight = weight * degrees / expected;
    for a in 0..layout.axes {
        let delay = layout.delay(a / layout.group.max(1));
        sums.pull[delay] -= sums.scale[delay] * weight * square * point.slope[a] * left(a);
    }
    let between = |a: usize, b: usize| {
        let one = f64::from(u8::from(a == b));
        (one - explained.column(a).dot(&explained.column(b))) * weight
    };
    sums.add(
        &point.rows,
        |a| layout.delay(a / layout.group.max(1)),
        layout.axes,
        &(reduced.residual * weight),
        between,
    );
}
