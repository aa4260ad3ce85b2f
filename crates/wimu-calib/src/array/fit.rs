//! The fit of an array: equation (99).

use nalgebra::{DMatrix, DVector, SVector, Vector3};
use wimu_model::geometry::Geometry;

use super::estimate::{ArrayEstimate, agreement};
use super::motion::{AxisNow, Body, nominal};
use super::{ArrayData, ArrayPrior};
use crate::least_squares::{self, Normal, Scaled, Settings};
use crate::{Reason, Refusal};

/// Unknowns of an axis: bias, row of the matrix, position, change of the bias in motion.
pub(super) const PER_AXIS: usize = 8;
/// Convergence threshold: change of the residuals in a step, in standard deviations; and the size of the sums for their
/// rounding error.
const SETTINGS: Settings = Settings { cauchy: None, last_step: 1e-3, magnitude: 1e5 };
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

    /// The delay of each sensor, s.
    pub fn delays<const M: usize>(self, value: &dyn Fn(usize) -> f64) -> [f64; M] {
        core::array::from_fn(|s| if s < self.sensors() { value(self.delay(s)) } else { 0.0 })
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

/// A row of derivatives: by the unknowns of its axis, and by one other unknown.
pub(super) type Row = SVector<f64, { PER_AXIS + 1 }>;

/// Normal equations in units of the prior deviations, lower triangle, with what the blocks of samples pull.
pub(super) struct Sums<'a> {
    pub normal: DMatrix<f64>,
    /// Minus the gradient.
    pub right: DVector<f64>,
    /// Σ of the outer products of the pull of each block of samples, whose errors are correlated.
    pub spread: DMatrix<f64>,
    pub pull: DVector<f64>,
    /// Prior deviation of each unknown.
    pub scale: &'a DVector<f64>,
    pub cost: f64,
}

impl<'a> Sums<'a> {
    fn new(scale: &'a DVector<f64>) -> Self {
        let n = scale.len();
        Self {
            normal: DMatrix::zeros(n, n),
            right: DVector::zeros(n),
            spread: DMatrix::zeros(n, n),
            pull: DVector::zeros(n),
            scale,
            cost: 0.0,
        }
    }

    /// Adds a block's pull to the gradient, and its outer product to the spread.
    pub fn end_block(&mut self) {
        if self.pull.iter().any(|pull| *pull != 0.0) {
            self.spread.ger(1.0, &self.pull, &self.pull, 1.0);
            self.right += &self.pull;
            self.pull.fill(0.0);
        }
    }

    /// Adds a row for each axis: derivatives by its own unknowns and by the unknown `last(axis)`, with the projection
    /// `between` the rows.
    pub fn add<const M: usize>(
        &mut self,
        rows: &[Row; M],
        last: impl Fn(usize) -> usize,
        axes: usize,
        residual: &SVector<f64, M>,
        between: impl Fn(usize, usize) -> f64,
    ) {
        let mut own = [SVector::<f64, PER_AXIS>::zeros(); M];
        let mut other = [0.0; M];
        for a in 0..axes {
            let scale = self.scale.fixed_rows::<PER_AXIS>(PER_AXIS * a);
            own[a] = rows[a].fixed_rows::<PER_AXIS>(0).component_mul(&scale);
            other[a] = rows[a][PER_AXIS] * self.scale[last(a)];
            let mut pull = self.pull.fixed_rows_mut::<PER_AXIS>(PER_AXIS * a);
            pull += own[a] * residual[a];
            self.pull[last(a)] += other[a] * residual[a];
        }
        for (a, b) in (0..axes).flat_map(|a| (0..=a).map(move |b| (a, b))) {
            let c = between(a, b);
            let (p, q) = (last(a), last(b));
            let at = (PER_AXIS * a, PER_AXIS * b);
            let mut block = self.normal.fixed_view_mut::<PER_AXIS, PER_AXIS>(at.0, at.1);
            block.ger(c, &own[a], &own[b], 1.0);
            let twice = if a != b && p == q { 2.0 } else { 1.0 };
            self.normal[(p, q)] += twice * c * other[a] * other[b];
            let mut line = self.normal.fixed_view_mut::<1, PER_AXIS>(p, at.1);
            line += own[b].transpose() * (c * other[a]);
            if a != b {
                let mut line = self.normal.fixed_view_mut::<1, PER_AXIS>(q, at.0);
                line += own[a].transpose() * (c * other[b]);
            }
        }
    }

    /// Ties the mean of the delays of the sensors in use, which no output shows, to zero.
    fn tie_delays(&mut self, layout: Layout, used: &dyn Fn(usize) -> bool, values: &DVector<f64>) {
        let sensors = || (0..layout.sensors()).filter(|s| used(*s)).map(|s| layout.delay(s));
        let weight = 1.0 / (TIED_S * TIED_S);
        let mean: f64 = sensors().map(|i| self.scale[i] * values[i]).sum();
        for i in sensors() {
            self.right[i] -= self.scale[i] * mean * weight;
            for j in sensors() {
                let value = self.scale[i] * self.scale[j] * weight;
                self.normal[(i, j)] += value;
                self.spread[(i, j)] += value;
            }
        }
        self.cost += mean * mean * weight;
    }

    /// Adds the prior, and fills in the upper triangle.
    fn finish(&mut self, values: &DVector<f64>) {
        for i in 0..values.len() {
            self.normal[(i, i)] += 1.0;
            self.spread[(i, i)] += 1.0;
        }
        self.right -= values;
        self.cost += values.norm_squared();
        self.normal.fill_upper_triangle_with_lower_triangle();
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

/// The recording with its geometry and prior: sums at values of the unknowns, in units of their prior deviations.
struct Problem<'a, const M: usize> {
    layout: Layout,
    usable: &'a dyn Fn(usize) -> bool,
    data: &'a ArrayData<'a, M>,
    prior: &'a ArrayPrior,
    start: [AxisNow; M],
    scale: DVector<f64>,
    /// Whether there are samples outside rests.
    moves: bool,
}

impl<const M: usize> Problem<'_, M> {
    fn sums(&self, values: &DVector<f64>) -> Result<Sums<'_>, Refusal> {
        let (layout, data) = (self.layout, self.data);
        let mut sums = Sums::new(&self.scale);
        let unscaled = |i: usize| values[i] * self.scale[i];
        let axes = axes_with(&self.start, layout, &unscaled);
        let delays = layout.delays(&unscaled);
        let gravity = self.prior.gravity_mps2 + unscaled(layout.gravity());
        super::rests::add(&axes, layout, data, self.prior, gravity, &mut sums);
        let current = super::moving::Current { layout, delays: &delays };
        match Body::new(axes) {
            Some(body) => super::moving::add(&body, &current, data, &mut sums),
            None if self.moves => return Err(no_motion()),
            None => {}
        }
        sums.tie_delays(layout, self.usable, values);
        sums.finish(values);
        if sums.cost.is_finite() { Ok(sums) } else { Err(diverged()) }
    }
}

fn no_motion() -> Refusal {
    let text = "the axes do not determine angular acceleration and specific force: mount the sensors apart, not on a line";
    Refusal::new(Reason::NotObservable, text)
}

fn diverged() -> Refusal {
    let text = "the fit does not converge: check outputs, sensitivity and geometry";
    Refusal::new(Reason::PoorFit { rms: f64::INFINITY, index: 0 }, text)
}

/// Fits all unknowns.
pub(super) fn solve_all<const M: usize>(
    geometry: &Geometry<M>,
    usable: &dyn Fn(usize) -> bool,
    data: &ArrayData<'_, M>,
    prior: &ArrayPrior,
) -> Result<ArrayEstimate<M>, Refusal> {
    let layout = Layout::of(geometry);
    let n = layout.unknowns();
    let mut moves = false;
    super::moving::for_each(data, |_| moves = true);
    let problem = Problem {
        layout,
        usable,
        data,
        prior,
        start: nominal(geometry, usable),
        scale: DVector::from_fn(n, |i, _| layout.prior(i, prior)),
        moves,
    };
    let start = DVector::zeros(n);
    problem.sums(&start)?;
    let sums = |values: &DVector<f64>| {
        let Sums { normal, right, cost, .. } = problem.sums(values).ok()?;
        Some(Normal { information: normal, gradient: -right, cost })
    };
    let moved = |values: &DVector<f64>, step: &DVector<f64>| values + step;
    // A fit that stops at a rough cost is as good as it gets.
    let end = least_squares::iterate(&start, 1.0, SETTINGS, sums, moved).ok_or_else(diverged)?;
    let Sums { normal, spread, .. } = problem.sums(&end.at)?;
    let factor = Scaled::new(&normal, 0.0).ok_or_else(diverged)?;
    // Variance of the gradient over that of white residuals, at least 1, from the blocks of samples: residuals of a
    // motion that is no rigid body's are correlated.
    let inverse = factor.inverse();
    let (found, known) = ((&inverse * spread).trace(), inverse.trace());
    let expected = n as f64 - known;
    let inflation = if expected > 0.0 { ((found - known) / expected).max(1.0) } else { 1.0 };
    // The information of the samples is smaller by that, not that of the prior.
    let one = DMatrix::identity(n, n);
    let tempered = (normal - &one) / inflation + one;
    let mut covariance = Scaled::new(&tempered, 0.0).ok_or_else(diverged)?.inverse();
    for (i, j) in (0..n).flat_map(|i| (0..n).map(move |j| (i, j))) {
        covariance[(i, j)] *= problem.scale[i] * problem.scale[j];
    }
    let values = end.at.component_mul(&problem.scale);
    Ok(ArrayEstimate {
        layout,
        agreement: agreement(geometry, usable, data, &values),
        values,
        covariance,
    })
}
