//! Poses that the others contradict, and how much each counts.

use crate::least_squares::{Fit, Magnitude, Real, Rejected, Weighting};
use crate::student;

/// Chance that a good set of poses loses one.
const SIGNIFICANCE: f64 = 1e-3;
/// Degrees of freedom that must be left for the others to outvote a pose.
const LEAST_DOF: usize = 3;

/// Leaves out poses by the generalised extreme Studentised deviate test: equation (42). Returns the
/// fit to the rest; what it left out is in `problem.rejected`.
pub(crate) fn reject<R: Real, const N: usize>(
    problem: &mut Magnitude<N>,
    fit: Fit<R, N>,
) -> Fit<R, N> {
    let count = problem.poses.len();
    let spare = count.saturating_sub(N + LEAST_DOF).min(count / 5);
    let most = spare.min(Rejected::MOST);
    let mut candidates = Rejected::default();
    let mut bad = 0;
    let mut current: Option<Fit<R, N>> = None;
    for number in 1..=most {
        let now = current.as_ref().unwrap_or(&fit);
        let dof = count - (number - 1) - N;
        let Some((pose, deviate)) = most_extreme(problem, now, dof) else {
            break;
        };
        candidates = candidates.with(pose);
        problem.rejected = candidates;
        let chance = SIGNIFICANCE / (count - number + 1) as f64;
        if deviate > student::two_sided(chance, dof as f64 - 1.0) {
            bad = number;
        } else if count > MANY {
            break;
        }
        current = problem.solve(&now.theta, None);
        if current.is_none() {
            break;
        }
    }
    // Not one that the rest needs.
    while bad > 0 {
        problem.rejected = candidates.first(bad);
        if let Some(without) = problem.solve(&fit.theta, None)
            && problem
                .knowledge(&without.theta)
                .is_some_and(|knowledge| knowledge.suffices())
        {
            return without;
        }
        bad -= 1;
    }
    problem.rejected = Rejected::default();
    fit
}

/// Beyond so many poses a few bad ones hide no other.
const MANY: usize = 1000;

fn most_extreme<R: Real, const N: usize>(
    problem: &Magnitude<N>,
    fit: &Fit<R, N>,
    dof: usize,
) -> Option<(usize, f64)> {
    let mut most: Option<(usize, f64)> = None;
    problem.scrutinise(fit, |k, pose| {
        let deviate = pose.studentized(fit.cost, dof);
        if most.is_none_or(|(_, largest)| deviate > largest) {
            most = Some((k, deviate));
        }
    });
    most
}

/// How much each pose should count, from what the fit leaves: σ₀² such that the residuals are as
/// large as it and the poses' noise say. Equation (40).
pub(crate) fn weighting<R: Real, const N: usize>(
    problem: &Magnitude<N>,
    fit: &Fit<R, N>,
) -> Weighting {
    let (mut count, mut mean_noise) = (0.0, 0.0);
    problem.scrutinise(fit, |_, pose| {
        count += 1.0;
        mean_noise += pose.noise;
    });
    mean_noise /= count;
    let dof = count - N as f64;
    let mut common = 0.0;
    // Newton's rule from below on a convex falling function: it never overshoots.
    for _ in 0..30 {
        let (mut excess, mut slope) = (-dof, 0.0);
        problem.scrutinise(fit, |_, pose| {
            let variance = common + pose.noise;
            let share = pose.residual_mps2 * pose.residual_mps2 / variance;
            excess += share;
            slope += share / variance;
        });
        if excess <= 1e-6 * dof || slope <= 0.0 {
            break;
        }
        common += excess / slope;
    }
    Weighting::new(common, mean_noise)
}
