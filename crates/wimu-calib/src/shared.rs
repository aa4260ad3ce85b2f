//! What the residuals of visits of one orientation share: equation (42b).

use nalgebra::SMatrix;

use crate::force::Evaluated;
use crate::least_squares::{Fit, Magnitude};
use crate::linear::{Real, double, real};
use crate::visits::{MOST, apart};

/// What the residuals of a fit say of their variance: equation (42b).
pub(crate) struct Shared<R: Real, const N: usize> {
    /// Of a residual of weight 1, (m/s²)².
    pub variance: f64,
    /// Covariance of what is fitted, per that variance.
    pub spread: SMatrix<R, N, N>,
    /// Degrees of freedom of the variance.
    pub dof: f64,
    /// So many poses, each in an orientation of its own, would tell as much.
    pub poses: f64,
}

/// How many poses are fitted in each orientation.
pub(crate) struct Visited {
    counts: [u32; MOST],
    /// Orientations with any.
    pub orientations: usize,
    /// How many of the poses are evidence of their own.
    pub apart: usize,
    /// Whether orientations come again.
    pub again: bool,
}

impl Visited {
    fn of(&self, group: usize) -> u32 {
        self.counts.get(group).copied().unwrap_or(0)
    }
}

impl<const N: usize> Magnitude<'_, N> {
    pub fn visited(&self) -> Visited {
        let mut counts = [0; MOST];
        for (k, pose) in self.poses.iter().enumerate() {
            if !self.is_rejected(k, pose)
                && let Some(count) = counts.get_mut(self.visits.group(k, pose))
            {
                *count += 1;
            }
        }
        let kept = self.poses.len() - self.rejected.count();
        let orientations = counts.iter().filter(|&&count| count > 0).count();
        let apart = apart(kept, orientations);
        Visited {
            counts,
            orientations,
            apart,
            again: apart < kept,
        }
    }

    /// Whether the orientation of pose `k` came more than once, and is left out as a whole.
    pub fn comes_again(&self, visited: &Visited, k: usize) -> bool {
        visited.again
            && self.poses.len() <= MOST
            && self
                .poses
                .get(k)
                .is_some_and(|pose| visited.of(self.visits.group(k, pose)) > 1)
    }

    /// `None` where rounding leaves nothing to compare.
    pub fn shared<R: Real>(&self, fit: &Fit<R, N>, visited: &Visited) -> Option<Shared<R, N>> {
        let orientations = visited.orientations;
        let kept = self.poses.len() - self.rejected.count();
        let (n, p) = (kept as f64, N as f64);
        let apart = Shared {
            variance: fit.cost / (n - p),
            spread: fit.inverse,
            dof: n - p,
            poses: n,
        };
        if !visited.again {
            return Some(apart);
        }
        // Σ e over the visits of an orientation, its square summed over these; G = Σ g gᵀ with g = Σ x;
        // Σ m², and Σ m g gᵀ. Residuals e and rows x times the root of the weight.
        let at = Evaluated::new(&fit.theta, self.terms)?;
        let mut sums = [0.0; MOST];
        let mut rows = SMatrix::<R, N, N>::zeros();
        let mut weighted = SMatrix::<R, N, N>::zeros();
        let mut squares = 0.0;
        let few = self.poses.len() <= MOST;
        let mut seen = [false; MOST];
        for (k, pose) in self.poses.iter().enumerate() {
            if self.is_rejected(k, pose) {
                continue;
            }
            let group = self.visits.group(k, pose);
            let m = visited.of(group);
            squares += f64::from(m);
            let (residual, mut row) = self.weighted_row(&at, pose);
            if let Some(sum) = sums.get_mut(group) {
                *sum += double(residual);
            }
            if m > 1 && few {
                if core::mem::replace(&mut seen[group.min(MOST - 1)], true) {
                    continue;
                }
                for (j, other) in self.poses.iter().enumerate().skip(k + 1) {
                    if self.visits.group(j, other) == group && !self.is_rejected(j, other) {
                        row += self.weighted_row(&at, other).1;
                    }
                }
            } else if m > 1 {
                // So many are taken to be the same to the last digit.
                row *= real::<R>(f64::from(m)).sqrt();
            }
            let m: R = real(f64::from(m));
            for c in 0..N {
                for r in 0..N {
                    let product = row[r] * row[c];
                    rows[(r, c)] += product;
                    weighted[(r, c)] += m * product;
                }
            }
        }
        let together: f64 = sums.iter().map(|sum| sum * sum).sum();
        let gain = fit.inverse * rows;
        let trace = double(gain.trace());
        let fourth = double((gain * gain).trace());
        let a = n - trace;
        let k = squares - 2.0 * double((fit.inverse * weighted).trace()) + fourth;
        // Nothing is left between orientations that the parameters do not take.
        if a < 0.5 * n / orientations as f64 {
            return None;
        }
        // S = α (n − p) + β a, T = α a + β k.
        let determinant = (n - p) * k - a * a;
        let beta = ((n - p) * together - a * fit.cost) / determinant;
        if !(determinant > 1e-9 * a * a && beta > 0.0) {
            return Some(apart);
        }
        let beta = beta.min(together / k);
        let alpha = ((fit.cost - beta * a) / (n - p)).max(0.0);
        let variance = alpha + beta;
        let share = beta / variance;
        let poses = visited
            .counts
            .iter()
            .map(|&m| f64::from(m) / (1.0 + share * (f64::from(m) - 1.0).max(0.0)))
            .sum();
        let inverse = fit.inverse * real::<R>(1.0 - share);
        Some(Shared {
            variance,
            spread: inverse + gain * fit.inverse * real::<R>(share),
            dof: (a * a / k).clamp(1.0, n - p),
            poses,
        })
    }

    /// The residuals of poses under the fit without their orientation, given to `take`, for orientations
    /// that came more than once; infinite where the others do not determine the model. Up to 256 poses.
    pub fn leave_orientations_out<R: Real>(
        &self,
        fit: &Fit<R, N>,
        visited: &Visited,
        mut take: impl FnMut(usize, f64),
    ) {
        if !visited.again || self.poses.len() > MOST {
            return;
        }
        for (group, _) in visited.counts.iter().enumerate().filter(|(_, m)| **m > 1) {
            let without = self.solve_without(fit, group);
            for (k, pose) in self.poses.iter().enumerate() {
                if self.visits.group(k, pose) == group && !self.is_rejected(k, pose) {
                    let left = without.and_then(|theta| self.residual(&theta, pose));
                    let left = left.filter(|r| r.is_finite());
                    take(k, left.unwrap_or(f64::INFINITY));
                }
            }
        }
    }
}
