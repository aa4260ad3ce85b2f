//! Calibration from the magnitude of gravity alone, in unknown orientations.

use alloc::format;

use wimu_model::ModelError;

use crate::evidence::evidence;
use crate::fit::{fit, too_few_poses};
use crate::force::Conditions;
use crate::terms::{Term, Terms};
use crate::visits::Visits;
use crate::{Estimate, Gravity, Model, MultiPosition, Pose, Reason, Refusal, input, pose};

/// Smallest temperature range for a temperature term, K: thermometers have as much noise.
const LEAST_WARMING_K: f64 = 1.0;

/// Estimates the error model from static poses in unknown orientations: |f| = g in each. Equations
/// (11) to (17) and (40) of docs/reference/equations.
///
/// `poses` are in m/s² by the nominal sensitivity, sensor axes. At least one more than the model
/// has parameters is needed; twelve well distributed ones give a good result. If every pose has a
/// standard deviation, poses are weighted by their noise and by the variance between poses;
/// otherwise all have equal weight. The resulting A is lower triangular.
///
/// # Errors
/// [`Refusal`] when the poses do not determine the model. Its text says what to do.
pub fn multi_position(poses: &[Pose], gravity: Gravity, model: Model) -> Result<Estimate, Refusal> {
    multi_position_with(poses, gravity, MultiPosition { model, ..MultiPosition::default() })
}

/// [`multi_position`] with further terms, and optionally with rejection of outliers. Equations (41)
/// and (42).
///
/// With [`Term::Drift`] the bias of the model is the bias at the last pose.
///
/// # Errors
/// [`Refusal`], also when the poses lack the times or temperatures that a term needs.
pub fn multi_position_with(
    poses: &[Pose],
    gravity: Gravity,
    what: MultiPosition,
) -> Result<Estimate, Refusal> {
    let visits = Visits::of(poses);
    let estimate =
        |model| with_terms(poses, &visits, gravity, MultiPosition { model, ..what }, None);
    match estimate(what.model) {
        Ok(fitted) => Ok(fitted.alone()),
        Err(refusal) => Err(refusal.advise(what.model, |smaller| estimate(smaller).is_ok())),
    }
}

/// An estimate, with the figures that model selection needs.
pub(crate) struct Fitted {
    pub estimate: Estimate,
    /// Residual of each fitted pose under the model fitted without its orientation, m/s² rms.
    pub kept_left_out_mps2: f64,
    /// Degrees of freedom of the residuals, with correlation within orientations taken into
    /// account.
    pub dof: f64,
    /// Effective number of poses: poses in different orientations that would carry as much
    /// information.
    pub telling: f64,
    /// ln of the marginal likelihood of the poses; 0 unless requested.
    pub evidence: f64,
}

impl Fitted {
    /// The estimate when no other model was considered.
    fn alone(self) -> Estimate {
        let mut estimate = self.estimate;
        let unseen = estimate.not_observed();
        estimate.covariance.take_for_granted(unseen);
        estimate
    }
}

/// What a fit violates: the bound, and the variance of its residuals, (m/s²)².
pub(crate) type Violation = Option<(ModelError, f64)>;

/// Fits `what`; with `weigh`, computes the marginal likelihood, too, and fills in a violated bound.
pub(crate) fn with_terms(
    poses: &[Pose],
    visits: &Visits,
    gravity: Gravity,
    what: MultiPosition,
    weigh: Option<&mut Violation>,
) -> Result<Fitted, Refusal> {
    check(poses, gravity, what)?;
    check_terms(poses, what.terms)?;
    let found = fit(poses, visits, gravity, what, conditions(poses, what.terms))?;
    let weighed = weigh.is_some();
    let mut fitted = found.fitted(weigh)?;
    if weighed {
        fitted.evidence = evidence(&found.fit, &found.problem, fitted.telling);
    }
    Ok(fitted)
}

fn check(poses: &[Pose], gravity: Gravity, what: MultiPosition) -> Result<(), Refusal> {
    let need = what.parameters() + 1;
    if poses.len() < need {
        return Err(too_few_poses(poses.len(), what));
    }
    input::check(poses.iter(), gravity)?;
    let different = input::different(poses, need);
    if different < need {
        return Err(too_few_poses(different, what));
    }
    Ok(())
}

fn check_terms(poses: &[Pose], terms: Terms) -> Result<(), Refusal> {
    let varies = |least: f64, value: fn(&Pose) -> Option<f64>| {
        let range = range(poses, value);
        range.is_some_and(|[low, high]| high > low && high - low >= least)
    };
    for term in terms.iter() {
        let shown = match term {
            Term::Drift => varies(0.0, |pose| Some(pose.time_s)),
            Term::BiasTemperature | Term::ScaleTemperature => {
                varies(LEAST_WARMING_K, |pose| pose.temperature_c)
            }
            Term::Quadratic => true,
        };
        if !shown {
            return Err(Refusal::new(
                Reason::NotObservable,
                format!(
                    "the term {term} is not observable: {}",
                    match term {
                        Term::Drift => "the poses have no times, or all the same",
                        _ =>
                            "a pose has no temperature, or all have the same within 1 K: warm or cool the sensor between \
                          poses",
                    }
                ),
            ));
        }
    }
    Ok(())
}

/// Range of a value over the poses; `None` if a pose has none or it is not finite.
pub(crate) fn range(poses: &[Pose], value: impl Fn(&Pose) -> Option<f64>) -> Option<[f64; 2]> {
    let values = || poses.iter().map(&value);
    let complete = values().all(|value| value.is_some_and(f64::is_finite));
    complete.then(|| input::extremes(values().flatten()))
}

fn conditions(poses: &[Pose], terms: Terms) -> Conditions {
    let mut conditions = Conditions::none();
    if terms.contains(Term::Drift)
        && let Some([start, end]) = range(poses, |pose| Some(pose.time_s))
    {
        (conditions.end_s, conditions.per_span) = (end, 1.0 / (end - start));
    }
    if terms.moves_with_temperature()
        && let Some(mean) = pose::mean_temperature(poses.iter())
    {
        conditions.reference_c = mean;
    }
    conditions
}
