//! Samples in motion in the fit: they must be those of one rigid body, equation (99).

use nalgebra::{SMatrix, SVector, Vector3};

use super::fit::{Layout, PER_AXIS, Sums};
use super::motion::{AxisNow, Body, Reduced};
use super::{ArrayData, ArrayPrior};

/// Least spacing of the samples between which outputs are interpolated and differentiated, s: below, noise
/// outweighs the change of a hand-held motion.
const SPACING_S: f64 = 0.01;
/// A sample counts as moving from this |ω|² (rad²/s²) or |ω̇| (rad/s²) on: at 1 cm 0.25 m/s², far above a bias drift.
const LEAST_TURN: f64 = 25.0;
/// Or from this mean square change of the outputs on, over the variance of a difference.
const LEAST_CHANGE: f64 = 9.0;
/// Errors of the samples within this time count as correlated, s.
const BLOCK_S: f64 = 0.25;
/// Length of a window in which the change of ω is compared with the integral of ω̇, s.
const WINDOW_S: f64 = 0.1;
/// Windows that are used, about: for 5 % in size a few suffice.
const MOST_WINDOWS: f64 = 250.0;
/// Least change of ω in a window, rad/s, and over its standard deviation.
const LEAST_WINDOW_RAD_S: f64 = 0.4;
const LEAST_WINDOW_SD: f64 = 3.0;
/// Error of the integral over the change of ω. The trapezoidal rule alone has (2π f Δt)²/12, at f = 3 Hz, Δt = 16 ms 0.8 %;
/// with the end correction 0.2 % is left.
pub(super) const INTEGRATION: f64 = 0.002;

/// Current values of the unknowns that samples in motion need beside those of the axes.
pub(super) struct Current<'a, const M: usize> {
    pub layout: Layout,
    pub delays: &'a [f64; M],
    pub size: f64,
    pub start: &'a [AxisNow; M],
}

type Rows<const M: usize> = [[f64; PER_AXIS + 1]; M];

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
    pub index: usize,
    pub reduced: Reduced<M>,
    rows: Rows<M>,
    /// Derivatives of the whitened model by the common size.
    by_size: SVector<f64, M>,
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
    let mut rows = [[0.0; PER_AXIS + 1]; M];
    let mut by_size = SVector::<f64, M>::zeros();
    for (a, axis) in body.axes.iter().enumerate() {
        let w = axis.weight;
        let force = (reduced.force_mps2 + reduced.tensor * axis.r) * w;
        let position = reduced.tensor.tr_mul(&axis.m) * w;
        rows[a] = [
            w,
            force.x,
            force.y,
            force.z,
            position.x,
            position.y,
            position.z,
            w,
            found.change[a] * w,
        ];
        by_size[a] = position.dot(&current.start[a].r) * current.size;
    }
    Some(Point { index: k, reduced, rows, by_size, output, gain: found.gain, slope: found.slope })
}

/// A window over which ω must change by the integral of ω̇.
struct Window<const M: usize> {
    begin: Point<M>,
    /// First and last difference of ω̇ between two samples, times their interval.
    steps: Option<[Vector3<f64>; 2]>,
    integral: Vector3<f64>,
    variance: f64,
}

/// ρ(s) for the mean square s of `degrees` residuals of unit variance, and its weight: a sample whose variance is unknown
/// above 1.
fn robust(square: f64, degrees: f64) -> (f64, f64) {
    let s = square / degrees;
    if s > 1.0 { (degrees * (1.0 + libm::log(s)), 1.0 / s) } else { (square, 1.0) }
}

/// Adds all samples in motion and the windows between them; `scratch` has room for four rows.
pub(super) fn add<const M: usize>(
    body: &Body<M>,
    current: &Current<'_, M>,
    data: &ArrayData<'_, M>,
    prior: &ArrayPrior,
    sums: &mut Sums<'_>,
    scratch: &mut [f64],
) {
    let mut window: Option<Window<M>> = None;
    let mut last: Option<Point<M>> = None;
    let mut block = f64::NEG_INFINITY;
    let (integral, row) = scratch.split_at_mut(3 * sums.n);
    let every = windows_apart(data);
    for_each(data, |k| {
        let time = data.times_s[k];
        if time - block > BLOCK_S {
            sums.end_block();
            block = time;
        }
        let sampled = k.is_multiple_of(data.stride.max(1));
        let opens = prior.size > 0.0 && ((time / WINDOW_S) as u64).is_multiple_of(every);
        if !(sampled || opens || window.is_some()) {
            return;
        }
        let Some(now) = point(data, k, current, body) else {
            (window, last) = (None, None);
            return;
        };
        if sampled {
            add_sample(&now, current.layout, sums);
        }
        let before = last.take().filter(|last| {
            let gap = time - data.times_s[last.index];
            last.reduced.rate.is_some() && gap < 1.5 * data.period_s
        });
        if now.reduced.rate.is_none() {
            window = None;
            return;
        }
        if let (Some(before), Some(open)) = (&before, &mut window) {
            let dt = time - data.times_s[before.index];
            open.extend(body, [before, &now], dt, current.layout, integral);
            if time - data.times_s[open.begin.index] > WINDOW_S - 0.5 * data.period_s {
                open.close(body, &now, current.layout, integral, row, sums);
                window = None;
            }
        } else {
            window = None;
        }
        if opens && window.is_none() {
            integral.fill(0.0);
            window = Some(Window {
                begin: now.clone(),
                steps: None,
                integral: Vector3::zeros(),
                variance: 0.0,
            });
        }
        last = Some(now);
    });
    sums.end_block();
}

/// Every how many windows one is used, so that at most [`MOST_WINDOWS`] are.
fn windows_apart<const M: usize>(data: &ArrayData<'_, M>) -> u64 {
    let mut moving = 0.0;
    for_each(data, |_| moving += data.period_s);
    libm::fmax(moving / WINDOW_S / MOST_WINDOWS, 1.0) as u64
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

/// Adds `factor` times the derivatives of one combination of the whitened outputs by all unknowns to `row`.
fn add_derivative<const M: usize>(
    combination: &[f64; M],
    point: &Point<M>,
    layout: Layout,
    factor: f64,
    row: &mut [f64],
) {
    for (a, part) in combination.iter().enumerate().take(layout.axes) {
        for (column, value) in layout.columns(a).into_iter().zip(point.rows[a]) {
            row[column] += factor * part * value;
        }
        row[layout.size()] += factor * part * point.by_size[a];
    }
}

fn row_of<const M: usize>(derivative: &SMatrix<f64, 6, M>, row: usize) -> [f64; M] {
    core::array::from_fn(|a| derivative[(row, a)])
}

impl<const M: usize> Window<M> {
    fn extend(
        &mut self,
        body: &Body<M>,
        [before, now]: [&Point<M>; 2],
        dt: f64,
        layout: Layout,
        rows: &mut [f64],
    ) {
        if let (Some(a), Some(b)) = (&before.reduced.rate, &now.reduced.rate) {
            let step = (b.omega_dot - a.omega_dot) * dt;
            self.steps = Some([self.steps.map_or(step, |[first, _]| first), step]);
        }
        for point in [before, now] {
            let Some(rate) = &point.reduced.rate else {
                continue;
            };
            self.integral += rate.omega_dot * (0.5 * dt);
            let derivative = body.derivative(rate);
            let turning = derivative.fixed_rows::<3>(3);
            self.variance += turning.norm_squared() * (dt * dt * 0.5) / 3.0;
            for (axis, row) in rows.chunks_exact_mut(layout.unknowns()).enumerate().take(3) {
                let combination = row_of(&derivative, 3 + axis);
                add_derivative(&combination, point, layout, 0.5 * dt, row);
            }
        }
    }

    fn close(
        &self,
        body: &Body<M>,
        end: &Point<M>,
        layout: Layout,
        rows: &[f64],
        row: &mut [f64],
        sums: &mut Sums<'_>,
    ) {
        let (Some(first), Some(last)) = (&self.begin.reduced.rate, &end.reduced.rate) else {
            return;
        };
        let [by_first, by_last] = [body.derivative(first), body.derivative(last)];
        let of_rate =
            |derivative: &SMatrix<f64, 6, M>| derivative.fixed_rows::<3>(0).norm_squared() / 3.0;
        // Gregory's end correction of the trapezoidal rule.
        let [first_step, last_step] = self.steps.unwrap_or_default();
        let integral = self.integral - (last_step - first_step) / 12.0;
        let least = LEAST_WINDOW_RAD_S.max(LEAST_WINDOW_SD * libm::sqrt(3.0 * self.variance));
        if integral.norm() < least {
            return;
        }
        // Each ω has an unknown sign: that with which it follows ω̇.
        let signs = [(1.0, 1.0), (1.0, -1.0), (-1.0, 1.0), (-1.0, -1.0)];
        let change = |(a, b): (f64, f64)| last.omega * b - first.omega * a - integral;
        let best = signs.into_iter().min_by(|a, b| change(*a).norm().total_cmp(&change(*b).norm()));
        let Some((a, b)) = best else { return };
        let residual = change((a, b));
        let rough = INTEGRATION * integral.norm();
        let variance = self.variance + of_rate(&by_first) + of_rate(&by_last) + rough * rough;
        let (cost, weight) = robust(residual.norm_squared() / variance, 3.0);
        sums.cost += cost;
        for (axis, known) in rows.chunks_exact(layout.unknowns()).enumerate().take(3) {
            for (value, known) in row.iter_mut().zip(known) {
                *value = -known;
            }
            add_derivative(&row_of(&by_last, axis), end, layout, b, row);
            add_derivative(&row_of(&by_first, axis), &self.begin, layout, -a, row);
            sums.add_dense(row, residual[axis], weight / variance);
        }
    }
}
