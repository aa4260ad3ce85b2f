//! Gauss-Newton iteration of the fit: equation (99).

use nalgebra::{SVector, Vector3};
use wimu_model::geometry::Geometry;

use super::dense::{factorise, invert, solve};
use super::motion::{AxisNow, Body, nominal};
use super::{ArrayData, ArrayPrior, ArrayRefusal};

/// Unknowns of an axis: bias, row of the matrix, position, change of the bias in motion.
pub(super) const PER_AXIS: usize = 8;
/// Largest number of iterations. Typical: 5 to 10.
const MOST_ITERATIONS: usize = 40;
/// Convergence threshold: largest change of an unknown, in its prior deviations.
const LAST_STEP: f64 = 1e-4;
/// First damping, and the largest: the fit ends when even this step does not reduce the cost.
const FIRST_DAMPING: f64 = 1e-3;
const MOST_DAMPING: f64 = 1e9;
/// The sum of all delays is tied to zero within this, s: far below any delay that matters.
const TIED_S: f64 = 1e-6;

/// Where each unknown is in the vector of all.
#[derive(Clone, Copy, Debug)]
pub(super) struct Layout {
    pub axes: usize,
    pub group: usize,
}

impl Layout {
    pub fn of<const M: usize>(geometry: &Geometry<M>) -> Self {
        Self { axes: geometry.axes().len(), group: geometry.group() }
    }

    pub fn sensors(self) -> usize {
        self.axes / self.group.max(1)
    }

    pub fn delay(self, sensor: usize) -> usize {
        PER_AXIS * self.axes + sensor
    }

    pub fn gravity(self) -> usize {
        PER_AXIS * self.axes + self.sensors()
    }

    pub fn unknowns(self) -> usize {
        self.gravity() + 1
    }

    /// Prior standard deviation of an unknown.
    pub fn prior(self, unknown: usize, prior: &ArrayPrior) -> f64 {
        if unknown < PER_AXIS * self.axes {
            match unknown % PER_AXIS {
                0 => prior.bias_mps2,
                1..=3 => prior.matrix,
                4..=6 => prior.position_m,
                _ => prior.repeatability_mps2,
            }
        } else if unknown < self.gravity() {
            prior.delay_s
        } else {
            prior.gravity_sd_mps2.max(1e-6)
        }
    }
}

/// Normal equations in units of the prior deviations, lower triangle, with what the blocks of samples pull.
pub(super) struct Sums<'a> {
    pub n: usize,
    pub normal: &'a mut [f64],
    pub right: &'a mut [f64],
    /// Σ of the outer products of the pull of each block of samples, whose errors are correlated.
    pub spread: &'a mut [f64],
    pub pull: &'a mut [f64],
    /// Prior deviation of each unknown.
    pub scale: &'a [f64],
    pub cost: f64,
}

impl Sums<'_> {
    fn clear(&mut self) {
        for part in [&mut *self.normal, self.right, self.spread, self.pull] {
            part.fill(0.0);
        }
        self.cost = 0.0;
    }

    /// Adds a block's pull to the gradient, and its outer product to the spread.
    pub fn end_block(&mut self) {
        for i in 0..self.n {
            let value = self.pull[i];
            if value != 0.0 {
                for j in 0..=i {
                    self.spread[i * self.n + j] += value * self.pull[j];
                }
            }
            self.right[i] += value;
        }
        self.pull.fill(0.0);
    }

    /// Adds a row for each axis: derivatives by its own unknowns and by the unknown `last(axis)`, with the projection
    /// `between` the rows.
    pub fn add<const M: usize>(
        &mut self,
        rows: &[[f64; PER_AXIS + 1]; M],
        last: impl Fn(usize) -> usize,
        axes: usize,
        residual: &SVector<f64, M>,
        between: impl Fn(usize, usize) -> f64,
    ) {
        let n = self.n;
        let mut scaled = *rows;
        for (a, row) in scaled.iter_mut().enumerate().take(axes) {
            let own = self.scale[PER_AXIS * a..].iter().take(PER_AXIS);
            for (value, scale) in row.iter_mut().zip(own.chain([&self.scale[last(a)]])) {
                *value *= scale;
            }
            for (pull, value) in self.pull[PER_AXIS * a..].iter_mut().zip(&row[..PER_AXIS]) {
                *pull += value * residual[a];
            }
            self.pull[last(a)] += row[PER_AXIS] * residual[a];
        }
        for a in 0..axes {
            for b in 0..=a {
                let c = between(a, b);
                let (x, y) = (&scaled[a], &scaled[b]);
                for (i, x) in x[..PER_AXIS].iter().enumerate() {
                    let at = (PER_AXIS * a + i) * n + PER_AXIS * b;
                    let count = if a == b { i + 1 } else { PER_AXIS };
                    accumulate(&mut self.normal[at..at + count], y, c * x);
                }
                let (p, q) = (last(a), last(b));
                let twice = if a != b && p == q { 2.0 } else { 1.0 };
                self.normal[p * n + q] += twice * c * x[PER_AXIS] * y[PER_AXIS];
                let at = p * n + PER_AXIS * b;
                accumulate(&mut self.normal[at..at + PER_AXIS], y, c * x[PER_AXIS]);
                if a != b {
                    let at = q * n + PER_AXIS * a;
                    accumulate(&mut self.normal[at..at + PER_AXIS], x, c * y[PER_AXIS]);
                }
            }
        }
    }

    /// Ties the mean of the delays of the sensors in use, which no output shows, to zero.
    fn tie_delays(&mut self, layout: Layout, used: &dyn Fn(usize) -> bool, values: &[f64]) {
        let sensors = || (0..layout.sensors()).filter(|s| used(*s)).map(|s| layout.delay(s));
        let weight = 1.0 / (TIED_S * TIED_S);
        let mean: f64 = sensors().map(|i| self.scale[i] * values[i]).sum();
        for i in sensors() {
            self.right[i] -= self.scale[i] * mean * weight;
            for j in sensors().take_while(|j| *j <= i) {
                let value = self.scale[i] * self.scale[j] * weight;
                self.normal[i * self.n + j] += value;
                self.spread[i * self.n + j] += value;
            }
        }
        self.cost += mean * mean * weight;
    }
}

fn accumulate(sums: &mut [f64], row: &[f64], factor: f64) {
    for (sum, value) in sums.iter_mut().zip(row) {
        *sum += factor * value;
    }
}

/// The axes with unknowns put in.
pub(super) fn axes_with<const M: usize>(
    start: &[AxisNow; M],
    layout: Layout,
    value: &dyn Fn(usize) -> f64,
) -> [AxisNow; M] {
    let mut axes = *start;
    for (index, axis) in axes.iter_mut().enumerate().take(layout.axes) {
        let at = |i: usize| value(PER_AXIS * index + i);
        (axis.bias_mps2, axis.drift_mps2) = (at(0), at(7));
        axis.m += Vector3::new(at(1), at(2), at(3));
        axis.r += Vector3::new(at(4), at(5), at(6));
    }
    axes
}

/// Result of the iteration; unknowns in their own units.
pub(super) struct Solved<'a> {
    pub values: &'a [f64],
    /// Posterior covariance, in units of the prior deviations, full.
    pub covariance: &'a [f64],
    pub cost: f64,
    pub inflation: f64,
    /// ln |N|, N the normal matrix in units of the prior deviations.
    pub log_determinant: f64,
}

/// Variance of the gradient over that of white residuals, at least 1, from the blocks of samples; `factor` is that of the
/// normal matrix. Residuals of a motion that is no rigid body's are correlated.
fn inflation(factor: &[f64], sums: &mut Sums<'_>) -> Option<f64> {
    let n = sums.n;
    let (mut found, mut prior) = (0.0, 0.0);
    for i in 0..n {
        sums.pull.fill(0.0);
        sums.pull[i] = 1.0;
        solve(factor, sums.pull)?;
        prior += sums.pull[i];
        for (j, value) in sums.pull.iter().enumerate() {
            found += value * sums.spread[i.max(j) * n + i.min(j)];
        }
    }
    let expected = n as f64 - prior;
    Some(if expected > 0.0 { ((found - prior) / expected).max(1.0) } else { 1.0 })
}

/// Levenberg-Marquardt on the unknowns in units of their prior deviations.
pub(super) fn solve_all<'w, const M: usize>(
    geometry: &Geometry<M>,
    usable: &dyn Fn(usize) -> bool,
    data: &ArrayData<'_, M>,
    prior: &ArrayPrior,
    workspace: &'w mut [f64],
) -> Result<Solved<'w>, ArrayRefusal> {
    let layout = Layout::of(geometry);
    let n = layout.unknowns();
    let need = super::workspace_len(layout.axes, layout.group);
    if workspace.len() < need {
        return Err(ArrayRefusal::Workspace { need });
    }
    let start = nominal(geometry, usable);
    let (normal, rest) = workspace.split_at_mut(n * n);
    let (spread, rest) = rest.split_at_mut(n * n);
    let (factor, rest) = rest.split_at_mut(n * n);
    let mut parts = rest.chunks_exact_mut(n);
    let mut part = || parts.next().ok_or(ArrayRefusal::Workspace { need });
    let (right, pull, scale, values, step) = (part()?, part()?, part()?, part()?, part()?);
    for (i, scale) in scale.iter_mut().enumerate() {
        *scale = layout.prior(i, prior);
    }
    values.fill(0.0);
    let mut moves = false;
    super::moving::for_each(data, |_| moves = true);
    let mut sums = Sums { n, normal, right, spread, pull, scale, cost: 0.0 };
    let evaluate = |values: &[f64], sums: &mut Sums<'_>| {
        sums.clear();
        let unscaled = |i: usize| values[i] * sums.scale[i];
        let axes = axes_with(&start, layout, &unscaled);
        let delays: [f64; M] = core::array::from_fn(|sensor| match sensor < layout.sensors() {
            true => unscaled(layout.delay(sensor)),
            false => 0.0,
        });
        let gravity = prior.gravity_mps2 + unscaled(layout.gravity());
        super::rests::add(&axes, layout, data, prior, gravity, sums);
        let current = super::moving::Current { layout, delays: &delays };
        match Body::new(axes) {
            Some(body) => super::moving::add(&body, &current, data, sums),
            None if moves => return Err(ArrayRefusal::Geometry),
            None => {}
        }
        for i in 0..n {
            sums.normal[i * n + i] += 1.0;
            sums.spread[i * n + i] += 1.0;
            sums.right[i] -= values[i];
            sums.cost += values[i] * values[i];
        }
        sums.tie_delays(layout, usable, values);
        sums.cost.is_finite().then_some(()).ok_or(ArrayRefusal::NotFinite)
    };
    evaluate(values, &mut sums)?;
    let mut damping = 0.0;
    for _ in 0..MOST_ITERATIONS {
        factor.copy_from_slice(sums.normal);
        for i in 0..n {
            factor[i * n + i] *= 1.0 + damping;
        }
        step.copy_from_slice(sums.right);
        factorise(factor, n).and_then(|()| solve(factor, step)).ok_or(ArrayRefusal::NotFinite)?;
        let before = sums.cost;
        for (value, step) in values.iter_mut().zip(step.iter()) {
            *value += step;
        }
        let largest = step.iter().fold(0.0, |most: f64, s| most.max(s.abs()));
        let better = evaluate(values, &mut sums).is_ok() && sums.cost <= before * (1.0 + 1e-9);
        if better {
            damping = if damping > FIRST_DAMPING { damping * 0.1 } else { 0.0 };
        } else {
            for (value, step) in values.iter_mut().zip(step.iter()) {
                *value -= step;
            }
            evaluate(values, &mut sums)?;
            damping = (damping * 10.0).max(FIRST_DAMPING);
        }
        if (better && largest < LAST_STEP) || damping > MOST_DAMPING {
            break;
        }
    }
    factor.copy_from_slice(sums.normal);
    factorise(factor, n).ok_or(ArrayRefusal::NotFinite)?;
    let log_determinant = 2.0 * (0..n).map(|i| libm::log(factor[i * n + i])).sum::<f64>();
    let inflation = inflation(factor, &mut sums).ok_or(ArrayRefusal::NotFinite)?;
    let Sums { normal, scale, cost, .. } = sums;
    // The information of the samples is smaller by that, not that of the prior.
    for (k, (tempered, value)) in factor.iter_mut().zip(normal.iter()).enumerate() {
        let prior = if k / n == k % n { 1.0 } else { 0.0 };
        *tempered = (value - prior) / inflation + prior;
    }
    factorise(factor, n).and_then(|()| invert(factor, normal, n)).ok_or(ArrayRefusal::NotFinite)?;
    for (value, scale) in values.iter_mut().zip(scale.iter()) {
        *value *= scale;
    }
    Ok(Solved { values, covariance: normal, cost, inflation, log_determinant })
}
