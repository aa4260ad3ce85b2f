//! Least squares on |f| − g: equations (12) to (17), (40), (41).

use crate::Pose;
use crate::force::{Applied, Conditions, Evaluated};
use crate::symmetric::{self, Scaled, Symmetric, Vector, dot};
use crate::terms::{Slots, Theta};
use crate::visits::Visits;
use crate::weights::{FarOff, Rejected, Weighting};

/// Largest number of iterations; a fit that needs more has not converged. Typical: 3 to 6.
const MOST_ITERATIONS: usize = 100;
/// Convergence threshold: rms change of the residuals in a Gauss-Newton step, m/s². The remaining
/// error is smaller than the last step by the ratio of residuals to gravity, 10⁻³ or less.
const LAST_STEP_MPS2: f64 = 1e-6;
/// The same for a robust fit, which only ranks poses: fraction of the scale of its cost.
const LAST_ROBUST_STEP: f64 = 1e-3;
/// Smallest damping other than 0, relative to the unit diagonal of the information matrix.
const LEAST_DAMPING: f64 = 1e-6;
/// Largest damping; the fit fails when even this step does not reduce the cost.
const MOST_DAMPING: f64 = 1e8;
/// Largest number of poses for which poses of high leverage are left out by a complete refit.
const MOST_REFITS: usize = 256;
/// Leverage above which a pose or orientation is left out by a complete refit instead of one step.
/// The error of the single step is of second order and grows with 1 / (1 − leverage).
const MOST_LEVERAGE: f64 = 0.5;

/// Poses whose products are summed together, for vector instructions, which a device lacks.
const BLOCK: usize = if cfg!(target_os = "none") { 1 } else { 4 };

/// Derivatives of poses: a row for each fitted parameter.
type Block = [[f64; BLOCK]; symmetric::MOST];

/// What is left out of a fit, besides the rejected poses.
#[derive(Clone, Copy, PartialEq)]
pub(crate) enum Without {
    Nothing,
    Pose(usize),
    /// All poses of one orientation.
    Orientation(usize),
}

/// The normal equations: JᵀWJ, JᵀWr and rᵀWr summed over the poses.
struct Normal {
    information: Symmetric,
    gradient: Vector,
    cost: f64,
    poses: usize,
}

impl Normal {
    fn zero(n: usize) -> Self {
        Self {
            information: Symmetric::zero(n),
            gradient: [0.0; symmetric::MOST],
            cost: 0.0,
            poses: 0,
        }
    }
}

/// Least-squares problem: some parameters fitted to |f| = g over static poses. Equations (12) to
/// (17), (40), (41).
pub(crate) struct Magnitude<'a> {
    pub poses: &'a [Pose],
    pub visits: &'a Visits,
    pub gravity_mps2: f64,
    pub conditions: Conditions,
    pub weighting: Weighting,
    pub rejected: Rejected,
    /// Rule that rejects further poses, when there are too many to list.
    pub far: Option<FarOff>,
    /// The fitted parameters; the others keep their starting values.
    pub free: Slots,
    /// Whether the fitted parameters include terms beyond the first twelve.
    pub terms: bool,
}

/// A converged fit.
#[derive(Clone)]
pub(crate) struct Fit {
    pub theta: Theta,
    /// (JᵀWJ)⁻¹: the covariance for residuals of unit variance.
    pub inverse: Symmetric,
    /// Σ w r², (m/s²)².
    pub cost: f64,
}

impl Fit {
    /// Standard deviation of a residual, m/s².
    pub fn sd(&self, dof: usize) -> f64 {
        libm::sqrt(self.cost / dof.max(1) as f64)
    }

    /// Adds a pose to the linearised fit, or with negative `weight` removes one; returns the step of
    /// the fitted parameters: equation (16).
    fn update(&mut self, row: &Vector, residual: f64, weight: f64) -> Vector {
        let gain = self.inverse.times(row);
        let factor = weight / (1.0 + weight * dot(row, &gain));
        self.inverse.add_outer(&gain, -factor);
        self.cost += factor * residual * residual;
        gain.map(|x| -factor * residual * x)
    }
}

impl Magnitude<'_> {
    #[cfg_attr(not(target_os = "none"), inline(always))]
    fn applied(&self, at: &Evaluated, pose: &Pose) -> Applied {
        let (mut progress, mut warmer) = (0.0, 0.0);
        if self.terms {
            progress = self.conditions.progress(pose);
            warmer = self.conditions.warmer(pose);
        }
        at.apply(pose.mean_mps2, progress, warmer)
    }

    /// |f| − g of one pose, m/s², and its derivatives.
    #[cfg_attr(not(target_os = "none"), inline(always))]
    fn row(&self, at: &Evaluated, pose: &Pose) -> (f64, Vector) {
        let applied = self.applied(at, pose);
        let residual = applied.force.norm() - self.gravity_mps2;
        (residual, self.derivatives(at, &applied))
    }

    /// Puts the derivatives of `pose` in a column of `rows`; returns its residual.
    #[cfg_attr(not(target_os = "none"), inline(always))]
    fn put(&self, at: &Evaluated, pose: &Pose, rows: &mut Block, column: usize) -> f64 {
        let applied = self.applied(at, pose);
        let all = at.derivatives(&applied);
        for (elements, slot) in rows.iter_mut().zip(&self.free) {
            elements[column] = all[slot.index()];
        }
        applied.force.norm() - self.gravity_mps2
    }

    #[cfg_attr(not(target_os = "none"), inline(always))]
    pub fn derivatives(&self, at: &Evaluated, applied: &Applied) -> Vector {
        self.fitted(&at.derivatives(applied))
    }

    /// The elements of the fitted parameters.
    #[cfg_attr(not(target_os = "none"), inline(always))]
    fn fitted(&self, all: &Theta) -> Vector {
        core::array::from_fn(|i| self.free.get(i).map_or(0.0, |slot| all[slot.index()]))
    }

    /// Residual and derivatives, multiplied by the square root of the weight.
    pub fn weighted_row(&self, at: &Evaluated, pose: &Pose) -> (f64, Vector) {
        let root: f64 = libm::sqrt(self.weighting.of(pose));
        let (residual, row) = self.row(at, pose);
        (residual * root, row.map(|d| d * root))
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

    /// Whether `pose`, the k-th, is rejected.
    #[cfg_attr(not(target_os = "none"), inline(always))]
    pub fn is_rejected(&self, k: usize, pose: &Pose) -> bool {
        self.rejected.contains(k)
            || self.far.as_ref().is_some_and(|far| (far.rejects)(far, self, pose))
    }

    /// Whether `pose`, the k-th, is left out of a fit.
    #[cfg_attr(not(target_os = "none"), inline(always))]
    pub fn is_out(&self, without: Without, k: usize, pose: &Pose) -> bool {
        self.is_rejected(k, pose)
            || match without {
                Without::Nothing => false,
                Without::Pose(one) => one == k,
                Without::Orientation(group) => self.visits.group(k, pose) == group,
            }
    }

    /// JᵀWJ at `theta` with the given weights.
    pub fn information(&self, theta: &Theta, weighting: &Weighting) -> Option<Symmetric> {
        let mut normal = Normal::zero(self.free.len());
        self.sum(theta, Without::Nothing, weighting, None, &mut normal)?;
        Some(normal.information)
    }

    /// Puts the normal equations at `theta` in `normal`. With `cauchy`, a scale in m/s², the cost of a
    /// residual r is cauchy² ln(1 + (r/cauchy)²) instead of r².
    fn sum(
        &self,
        theta: &Theta,
        without: Without,
        weighting: &Weighting,
        cauchy: Option<f64>,
        normal: &mut Normal,
    ) -> Option<()> {
        let at = Evaluated::new(theta, self.terms)?;
        normal.information.clear();
        normal.gradient = [0.0; symmetric::MOST];
        (normal.cost, normal.poses) = (0.0, 0);
        let n = self.free.len();
        let mut rows = [[0.0; BLOCK]; symmetric::MOST];
        for (block, poses) in self.poses.chunks(BLOCK).enumerate() {
            let (mut weights, mut pulls) = ([0.0; BLOCK], [0.0; BLOCK]);
            for (i, pose) in poses.iter().enumerate() {
                if self.is_out(without, BLOCK * block + i, pose) {
                    continue;
                }
                let residual = self.put(&at, pose, &mut rows, i);
                let mut weight: f64 = weighting.of(pose);
                let mut cost = weight * residual * residual;
                if let Some(cauchy) = cauchy {
                    let square: f64 = cauchy * cauchy;
                    let grown = 1.0 + residual * residual / square;
                    cost = square * libm::log(grown);
                    weight = 1.0 / grown;
                }
                normal.cost += cost;
                normal.poses += 1;
                (weights[i], pulls[i]) = (weight, weight * residual);
            }
            normal.information.add_outers(&rows, &weights);
            for (gradient, elements) in normal.gradient[..n].iter_mut().zip(&rows) {
                *gradient += dot(&pulls, elements);
            }
        }
        normal.cost.is_finite().then_some(())
    }

    /// Levenberg-Marquardt from `start`. `None` when it does not converge or a parameter is not
    /// determined.
    pub fn solve(&self, start: &Theta, without: Without) -> Option<Fit> {
        self.minimise(start, LAST_STEP_MPS2, |theta, normal| {
            self.sum(theta, without, &self.weighting, None, normal)
        })
    }

    /// Robust fit with the Cauchy cost of scale `cauchy`, m/s²: large residuals have little
    /// influence.
    pub fn solve_robust(&self, start: &Theta, cauchy: f64) -> Option<Fit> {
        self.minimise(start, LAST_ROBUST_STEP * cauchy, |theta, normal| {
            let weighting = &Weighting::EQUAL;
            self.sum(theta, Without::Nothing, weighting, Some(cauchy), normal)
        })
    }

    fn minimise(
        &self,
        start: &Theta,
        last_step_mps2: f64,
        sum: impl Fn(&Theta, &mut Normal) -> Option<()>,
    ) -> Option<Fit> {
        let epsilon = f64::EPSILON;
        let last_step = last_step_mps2.max(4.0 * epsilon * self.gravity_mps2);
        let mut theta = *start;
        let mut both = [0, 1].map(|_| Normal::zero(self.free.len()));
        let [mut normal, mut next] = both.each_mut();
        sum(&theta, normal)?;
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
            let trial = self.moved(&theta, step, -1.0);
            // The step lowers the cost by the square of the change of the residuals.
            let gained = change * change;
            let change_mps2 = libm::sqrt(gained / normal.poses as f64);
            if damping <= 0.0 && change_mps2 <= last_step {
                return Some(Fit {
                    theta: trial,
                    inverse: factor.inverse(),
                    cost: (normal.cost - gained).max(0.0),
                });
            }
            let cost = normal.cost;
            // Rounding error of the cost.
            let rounding =
                20.0 * epsilon * self.gravity_mps2 * libm::sqrt(cost * normal.poses as f64);
            match sum(&trial, next) {
                Some(()) if next.cost <= cost + rounding => {
                    theta = trial;
                    core::mem::swap(&mut normal, &mut next);
                    damping = if damping > LEAST_DAMPING { damping * 0.1 } else { 0.0 };
                }
                _ if damping > MOST_DAMPING => return None,
                _ => damping = more(damping),
            }
        }
        None
    }

    /// For each fitted pose: derivatives with respect to the fitted and to all parameters, and the
    /// weight.
    pub fn rows<'b>(
        &'b self,
        at: &'b Evaluated<'b>,
    ) -> impl Iterator<Item = (Vector, Theta, f64)> + 'b {
        let kept = self.poses.iter().enumerate();
        kept.filter(|(k, pose)| !self.is_rejected(*k, pose)).map(|(_, pose)| {
            let all = at.derivatives(&self.applied(at, pose));
            (self.fitted(&all), all, self.weighting.of(pose))
        })
    }

    /// |f| − g of `pose` under `theta`, m/s².
    #[cfg_attr(not(target_os = "none"), inline(always))]
    pub fn residual(&self, theta: &Theta, pose: &Pose) -> Option<f64> {
        let at = Evaluated::new(theta, self.terms)?;
        Some(self.applied(&at, pose).force.norm() - self.gravity_mps2)
    }

    /// Calls `take` with the index and the residual, m/s², of every pose under `theta`.
    pub fn residuals(&self, theta: &Theta, mut take: impl FnMut(usize, f64)) {
        let Some(at) = Evaluated::new(theta, self.terms) else {
            return;
        };
        for (k, pose) in self.poses.iter().enumerate() {
            let norm = self.applied(&at, pose).force.norm();
            take(k, norm - self.gravity_mps2);
        }
    }

    /// Residual of a pose that was left out, m/s², and the variance of its prediction relative to
    /// that of a residual.
    pub fn predicted(&self, fit: &Fit, pose: usize) -> Option<(f64, f64)> {
        let at = Evaluated::new(&fit.theta, self.terms)?;
        let (residual, row) = self.row(&at, self.poses.get(pose)?);
        Some((residual, fit.inverse.form(&row)))
    }

    /// The parameters fitted without one orientation.
    pub fn solve_without(&self, fit: &Fit, group: usize) -> Option<Theta> {
        let at = Evaluated::new(&fit.theta, self.terms)?;
        let mut without = fit.clone();
        let mut leverage = 0.0;
        let mut step = [0.0; symmetric::MOST];
        for (k, pose) in self.poses.iter().enumerate() {
            if self.visits.group(k, pose) != group || self.is_rejected(k, pose) {
                continue;
            }
            let (residual, row) = self.weighted_row(&at, pose);
            leverage += fit.inverse.form(&row);
            let more = without.update(&row, residual + dot(&row, &step), -1.0);
            symmetric::add(&mut step, 1.0, &more);
        }
        if leverage > MOST_LEVERAGE {
            let refit = self.solve(&fit.theta, Without::Orientation(group));
            return refit.map(|without| without.theta);
        }
        Some(self.moved(&fit.theta, step, 1.0))
    }

    /// `theta` with `factor` times `step` added to the fitted parameters.
    fn moved(&self, theta: &Theta, step: impl IntoIterator<Item = f64>, factor: f64) -> Theta {
        let mut moved = *theta;
        for (slot, step) in self.free.iter().zip(step) {
            moved[slot.index()] += step * factor;
        }
        moved
    }

    /// Adds (`sign` 1) or removes (−1) a pose in one step, with an error of second order. `None` if
    /// the fit becomes singular.
    pub fn change(&self, fit: &mut Fit, pose: usize, sign: f64) -> Option<()> {
        let at = Evaluated::new(&fit.theta, self.terms)?;
        let pose = self.poses.get(pose)?;
        let (residual, row) = self.row(&at, pose);
        let step = fit.update(&row, residual, sign * self.weighting.of(pose));
        fit.theta = self.moved(&fit.theta, step, 1.0);
        fit.theta.iter().all(|t| t.is_finite()).then_some(())
    }

    /// Calls `take` with the index of every pose, its residual, and its residual under the fit to
    /// all other poses: equation (16). The latter is infinite if the others do not determine the
    /// parameters.
    pub fn leave_out(&self, fit: &Fit, mut take: impl FnMut(usize, f64, f64)) {
        let Some(at) = Evaluated::new(&fit.theta, self.terms) else {
            return;
        };
        let few = self.poses.len() <= MOST_REFITS;
        let mut rows: Block = [[0.0; BLOCK]; symmetric::MOST];
        let mut residuals = [0.0; BLOCK];
        for (block, poses) in self.poses.chunks(BLOCK).enumerate() {
            for (i, pose) in poses.iter().enumerate() {
                residuals[i] = self.put(&at, pose, &mut rows, i);
            }
            let steps = fit.inverse.times_columns(&rows);
            let mut leverages = [0.0; BLOCK];
            for (row, step) in rows.iter().zip(&steps).take(self.free.len()) {
                for i in 0..BLOCK {
                    leverages[i] += row[i] * step[i];
                }
            }
            for (i, pose) in poses.iter().enumerate() {
                let (k, residual) = (BLOCK * block + i, residuals[i]);
                if self.is_rejected(k, pose) {
                    take(k, residual, residual);
                    continue;
                }
                let weight: f64 = self.weighting.of(pose);
                let leverage = weight * leverages[i];
                let left_out = if few && leverage > MOST_LEVERAGE {
                    self.solve(&fit.theta, Without::Pose(k))
                        .and_then(|without| self.residual(&without.theta, pose))
                } else {
                    let by = weight * residual / (1.0 - leverage);
                    let step = steps.iter().map(|row| row[i]);
                    self.residual(&self.moved(&fit.theta, step, by), pose)
                };
                let left_out = left_out.filter(|r| r.is_finite());
                take(k, residual, left_out.unwrap_or(f64::INFINITY));
            }
        }
    }
}

fn more(damping: f64) -> f64 {
    (damping * 10.0).max(LEAST_DAMPING)
}
