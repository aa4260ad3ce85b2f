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

/// An output at its time less the delay, and its derivative; `None` where samples are missing.
struct Interpolated<const M: usize> {
    value: SVector<f64, M>,
    change: SVector<f64, M>,
}

impl<const M: usize> Interpolated<M> {
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
        };
        let (mut last, mut rows, mut offset) = (usize::MAX, None, 0.0);
        for (index, axis) in body.axes.iter().enumerate().take(current.layout.axes) {
            if axis.weight <= 0.0 {
                continue;
            }
            let sensor = index / current.layout.group.max(1);
            if sensor != last {
                let delay = *current.delays.get(sensor)?;
                let shift = libm::round(delay / data.period_s);
                let base = k as f64 - shift;
                rows = stencil(data, base, apart, spacing);
                (last, offset) = (sensor, (shift * data.period_s - delay) / spacing);
            }
            let [a, b, c, d, e] = rows.as_ref()?.map(|row: &[f64; M]| row[index]);
            let first = (8.0 * (d - b) - (e - a)) / 12.0;
            let second = (16.0 * (b + d) - a - e - 30.0 * c) / 12.0;
            let third = (e - a) * 0.5 - (d - b);
            let fourth = a + e - 4.0 * (b + d) + 6.0 * c;
            let u = offset;
            found.value[index] =
                c + u * (first + u * (second / 2.0 + u * (third / 6.0 + u * fourth / 24.0)));
            found.change[index] =
                (first + u * (second + u * (third / 2.0 + u * fourth / 6.0))) / spacing;
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
pub(super) struct Point<const M: usize> {
    pub index: usize,
    pub reduced: Reduced<M>,
    rows: Rows<M>,
    /// Derivatives of the whitened model by the common size.
    by_size: SVector<f64, M>,
    /// Outputs without bias, whitened.
    pub output: SVector<f64, M>,
}

/// Sample `k` where the body moves and all axes in use have an output.
pub(super) fn point<const M: usize>(
    data: &ArrayData<'_, M>,
    k: usize,
    current: &Current<'_, M>,
    body: &Body<M>,
) -> Option<Point<M>> {
    let found = Interpolated::at(data, k, current, body)?;
    let whitened =
        |v: &SVector<f64, M>| SVector::<f64, M>::from_fn(|a, _| v[a] * body.axes[a].weight);
    let output = SVector::<f64, M>::from_fn(|a, _| {
        (found.value[a] - body.axes[a].bias_mps2 - body.axes[a].drift_mps2) * body.axes[a].weight
    });
    let reduced = body.reduce(&output)?;
    let change = whitened(&found.change);
    let span = SPACING_S.max(data.period_s);
    let changes = change.norm_squared() * span * span > LEAST_CHANGE * 0.9 * body.used as f64;
    // |S|² = 2 |ω̇|² + 2 |ω|⁴ for a rotation.
    let turns = reduced.tensor.norm_squared() > 2.0 * LEAST_TURN * LEAST_TURN;
    if !(turns || changes) {
        return None;
    }
    let mut rows = [[0.0; PER_AXIS + 1]; M];
    let mut by_size = SVector::<f64, M>::zeros();
    for (a, axis) in body.axes.iter().enumerate() {
        let w = axis.weight;
        let force = (reduced.force_mps2 + reduced.tensor * axis.r) * w;
        let position = reduced.tensor.tr_mul(&axis.m) * w;
        rows[a] = [
            w, force.x, force.y, force.z, position.x, position.y, position.z, w, change[a],
        ];
        by_size[a] = position.dot(&current.start[a].r) * current.size;
    }
    Some(Point {
        index: k,
        reduced,
        rows,
        by_size,
        output,
    })
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
    if s > 1.0 {
        (degrees * (1.0 + libm::log(s)), 1.0 / s)
    } else {
        (square, 1.0)
    }
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
    for_each(data, |k| {
        let time = data.times_s[k];
        if time - block > BLOCK_S {
            sums.end_block();
            block = time;
        }
        let Some(now) = point(data, k, current, body) else {
            (window, last) = (None, None);
            return;
        };
        if k.is_multiple_of(data.stride.max(1)) {
            add_sample(&now, current.layout, sums);
        }
        if prior.size <= 0.0 {
            return;
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
            open.extend(
                before,
                &now,
                time - data.times_s[before.index],
                current.layout,
                integral,
            );
            if time - data.times_s[open.begin.index] > WINDOW_S - 0.5 * data.period_s {
                open.close(&now, current.layout, integral, row, sums);
                window = None;
            }
        } else {
            window = None;
        }
        if window.is_none()
            && let Some(begin) = point(data, k, current, body)
        {
            integral.fill(0.0);
            window = Some(Window {
                begin,
                steps: None,
                integral: Vector3::zeros(),
                variance: 0.0,
            });
        }
        last = Some(now);
    });
    sums.end_block();
}

/// Calls `each` for the samples outside rests.
pub(super) fn for_each<const M: usize>(data: &ArrayData<'_, M>, mut each: impl FnMut(usize)) {
    let mut rests = data.rests.iter().peekable();
    for k in 0..data.outputs_mps2.len().min(data.times_s.len()) {
        while rests
            .next_if(|(first, count)| first.saturating_add(*count) <= k)
            .is_some()
        {}
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
    let (cost, weight) = robust(reduced.residual.norm_squared(), reduced.degrees as f64);
    sums.cost += cost;
    let explained = reduced.explained.transpose();
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
        before: &Point<M>,
        now: &Point<M>,
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
            let turning = rate.derivative.fixed_rows::<3>(3);
            self.variance += turning.norm_squared() * (dt * dt * 0.5) / 3.0;
            for (axis, row) in rows.chunks_exact_mut(layout.unknowns()).enumerate().take(3) {
                let combination = row_of(&rate.derivative, 3 + axis);
                add_derivative(&combination, point, layout, 0.5 * dt, row);
            }
        }
    }

    fn close(
        &self,
        end: &Point<M>,
        layout: Layout,
        rows: &[f64],
        row: &mut [f64],
        sums: &mut Sums<'_>,
    ) {
        let (Some(first), Some(last)) = (&self.begin.reduced.rate, &end.reduced.rate) else {
            return;
        };
        let of_rate =
            |rate: &super::motion::Rate<M>| rate.derivative.fixed_rows::<3>(0).norm_squared() / 3.0;
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
        let best = signs
            .into_iter()
            .min_by(|a, b| change(*a).norm().total_cmp(&change(*b).norm()));
        let Some((a, b)) = best else { return };
        let residual = change((a, b));
        let rough = INTEGRATION * integral.norm();
        let variance = self.variance + of_rate(first) + of_rate(last) + rough * rough;
        let (cost, weight) = robust(residual.norm_squared() / variance, 3.0);
        sums.cost += cost;
        for (axis, known) in rows.chunks_exact(layout.unknowns()).enumerate().take(3) {
            for (value, known) in row.iter_mut().zip(known) {
                *value = -known;
            }
            add_derivative(&row_of(&last.derivative, axis), end, layout, b, row);
            add_derivative(
                &row_of(&first.derivative, axis),
                &self.begin,
                layout,
                -a,
                row,
            );
            sums.add_dense(row, residual[axis], weight / variance);
        }
    }
}
