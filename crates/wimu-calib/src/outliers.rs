//! Rejection of poses that are outliers: equations (42) and (42d).

use alloc::format;
use alloc::string::String;
use alloc::vec::Vec;

use crate::magnitude::{Fit, Magnitude};
use crate::terms::Theta;
use crate::weights::Weighting;
use crate::{Reason, Refusal, student};

/// Probability that a set without outliers loses a pose.
const SIGNIFICANCE: f64 = 1e-3;
/// Probability that a sound session loses a pose by the leave-one-out test: half of the 1 % of sound sessions that may be
/// warned. The tests of [`nested`](crate::nested) models have the other half.
const CONTRADICTION: f64 = 0.005;
/// Largest probability that a set without outliers is refused because the suspected pose cannot be
/// left out.
const UNSPARED: f64 = 0.1;
/// Repeatability of a pose, m/s² rms. It enters the residual variance as [`REPEATS`] prior
/// observations, because few residuals may be small by chance. Chosen on real sensors, see
/// VALIDATION.
const REPEATS_MPS2: f64 = 0.002;
const REPEATS: f64 = 2.0;
/// Significance level at which the first suspect is still an outlier after the second was left out.
const EITHER: f64 = 0.01;
/// Number of poses tested one by one: those whose removal reduces the cost most.
const TRIED: usize = 3;
/// Smallest number of degrees of freedom after rejection, and of a test.
const LEAST_DOF: usize = 3;
const LEAST_TESTED_DOF: f64 = 0.5;
/// Poses per rejected pose, at least.
const DOUBTED: usize = 5;
/// Largest number of rejected poses.
const MOST: usize = 128;
/// Tuning constant of the Cauchy cost, standard deviations: 95 % efficiency for normal residuals.
const CAUCHY: f64 = 2.385;
/// Standard deviation of normal deviates per median of their absolute values.
const PER_MEDIAN: f64 = 1.4826;
/// Relative change of the median of the residuals at which the robust fit has converged.
const MEDIAN_ERROR: f64 = 0.05;
/// Fraction of a limit below which the deviate of the linearised fit decides: its error is of second
/// order.
const CLOSE: f64 = 0.9;
/// Largest number of robust fits, each with a scale from the previous one.
const ROBUST_FITS: usize = 4;

/// Rejects outliers by a forward search: equation (42). A robust fit ranks the poses by their
/// distance. The rest is fitted, and the most distant poses are added again one by one, the nearest
/// first, until the next one is an outlier. Returns the fit; the rejected poses are in
/// `problem.rejected`.
pub(crate) fn reject(problem: &mut Magnitude, fit: Fit) -> Fit {
    let most = spare(problem, &fit);
    if most == 0 {
        return fit;
    }
    let theta = robust(problem, &fit);
    let noisy = problem.has_noise();
    if noisy {
        // A residual is judged by the noise of its pose.
        let scatter = PER_MEDIAN * median_residual(problem, &theta);
        problem.weighting = Weighting::new(scatter * scatter, problem.mean_noise());
    }
    problem.rejected = farthest(problem, &theta, most);
    if let Some(found) = added_again(problem, &fit.at, noisy) {
        return found;
    }
    problem.rejected.clear();
    problem.weighting = Weighting::EQUAL;
    fit
}

/// Adds the rejected poses again until the next one is an outlier; `None` if none is.
fn added_again(problem: &mut Magnitude, start: &Theta, noisy: bool) -> Option<Fit> {
    let count = problem.poses.len() as f64;
    let mut inner = problem.solve(start)?;
    let mut linearised = false;
    while let Some((place, deviate)) = nearest(problem, &inner) {
        let dof = problem.independent().0 as f64 - problem.determined(&inner) + problem.usual().1;
        let limit = student::two_sided(SIGNIFICANCE / count, dof.max(1.0));
        if linearised && deviate > CLOSE * limit {
            (inner, linearised) = (problem.solve(&inner.at)?, false);
            continue;
        }
        if deviate > limit && problem.knowledge(&inner).is_some_and(|known| known.suffices) {
            return Some(inner);
        }
        let pose = problem.rejected.remove(place);
        problem.change(&mut inner, pose, 1.0)?;
        linearised = !noisy;
        if noisy {
            inner = problem.solve(&inner.at)?;
            problem.weighting = Weighting::from_residuals(problem, &inner);
        }
    }
    None
}

/// Largest number of poses that may be rejected.
fn spare(problem: &Magnitude, fit: &Fit) -> usize {
    let count = problem.poses.len();
    let apart = problem.visits.apart(count);
    let determined = libm::ceil(problem.determined(fit)) as usize;
    apart.saturating_sub(determined + LEAST_DOF).min(count / DOUBTED).min(MOST)
}

/// A pose that is an outlier with respect to the fit of all others.
pub(crate) struct Contradicted {
    pub pose: usize,
    /// Another pose that may be the outlier instead.
    pub or: Option<usize>,
    /// Residual of the pose under the fit of the others, m/s².
    pub off_mps2: f64,
    /// Whether the pose can be rejected.
    pub spared: bool,
}

impl Contradicted {
    pub fn refusal(&self) -> Refusal {
        let Self { pose, or, off_mps2, .. } = *self;
        let other =
            or.map_or(String::new(), |other| format!(" Pose {other} may be the outlier instead."));
        let text = format!(
            "Pose {pose} (from 0) differs significantly, by {:.0} mm/s², from the fit of the others.{other} Repeat it, and \
             add two poses in other orientations.",
            off_mps2.abs() * 1e3
        );
        Refusal::new(Reason::Contradicted { index: pose, or }, text)
    }
}

/// The pose with the largest leave-one-out residual, if it is significant: equation (42d). It is
/// found even if it has great leverage.
pub(crate) fn contradicted(problem: &mut Magnitude, fit: &Fit) -> Option<Contradicted> {
    let count = problem.poses.len() as f64;
    let dof = problem.independent().0 as f64 - problem.determined(fit) - 1.0 + problem.usual().1;
    if dof < LEAST_TESTED_DOF {
        return None;
    }
    let beyond = |chance: f64| student::two_sided(chance / count, dof);
    let limit = beyond(UNSPARED);
    let tried = suspects(problem, fit).into_iter().filter_map(|pose| {
        let (off_mps2, deviate) = doubt(problem, fit, pose, limit)?;
        Some((pose, off_mps2, deviate))
    });
    let found: Vec<(usize, f64, f64)> = tried.collect();
    let (pose, off_mps2, deviate) = found.iter().copied().max_by(|a, b| a.2.total_cmp(&b.2))?;
    let or = found.iter().map(|found| found.0).filter(|other| *other != pose).find(|other| {
        if dof < 1.0 + LEAST_TESTED_DOF {
            return true;
        }
        problem.rejected.push(*other);
        let limit = student::two_sided(EITHER, dof - 1.0);
        let without = problem.solve(&fit.at);
        let still = without.and_then(|fit| doubt(problem, &fit, pose, limit));
        problem.rejected.pop();
        still.is_none()
    });
    let spared = or.is_none() && problem.rejected.len() < spare(problem, fit);
    (!spared || deviate > beyond(CONTRADICTION)).then_some(Contradicted {
        pose,
        or,
        off_mps2,
        spared,
    })
}

/// The poses whose removal reduces the cost of the linearised fit most.
fn suspects(problem: &Magnitude, fit: &Fit) -> Vec<usize> {
    let variances = fit.variances();
    let gain = |k: usize| {
        let (weight, residual) = (problem.weighting.of(&problem.poses[k]), fit.rows.residual[k]);
        (weight * residual * residual / (1.0 - weight * variances[k]).max(0.0), k)
    };
    let mut gains: Vec<(f64, usize)> = problem.kept().map(gain).collect();
    gains.sort_by(|a, b| b.0.total_cmp(&a.0));
    gains.into_iter().filter(|(gain, _)| *gain > 0.0).take(TRIED).map(|(_, k)| k).collect()
}

/// Residual of a pose under the fit of all others, m/s², and in standard deviations of its
/// prediction; `None` if these do not exceed `limit`.
fn doubt(problem: &Magnitude, fit: &Fit, pose: usize, limit: f64) -> Option<(f64, f64)> {
    let own = 1.0 / problem.weighting.of(problem.poses.get(pose)?);
    let predicted = |without: &Fit| {
        let (residual, growth) = problem.predicted(without, pose)?;
        let (usual, usual_dof) = problem.usual();
        let dof = problem.count() as f64 - 1.0 - problem.determined(without) + usual_dof;
        let cost = problem.cost(without, Some(pose)) + usual;
        let noise = (cost + REPEATS * REPEATS_MPS2 * REPEATS_MPS2) / dof;
        let variance = predicted_variance(problem, noise, own, growth);
        let deviate = residual.abs() / libm::sqrt(variance);
        (dof >= LEAST_TESTED_DOF).then_some((residual, deviate, growth))
    };
    let mut without = fit.clone();
    problem.change(&mut without, pose, -1.0)?;
    let (_, deviate, growth) = predicted(&without)?;
    // Of a leverage above one half, the linearised fit does not decide.
    if growth < own && deviate < CLOSE * limit {
        return None;
    }
    let without = problem.solve_without(&without.at, pose)?;
    let (residual, deviate, _) = predicted(&without)?;
    (deviate > limit).then_some((residual, deviate))
}

/// Variance of a pose's residual under a fit without it: `noise` of weight 1, of which the pose has `own`, and the variance
/// of the prediction `growth`. With priors, that is relative to the variance against which they are weighed.
fn predicted_variance(problem: &Magnitude, noise: f64, own: f64, growth: f64) -> f64 {
    let of_fit =
        if problem.has_priors() { noise.max(problem.sd_mps2 * problem.sd_mps2) } else { noise };
    noise * own + of_fit * growth
}

/// Robust fit, starting from the least-squares fit.
fn robust(problem: &Magnitude, fit: &Fit) -> Theta {
    let mut theta = fit.at;
    let count = problem.poses.len() as f64;
    let mut last = 0.0;
    for _ in 0..ROBUST_FITS {
        let median = median_residual(problem, &theta);
        if (median - last).abs() <= MEDIAN_ERROR * median {
            break;
        }
        last = median;
        let dof = (count - problem.determined(fit)).max(1.0);
        let small_sample = libm::sqrt(count / dof);
        let scale = CAUCHY * PER_MEDIAN * median * small_sample;
        match problem.solve_robust(&theta, scale) {
            Some(better) => theta = better.at,
            None => break,
        }
    }
    theta
}

/// Median of |r|.
fn median_residual(problem: &Magnitude, theta: &Theta) -> f64 {
    let mut sizes: Vec<f64> = problem.residuals(theta).into_iter().map(f64::abs).collect();
    sizes.sort_by(f64::total_cmp);
    sizes.get(sizes.len() / 2).copied().unwrap_or(0.0)
}

/// The `most` poses with the largest residuals.
fn farthest(problem: &Magnitude, theta: &Theta, most: usize) -> Vec<usize> {
    let sizes = problem.residuals(theta).into_iter().zip(problem.poses);
    let sizes = sizes.map(|(r, pose)| r.abs() * libm::sqrt(problem.weighting.of(pose)));
    let mut worst: Vec<(f64, usize)> = sizes.zip(0..).filter(|(size, _)| *size > 0.0).collect();
    worst.sort_by(|a, b| b.0.total_cmp(&a.0));
    worst.into_iter().take(most).map(|(_, k)| k).collect()
}

/// The rejected pose that the fit predicts best: its index among the rejected poses, and its residual
/// in standard deviations of the prediction.
fn nearest(problem: &Magnitude, fit: &Fit) -> Option<(usize, f64)> {
    let (usual, usual_dof) = problem.usual();
    let dof = (problem.count() as f64 - problem.determined(fit) + usual_dof).max(1.0);
    let noise = (problem.cost(fit, None) + usual) / dof;
    let deviates = problem.rejected.iter().enumerate().filter_map(|(place, &pose)| {
        let (residual, growth) = problem.predicted(fit, pose)?;
        let own = 1.0 / problem.weighting.of(problem.poses.get(pose)?);
        let variance = predicted_variance(problem, noise, own, growth);
        Some((place, residual.abs() / libm::sqrt(variance)))
    });
    deviates.min_by(|a, b| a.1.total_cmp(&b.1))
}
