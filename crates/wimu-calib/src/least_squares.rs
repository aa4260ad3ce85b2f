//! Least squares on |f| − g: equations (12) to (17), (40), (41).

use nalgebra::{SMatrix, SVector};

use crate::Pose;
use crate::force::{Applied, Conditions, Evaluated};
use crate::linear::{Real, Scaled, double, real};
use crate::terms::{Slot, Theta};
use crate::visits::Visits;
use crate::weights::{FarOff, Rejected, Weighting};

/// Iterations after which a fit counts as not converged; a good one takes 3 to 6.
const MOST_ITERATIONS: usize = 100;
/// A step that changes the residuals by less than this, m/s² rms, is the last: what a Gauss-Newton
/// step leaves is smaller than it by a factor of the residuals per gravity, 10⁻³ or less.
const LAST_STEP_MPS2: f64 = 1e-6;
/// Of an information matrix with unit diagonal: below, the step counts as undamped.
const LEAST_DAMPING: f64 = 1e-6;
/// Beyond, no step descends.
const MOST_DAMPING: f64 = 1e8;
/// Up to this many poses, one of great leverage is left out by a true refit.
const MOST_REFITS: usize = 256;
/// Leverage up to which the first step of the refit is the refit: what it leaves is of second
/// order in the step, which grows with 1 / (1 − h).
const MOST_LEVERAGE: f64 = 0.5;

/// What a fit is made without, beside the poses that are rejected.
#[derive(Clone, Copy, PartialEq)]
pub(crate) enum Without {
    Nothing,
    Pose(usize),
    /// All visits of one.
    Orientation(usize),
}

/// Sums over poses: JᵀWJ, JᵀWr and rᵀWr.
#[derive(Clone)]
pub(crate) struct Normal<R: Real, const N: usize> {
    /// The lower triangle counts.
    pub information: SMatrix<R, N, N>,
    gradient: SVector<R, N>,
    cost: R,
    poses: usize,
}

impl<R: Real, const N: usize> Normal<R, N> {
    /// (JᵀWJ)⁻¹.
    pub fn inverse(&self) -> Option<SMatrix<R, N, N>> {
        Some(Scaled::new(&self.information, R::zero())?.inverse())
    }
}

/// The fit of some parameters to |f| = g over static poses: equations (12) to (17), (40), (41).
pub(crate) struct Magnitude<'a, const N: usize> {
    pub poses: &'a [Pose],
    pub visits: &'a Visits,
    pub gravity_mps2: f64,
    pub conditions: Conditions,
    pub weighting: Weighting,
    pub rejected: Rejected,
    /// What is rejected beside those that are named.
    pub far: Option<FarOff>,
    /// The parameters that are fitted; the others stay as they start.
    pub free: [Slot; N],
    /// Whether some of them are terms.
    pub terms: bool,
}

/// A converged fit.
pub(crate) struct Fit<R: Real, const N: usize> {
    pub theta: Theta<R>,
    /// (JᵀWJ)⁻¹: the covariance for residuals of unit variance.
    pub inverse: SMatrix<R, N, N>,
    /// Σ w r², (m/s²)².
    pub cost: f64,
    pub normal: Normal<R, N>,
}

impl<R: Real, const N: usize> Fit<R, N> {
    /// Standard deviation of a residual, m/s².
    pub fn sd(&self, dof: usize) -> f64 {
        libm::sqrt(self.cost / dof.max(1) as f64)
    }
}

impl<'a, const N: usize> Magnitude<'a, N> {
    /// The same poses with bias and scale factors alone.
    pub fn smaller(&self) -> Magnitude<'a, 6> {
        Magnitude {
            poses: self.poses,
            visits: self.visits,
            gravity_mps2: self.gravity_mps2,
            conditions: self.conditions,
            weighting: self.weighting,
            rejected: self.rejected,
            far: self.far,
            free: [0, 1, 2, 3, 7, 11].map(|i| Slot::ALL[i]),
            terms: false,
        }
    }

    #[inline(always)]
    fn applied<R: Real>(&self, at: &Evaluated<R>, pose: &Pose) -> Applied<R> {
        at.apply(
            pose.mean_mps2.map(real),
            real(self.conditions.progress(pose)),
            real(self.conditions.warmer(pose)),
        )
    }

    /// |f| − g of one pose, m/s², and its derivatives.
    #[inline(always)]
    fn row<R: Real>(&self, at: &Evaluated<R>, pose: &Pose) -> (R, SVector<R, N>) {
        let applied = self.applied(at, pose);
        let residual = applied.force.norm() - real(self.gravity_mps2);
        (residual, self.derivatives(at, &applied))
    }

    #[inline(always)]
    pub fn derivatives<R: Real>(&self, at: &Evaluated<R>, applied: &Applied<R>) -> SVector<R, N> {
        let all = at.derivatives(applied);
        SVector::from_fn(|i, _| all[self.free[i].index()])
    }

    /// The same times the root of the pose's weight.
    pub fn weighted_row<R: Real>(&self, at: &Evaluated<R>, pose: &Pose) -> (R, SVector<R, N>) {
        let root: R = real(libm::sqrt(self.weighting.of(pose)));
        let (residual, row) = self.row(at, pose);
        (residual * root, row * root)
    }

    /// Whether pose `k`, which is `pose`, is rejected.
    #[inline(always)]
    pub fn is_rejected(&self, k: usize, pose: &Pose) -> bool {
        self.rejected.contains(k) || (self.far.is_some() && self.is_far_off(pose))
    }

    #[cold]
    #[inline(never)]
    fn is_far_off(&self, pose: &Pose) -> bool {
        self.far.as_ref().is_some_and(|far| {
            let residual = self.residual(&far.theta, pose);
            residual.is_none_or(|residual| far.has(residual, pose))
        })
    }

    /// Whether pose `k` has no part in a fit.
    #[inline(always)]
    pub fn is_out(&self, without: Without, k: usize, pose: &Pose) -> bool {
        self.is_rejected(k, pose)
            || match without {
                Without::Nothing => false,
                Without::Pose(one) => one == k,
                Without::Orientation(group) => self.visits.group(k, pose) == group,
            }
    }

    fn normal<R: Real>(&self, theta: &Theta<R>, without: Without) -> Option<Normal<R, N>> {
        self.weighted_normal(theta, without, &self.weighting, None)
    }

    /// With `cauchy`, m/s², each residual counts as cauchy² ln(1 + (r/cauchy)²) instead of r².
    pub fn weighted_normal<R: Real>(
        &self,
        theta: &Theta<R>,
        without: Without,
        weighting: &Weighting,
        cauchy: Option<f64>,
    ) -> Option<Normal<R, N>> {
        let at = Evaluated::new(theta, self.terms)?;
        let mut normal = Normal::<R, N> {
            information: SMatrix::zeros(),
            gradient: SVector::zeros(),
            cost: R::zero(),
            poses: 0,
        };
        for (k, pose) in self.poses.iter().enumerate() {
            if self.is_out(without, k, pose) {
                continue;
            }
            let (residual, row) = self.row(&at, pose);
            let mut weight: R = real(weighting.of(pose));
            let mut cost = weight * residual * residual;
            if let Some(cauchy) = cauchy {
                let square: R = real(cauchy * cauchy);
                let grown = R::one() + residual * residual / square;
                cost = square * grown.ln();
                weight = R::one() / grown;
            }
            for c in 0..N {
                let weighted = row[c] * weight;
                normal.gradient[c] += weighted * residual;
                // From an even row on, which vector instructions can take in pairs.
                for r in c & !1..N {
                    normal.information[(r, c)] += weighted * row[r];
                }
            }
            normal.cost += cost;
            normal.poses += 1;
        }
        normal.cost.is_finite().then_some(normal)
    }

    /// Damped Gauss-Newton from `start`. `None` when it does not converge
    /// or a parameter is not determined at all.
    pub fn solve<R: Real>(&self, start: &Theta<R>, without: Without) -> Option<Fit<R, N>> {
        self.minimise(start, |theta| self.normal(theta, without))
    }

    /// The fit that large residuals pull on ever less, beyond `cauchy`, m/s².
    pub fn solve_robust<R: Real>(&self, start: &Theta<R>, cauchy: f64) -> Option<Fit<R, N>> {
        let normal = |theta: &Theta<R>| {
            self.weighted_normal(theta, Without::Nothing, &Weighting::EQUAL, Some(cauchy))
        };
        self.minimise(start, normal)
    }

    fn minimise<R: Real>(
        &self,
        start: &Theta<R>,
        normal_at: impl Fn(&Theta<R>) -> Option<Normal<R, N>>,
    ) -> Option<Fit<R, N>> {
        let epsilon = double(R::default_epsilon());
        let last_step = LAST_STEP_MPS2.max(4.0 * epsilon * self.gravity_mps2);
        let mut theta = *start;
        let mut normal = normal_at(&theta)?;
        let mut damping = 0.0;
        for _ in 0..MOST_ITERATIONS {
            // The damped Gauss-Newton step: equation (14).
            let Some(factor) = Scaled::new(&normal.information, real(damping)) else {
                if damping > 1.0 {
                    return None;
                }
                damping = more(damping);
                continue;
            };
            let (step, change) = factor.solve(&normal.gradient);
            let trial = self.moved(&theta, &step, -R::one());
            // The step lowers the cost by the square of the change of the residuals.
            let gained = double(change * change);
            let change_mps2 = libm::sqrt(gained / normal.poses as f64);
            if damping < LEAST_DAMPING && change_mps2 <= last_step {
                return Some(Fit {
                    theta: trial,
                    inverse: if damping > 0.0 {
                        normal.inverse()?
                    } else {
                        factor.inverse()
                    },
                    cost: (double(normal.cost) - gained).max(0.0),
                    normal,
                });
            }
            let cost = double(normal.cost);
            // That of a sum of squares.
            let rounding =
                20.0 * epsilon * self.gravity_mps2 * libm::sqrt(cost * normal.poses as f64);
            match normal_at(&trial) {
                Some(next) if double(next.cost) <= cost + rounding => {
                    theta = trial;
                    normal = next;
                    damping = if damping > LEAST_DAMPING {
                        damping * 0.1
                    } else {
                        0.0
                    };
                }
                _ if damping > MOST_DAMPING => return None,
                _ => damping = more(damping),
            }
        }
        None
    }

    /// The poses that are fitted: derivatives by what is fitted and by everything, and the weight.
    pub fn rows<'b, R: Real>(
        &'b self,
        at: &'b Evaluated<'b, R>,
    ) -> impl Iterator<Item = (SVector<R, N>, Theta<R>, f64)> + 'b {
        let kept = self.poses.iter().enumerate();
        kept.filter(|(k, pose)| !self.is_rejected(*k, pose))
            .map(|(_, pose)| {
                let all = at.derivatives(&self.applied(at, pose));
                let row = SVector::from_fn(|i, _| all[self.free[i].index()]);
                (row, all, self.weighting.of(pose))
            })
    }

    /// |f| − g of `pose` under `theta`, m/s².
    #[inline(always)]
    pub fn residual<R: Real>(&self, theta: &Theta<R>, pose: &Pose) -> Option<f64> {
        let at = Evaluated::new(theta, self.terms)?;
        Some(double(
            self.applied(&at, pose).force.norm() - real(self.gravity_mps2),
        ))
    }

    /// Goes over the poses with the residual of each under `theta`, m/s².
    pub fn residuals<R: Real>(&self, theta: &Theta<R>, mut take: impl FnMut(usize, f64)) {
        let Some(at) = Evaluated::new(theta, self.terms) else {
            return;
        };
        for (k, pose) in self.poses.iter().enumerate() {
            let norm = self.applied(&at, pose).force.norm();
            take(k, double(norm - real(self.gravity_mps2)));
        }
    }

    /// Residual of a pose that was left out, m/s², and the variance of its prediction per that of a
    /// residual.
    pub fn predicted<R: Real>(&self, fit: &Fit<R, N>, pose: usize) -> Option<(f64, f64)> {
        let at = Evaluated::new(&fit.theta, self.terms)?;
        let (residual, row) = self.row(&at, self.poses.get(pose)?);
        Some((double(residual), double(row.dot(&(fit.inverse * row)))))
    }

    /// The parameters without one orientation.
    pub fn solve_without<R: Real>(&self, fit: &Fit<R, N>, group: usize) -> Option<Theta<R>> {
        let at = Evaluated::new(&fit.theta, self.terms)?;
        let mut rest = fit.normal.clone();
        let mut leverage = R::zero();
        let mut pull = SVector::<R, N>::zeros();
        for (k, pose) in self.poses.iter().enumerate() {
            if self.visits.group(k, pose) != group || self.is_rejected(k, pose) {
                continue;
            }
            let (residual, row) = self.weighted_row(&at, pose);
            leverage += row.dot(&(fit.inverse * row));
            pull += row * residual;
            rest.information -= row * row.transpose();
        }
        if double(leverage) > MOST_LEVERAGE {
            let refit = self.solve(&fit.theta, Without::Orientation(group));
            return refit.map(|without| without.theta);
        }
        let (step, _) = Scaled::new(&rest.information, R::zero())?.solve(&pull);
        Some(self.moved(&fit.theta, &step, R::one()))
    }

    /// `theta` with `factor` times `step` added to the fitted parameters.
    fn moved<R: Real>(&self, theta: &Theta<R>, step: &SVector<R, N>, factor: R) -> Theta<R> {
        let mut moved = *theta;
        for (slot, step) in self.free.iter().zip(step.iter()) {
            moved[slot.index()] += *step * factor;
        }
        moved
    }

    /// Goes over all poses with the residual of each and the one under the fit to all others:
    /// equation (16); infinite for a pose that cannot be spared.
    pub fn leave_out<R: Real>(&self, fit: &Fit<R, N>, mut take: impl FnMut(usize, f64, f64)) {
        let Some(at) = Evaluated::new(&fit.theta, self.terms) else {
            return;
        };
        let few = self.poses.len() <= MOST_REFITS;
        for (k, pose) in self.poses.iter().enumerate() {
            let (residual, row) = self.row(&at, pose);
            if self.is_rejected(k, pose) {
                take(k, double(residual), double(residual));
                continue;
            }
            let weight: R = real(self.weighting.of(pose));
            let step = fit.inverse * row;
            let leverage = weight * row.dot(&step);
            let left_out = if few && double(leverage) > MOST_LEVERAGE {
                self.solve(&fit.theta, Without::Pose(k))
                    .and_then(|without| self.residual(&without.theta, pose))
            } else {
                let by = weight * residual / (R::one() - leverage);
                self.residual(&self.moved(&fit.theta, &step, by), pose)
            };
            let left_out = left_out.filter(|r| r.is_finite());
            take(k, double(residual), left_out.unwrap_or(f64::INFINITY));
        }
    }
}

fn more(damping: f64) -> f64 {
    (damping * 10.0).max(LEAST_DAMPING)
}
