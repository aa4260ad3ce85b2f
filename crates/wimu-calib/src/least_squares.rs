//! Maximum-a-posteriori least squares, the estimator of every sensor: equations (14) to (16).
//!
//! A [`ResidualModel`] gives the residuals r and their derivatives J at a point. The fit minimises Σ w ρ(r) by
//! Levenberg-Marquardt. A Gaussian prior is a row with weight 1/σ², and an observation of weight 0 is left out. The
//! covariance for residuals of unit variance is (JᵀWJ)⁻¹; leaving observations out follows from the hat matrix.

use nalgebra::{Cholesky, DMatrix, DVector, Dyn};

/// Largest number of iterations; a fit that needs more has not converged. Typical: 3 to 6.
const MOST_ITERATIONS: usize = 100;
/// Smallest damping other than 0, relative to the unit diagonal of the information matrix.
const LEAST_DAMPING: f64 = 1e-6;
/// Largest damping; the fit fails when even this step does not reduce the cost.
const MOST_DAMPING: f64 = 1e8;
/// Leverage above which observations are left out by a complete refit. The error of the single step is of second
/// order and grows with 1 / (1 − leverage).
const MOST_LEVERAGE: f64 = 0.5;

/// Residuals of a model at a point, a row for each observation.
#[derive(Clone, Debug)]
pub(crate) struct Rows {
    pub residual: DVector<f64>,
    /// Derivatives by the unknowns.
    pub jacobian: DMatrix<f64>,
}

impl Rows {
    pub fn zeros(observations: usize, unknowns: usize) -> Self {
        let zeros = alloc::vec![0.0; observations * unknowns];
        let jacobian = DMatrix::from_vec(observations, unknowns, zeros);
        Self { residual: DVector::zeros(observations), jacobian }
    }
}

/// What is fitted: observations as functions of a point.
pub(crate) trait ResidualModel {
    /// The unknowns, and what is held.
    type Point: Clone;

    /// `None` where the model is not defined.
    fn rows(&self, at: &Self::Point) -> Option<Rows>;

    /// The point after a step of the unknowns.
    fn moved(&self, at: &Self::Point, step: &DVector<f64>) -> Self::Point;
}

/// Cost of a residual, and when the iteration ends.
#[derive(Clone, Copy)]
pub(crate) struct Settings {
    /// Scale of the Cauchy cost c² ln(1 + (r/c)²), in the unit of the residuals; `None` for squares. Large residuals
    /// then have little influence.
    pub cauchy: Option<f64>,
    /// Convergence threshold: rms change of the residuals in an undamped step.
    pub last_step: f64,
    /// Size of the observations, for the rounding error of the residuals.
    pub magnitude: f64,
}

/// A converged fit.
#[derive(Clone, Debug)]
pub(crate) struct Fit<P> {
    pub at: P,
    /// (JᵀWJ)⁻¹: the covariance for residuals of unit variance.
    pub inverse: DMatrix<f64>,
    /// Σ w r².
    pub cost: f64,
    /// Residuals of all observations at the solution; [`Fit::change`] leaves them.
    pub rows: Rows,
}

/// The normal equations at a point: JᵀWJ, JᵀWr and Σ w ρ(r).
pub(crate) struct Normal {
    /// What they are formed of; without rows where the sums are formed otherwise.
    pub rows: Rows,
    pub information: DMatrix<f64>,
    pub gradient: DVector<f64>,
    pub cost: f64,
}

impl Normal {
    fn new(rows: Rows, weights: &[f64], cauchy: Option<f64>) -> Option<Self> {
        let mut effective = DVector::from_column_slice(weights);
        let mut cost = 0.0;
        for (weight, residual) in effective.iter_mut().zip(&rows.residual) {
            let square = residual * residual;
            if *weight == 0.0 {
                continue;
            }
            let Some(cauchy) = cauchy else {
                cost += *weight * square;
                continue;
            };
            let grown = 1.0 + square / (cauchy * cauchy);
            cost += *weight * cauchy * cauchy * libm::log(grown);
            *weight /= grown;
        }
        let mut weighted = rows.jacobian.clone();
        weighted.column_iter_mut().for_each(|mut of| of.component_mul_assign(&effective));
        let gradient = weighted.tr_mul(&rows.residual);
        let unknowns = weighted.ncols();
        let mut information = DMatrix::zeros(unknowns, unknowns);
        for (r, c) in (0..unknowns).flat_map(|c| (c..unknowns).map(move |r| (r, c))) {
            information[(r, c)] = rows.jacobian.column(r).dot(&weighted.column(c));
        }
        information.fill_upper_triangle_with_lower_triangle();
        cost.is_finite().then_some(Self { rows, information, gradient, cost })
    }
}

/// Cholesky decomposition of a symmetric matrix scaled to unit diagonal.
pub(crate) struct Scaled {
    /// 1 / square root of each diagonal element of the matrix.
    scale: DVector<f64>,
    factor: Cholesky<f64, Dyn>,
}

impl Scaled {
    /// Of `matrix` with `damping` added to its unit diagonal; `None` unless it is positive definite beyond rounding.
    pub fn new(matrix: &DMatrix<f64>, damping: f64) -> Option<Self> {
        let scale = matrix.diagonal().map(|element| 1.0 / libm::sqrt(element));
        if !scale.iter().all(|scale| scale.is_finite()) {
            return None;
        }
        let mut scaled = on_both_sides(matrix.clone(), &scale);
        for i in 0..scale.len() {
            scaled[(i, i)] += damping;
        }
        let factor = Cholesky::new(scaled)?;
        let pivots = factor.l_dirty().diagonal();
        pivots.iter().all(|pivot| pivot * pivot > f64::EPSILON).then_some(Self { scale, factor })
    }

    /// Solution x of matrix · x = `right`, and its norm in the scaled unknowns.
    pub fn solve(&self, right: &DVector<f64>) -> (DVector<f64>, f64) {
        let scaled = right.component_mul(&self.scale);
        let half = self.factor.l_dirty().solve_lower_triangular(&scaled);
        let norm = half.map_or(f64::NAN, |half| half.norm());
        (self.factor.solve(&scaled).component_mul(&self.scale), norm)
    }

    pub fn inverse(&self) -> DMatrix<f64> {
        on_both_sides(self.factor.inverse(), &self.scale)
    }
}

/// Multiplies rows and columns of `matrix` by `scale`.
pub(crate) fn on_both_sides(mut matrix: DMatrix<f64>, scale: &DVector<f64>) -> DMatrix<f64> {
    for (mut column, factor) in matrix.column_iter_mut().zip(scale) {
        column.component_mul_assign(scale);
        column *= *factor;
    }
    matrix
}

/// Where an iteration ended.
pub(crate) struct End<P> {
    pub at: P,
    /// JᵀWJ near there.
    pub information: Scaled,
    pub cost: f64,
    pub rows: Rows,
}

impl<P> End<P> {
    pub fn fit(self) -> Fit<P> {
        let inverse = self.information.inverse();
        Fit { at: self.at, inverse, cost: self.cost, rows: self.rows }
    }
}

/// Levenberg-Marquardt from `start` on normal equations of `count` observations. `None` where they are not defined at
/// the start, an unknown is not determined, or it does not converge.
pub(crate) fn iterate<P: Clone>(
    start: &P,
    count: f64,
    settings: Settings,
    sums: impl Fn(&P) -> Option<Normal>,
    moved: impl Fn(&P, &DVector<f64>) -> P,
) -> Option<End<P>> {
    let last_step = settings.last_step.max(4.0 * f64::EPSILON * settings.magnitude);
    let mut at = start.clone();
    let mut normal = sums(&at)?;
    let mut damping = 0.0;
    for _ in 0..MOST_ITERATIONS {
        // The damped Gauss-Newton step: equation (14).
        let Some(factor) = Scaled::new(&normal.information, damping) else {
            if damping > 1.0 {
                return None;
            }
            damping = more(damping);
            continue;
        };
        let (step, change) = factor.solve(&normal.gradient);
        let step = -step;
        let trial = moved(&at, &step);
        // The step lowers the cost by the square of the change of the residuals.
        let gained = change * change;
        if damping <= 0.0 && libm::sqrt(gained / count) <= last_step {
            let cost = (normal.cost - gained).max(0.0);
            let mut rows = normal.rows;
            rows.residual.gemv(1.0, &rows.jacobian, &step, 1.0);
            return Some(End { at: trial, information: factor, cost, rows });
        }
        let rounding = 20.0 * f64::EPSILON * settings.magnitude * libm::sqrt(normal.cost * count);
        match sums(&trial) {
            Some(next) if next.cost <= normal.cost + rounding => {
                (at, normal) = (trial, next);
                damping = if damping > LEAST_DAMPING { damping * 0.1 } else { 0.0 };
            }
            _ if damping > MOST_DAMPING => return None,
            _ => damping = more(damping),
        }
    }
    None
}

/// Minimises the cost of `model` from `start`. `None` when it does not converge or an unknown is not determined.
pub(crate) fn minimise<M: ResidualModel>(
    model: &M,
    start: &M::Point,
    weights: &[f64],
    settings: Settings,
) -> Option<Fit<M::Point>> {
    Some(end(model, start, weights, settings)?.fit())
}

/// [`minimise`] without the covariance.
pub(crate) fn end<M: ResidualModel>(
    model: &M,
    start: &M::Point,
    weights: &[f64],
    settings: Settings,
) -> Option<End<M::Point>> {
    let sums = |at: &M::Point| Normal::new(model.rows(at)?, weights, settings.cauchy);
    let count = weights.iter().filter(|weight| **weight > 0.0).count() as f64;
    iterate(start, count, settings, sums, |at, step| model.moved(at, step))
}

fn more(damping: f64) -> f64 {
    (damping * 10.0).max(LEAST_DAMPING)
}

impl<P: Clone> Fit<P> {
    /// Variance that the fit gives to an observation with derivatives `row`, for residuals of unit variance.
    pub fn variance(&self, row: &DVector<f64>) -> f64 {
        row.dot(&(&self.inverse * row))
    }

    /// Adds an observation to the linearised fit, or with negative `weight` removes one; returns the step of the
    /// unknowns: equation (16).
    pub fn change(&mut self, row: &DVector<f64>, residual: f64, weight: f64) -> DVector<f64> {
        let gain = &self.inverse * row;
        let factor = weight / (1.0 + weight * row.dot(&gain));
        self.inverse.ger(-factor, &gain, &gain, 1.0);
        self.cost += factor * residual * residual;
        gain * (-factor * residual)
    }

    /// Variance that the fit gives to each observation, for residuals of unit variance: the diagonal of J P Jᵀ.
    pub fn variances(&self) -> DVector<f64> {
        quadratic_forms(&self.rows.jacobian, &self.inverse)
    }

    /// Residual of each observation under the fit to those outside its group: equation (16). Infinite if these do not
    /// determine the unknowns.
    pub fn left_out<M: ResidualModel<Point = P>>(
        &self,
        model: &M,
        weights: &[f64],
        groups: impl Iterator<Item = impl AsRef<[usize]>>,
        settings: Settings,
    ) -> DVector<f64> {
        let variances = self.variances();
        let mut left = self.rows.residual.clone();
        for group in groups {
            let group = group.as_ref();
            let leverage: f64 = group.iter().map(|k| weights[*k] * variances[*k]).sum();
            if let [alone] = *group
                && leverage <= MOST_LEVERAGE
            {
                left[alone] /= 1.0 - leverage;
                continue;
            }
            let found = if leverage > MOST_LEVERAGE {
                self.refitted(model, weights, group, settings)
            } else {
                self.taken_out(weights, group)
            };
            let found = found.filter(|found| found.iter().all(|r| r.is_finite()));
            for (i, k) in group.iter().enumerate() {
                left[*k] = found.as_ref().map_or(f64::INFINITY, |found| found[i]);
            }
        }
        left
    }

    /// Residuals of `group` under a refit of all others.
    fn refitted<M: ResidualModel<Point = P>>(
        &self,
        model: &M,
        weights: &[f64],
        group: &[usize],
        settings: Settings,
    ) -> Option<DVector<f64>> {
        let mut others = weights.to_vec();
        group.iter().for_each(|k| others[*k] = 0.0);
        let without = minimise(model, &self.at, &others, settings)?;
        Some(model.rows(&without.at)?.residual.select_rows(group))
    }

    /// Residuals of `group` under the linearised fit to all others.
    fn taken_out(&self, weights: &[f64], group: &[usize]) -> Option<DVector<f64>> {
        // In the space of the unknowns: a group may have far more observations.
        let residual = self.rows.residual.select_rows(group);
        let jacobian = self.rows.jacobian.select_rows(group);
        let mut weighted = jacobian.clone();
        for (mut row, k) in weighted.row_iter_mut().zip(group) {
            row.scale_mut(weights[*k]);
        }
        let taken = &self.inverse * jacobian.tr_mul(&weighted);
        let rest = DMatrix::identity(taken.nrows(), taken.ncols()) - taken;
        let step = rest.lu().solve(&(&self.inverse * weighted.tr_mul(&residual)))?;
        Some(residual + jacobian * step)
    }
}

/// xᵀ M x of each row x.
pub(crate) fn quadratic_forms(rows: &DMatrix<f64>, matrix: &DMatrix<f64>) -> DVector<f64> {
    (rows * matrix).component_mul(rows).column_sum()
}

#[cfg(test)]
mod thermal_bias;

#[cfg(test)]
mod tests {
    use alloc::vec;
    use alloc::vec::Vec;

    use super::*;

    /// y = exp(a + b t) at the times, with a prior on b in the last row.
    struct Growth {
        times: Vec<f64>,
        values: Vec<f64>,
    }

    impl ResidualModel for Growth {
        type Point = [f64; 2];

        fn rows(&self, at: &[f64; 2]) -> Option<Rows> {
            let n = self.times.len();
            let mut rows =
                Rows { residual: DVector::zeros(n + 1), jacobian: DMatrix::zeros(n + 1, 2) };
            for k in 0..n {
                let value = libm::exp(at[0] + at[1] * self.times[k]);
                rows.residual[k] = value - self.values[k];
                rows.jacobian[(k, 0)] = value;
                rows.jacobian[(k, 1)] = value * self.times[k];
            }
            rows.residual[n] = at[1];
            rows.jacobian[(n, 1)] = 1.0;
            Some(rows)
        }

        fn moved(&self, at: &[f64; 2], step: &DVector<f64>) -> [f64; 2] {
            [at[0] + step[0], at[1] + step[1]]
        }
    }

    const EXACT: Settings = Settings { cauchy: None, last_step: 1e-12, magnitude: 1.0 };

    #[test]
    fn a_fit_finds_the_unknowns_and_leaves_observations_out() {
        let times: Vec<f64> = (0..12).map(|k| 0.1 * f64::from(k)).collect();
        let values = times.iter().map(|t| libm::exp(0.3 - 0.8 * t)).collect();
        let mut growth = Growth { times, values };
        let mut weights = vec![1.0; 13];
        weights[12] = 0.0;
        let found = minimise(&growth, &[0.0, 0.0], &weights, EXACT).expect("converges");
        assert!((found.at[0] - 0.3).abs() < 1e-9 && (found.at[1] + 0.8).abs() < 1e-9);
        // A prior of the weight of the data moves the estimate half way.
        weights[12] = 1.0 / found.inverse[(1, 1)];
        let with = minimise(&growth, &[0.0, 0.0], &weights, EXACT).expect("converges");
        assert!((-0.5..-0.3).contains(&with.at[1]), "{}", with.at[1]);
        weights[12] = 0.0;
        // One observation is wrong: left out, it is off by its whole error; a Cauchy cost ignores it.
        growth.values[4] += 0.2;
        let wrong = minimise(&growth, &[0.0, 0.0], &weights, EXACT).expect("converges");
        let left = wrong.left_out(&growth, &weights, [[4]].iter(), EXACT);
        assert!((left[4] + 0.2).abs() < 0.02 && wrong.rows.residual[4] > -0.19, "{left}");
        let robust = Settings { cauchy: Some(1e-3), ..EXACT };
        let found = minimise(&growth, &wrong.at, &weights, robust).expect("converges");
        assert!((found.at[1] + 0.8).abs() < 1e-3, "{}", found.at[1]);
        // Two observations determine two unknowns, but not if they are the same.
        let two = |a: usize, b: usize| {
            let only = (0..13).map(|k| f64::from(u8::from(k == a || k == b))).collect::<Vec<_>>();
            minimise(&growth, &[0.0, 0.0], &only, EXACT).is_some()
        };
        assert!(two(1, 9) && !two(3, 3));
    }

    #[test]
    fn the_scaled_decomposition_is_that_of_the_matrix() {
        let matrix = DMatrix::from_row_slice(2, 2, &[4e6, 1e3, 1e3, 9.0]);
        let scaled = Scaled::new(&matrix, 0.0).expect("definite");
        assert!((scaled.inverse() * &matrix - DMatrix::identity(2, 2)).norm() < 1e-9);
        assert!(Scaled::new(&DMatrix::from_element(2, 2, 1.0), 0.0).is_none());
    }
}
