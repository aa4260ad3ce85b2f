//! The fit of one model, its covariance and its refusals.

use wimu_model::{ErrorModel, ErrorTerms, TemperatureTerms};

use crate::estimate::{Drift, Residuals, TermDeviations};
use crate::force::Conditions;
use crate::knowledge::Knowledge;
use crate::least_squares::{Fit, Magnitude, Without};
use crate::multi_position::{Fitted, Violation, range};
use crate::shared::{Shared, Visited};
use crate::terms::{self, PERFECT, Term, Terms, Theta};
use crate::unfitted::Unfitted;
use crate::visits::Visits;
use crate::weights::{Rejected, Weighting};
use crate::{
    Covariance, Estimate, Gravity, Method, Model, MultiPosition, Pose, Refusal, design, ellipsoid,
    input, outliers, pose,
};

/// Largest leave-one-out error, in standard deviations of a residual. Above it a single pose
/// dominates the fit. Twelve well distributed poses give 2 to 3.
const MOST_LEFT_OUT: f64 = 10.0;
/// Largest residual of a fit to static poses, m/s² rms: with three or six parameters; with nine (10
/// mg, as after a cold start); with nine and further terms.
const MOST_RMS_MPS2: [f64; 3] = [0.5, 0.1, 0.05];
/// Residual above which clipped axes are searched for, m/s² rms: 5 mg.
const SUSPICIOUS_RMS_MPS2: f64 = 0.05;
/// Scale of the Cauchy cost when least squares does not converge, m/s².
const FAR_OFF_MPS2: f64 = 0.5;
/// Leave-one-out error that is always accepted, m/s².
const GOOD_LEFT_OUT_MPS2: f64 = 1e-4;

/// Weights the poses, and rejects outliers if that is asked for, and fits again, from the least-squares
/// fit with equal weights if that converged. `None` if no fit converges.
pub(crate) type Refine =
    fn(&mut Magnitude, Option<Fit>, MultiPosition) -> Result<Option<Fit>, Refusal>;

/// A fit whose parameters are observable.
pub(crate) struct Found<'a> {
    pub problem: Magnitude<'a>,
    pub fit: Fit,
    knowledge: Knowledge,
    gravity: Gravity,
    what: MultiPosition,
}

/// A fit that explains the poses, before poses are left out.
struct Basis {
    model: ErrorModel,
    /// Covariance of its 12 parameters, including the uncertainty of gravity.
    covariance: Covariance,
    /// Residuals of the poses that are not rejected, m/s² rms.
    rms_mps2: f64,
    visited: Visited,
    shared: Shared,
}

pub(crate) fn fit<'a>(
    poses: &'a [Pose],
    visits: &'a Visits,
    gravity: Gravity,
    what: MultiPosition,
    refine: Refine,
    conditions: Conditions,
) -> Result<Found<'a>, Refusal> {
    let mut problem = Magnitude {
        poses,
        visits,
        gravity_mps2: gravity.mps2(),
        conditions,
        weighting: Weighting::EQUAL,
        rejected: Rejected::default(),
        far: None,
        free: what.slots(),
        terms: what.terms != Terms::NONE,
    };
    let defect = || {
        let dead = || input::dead_axis(poses, gravity).map(|axis| Refusal::AxisStuck { axis });
        input::mixed_units(poses).or_else(dead)
    };
    let solve = |start: &Theta| problem.solve(start, Without::Nothing);
    let squares = ellipsoid::start(poses, gravity, what.model).and_then(|start| solve(&start));
    let squares = squares.or_else(|| solve(&PERFECT));
    let fit = match refine(&mut problem, squares, what) {
        // Poses about one axis have no unique fit.
        Err(Refusal::NotConverged) => None,
        fit => fit?,
    };
    let knowledge = match &fit {
        Some(fit) => problem.knowledge(fit, |problem, inverse| problem.condition(inverse)),
        None => near_solution(&mut problem, what),
    };
    if let Some(knowledge) = knowledge.as_ref().filter(|knowledge| !knowledge.suffices()) {
        return Err(defect().unwrap_or_else(|| knowledge.refusal(what, &problem.free)));
    }
    let Some((fit, knowledge)) = fit.zip(knowledge) else {
        return Err(defect().unwrap_or(Refusal::NotConverged));
    };
    if let Some(axis) = input::stuck_axis(poses) {
        return Err(Refusal::AxisStuck { axis });
    }
    Ok(Found { problem, fit, knowledge, gravity, what })
}

/// Observability at the bias and scale factors that fit best.
fn near_solution(problem: &mut Magnitude, what: MultiPosition) -> Option<Knowledge> {
    problem.free = MultiPosition { model: Model::BiasScale6, ..MultiPosition::default() }.slots();
    let smaller = problem.solve(&PERFECT, Without::Nothing);
    problem.free = what.slots();
    problem.knowledge_at(&smaller.map_or(PERFECT, |fit| fit.theta))
}

/// Rejects outliers.
pub(crate) fn searched(
    problem: &mut Magnitude,
    squares: Option<Fit>,
    what: MultiPosition,
) -> Result<Option<Fit>, Refusal> {
    // A gross outlier may keep least squares, but not the robust fit, from converging.
    let converged = squares.is_some();
    let robust = || problem.solve_robust(&PERFECT, FAR_OFF_MPS2);
    let Some(first) = squares.or_else(robust) else {
        return Ok(None);
    };
    let fit = refined(problem, first, what)?;
    Ok(fit.filter(|_| converged || problem.rejected.count() > 0))
}

fn refined(
    problem: &mut Magnitude,
    first: Fit,
    what: MultiPosition,
) -> Result<Option<Fit>, Refusal> {
    let start = first.theta;
    let fit = outliers::reject(problem, first, what.model).map_err(|pose| {
        let mut squares = 0.0;
        problem.residuals(&start, |_, residual| squares += residual * residual);
        input::mixed_units(problem.poses).unwrap_or(Refusal::PoorFit {
            rms_mps2: libm::sqrt(squares / problem.poses.len() as f64),
            pose,
        })
    })?;
    let mut fit = weighted(problem, Some(fit), what)?;
    while let Some(current) = &fit
        && let Some(bad) = outliers::contradicted(problem, current, what.model)
    {
        let known = problem.knowledge(current, |_, _| f64::NAN);
        if !known.is_some_and(|known| known.suffices()) {
            // The poses do not determine the parameters: no outlier is the cause.
            break;
        }
        if !bad.spared {
            let poses = problem.poses;
            let stuck = || input::stuck_axis(poses).map(|axis| Refusal::AxisStuck { axis });
            let clipped = || input::clipped_axis(poses).map(|axis| Refusal::Saturated { axis });
            let refusal = input::mixed_units(poses).or_else(stuck).or_else(clipped);
            return Err(refusal.unwrap_or(Refusal::PoseContradicted {
                pose: bad.pose,
                or: bad.or,
                off_mps2: bad.off_mps2,
            }));
        }
        problem.rejected = problem.rejected.with(bad.pose);
        problem.weighting = Weighting::EQUAL;
        let without = problem.solve(&current.theta, Without::Nothing);
        fit = weighted(problem, Some(without.ok_or(Refusal::NotConverged)?), what)?;
    }
    Ok(fit)
}

/// Weights the poses, if every one has a noise figure.
pub(crate) fn weighted(
    problem: &mut Magnitude,
    mut fit: Option<Fit>,
    _: MultiPosition,
) -> Result<Option<Fit>, Refusal> {
    if !problem.has_noise() {
        return Ok(fit);
    }
    // Twice: the variance between poses is estimated with weights that depend on it.
    for _ in 0..2 {
        let Some(current) = &fit else { break };
        problem.weighting = outliers::weighting(problem, current);
        let again = problem.solve(&current.theta, Without::Nothing);
        fit = Some(again.ok_or(Refusal::NotConverged)?);
    }
    Ok(fit)
}

impl Found<'_> {
    fn basis(&self, violation: Option<&mut Violation>) -> Result<Basis, Refusal> {
        let Self { problem, fit, what, .. } = self;
        let poses = problem.poses;
        let theta = &fit.theta;
        let free = &problem.free;
        let error_terms = ErrorTerms {
            bias_mps2: terms::bias(theta),
            matrix: terms::matrix(theta),
            temperature: TemperatureTerms {
                reference_c: problem.conditions.reference_c,
                bias_mps2_per_k: terms::triple(theta, 15),
                scale_per_k: terms::triple(theta, 18),
                ..TemperatureTerms::default()
            },
            nonlinearity: terms::triple(theta, 21),
        };
        let fitted_poses = poses.len() - problem.rejected.count();
        let dof = fitted_poses - free.len();
        let model = ErrorModel::new(error_terms).map_err(|error| {
            if let Some(violation) = violation {
                *violation = Some((error, fit.cost / dof as f64));
            }
            Refusal::OutOfBounds(error)
        })?;
        let visited = problem.visited();
        let shared = problem.shared(fit, &visited).ok_or_else(|| Refusal::TooFewPoses {
            have: visited.apart,
            need: free.len() + 1,
            model: what.model,
            instead: None,
        })?;
        let mut kept = Residuals::default();
        problem.residuals(&fit.theta, |k, residual| {
            if !problem.is_rejected(k, &poses[k]) {
                kept.add(k, residual);
            }
        });
        if kept.rms_mps2() > SUSPICIOUS_RMS_MPS2
            && let Some(axis) = input::clipped_axis(poses)
        {
            return Err(Refusal::Saturated { axis });
        }
        let most_rms = match (what.model, what.terms) {
            (Model::Full9, Terms::NONE) => MOST_RMS_MPS2[1],
            (Model::Full9, _) => MOST_RMS_MPS2[2],
            _ => MOST_RMS_MPS2[0],
        };
        if kept.rms_mps2() > most_rms {
            return Err(input::mixed_units(poses)
                .unwrap_or(Refusal::PoorFit { rms_mps2: kept.rms_mps2(), pose: kept.worst_pose }));
        }
        let known = |r, c| shared.variance * shared.spread.at(r, c);
        let mut covariance = Covariance::ZERO;
        covariance.add_fitted(free, known);
        if what.model != Model::Bias3 {
            covariance.add_gravity(theta, self.gravity);
        }
        Ok(Basis { model, covariance, rms_mps2: kept.rms_mps2(), visited, shared })
    }

    /// The estimate, judged by leaving poses out and by what its model leaves out.
    pub fn fitted(&self, violation: Option<&mut Violation>) -> Result<Fitted, Refusal> {
        let Basis { model, covariance, rms_mps2, visited, shared } = self.basis(violation)?;
        let Self { problem, fit, what, .. } = self;
        let (poses, free) = (problem.poses, &problem.free);
        let theta = &fit.theta;
        let fitted_poses = poses.len() - problem.rejected.count();
        let (mut all, mut left_out) = (Residuals::default(), Residuals::default());
        // By orientation: a repeated orientation does not confirm the model elsewhere.
        let mut kept_left_out = Residuals::default();
        let mut by_orientation = Residuals::default();
        problem.leave_out(fit, |k, residual, without| {
            all.add(k, residual);
            left_out.add(k, without);
            if problem.is_rejected(k, &poses[k]) {
                by_orientation.add(k, without);
            } else if !problem.comes_again(&visited, k) {
                kept_left_out.add(k, without);
                by_orientation.add(k, without);
            }
        });
        problem.leave_orientations_out(fit, &visited, |k, without| {
            kept_left_out.add(k, without);
            by_orientation.add(k, without);
        });
        let sd = libm::sqrt(shared.variance);
        let mut term_sd = TermDeviations::default();
        term_sd.add_fitted(free, |i| shared.variance * shared.spread.at(i, i));
        let mut estimate = Estimate {
            model,
            method: Method::MultiPosition(what.model),
            terms: what.terms,
            fitted: what.model.fitted(),
            covariance,
            term_sd,
            gravity: self.gravity,
            poses: fitted_poses,
            orientations: visited.orientations,
            dof: fitted_poses - free.len(),
            interval_dof: Some(shared.dof),
            rms_mps2: all.rms_mps2(),
            fitted_rms_mps2: rms_mps2,
            max_mps2: all.largest_mps2,
            worst_pose: all.worst_pose,
            loo_rms_mps2: None,
            loo_orientation_rms_mps2: None,
            pose_sd_mps2: problem.weighting.common_sd().unwrap_or(sd),
            rejected: problem.rejected,
            beyond_bounds: None,
            condition: self.knowledge.condition,
            worst_sd_mps2: problem.worst_sd(fit, &self.knowledge, &shared),
            coverage: design::coverage(poses),
            temperature_c: pose::mean_temperature(poses.iter()),
            temperature_range_c: range(poses, |pose| pose.temperature_c),
            drift: what.terms.contains(Term::Drift).then(|| Drift {
                change_mps2: terms::triple(theta, 12),
                end_s: problem.conditions.end_s,
                span_s: 1.0 / problem.conditions.per_span,
            }),
        };
        let most = (MOST_LEFT_OUT * sd).max(GOOD_LEFT_OUT_MPS2);
        let predicted = kept_left_out.rms_mps2();
        if predicted > most || predicted.is_nan() {
            return Err(Refusal::PoorPrediction {
                model: what.model,
                loo_rms_mps2: predicted,
                rms_mps2: estimate.fitted_rms_mps2,
                pose: kept_left_out.worst_pose,
                instead: None,
            });
        }
        estimate.loo_rms_mps2 = Some(left_out.rms_mps2());
        estimate.loo_orientation_rms_mps2 = visited.again.then(|| by_orientation.rms_mps2());
        if let Some(unfitted) = Unfitted::of(problem, fit, &shared, *what, true) {
            // Poses in a plane determine the bias normal to the plane up to its sign, and that only by
            // its square: the derivatives vanish for a perfect sensor.
            let perfect = at_perfect(problem, fit)
                .and_then(|perfect| Unfitted::of(problem, &perfect, &shared, *what, false));
            for unfitted in [Some(&unfitted), perfect.as_ref()].into_iter().flatten() {
                if let Some(refusal) = unfitted.refusal(what.model) {
                    return Err(refusal);
                }
            }
            let added = |r, c| unfitted.covariance.at(r, c);
            estimate.covariance.add_fitted(free, added);
            estimate.term_sd.add_fitted(free, |i| added(i, i));
            estimate.interval_dof = Some(unfitted.dof);
            estimate.worst_sd_mps2 = unfitted.worst_sd_mps2;
        }
        Ok(Fitted {
            estimate,
            kept_left_out_mps2: predicted,
            dof: shared.dof,
            telling: shared.poses,
            evidence: 0.0,
        })
    }
}

/// `fit` with the derivatives of a perfect sensor.
fn at_perfect(problem: &Magnitude, fit: &Fit) -> Option<Fit> {
    let information = problem.information(&PERFECT, &problem.weighting)?;
    Some(Fit { inverse: information.inverse()?, cost: fit.cost, theta: PERFECT })
}
