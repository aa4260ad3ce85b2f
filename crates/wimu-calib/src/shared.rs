//! Correlation of residuals within an orientation: equation (42b).

use crate::force::Evaluated;
use crate::least_squares::{Fit, Magnitude};
use crate::symmetric::{self, Symmetric};
use crate::visits::{MOST, apart};

/// Variance components of the residuals: equation (42b).
pub(crate) struct Shared {
    /// Variance of a residual of weight 1, (m/s²)².
    pub variance: f64,
    /// Covariance of the fitted parameters, relative to `variance`.
    pub spread: Symmetric,
    /// Degrees of freedom of `variance`.
    pub dof: f64,
    /// Effective number of poses: poses in different orientations that would carry as much
    /// information.
    pub poses: f64,
}

/// Number of fitted poses in each orientation.
pub(crate) struct Visited {
    counts: [u32; MOST],
    /// Orientations with at least one pose.
    pub orientations: usize,
    /// Number of independent observations.
    pub apart: usize,
    /// Whether orientations are repeated.
    pub again: bool,
}

impl Visited {
    fn of(&self, group: usize) -> u32 {
        self.counts.get(group).copied().unwrap_or(0)
    }
}

impl Magnitude<'_> {
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
        Visited { counts, orientations, apart, again: apart < kept }
    }

    /// Whether the orientation of pose `k` is repeated and is left out as a whole.
    pub fn comes_again(&self, visited: &Visited, k: usize) -> bool {
        visited.again
            && self.poses.len() <= MOST
            && self.poses.get(k).is_some_and(|pose| visited.of(self.visits.group(k, pose)) > 1)
    }

    /// Variance within and between orientations. `None` when the differences between orientations
    /// are used up by the parameters.
    pub fn shared(&self, fit: &Fit, visited: &Visited) -> Option<Shared> {
        let orientations = visited.orientations;
        let kept = self.poses.len() - self.rejected.count();
        let (n, p) = (kept as f64, self.free.len() as f64);
        let apart = Shared {
            variance: fit.cost / (n - p),
            spread: fit.inverse.clone(),
            dof: n - p,
            poses: n,
        };
        if !visited.again {
            return Some(apart);
        }
        // Sums over the poses of each orientation, with residuals e and rows x multiplied by the
        // root of the weight: Σ e; G = Σ g gᵀ with g = Σ x; Σ m²; Σ m g gᵀ.
        let at = Evaluated::new(&fit.theta, self.terms)?;
        let mut sums = [0.0; MOST];
        let mut rows = Symmetric::zero(self.free.len());
        let mut weighted = rows.clone();
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
                *sum += residual;
            }
            if m > 1 && few {
                if core::mem::replace(&mut seen[group.min(MOST - 1)], true) {
                    continue;
                }
                for (j, other) in self.poses.iter().enumerate().skip(k + 1) {
                    if self.visits.group(j, other) == group && !self.is_rejected(j, other) {
                        let (_, other) = self.weighted_row(&at, other);
                        symmetric::add(&mut row, 1.0, &other);
                    }
                }
            } else if m > 1 {
                // Poses of one orientation are taken as identical when there are many.
                let root = libm::sqrt(f64::from(m));
                row = row.map(|d| d * root);
            }
            rows.add_outer(&row, 1.0);
            weighted.add_outer(&row, f64::from(m));
        }
        let together: f64 = sums.iter().map(|sum| sum * sum).sum();
        let around = fit.inverse.around(&rows);
        let trace = fit.inverse.trace_with(&rows);
        let fourth = around.trace_with(&rows);
        let a = n - trace;
        let k = squares - 2.0 * fit.inverse.trace_with(&weighted) + fourth;
        // The parameters use up the differences between orientations.
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
        let (of_inverse, of_around) = (1.0 - share, share);
        Some(Shared {
            variance,
            spread: Symmetric::from_fn(self.free.len(), |r, c| {
                fit.inverse.at(r, c) * of_inverse + around.at(r, c) * of_around
            }),
            dof: (a * a / k).clamp(1.0, n - p),
            poses,
        })
    }

    /// Calls `take` with the index and the residual, under the fit without its orientation, of each
    /// pose in a repeated orientation. The residual is infinite when the other poses do not
    /// determine the model. Only for up to 256 poses.
    pub fn leave_orientations_out(
        &self,
        fit: &Fit,
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
