//! The fit to the magnitude of gravity, its covariance and its refusals.

use alloc::format;
use alloc::vec::Vec;

use nalgebra::DMatrix;
use wimu_model::{CalibrationMethod, ErrorModel, ErrorTerms, TemperatureTerms};

use crate::estimate::{Drift, Residuals};
use crate::force::Conditions;
use crate::least_squares::End;
use crate::magnitude::{Fit, Knowledge, Magnitude, Shared};
use crate::multi_position::range;
use crate::terms::{self, PERFECT, Term, Terms, Theta};
use crate::visits::Visits;
use crate::weights::Weighting;
use crate::{
    Covariance, Estimate, Gravity, MultiPosition, Parameter, Parameters, Pose, Reason, Refusal,
    ellipsoid, input, outliers, pose,
};

/// Largest leave-one-out error, in standard deviations of a residual. Above it a single pose
/// dominates the fit. Twelve well distributed poses give 2 to 3.
const MOST_LEFT_OUT: f64 = 10.0;
/// Largest residual of a fit to static poses, m/s² rms: 10 mg, as after a cold start; with further terms 5 mg.
const MOST_RMS_MPS2: [f64; 2] = [0.1, 0.05];
/// Residual above which clipped axes are searched for, m/s² rms: 5 mg.
const SUSPICIOUS_RMS_MPS2: f64 = 0.05;
/// Scale of the Cauchy cost when least squares does not converge, m/s².
const FAR_OFF_MPS2: f64 = 0.5;
/// Leave-one-out error that is always accepted, m/s².
const GOOD_LEFT_OUT_MPS2: f64 = 1e-4;
/// A parameter is assumed, not determined, if its standard deviation exceeds this fraction of its prior's.
const ASSUMED: f64 = 0.5;
/// Iterations of the fit and of the variance of its residuals, which the weights of the priors depend on.
const PRIOR_ROUNDS: usize = 4;

/// A fit whose parameters are observable.
pub(crate) struct Found<'a> {
    problem: Magnitude<'a>,
    fit: Fit,
    knowledge: Knowledge,
    gravity: Gravity,
    what: MultiPosition,
    terms: Terms,
}

/// A fit that explains the poses, before poses are left out.
struct Basis {
    model: ErrorModel,
    /// Covariance of its 12 parameters, including the uncertainty of gravity.
    covariance: Covariance,
    /// Residuals of the poses that are not rejected, m/s² rms.
    rms_mps2: f64,
    shared: Shared,
}

/// Fits the nine parameters and `terms`.
pub(crate) fn fit<'a>(
    poses: &'a [Pose],
    visits: &'a Visits,
    gravity: Gravity,
    what: MultiPosition,
    terms: Terms,
    conditions: Conditions,
) -> Result<Found<'a>, Refusal> {
    let nine = Parameters::OF_GRAVITY;
    let is_fitted = |index: &usize| match terms::parameter(*index) {
        Some(parameter) => nine.contains(parameter),
        None => terms::term(*index).is_some_and(|term| terms.contains(term)),
    };
    let free: Vec<usize> = (0..terms::COUNT).filter(is_fitted).collect();
    let has_prior =
        |index| what.priors && !terms::term(index).is_some_and(|term| what.terms.contains(term));
    let mut problem = Magnitude::new(poses, visits, gravity.mps2(), conditions, free);
    problem.set_priors(has_prior);
    let defect = || input::dead_axis(poses, gravity).map(Refusal::stuck);
    let ellipsoid = ellipsoid::start(poses, gravity).filter(|_| !what.priors);
    let squares = ellipsoid.and_then(|start| problem.solve(&start));
    let squares = squares.or_else(|| problem.solve(&PERFECT));
    // Poses about one axis have no unique fit.
    let fit = if what.reject {
        searched(&mut problem, squares)?
    } else {
        let weighted = squares.and_then(|fit| weighted(&mut problem, fit));
        weighted.and_then(|fit| settled(&mut problem, fit))
    };
    let knowledge = match &fit {
        Some(fit) => problem.knowledge(fit),
        None => near_solution(&mut problem),
    };
    if let Some(knowledge) = knowledge.as_ref().filter(|knowledge| !knowledge.suffices) {
        return Err(defect().unwrap_or_else(|| knowledge.refusal()));
    }
    let Some((fit, knowledge)) = fit.zip(knowledge) else {
        return Err(defect().unwrap_or_else(not_converged));
    };
    if let Some(axis) = input::stuck_axis(poses) {
        return Err(Refusal::stuck(axis));
    }
    Ok(Found { problem, fit, knowledge, gravity, what, terms })
}

fn not_converged() -> Refusal {
    let text = "No error model gives these poses the same magnitude. Check that the sensor was at rest, that it was not \
                saturated, and that every axis works.";
    Refusal::new(Reason::PoorFit { rms: f64::INFINITY, index: 0 }, text)
}

/// Observability at the parameters that fit best with priors.
fn near_solution(problem: &mut Magnitude) -> Option<Knowledge> {
    problem.set_priors(|_| true);
    let near = problem.solve(&PERFECT);
    problem.set_priors(|_| false);
    problem.knowledge_at(&near.map_or(PERFECT, |fit| fit.at))
}

/// Weights the poses and rejects outliers. `None` if no fit converges.
fn searched(problem: &mut Magnitude, squares: Option<Fit>) -> Result<Option<Fit>, Refusal> {
    // A gross outlier may keep least squares, but not the robust fit, from converging.
    let converged = squares.is_some();
    let robust = || problem.solve_robust(&PERFECT, FAR_OFF_MPS2).map(End::fit);
    let Some(first) = squares.or_else(robust) else {
        return Ok(None);
    };
    let fit = outliers::reject(problem, first);
    let fit = contradictions(problem, fit)?.and_then(|fit| settled(problem, fit));
    Ok(fit.filter(|_| converged || !problem.rejected.is_empty()))
}

/// Rejects poses that the fit of the others contradicts, one by one.
fn contradictions(problem: &mut Magnitude, fit: Fit) -> Result<Option<Fit>, Refusal> {
    let mut fit = weighted(problem, fit);
    while let Some(current) = &fit
        && let Some(bad) = outliers::contradicted(problem, current)
    {
        if !problem.knowledge(current).is_some_and(|known| known.suffices) {
            // The poses do not determine the parameters: no outlier is the cause.
            break;
        }
        if !bad.spared {
            let poses = problem.poses;
            let clipped = || input::clipped_axis(poses).map(Refusal::saturated);
            let refusal = input::stuck_axis(poses).map(Refusal::stuck).or_else(clipped);
            return Err(refusal.unwrap_or_else(|| bad.refusal()));
        }
        problem.rejected.push(bad.pose);
        problem.weighting = Weighting::EQUAL;
        let without = problem.solve(&current.at);
        fit = without.and_then(|fit| weighted(problem, fit));
    }
    Ok(fit)
}

/// Weights the poses, if every one has a noise figure. `None` if the fit does not converge.
fn weighted(problem: &mut Magnitude, mut fit: Fit) -> Option<Fit> {
    if !problem.has_noise() {
        return Some(fit);
    }
    // Twice: the variance between poses is estimated with weights that depend on it.
    for _ in 0..2 {
        problem.weighting = Weighting::from_residuals(problem, &fit);
        fit = problem.solve(&fit.at)?;
    }
    Some(fit)
}

/// Weighs the priors against the variance of the residuals.
fn settled(problem: &mut Magnitude, mut fit: Fit) -> Option<Fit> {
    for _ in 0..if problem.has_priors() { PRIOR_ROUNDS } else { 0 } {
        problem.sd_mps2 = libm::sqrt(problem.variance(&fit));
        let at = problem.solve(&fit.at)?;
        fit = weighted(problem, at)?;
    }
    Some(fit)
}

impl Found<'_> {
    fn basis(&self) -> Result<Basis, Refusal> {
        let Self { problem, fit, what, .. } = self;
        let poses = problem.poses;
        let (theta, free) = (&fit.at, &problem.free);
        let model = ErrorModel::new(self.error_terms())
            .map_err(|error| Refusal::out_of_bounds(error, "an accelerometer"))?;
        let too_few = || too_few_poses(problem.independent().0, *what);
        let shared = problem.shared(fit).ok_or_else(too_few)?;
        let kept = Residuals::of(problem.kept().map(|k| (k, fit.rows.residual[k])));
        if kept.rms() > SUSPICIOUS_RMS_MPS2
            && let Some(axis) = input::clipped_axis(poses)
        {
            return Err(Refusal::saturated(axis));
        }
        let most_rms = MOST_RMS_MPS2[usize::from(self.terms != Terms::NONE)];
        if kept.rms() > most_rms {
            return Err(poor_fit(&kept));
        }
        let mut covariance = Covariance::ZERO;
        covariance.add_fitted(free, |r, c| shared.variance * shared.spread[(r, c)]);
        covariance.add_gravity(theta, self.gravity);
        Ok(Basis { model, covariance, rms_mps2: kept.rms(), shared })
    }

    fn error_terms(&self) -> ErrorTerms {
        let theta = &self.fit.at;
        ErrorTerms {
            bias_mps2: terms::bias(theta),
            matrix: terms::matrix(theta),
            temperature: TemperatureTerms {
                reference_c: self.problem.conditions.reference_c,
                bias_mps2_per_k: terms::triple(theta, 15),
                scale_per_k: terms::triple(theta, 18),
                ..TemperatureTerms::default()
            },
            nonlinearity: terms::triple(theta, 21),
        }
    }

    /// Standard deviation of |f| − g in the worst orientation, relative to that of the residuals.
    fn amplification(&self, spread: &DMatrix<f64>) -> f64 {
        let Self { problem, fit, knowledge, .. } = self;
        // Observability is of equal weights without repetitions.
        if problem.weighting.is_equal() && *spread == fit.inverse {
            return knowledge.amplification;
        }
        problem.worst(&fit.at, spread).map_or(f64::INFINITY, |(amplification, _)| amplification)
    }

    /// The estimate, judged by leaving poses out.
    pub fn estimate(&self) -> Result<Estimate, Refusal> {
        let Basis { model, covariance, rms_mps2, shared } = self.basis()?;
        let Self { problem, fit, what, .. } = self;
        let (poses, free) = (problem.poses, &problem.free);
        let theta: &Theta = &fit.at;
        let all = Residuals::of((0..poses.len()).map(|k| (k, fit.rows.residual[k])));
        let left_out = problem.left_out(fit, true);
        // By orientation: a repeated orientation does not confirm the model elsewhere.
        let again = problem.independent().1;
        let by_orientation = again.then(|| problem.left_out(fit, false));
        // A rejected pose says nothing of the fit: it would hide how well the others are predicted.
        let of_kept = |residuals: &[f64]| Residuals::of(problem.kept().map(|k| (k, residuals[k])));
        let kept_left_out = of_kept(by_orientation.as_ref().unwrap_or(&left_out));
        let sd = libm::sqrt(shared.variance);
        let sd_of = |i: usize| sd * libm::sqrt(shared.spread[(i, i)]);
        let mut term_sd = [[0.0; 3]; Term::ALL.len()];
        for (i, index) in free.iter().enumerate() {
            if let Some(term) = terms::term(*index) {
                term_sd[term as usize][index % 3] = sd_of(i);
            }
        }
        let most = (MOST_LEFT_OUT * sd).max(GOOD_LEFT_OUT_MPS2);
        let predicted = kept_left_out.rms();
        // With priors, the intervals hold what a single pose determines.
        if !what.priors && (predicted > most || predicted.is_nan()) {
            return Err(poor_prediction(rms_mps2, &kept_left_out));
        }
        let is_assumed = |i: &usize| {
            let prior = problem.prior_sd[*i];
            prior.is_some_and(|prior| sd_of(*i) > ASSUMED * prior)
        };
        let mut prior_shares = [0.0; Parameter::COUNT];
        for (index, share) in free.iter().zip(problem.prior_shares(fit)) {
            if let Some(of_parameter) = prior_shares.get_mut(*index) {
                *of_parameter = share;
            }
        }
        let assumed = (0..free.len()).filter(is_assumed).filter_map(|i| terms::parameter(free[i]));
        Ok(Estimate {
            model,
            method: CalibrationMethod::MultiPosition,
            sides: None,
            terms: self.terms,
            fitted: Parameters::OF_GRAVITY,
            assumed: assumed.collect(),
            covariance,
            term_sd,
            gravity: self.gravity,
            poses: problem.count(),
            orientations: problem.orientations(),
            dof: (problem.count() as f64 - problem.determined(fit)).max(0.0) as usize,
            interval_dof: Some(shared.dof),
            prior_shares,
            rms_mps2: all.rms(),
            fitted_rms_mps2: rms_mps2,
            max_mps2: all.largest,
            worst_pose: all.worst,
            loo_rms_mps2: Some(of_kept(&left_out).rms()),
            loo_orientation_rms_mps2: by_orientation.map(|left| of_kept(&left).rms()),
            pose_sd_mps2: problem.weighting.common_sd().unwrap_or(sd),
            rejected: problem.rejected.clone(),
            cofactors: self.knowledge.cofactors.clone(),
            worst_sd_mps2: sd * self.amplification(&shared.spread),
            temperature_c: pose::mean_temperature(poses.iter()),
            temperature_range_c: range(poses, |pose| pose.temperature_c),
            drift: self.terms.contains(Term::Drift).then(|| Drift {
                change_mps2: terms::triple(theta, 12),
                end_s: problem.conditions.end_s,
                span_s: 1.0 / problem.conditions.per_span,
            }),
        })
    }
}

fn poor_fit(residuals: &Residuals) -> Refusal {
    let (rms, index) = (residuals.rms(), residuals.worst);
    let text = format!(
        "The residuals are {:.0} mm/s² rms, the largest in pose {index} (from 0). Leave that pose out, and check that the \
         sensor was at rest and not saturated.",
        rms * 1e3
    );
    Refusal::new(Reason::PoorFit { rms, index }, text)
}

fn poor_prediction(rms_mps2: f64, left_out: &Residuals) -> Refusal {
    let (predicted, index) = (left_out.rms(), left_out.worst);
    let error = if predicted.is_finite() {
        format!("the leave-one-out error is {:.2} mm/s² rms", predicted * 1e3)
    } else {
        "the others do not determine the model".into()
    };
    let text = format!(
        "Pose {index} (from 0) dominates the fit: {error}, the residuals are {:.2}. Add poses in other orientations.",
        rms_mps2 * 1e3
    );
    Refusal::new(Reason::PoorPrediction { index }, text)
}

/// The refusal of `have` independent poses.
pub(crate) fn too_few_poses(have: usize, what: MultiPosition) -> Refusal {
    let need = what.fewest_poses();
    let text = match have {
        0 => format!(
            "No static pose was found. Hold the sensor still for two seconds in each of {need} orientations or more."
        ),
        _ => format!(
            "{have} static pose{}, {need} or more are needed. Add poses in other orientations.",
            if have == 1 { "" } else { "s" },
        ),
    };
    Refusal::new(Reason::TooFew { have, need }, text)
}
