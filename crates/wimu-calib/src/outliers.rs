//! Outlier rejection and weights of poses.

use crate::force::Evaluated;
use crate::least_squares::{Fit, Magnitude, Without};
use crate::terms::{Theta, USUAL_ACROSS, USUAL_SCALE};
use crate::weights::{FarOff, Rejected, Weighting};
use crate::{Model, Pose, student};

/// Probability that a set without outliers loses a pose.
const SIGNIFICANCE: f64 = 1e-3;
/// Probability that a valid pose is rejected by the leave-one-out test.
const CONTRADICTION: f64 = 0.01;
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
/// Largest number of poses for the forward search. Of more poses, all distant ones are rejected.
const MANY: usize = Rejected::MOST * 20;
/// Largest number of fits in the rejection of distant poses.
const FAR_OFF_FITS: usize = 4;
/// Smallest number of degrees of freedom after rejection.
const LEAST_DOF: usize = 3;
/// At most one pose in this many is rejected.
const DOUBTED: usize = 5;
/// Tuning constant of the Cauchy cost, standard deviations: 95 % efficiency for normal residuals.
const CAUCHY: f64 = 2.385;
/// Standard deviation of normal deviates per median of their absolute values.
const PER_MEDIAN: f64 = 1.4826;
/// Relative error of a median of residuals.
const MEDIAN_ERROR: f64 = 0.01;
/// Fraction of a limit below which the deviate of the linearised fit decides: its error is of second
/// order.
const CLOSE: f64 = 0.9;
/// Largest number of robust fits, each with a scale from the previous one.
const ROBUST_FITS: usize = 4;

/// Rejects outliers by a forward search: equation (42). A robust fit ranks the poses by their
/// distance. The rest is fitted, and the most distant poses are added again one by one, the nearest
/// first, until the next one is an outlier. Returns the fit; the rejected poses are in
/// `problem.rejected`.
///
/// # Errors
/// The worst pose, when more than every fifth of very many is an outlier.
pub(crate) fn reject(problem: &mut Magnitude, fit: Fit, model: Model) -> Result<Fit, usize> {
    let count = problem.poses.len();
    if count > MANY {
        return leave_far_off(problem, fit, model);
    }
    let most = spare(problem);
    if most == 0 {
        return Ok(fit);
    }
    let unfitted_mps2 = unfitted(problem.gravity_mps2, model);
    let theta = robust(problem, &fit);
    let noisy = problem.has_noise();
    if noisy {
        // A residual is judged by the noise of its pose.
        let scatter = PER_MEDIAN * median_residual(problem, &theta);
        problem.weighting = Weighting::new(scatter * scatter, problem.mean_noise());
    }
    problem.rejected = farthest(problem, &theta, most);
    let Some(mut inner) = problem.solve(&fit.theta, Without::Nothing) else {
        problem.rejected = Rejected::default();
        problem.weighting = Weighting::EQUAL;
        return Ok(fit);
    };
    let mut linearised = false;
    while let Some((place, pose, deviate)) = nearest(problem, &inner, unfitted_mps2) {
        let dof = problem.visited().apart.saturating_sub(problem.free.len()).max(1);
        let limit = student::two_sided(SIGNIFICANCE / count as f64, dof as f64);
        if linearised && deviate > CLOSE * limit {
            let Some(exact) = problem.solve(&inner.theta, Without::Nothing) else {
                break;
            };
            (inner, linearised) = (exact, false);
            continue;
        }
        let known = || {
            let knowledge = problem.knowledge(&inner, |_, _| f64::NAN);
            knowledge.is_some_and(|knowledge| knowledge.suffices())
        };
        if deviate > limit && known() {
            return Ok(inner);
        }
        problem.rejected = problem.rejected.without(place);
        if problem.change(&mut inner, pose, 1.0).is_none() {
            break;
        }
        linearised = !noisy;
        if noisy {
            match problem.solve(&inner.theta, Without::Nothing) {
                Some(wider) => inner = wider,
                None => break,
            }
            problem.weighting = weighting(problem, &inner);
        }
    }
    problem.rejected = Rejected::default();
    problem.weighting = Weighting::EQUAL;
    Ok(fit)
}

/// Largest number of poses that may be rejected.
fn spare(problem: &Magnitude) -> usize {
    let count = problem.poses.len();
    problem
        .visits
        .apart(count)
        .saturating_sub(problem.free.len() + LEAST_DOF)
        .min(count / DOUBTED)
        .min(Rejected::MOST)
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

/// The pose with the largest leave-one-out residual, if it is significant: equation (42d). It is
/// found even if it has great leverage. Not used for very many poses, where a single one has little
/// influence.
pub(crate) fn contradicted(
    problem: &mut Magnitude,
    fit: &Fit,
    model: Model,
) -> Option<Contradicted> {
    let count = problem.poses.len();
    let dof = problem.visited().apart.checked_sub(problem.free.len() + 1)?;
    if count > MANY || dof == 0 {
        return None;
    }
    let unfitted_mps2 = unfitted(problem.gravity_mps2, model);
    let beyond = |chance: f64| student::two_sided(chance / count as f64, dof as f64);
    let limit = beyond(UNSPARED);
    let tried = suspects(problem, fit).map(|pose| {
        let pose = pose?;
        let (off_mps2, deviate) = doubt(problem, fit, pose, unfitted_mps2, limit)?;
        Some((pose, off_mps2, deviate))
    });
    let found = tried.into_iter().flatten();
    let (pose, off_mps2, deviate) = found.clone().max_by(|a, b| a.2.total_cmp(&b.2))?;
    let kept = problem.rejected;
    let or = found.map(|(other, ..)| other).find(|&other| {
        if other == pose || dof == 1 {
            return other != pose;
        }
        problem.rejected = kept.with(other);
        let limit = student::two_sided(EITHER, (dof - 1) as f64);
        problem
            .solve(&fit.theta, Without::Nothing)
            .and_then(|without| doubt(problem, &without, pose, unfitted_mps2, limit))
            .is_none()
    });
    problem.rejected = kept;
    let spared = or.is_none() && kept.count() < spare(problem);
    (!spared || deviate > beyond(CONTRADICTION)).then_some(Contradicted {
        pose,
        or,
        off_mps2,
        spared,
    })
}

/// The poses whose removal reduces the cost of the linearised fit most.
fn suspects(problem: &Magnitude, fit: &Fit) -> [Option<usize>; TRIED] {
    let mut worst = [(0.0, None); TRIED];
    let Some(at) = Evaluated::new(&fit.theta, problem.terms) else {
        return [None; TRIED];
    };
    for (k, pose) in problem.poses.iter().enumerate() {
        if problem.is_rejected(k, pose) {
            continue;
        }
        let (residual, row) = problem.weighted_row(&at, pose);
        let left = 1.0 - fit.inverse.form(&row);
        keep_largest(&mut worst, (residual * residual / left.max(0.0), Some(k)));
    }
    worst.map(|(_, pose)| pose)
}

/// Inserts `candidate` into a list in descending order, from which the smallest drops out.
fn keep_largest<T>(largest: &mut [(f64, T)], mut candidate: (f64, T)) {
    for entry in largest {
        if candidate.0 > entry.0 {
            core::mem::swap(entry, &mut candidate);
        }
    }
}

/// Residual of a pose under the fit of all others, m/s², and in standard deviations of its
/// prediction; `None` if these do not exceed `limit`.
fn doubt(
    problem: &Magnitude,
    fit: &Fit,
    pose: usize,
    unfitted_mps2: f64,
    limit: f64,
) -> Option<(f64, f64)> {
    let inside = problem.poses.len() - problem.rejected.count();
    let dof = inside.checked_sub(problem.free.len() + 1).filter(|dof| *dof > 0)?;
    let own = 1.0 / problem.weighting.of(problem.poses.get(pose)?);
    let predicted = |without: &Fit| {
        let (residual, growth) = problem.predicted(without, pose)?;
        let squares = without.cost + REPEATS * REPEATS_MPS2 * REPEATS_MPS2;
        let variance = squares / dof as f64 * (own + growth) + unfitted_mps2 * unfitted_mps2;
        Some((residual, residual.abs() / libm::sqrt(variance), growth))
    };
    let mut without = fit.clone();
    problem.change(&mut without, pose, -1.0)?;
    let (_, deviate, growth) = predicted(&without)?;
    // Of a leverage above one half, the linearised fit does not decide.
    if growth < own && deviate < CLOSE * limit {
        return None;
    }
    let without = problem.solve(&without.theta, Without::Pose(pose))?;
    let (residual, deviate, _) = predicted(&without)?;
    (deviate > limit).then_some((residual, deviate))
}

/// Standard deviation of |f| caused by the parameters that the model leaves out, m/s².
fn unfitted(gravity_mps2: f64, model: Model) -> f64 {
    gravity_mps2
        * match model {
            Model::Bias3 => USUAL_SCALE,
            Model::BiasScale6 => USUAL_ACROSS,
            Model::Full9 => 0.0,
        }
}

/// Rejects all distant poses: equation (42c).
fn leave_far_off(problem: &mut Magnitude, fit: Fit, model: Model) -> Result<Fit, usize> {
    let count = problem.poses.len();
    let least = unfitted(problem.gravity_mps2, model);
    let mut fit = fit;
    let mut theta = robust(problem, &fit);
    for _ in 0..FAR_OFF_FITS {
        let far = FarOff {
            theta,
            sd_mps2: libm::hypot(PER_MEDIAN * median_residual(problem, &theta), least),
            deviations: student::normal_two_sided(SIGNIFICANCE / count as f64),
            rejects: FarOff::rejects,
        };
        let (mut found, mut worst) = (0, (0.0, 0));
        problem.residuals(&theta, |k, residual| {
            if far.has(residual, &problem.poses[k]) {
                found += 1;
                if residual.abs() > worst.0 {
                    worst = (residual.abs(), k);
                }
            }
        });
        if DOUBTED * found > count {
            return Err(worst.1);
        }
        let named = farthest(problem, &theta, found.min(Rejected::MOST));
        let same = problem.rejected.count() == found && problem.far.is_some();
        problem.far = Some(far);
        problem.rejected = Rejected { unnamed: found - named.count, ..named };
        match problem.solve(&fit.theta, Without::Nothing) {
            Some(without) => fit = without,
            None => return Err(worst.1),
        }
        if same {
            break;
        }
        theta = fit.theta;
    }
    Ok(fit)
}

/// Robust fit, starting from the least-squares fit.
fn robust(problem: &Magnitude, fit: &Fit) -> Theta {
    let mut theta = fit.theta;
    let count = problem.poses.len();
    let mut last = 0.0;
    for _ in 0..ROBUST_FITS {
        let median = median_residual(problem, &theta);
        if (median - last).abs() <= MEDIAN_ERROR * median {
            break;
        }
        last = median;
        let small_sample = libm::sqrt(count as f64 / (count - problem.free.len()) as f64);
        let scale = CAUCHY * PER_MEDIAN * median * small_sample;
        match problem.solve_robust(&theta, scale) {
            Some(better) => theta = better.theta,
            None => break,
        }
    }
    theta
}

/// Median of |r| to 1 %, by bisection: there is no memory to sort the residuals of very many poses.
fn median_residual(problem: &Magnitude, theta: &Theta) -> f64 {
    let mut sizes = heapless::Vec::<f64, MANY>::new();
    let mut largest = 0.0_f64;
    problem.residuals(theta, |_, residual| {
        largest = largest.max(residual.abs());
        let _ = sizes.push(residual.abs());
    });
    let below = |middle: f64| {
        let mut count = 0;
        let mut take = |size: f64| count += usize::from(size <= middle);
        if problem.poses.len() > MANY {
            problem.residuals(theta, |_, residual| take(residual.abs()));
        } else {
            sizes.iter().copied().for_each(take);
        }
        count
    };
    let (mut low, mut high) = (0.0, largest);
    for _ in 0..60 {
        let middle = 0.5 * (low + high);
        if 2 * below(middle) > problem.poses.len() {
            high = middle;
        } else {
            low = middle;
        }
        if high - low <= MEDIAN_ERROR * high {
            break;
        }
    }
    high
}

/// The `most` poses with the largest residuals.
fn farthest(problem: &Magnitude, theta: &Theta, most: usize) -> Rejected {
    let mut worst = [(0.0, 0); Rejected::MOST];
    problem.residuals(theta, |k, residual| {
        let pose = problem.poses.get(k);
        let weight = pose.map_or(1.0, |pose| problem.weighting.of(pose));
        keep_largest(
            worst.get_mut(..most).unwrap_or_default(),
            (residual.abs() * libm::sqrt(weight), k),
        );
    });
    worst
        .iter()
        .take(most)
        .filter(|(size, _)| *size > 0.0)
        .fold(Rejected::default(), |all, &(_, pose)| all.with(pose))
}

/// The rejected pose that the fit predicts best: its index among the rejected poses and
/// among all, and its residual in standard deviations of the prediction.
fn nearest(problem: &Magnitude, fit: &Fit, unfitted_mps2: f64) -> Option<(usize, usize, f64)> {
    let inside = problem.poses.len() - problem.rejected.as_slice().len();
    let sd = fit.sd(inside - problem.free.len());
    let mut nearest: Option<(usize, usize, f64)> = None;
    for (place, &pose) in problem.rejected.as_slice().iter().enumerate() {
        let (residual, growth) = problem.predicted(fit, pose)?;
        let own = 1.0 / problem.weighting.of(problem.poses.get(pose)?);
        let variance = sd * sd * (own + growth) + unfitted_mps2 * unfitted_mps2;
        let deviate = residual.abs() / libm::sqrt(variance);
        if nearest.is_none_or(|(.., least)| deviate < least) {
            nearest = Some((place, pose, deviate));
        }
    }
    nearest
}

/// Weights from the residuals: the variance σ₀² between poses is chosen such that the residuals
/// agree with it and with the noise of the poses. Equation (40).
pub(crate) fn weighting(problem: &Magnitude, fit: &Fit) -> Weighting {
    let kept = |k: usize, pose: &Pose| !problem.is_rejected(k, pose);
    let (mut count, mut mean_noise) = (0.0, 0.0);
    let poses = problem.poses.iter().enumerate();
    for (_, pose) in poses.filter(|(k, pose)| kept(*k, pose)) {
        count += 1.0;
        mean_noise += pose.mean_free_noise();
    }
    mean_noise /= count;
    let dof = count - problem.free.len() as f64;
    let mut common = 0.0;
    // Newton's method from below on a convex decreasing function: it does not overshoot.
    for _ in 0..30 {
        let (mut excess, mut slope) = (-dof, 0.0);
        problem.residuals(&fit.theta, |k, residual| {
            if kept(k, &problem.poses[k]) {
                let variance = common + problem.poses[k].mean_free_noise();
                let share = residual * residual / variance;
                excess += share;
                slope += share / variance;
            }
        });
        if excess <= 1e-6 * dof || slope <= 0.0 {
            break;
        }
        common += excess / slope;
    }
    Weighting::new(common, mean_noise)
}
