//! Model selection, and the uncertainty that it adds: equation (49).

use nalgebra::{SMatrix, SVector, Vector3};

use crate::fit::not_converged;
use crate::multi_position::{Fitted, with_terms};
use crate::terms::{Slot, Terms, Theta, theta_of};
use crate::visits::Visits;
use crate::{
    BeyondBounds, Estimate, Gravity, Method, Model, MultiPosition, Parameter, Pose, Reason, Refusal,
};

/// Smallest number of degrees of freedom for further terms.
const LEAST_DOF: f64 = 4.0;
/// If nine parameters fit poorly, a model with terms is accepted only with a leave-one-out error
/// below this fraction of their residual.
const OF_POOR_FIT: f64 = 0.5;
/// Penalty per parameter on n ln(leave-one-out error²).
const PER_PARAMETER: f64 = 1.0;
/// Leave-one-out error assigned to a rejected pose, relative to that of the others: rejecting poses
/// must not improve the score.
const LEFT_OUT: f64 = 4.0;
/// Difference of the Bayesian information criterion that is very strong evidence (Kass and Raftery,
/// 1995).
const STRONG: f64 = 10.0;

/// Selects the model with the smallest leave-one-out error among those the poses determine: 3, 6 or
/// 9 parameters, each with every set of terms that includes `least`. A larger model is selected
/// only if the error decreases significantly. Equation (49).
///
/// The standard deviations include the uncertainty of the selection: the differences to other
/// models that predict nearly as well.
///
/// ```
/// use wimu_calib::{Gravity, Method, Model, Orientation, Pose, Terms, best_model};
///
/// // Ten poses of a sensor of 0.2 m/s² of bias: too few to judge nine parameters by.
/// let poses = [0, 3, 6, 9, 12, 14, 17, 20, 23, 25].map(|k| {
///     let up = Orientation::ALL[k].up();
///     let rough = 0.002 * f64::sin(2.3 * k as f64);
///     Pose::from_mean(up.map(|c| 9.81 * c + 0.2 + rough))
/// });
/// let best = best_model(&poses, Gravity::new(9.81, 0.0)?, Terms::NONE, true)?;
/// assert!(matches!(best.method, Method::MultiPosition(Model::Bias3)));
/// // What smaller models leave out is in the interval.
/// let half_width = best.half_width_95(wimu_calib::Parameter::BiasX);
/// assert!((best.model.terms().bias_mps2[0] - 0.2).abs() < half_width);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Errors
/// The refusal of the nine-parameter model with the terms of `least`, if no model is supported.
pub fn best_model(
    poses: &[Pose],
    gravity: Gravity,
    least: Terms,
    reject: bool,
) -> Result<Estimate, Refusal> {
    let visits = Visits::of(poses);
    let mut best: Option<(Fitted, f64)> = None;
    // Refusal of the nine-parameter model without further terms.
    let mut nine: Option<Refusal> = None;
    let mut average = Average::new();
    let mut nine_known = false;
    let mut violated: Option<(BeyondBounds, f64)> = None;
    for terms in Terms::every().filter(|terms| terms.include(least)) {
        // An unobserved scale factor would be mistaken for drift or nonlinearity.
        if terms != least && !nine_known {
            break;
        }
        for model in Model::ALL {
            let what = MultiPosition { model, terms, reject };
            let mut violation = None;
            let fitted = match with_terms(poses, &visits, gravity, what, Some(&mut violation)) {
                Ok(fitted) => fitted,
                Err(refusal) => {
                    if let Some((error, variance)) = violation {
                        let score = information(poses.len(), variance, what.parameters());
                        if violated.is_none_or(|(_, least)| score < least) {
                            let model = BeyondBounds { model, terms, error };
                            violated = Some((model, score));
                        }
                    }
                    if model == Model::Full9 && terms == least {
                        // A poor fit of observable parameters may need a further term.
                        nine_known = poor_fit(&refusal).is_some();
                        nine = Some(refusal);
                    }
                    continue;
                }
            };
            nine_known |= model == Model::Full9;
            if terms != least
                && let Some(rms_mps2) = nine.as_ref().and_then(poor_fit)
                && fitted.kept_left_out_mps2 > OF_POOR_FIT * rms_mps2
            {
                continue;
            }
            average.add(&fitted);
            if terms != least && fitted.dof < LEAST_DOF {
                continue;
            }
            let badness = badness(&fitted, terms);
            if best.as_ref().is_none_or(|(_, least)| badness < *least) {
                best = Some((fitted, badness));
            }
        }
    }
    // A smaller model cannot repair a poor fit of nine observable parameters.
    if let Some(refusal) = nine.as_ref().filter(|refusal| is_final(refusal))
        && best.as_ref().is_some_and(|(best, _)| {
            best.estimate.method != Method::MultiPosition(Model::Full9)
                && best.estimate.terms == least
        })
    {
        return Err(refusal.clone());
    }
    let Some((mut best, _)) = best else {
        return Err(nine.unwrap_or_else(not_converged));
    };
    average.widen(&mut best, nine_known);
    let mut estimate = best.estimate;
    estimate.beyond_bounds = violated.and_then(|(model, score)| {
        let parameters = estimate.poses - estimate.dof;
        let rms = estimate.fitted_rms_mps2;
        let variance = rms * rms * estimate.poses as f64 / estimate.dof as f64;
        let own = information(poses.len(), variance, parameters);
        (score + STRONG < own).then_some(model)
    });
    Ok(estimate)
}

/// Residual of a converged fit that is too poor, m/s² rms.
fn poor_fit(refusal: &Refusal) -> Option<f64> {
    match refusal.reason {
        Reason::PoorFit { rms, .. } if rms.is_finite() => Some(rms),
        _ => None,
    }
}

/// Whether a refusal of nine parameters holds for smaller models, too.
fn is_final(refusal: &Refusal) -> bool {
    poor_fit(refusal).is_some()
        || matches!(
            refusal.reason,
            Reason::Contradicted { .. } | Reason::Axis { clipped: true, .. }
        )
}

/// Bayesian information criterion of a model of `parameters` with this residual variance, (m/s²)².
fn information(poses: usize, variance: f64, parameters: usize) -> f64 {
    let n = poses as f64;
    n * libm::log(variance.max(1e-12)) + parameters as f64 * libm::log(n)
}

/// Score of a model: n ln(leave-one-out error²) with a penalty for each parameter. Lower is better.
fn badness(fitted: &Fitted, terms: Terms) -> f64 {
    let rejected = fitted.estimate.rejected.len() as f64;
    let n = fitted.telling + rejected;
    let square = fitted.kept_left_out_mps2 * fitted.kept_left_out_mps2;
    let all = square * (n + (LEFT_OUT * LEFT_OUT - 1.0) * rejected) / n;
    n * libm::log(all.max(1e-24)) + PER_PARAMETER * terms.parameters() as f64
}

/// Model averaging: sums over models, weighted by marginal likelihood.
struct Average {
    /// Largest ln of the marginal likelihood so far; that model has weight 1.
    most: f64,
    weight: f64,
    /// Of 1 / the degrees of freedom: of the residuals, and of the intervals.
    per_dof: SVector<f64, 2>,
    /// Of the parameters, and of their products with the covariance added.
    first: SVector<f64, { Slot::COUNT }>,
    second: Covariances,
    /// Of the models that fit a parameter: weight, parameter, and its square with the variance added.
    fitting: SMatrix<f64, 3, { Parameter::COUNT }>,
    /// Of the squares of all parameters, each with its variance added.
    squares: SVector<f64, { Slot::COUNT }>,
}

type Covariances = SMatrix<f64, { Parameter::COUNT }, { Parameter::COUNT }>;

impl Average {
    fn new() -> Self {
        Self {
            most: f64::NEG_INFINITY,
            weight: 0.0,
            per_dof: SVector::zeros(),
            first: SVector::zeros(),
            second: SMatrix::zeros(),
            fitting: SMatrix::zeros(),
            squares: SVector::zeros(),
        }
    }

    fn add(&mut self, fitted: &Fitted) {
        let (estimate, evidence) = (&fitted.estimate, fitted.evidence);
        if evidence > self.most {
            let shrink = libm::exp(self.most - evidence);
            self.weight *= shrink;
            self.per_dof *= shrink;
            self.first *= shrink;
            self.second *= shrink;
            self.fitting *= shrink;
            self.squares *= shrink;
            self.most = evidence;
        }
        let weight = libm::exp(evidence - self.most);
        if weight.is_nan() {
            return;
        }
        let theta = all_of(estimate);
        self.weight += weight;
        self.per_dof += SVector::from(freedoms(fitted).map(|dof| weight / dof));
        for (i, slot) in Slot::ALL.into_iter().enumerate() {
            let sd = estimate.term_sd.get(slot);
            self.first[i] += weight * theta[i];
            self.squares[i] += weight * (sd * sd + theta[i] * theta[i]);
        }
        for parameter in estimate.fitted.iter() {
            let i = parameter.index();
            let variance = estimate.covariance.get(parameter, parameter);
            let own = Vector3::new(1.0, theta[i], variance + theta[i] * theta[i]);
            self.fitting.column_mut(i).axpy(weight, &own, 1.0);
        }
        self.second += Covariances::from_fn(|i, j| {
            weight * (estimate.covariance.matrix()[i][j] + theta[i] * theta[j])
        });
    }

    /// Sets the covariance of `best` to the mean square deviation of all models about it.
    fn widen(&self, best: &mut Fitted, nine_known: bool) {
        if self.weight.is_nan() || self.weight <= 0.0 {
            return;
        }
        let own = freedoms(best);
        let best = &mut best.estimate;
        let theta = all_of(best);
        for i in 0..Parameter::COUNT {
            for j in 0..Parameter::COUNT {
                let about =
                    self.second[(i, j)] - theta[i] * self.first[j] - theta[j] * self.first[i]
                        + theta[i] * theta[j] * self.weight;
                let (a, b) = (Parameter::ALL[i], Parameter::ALL[j]);
                best.covariance.set(a, b, about / self.weight);
            }
        }
        // Parameters that were not fitted: from the models that fit them, otherwise the prior.
        for parameter in best.not_observed().iter() {
            let i = parameter.index();
            let [weight, first, square] = [0, 1, 2].map(|k| self.fitting[(k, i)]);
            if weight > 1e-9 * self.weight {
                let about = square - 2.0 * theta[i] * first + theta[i] * theta[i] * weight;
                let most = best.covariance.get(parameter, parameter).max(about / weight);
                best.covariance.set(parameter, parameter, most);
            } else {
                best.covariance.take_for_granted([parameter].into_iter().collect());
            }
        }
        for slot in Slot::ALL.into_iter().skip(Parameter::COUNT) {
            let i = slot.index();
            if best.term_sd.get(slot) > 0.0 {
                let about = self.squares[i] - 2.0 * theta[i] * self.first[i]
                    + theta[i] * theta[i] * self.weight;
                // At least that of this model: models without the term contribute no variance.
                let sd = libm::sqrt((about / self.weight).max(0.0));
                best.term_sd.set(slot, sd.max(best.term_sd.get(slot)));
            }
        }
        // The parameters that smaller models leave out are estimated once nine parameters are among
        // the models.
        let which = usize::from(!nine_known);
        let mean = self.weight / self.per_dof[which];
        best.interval_dof = Some(mean.min(own[which]));
    }
}

/// Degrees of freedom of the residuals and of the confidence intervals.
fn freedoms(fitted: &Fitted) -> [f64; 2] {
    [fitted.dof, fitted.estimate.interval_dof.unwrap_or(fitted.dof)]
}

/// The model's parameters with the drift among them.
fn all_of(estimate: &Estimate) -> Theta {
    let mut theta = theta_of(&estimate.model);
    if let Some(drift) = estimate.drift {
        for (axis, change) in drift.change_mps2.into_iter().enumerate() {
            theta[Parameter::COUNT + axis] = change;
        }
    }
    theta
}
