//! The accelerometer in unknown orientations: at rest |f| = g. Equations (12) to (17), (40) to (42b).
//!
//! r_k = |f(y_k; θ)| − g, with f = z − q ∘ z ∘ z and z = A(T)⁻¹ (y − b(T) − drift). The free parameters are a subset of
//! θ; the others keep their starting values. A prior is a row (θ_i − ideal) σ/σ_i, with σ of the residuals.

use alloc::format;
use alloc::string::String;
use alloc::vec::Vec;

use nalgebra::{DMatrix, DVector, Vector3};

use crate::force::{Conditions, Evaluated};
use crate::least_squares::{
    self, End, ResidualModel, Rows, Scaled, Settings, on_both_sides, quadratic_forms,
};
use crate::terms::{self, PERFECT, Theta, USUAL_BIAS_MPS2};
use crate::visits::Visits;
use crate::weights::{USUAL_DOF, USUAL_MPS2, Weighting};
use crate::{Orientation, Pose, Reason, Refusal};

/// Convergence threshold: rms change of the residuals in a Gauss-Newton step, m/s². The remaining
/// error is smaller than the last step by the ratio of residuals to gravity, 10⁻³ or less.
const LAST_STEP_MPS2: f64 = 1e-5;
/// The same for a robust fit, which only ranks poses: fraction of the scale of its cost.
const LAST_ROBUST_STEP: f64 = 1e-2;
/// Largest amplification of an error from the poses to other orientations. Twelve well distributed
/// poses give 1 to 2, twelve random ones 4.
const MOST_AMPLIFICATION: f64 = 10.0;
/// Largest standard deviation of a bias that the poses determine, relative to that of typical sensors.
const LEAST_KNOWN: f64 = 0.5;
/// A fit of the free parameters.
pub(crate) type Fit = least_squares::Fit<Theta>;

/// Least-squares problem: some parameters fitted to |f| = g over static poses.
pub(crate) struct Magnitude<'a> {
    pub poses: &'a [Pose],
    pub visits: &'a Visits,
    pub gravity_mps2: f64,
    pub conditions: Conditions,
    pub weighting: Weighting,
    /// Indices of the rejected poses, the worst first.
    pub rejected: Vec<usize>,
    /// The fitted parameters, indices of [`Theta`]; the others keep their starting values.
    pub free: Vec<usize>,
    /// Standard deviation of the prior of each about a perfect sensor; `None` if it is flat.
    pub prior_sd: Vec<Option<f64>>,
    /// Standard deviation of a residual of weight 1, m/s², against which the priors are weighed.
    pub sd_mps2: f64,
}

impl ResidualModel for Magnitude<'_> {
    type Point = Theta;

    fn rows(&self, theta: &Theta) -> Option<Rows> {
        let at = Evaluated::new(theta)?;
        let (n, p, priors) = (self.poses.len(), self.free.len(), self.priors().count());
        let mut rows = Rows::zeros(n + priors, p);
        for (k, pose) in self.poses.iter().enumerate() {
            let applied = at.pose(pose, &self.conditions);
            rows.residual[k] = applied.force.norm() - self.gravity_mps2;
            self.set_row(&mut rows.jacobian, k, &at.derivatives(&applied));
        }
        for (row, (i, root)) in (n..).zip(self.priors()) {
            let index = self.free[i];
            rows.residual[row] = root * (theta[index] - PERFECT[index]);
            rows.jacobian[(row, i)] = root;
        }
        Some(rows)
    }

    fn moved(&self, theta: &Theta, step: &DVector<f64>) -> Theta {
        let mut moved = *theta;
        for (index, step) in self.free.iter().zip(step) {
            moved[*index] += step;
        }
        moved
    }
}

/// Variance components of the residuals: equation (42b).
pub(crate) struct Shared {
    /// Variance of a residual of weight 1, (m/s²)².
    pub variance: f64,
    /// Covariance of the fitted parameters, relative to `variance`.
    pub spread: DMatrix<f64>,
    /// Degrees of freedom of `variance`.
    pub dof: f64,
}

/// Observability of the fitted parameters: equation (17).
pub(crate) struct Knowledge {
    /// Cofactor matrix (JᵀJ)⁻¹ with the parameters scaled to m/s² at 1 g.
    pub cofactors: DMatrix<f64>,
    /// Standard deviation of |f| − g in the worst orientation, relative to that of the residuals.
    pub amplification: f64,
    /// The orientation in which |f| − g is known worst: a pose there adds most information.
    pub poorest: Orientation,
    /// Whether it is good enough.
    pub suffices: bool,
}

impl Knowledge {
    pub fn refusal(&self) -> Refusal {
        let number = thousands(condition(&self.cofactors));
        let text = format!(
            "These poses do not determine the model (condition number {number}). Add poses with {}, and with {}.",
            self.poorest,
            self.poorest.opposite()
        );
        Refusal::new(Reason::NotObservable, text)
    }
}

/// Condition number of the Jacobian of a cofactor matrix.
pub(crate) fn condition(cofactors: &DMatrix<f64>) -> f64 {
    let values = cofactors.symmetric_eigenvalues();
    // A zero eigenvalue comes out as rounding of about this size.
    let floor = values.max() * f64::EPSILON * 0.5;
    libm::sqrt(values.max() / values.min().max(floor))
}

/// A number in groups of three digits.
fn thousands(value: f64) -> String {
    if value > 1e9 {
        return format!("{value:.0e}");
    }
    let digits = format!("{value:.0}");
    let mut text = String::new();
    for (k, digit) in digits.chars().enumerate() {
        if k > 0 && (digits.len() - k).is_multiple_of(3) {
            text.push(',');
        }
        text.push(digit);
    }
    text
}

impl<'a> Magnitude<'a> {
    /// Of all poses with equal weights, without priors.
    pub fn new(
        poses: &'a [Pose],
        visits: &'a Visits,
        gravity_mps2: f64,
        conditions: Conditions,
        free: Vec<usize>,
    ) -> Self {
        Self {
            poses,
            visits,
            gravity_mps2,
            conditions,
            weighting: Weighting::EQUAL,
            rejected: Vec::new(),
            prior_sd: alloc::vec![None; free.len()],
            free,
            sd_mps2: USUAL_MPS2,
        }
    }

    /// Gives the parameters that `has_prior` selects the prior of typical datasheets: equation (42a).
    pub fn set_priors(&mut self, has_prior: impl Fn(usize) -> bool) {
        let prior = |index: &usize| terms::usual_sd(*index).filter(|_| has_prior(*index));
        self.prior_sd = self.free.iter().map(prior).collect();
    }

    pub fn has_priors(&self) -> bool {
        self.prior_sd.iter().any(Option::is_some)
    }

    /// The column of each prior, and the root of its weight.
    fn priors(&self) -> impl Iterator<Item = (usize, f64)> {
        let all = self.prior_sd.iter().enumerate();
        all.filter_map(|(i, sd)| Some((i, self.sd_mps2 / (*sd)?)))
    }

    /// Number of parameters that the poses determine: all, less the share of the priors.
    pub fn determined(&self, fit: &Fit) -> f64 {
        let share = |(i, root): (usize, f64)| root * root * fit.inverse[(i, i)];
        self.free.len() as f64 - self.priors().map(share).sum::<f64>()
    }

    /// Of the variance of each fitted parameter, the fraction that the priors' uncertainty is: P Λ P of P = (JᵀWJ + Λ)⁻¹.
    pub fn prior_shares(&self, fit: &Fit) -> Vec<f64> {
        let of_priors = |i: usize| {
            let pulls = self.priors().map(|(j, root)| root * fit.inverse[(i, j)]);
            pulls.map(|pull| pull * pull).sum::<f64>() / fit.inverse[(i, i)]
        };
        (0..self.free.len()).map(of_priors).collect()
    }

    /// Σ w r² of the fitted poses but `without`.
    pub fn cost(&self, fit: &Fit, without: Option<usize>) -> f64 {
        if !self.has_priors() {
            return fit.cost;
        }
        let residuals = self.residuals(&fit.at);
        let kept = self.kept().filter(|k| Some(*k) != without);
        kept.map(|k| self.weighting.of(&self.poses[k]) * residuals[k] * residuals[k]).sum()
    }

    /// Prior observations of the residuals' variance, beside priors of the parameters: Σ w r² of usual sensors, and degrees of
    /// freedom.
    pub fn usual(&self) -> (f64, f64) {
        if !self.has_priors() {
            return (0.0, 0.0);
        }
        let dof = USUAL_DOF as f64;
        (dof * (USUAL_MPS2 * USUAL_MPS2 + self.mean_noise()), dof)
    }

    /// Variance of a residual of weight 1: equation (42a).
    pub fn variance(&self, fit: &Fit) -> f64 {
        let (squares, usual_dof) = self.usual();
        let dof = self.count() as f64 - self.determined(fit);
        (self.cost(fit, None) + squares) / (dof.max(0.0) + usual_dof)
    }

    fn settings(&self, cauchy: Option<f64>) -> Settings {
        let last_step = cauchy.map_or(LAST_STEP_MPS2, |scale| LAST_ROBUST_STEP * scale);
        Settings { cauchy, last_step, magnitude: self.gravity_mps2 }
    }

    /// Weight of each pose; 0 for rejected ones.
    pub fn weights(&self) -> Vec<f64> {
        let mut weights: Vec<f64> = self.poses.iter().map(|pose| self.weighting.of(pose)).collect();
        self.rejected.iter().for_each(|k| weights[*k] = 0.0);
        weights.extend(self.priors().map(|_| 1.0));
        weights
    }

    /// The fit to the poses that are not rejected.
    pub fn solve(&self, start: &Theta) -> Option<Fit> {
        least_squares::minimise(self, start, &self.weights(), self.settings(None))
    }

    /// The fit without one more pose.
    pub fn solve_without(&self, start: &Theta, pose: usize) -> Option<Fit> {
        let mut weights = self.weights();
        weights[pose] = 0.0;
        least_squares::minimise(self, start, &weights, self.settings(None))
    }

    /// Robust fit with the Cauchy cost of scale `cauchy`, m/s²: large residuals have little
    /// influence.
    pub fn solve_robust(&self, start: &Theta, cauchy: f64) -> Option<End<Theta>> {
        let of_pose = |k: usize| if self.is_rejected(k) { 0.0 } else { 1.0 };
        let priors = self.priors().map(|_| 1.0);
        let weights: Vec<f64> = (0..self.poses.len()).map(of_pose).chain(priors).collect();
        least_squares::end(self, start, &weights, self.settings(Some(cauchy)))
    }

    pub fn is_rejected(&self, pose: usize) -> bool {
        self.rejected.contains(&pose)
    }

    /// Indices of the fitted poses.
    pub fn kept(&self) -> impl Iterator<Item = usize> {
        (0..self.poses.len()).filter(|k| !self.is_rejected(*k))
    }

    /// Number of fitted poses.
    pub fn count(&self) -> usize {
        self.poses.len() - self.rejected.len()
    }

    /// Whether the noise of every pose is known.
    pub fn has_noise(&self) -> bool {
        self.poses.iter().all(|pose| pose.mean_free_noise() > 0.0)
    }

    /// Mean variance of the noise of a pose, (m/s²)².
    pub fn mean_noise(&self) -> f64 {
        let sum: f64 = self.poses.iter().map(Pose::mean_free_noise).sum();
        sum / self.poses.len() as f64
    }

    /// |f| − g of every pose under `theta`, m/s²; infinite if A is singular.
    pub fn residuals(&self, theta: &Theta) -> Vec<f64> {
        let Some(at) = Evaluated::new(theta) else {
            return alloc::vec![f64::INFINITY; self.poses.len()];
        };
        let of = |pose| at.pose(pose, &self.conditions).force.norm() - self.gravity_mps2;
        self.poses.iter().map(of).collect()
    }

    /// Residual of a pose, m/s², and its derivatives.
    pub fn row(&self, theta: &Theta, pose: usize) -> Option<(f64, DVector<f64>)> {
        let at = Evaluated::new(theta)?;
        let applied = at.pose(self.poses.get(pose)?, &self.conditions);
        let residual = applied.force.norm() - self.gravity_mps2;
        Some((residual, self.fitted(&at.derivatives(&applied))))
    }

    /// The elements of the fitted parameters.
    pub fn fitted(&self, all: &Theta) -> DVector<f64> {
        DVector::from_iterator(self.free.len(), self.free.iter().map(|index| all[*index]))
    }

    /// Residual of a pose that was left out, m/s², and the variance of its prediction relative to
    /// that of a residual.
    pub fn predicted(&self, fit: &Fit, pose: usize) -> Option<(f64, f64)> {
        let (residual, row) = self.row(&fit.at, pose)?;
        Some((residual, fit.variance(&row)))
    }

    /// Adds (`sign` 1) or removes (−1) a pose in one step, with an error of second order. `None` if
    /// the fit becomes singular.
    pub fn change(&self, fit: &mut Fit, pose: usize, sign: f64) -> Option<()> {
        let (residual, row) = self.row(&fit.at, pose)?;
        let step = fit.change(&row, residual, sign * self.weighting.of(&self.poses[pose]));
        fit.at = self.moved(&fit.at, &step);
        fit.at.iter().all(|t| t.is_finite()).then_some(())
    }

    /// The residual of each pose under the fit to the poses of other orientations, or with `each` to all other poses;
    /// infinite if those do not determine the parameters. A rejected pose has its residual.
    pub fn left_out(&self, fit: &Fit, each: bool) -> Vec<f64> {
        let (weights, settings) = (self.weights(), self.settings(None));
        let left = if each {
            fit.left_out(self, &weights, self.kept().map(|k| [k]), settings)
        } else {
            fit.left_out(self, &weights, self.groups().iter(), settings)
        };
        left.iter().copied().take(self.poses.len()).collect()
    }

    /// The fitted poses by orientation.
    pub fn groups(&self) -> Vec<Vec<usize>> {
        let mut groups = alloc::vec![Vec::new(); self.visits.orientations()];
        self.kept().for_each(|k| groups[self.visits.group(k)].push(k));
        groups.retain(|group| !group.is_empty());
        groups
    }

    /// Number of orientations of the fitted poses.
    pub fn orientations(&self) -> usize {
        let mut seen = alloc::vec![false; self.visits.orientations()];
        self.kept().for_each(|k| seen[self.visits.group(k)] = true);
        seen.into_iter().filter(|seen| *seen).count()
    }

    /// Number of independent observations among the fitted poses, and whether orientations are repeated.
    pub fn independent(&self) -> (usize, bool) {
        let apart = crate::visits::apart(self.count(), self.orientations());
        (apart, apart < self.count())
    }

    /// Variance within and between orientations. `None` when the differences between orientations
    /// are used up by the parameters.
    pub fn shared(&self, fit: &Fit) -> Option<Shared> {
        let (n, p) = (self.count() as f64, self.determined(fit));
        let cost = self.cost(fit, None);
        let apart = Shared { variance: cost / (n - p), spread: fit.inverse.clone(), dof: n - p };
        if !self.independent().1 {
            return Some(self.with_usual_variance(apart));
        }
        // Sums over the poses of each orientation, with residuals e and rows x multiplied by the
        // root of the weight: Σ e; G = Σ g gᵀ with g = Σ x; Σ m²; Σ m g gᵀ.
        let (weights, groups) = (self.weights(), self.groups());
        let mut rows = DMatrix::zeros(self.free.len(), self.free.len());
        let mut weighted = rows.clone();
        let (mut squares, mut together) = (0.0, 0.0);
        for group in &groups {
            let m = group.len() as f64;
            squares += m * m;
            let mut sum = 0.0;
            let mut row = DVector::zeros(self.free.len());
            for k in group {
                let root = libm::sqrt(weights[*k]);
                sum += root * fit.rows.residual[*k];
                row += fit.rows.jacobian.row(*k).transpose() * root;
            }
            together += sum * sum;
            rows.ger(1.0, &row, &row, 1.0);
            weighted.ger(m, &row, &row, 1.0);
        }
        let around = &fit.inverse * &rows * &fit.inverse;
        let mut with_priors = rows.clone();
        self.priors().for_each(|(i, root)| with_priors[(i, i)] += root * root);
        let a = n - (&fit.inverse * &rows).trace();
        let k = squares - 2.0 * (&fit.inverse * weighted).trace() + (&around * rows).trace();
        // The parameters use up the differences between orientations.
        if a < 0.5 * n / groups.len() as f64 {
            return self.has_priors().then(|| self.with_usual_variance(apart));
        }
        // S = α (n − p) + β a, T = α a + β k.
        let determinant = (n - p) * k - a * a;
        let beta = ((n - p) * together - a * cost) / determinant;
        if !(determinant > 1e-9 * a * a && beta > 0.0) {
            return Some(self.with_usual_variance(apart));
        }
        let beta = beta.min(together / k);
        let alpha = ((cost - beta * a) / (n - p)).max(0.0);
        let variance = alpha + beta;
        let share = beta / variance;
        let around = &fit.inverse * with_priors * &fit.inverse;
        Some(self.with_usual_variance(Shared {
            variance,
            spread: &fit.inverse * (1.0 - share) + around * share,
            dof: (a * a / k).min(n - p).max(1.0),
        }))
    }

    /// With the prior observations of the variance.
    fn with_usual_variance(&self, mut shared: Shared) -> Shared {
        let (squares, usual_dof) = self.usual();
        if usual_dof > 0.0 {
            let dof = shared.dof.max(0.0);
            let own = if dof > 0.0 { shared.variance * dof } else { 0.0 };
            shared.dof = dof + usual_dof;
            shared.variance = (own + squares) / shared.dof;
        }
        shared
    }

    /// JᵀJ with equal weights of the fitted poses.
    fn information(&self, rows: &Rows) -> DMatrix<f64> {
        let kept: Vec<usize> = self.kept().collect();
        let jacobian = rows.jacobian.select_rows(&kept);
        jacobian.tr_mul(&jacobian)
    }

    /// Observability of the fitted parameters, with equal weights.
    pub fn knowledge(&self, fit: &Fit) -> Option<Knowledge> {
        if self.has_priors() {
            let knowledge = self.with_inverse(&fit.at, &fit.inverse)?;
            // Poses in a plane show the bias normal to it only by its square, which the derivatives of a perfect sensor lack.
            let at_perfect = self.rows(&PERFECT)?;
            let suffices = self.determines_bias(&fit.rows) && self.determines_bias(&at_perfect);
            return Some(Knowledge { suffices, ..knowledge });
        }
        if self.weighting.is_equal() {
            return self.with_inverse(&fit.at, &fit.inverse);
        }
        let inverse = Scaled::new(&self.information(&fit.rows), 0.0)?.inverse();
        self.with_inverse(&fit.at, &inverse)
    }

    /// Whether poses of usual scatter determine the bias, beside the priors.
    fn determines_bias(&self, rows: &Rows) -> bool {
        let mut information = self.information(rows);
        for (i, sd) in self.prior_sd.iter().enumerate() {
            let root = sd.map_or(0.0, |sd| USUAL_MPS2 / sd);
            information[(i, i)] += root * root;
        }
        let Some(factor) = Scaled::new(&information, 0.0) else { return false };
        let inverse = factor.inverse();
        let mut biases = (0..self.free.len()).filter(|i| self.free[*i] < 3);
        biases.all(|i| USUAL_MPS2 * libm::sqrt(inverse[(i, i)]) < LEAST_KNOWN * USUAL_BIAS_MPS2)
    }

    /// Observability at `theta`, which need not be a solution; the parameters may be undetermined.
    pub fn knowledge_at(&self, theta: &Theta) -> Option<Knowledge> {
        let (information, units) = (self.information(&self.rows(theta)?), self.units());
        let scale = &units * units.transpose();
        let mut eigen = information.component_mul(&scale).symmetric_eigen();
        // A zero eigenvalue comes out as rounding.
        let rounding = eigen.eigenvalues.max() * f64::EPSILON;
        eigen.eigenvalues.apply(|value| *value = 1.0 / value.max(rounding));
        self.with_inverse(theta, &eigen.recompose().component_mul(&scale))
    }

    /// Value of each parameter that causes an error of 1 m/s² at 1 g.
    fn units(&self) -> DVector<f64> {
        let units = self.free.iter().map(|index| terms::per_mps2(*index, self.gravity_mps2));
        DVector::from_iterator(self.free.len(), units)
    }

    /// Standard deviation of |f| − g in the worst orientation, relative to that of the residuals, and the orientation.
    pub fn worst(&self, theta: &Theta, inverse: &DMatrix<f64>) -> Option<(f64, Orientation)> {
        let at = Evaluated::new(theta)?;
        let mut jacobian = Rows::zeros(Orientation::ALL.len(), self.free.len()).jacobian;
        for (k, orientation) in Orientation::ALL.iter().enumerate() {
            let force = Vector3::from(orientation.up().map(|c| c * self.gravity_mps2));
            self.set_row(&mut jacobian, k, &at.derivatives(&at.at(force)));
        }
        let (mut worst, mut poorest) = (0.0, Orientation::ALL[0]);
        let variances = quadratic_forms(&jacobian, inverse);
        for (orientation, variance) in Orientation::ALL.into_iter().zip(&variances) {
            // Opposite orientations are equal to rounding where the bias is determined alone.
            if *variance > worst * (1.0 + 1e-12) {
                (worst, poorest) = (*variance, orientation);
            }
        }
        Some((libm::sqrt(worst), poorest))
    }

    /// Sets a row of `jacobian` to the derivatives by the fitted parameters.
    fn set_row(&self, jacobian: &mut DMatrix<f64>, row: usize, all: &Theta) {
        for (i, index) in self.free.iter().enumerate() {
            jacobian[(row, i)] = all[*index];
        }
    }

    fn with_inverse(&self, theta: &Theta, inverse: &DMatrix<f64>) -> Option<Knowledge> {
        let (amplification, poorest) = self.worst(theta, inverse)?;
        let scale = self.units().map(|unit| 1.0 / unit);
        let cofactors = on_both_sides(inverse.clone(), &scale);
        let suffices = amplification < MOST_AMPLIFICATION;
        Some(Knowledge { cofactors, amplification, poorest, suffices })
    }
}
