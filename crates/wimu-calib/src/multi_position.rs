//! Calibration from the magnitude of gravity alone, in unknown orientations.

use alloc::format;

use crate::fit::{fit, too_few_poses};
use crate::force::Conditions;
use crate::terms::{Term, Terms};
use crate::visits::Visits;
use crate::{Estimate, Gravity, Parameters, Pose, Reason, Refusal, input, pose};

/// Smallest temperature range for a temperature term, K: thermometers have as much noise.
const LEAST_WARMING_K: f64 = 1.0;
/// Fewest poses of a fit with priors: more than biases.
const FEWEST_WITH_PRIORS: usize = 4;

/// Options of [`multi_position`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct MultiPosition {
    /// Terms that the poses alone determine, in addition to the nine parameters.
    pub terms: Terms,
    /// Gaussian priors from typical datasheets: of scale factors and misalignments, and of drift and temperature terms,
    /// which are fitted where the poses have times and temperatures. The poses need to determine the bias only.
    pub priors: bool,
    /// Reject outliers, listed in [`Estimate::rejected`]; never more than the redundancy of the data permits.
    pub reject: bool,
}

impl MultiPosition {
    /// Number of poses that are needed, at least.
    pub fn fewest_poses(self) -> usize {
        let determined = Parameters::OF_GRAVITY.iter().count() + self.terms.parameters();
        if self.priors { FEWEST_WITH_PRIORS + self.terms.parameters() } else { determined + 1 }
    }
}

/// Estimates the error model from static poses in unknown orientations: |f| = g in each. Equations
/// (11) to (17) and (40) to (42) of docs/reference/equations.
///
/// Fitted are bias, scale factors and the three misalignments below the diagonal of A: all that gravity
/// alone determines, because a rotation of the whole sensor is not observable. `poses` are in m/s² by the
/// nominal sensitivity, sensor axes. At least ten are needed, or four with priors; twelve well distributed
/// ones give a good result. If every pose has a standard deviation, poses are weighted by their noise and
/// by the variance between poses; otherwise all have equal weight. With [`Term::Drift`] the bias of the
/// model is the bias at the last pose.
///
/// ```
/// use wimu_calib::{Gravity, MultiPosition, Orientation, Parameter, Pose, multi_position};
///
/// // Six poses of a sensor of 0.2 m/s² of bias: too few for nine parameters without priors.
/// let poses = [0, 5, 9, 14, 20, 25].map(|k| {
///     let up = Orientation::ALL[k].up();
///     Pose::from_mean(up.map(|c| 9.81 * c + 0.2))
/// });
/// let what = MultiPosition { priors: true, ..MultiPosition::default() };
/// let gravity = Gravity::new(9.81, 0.0).ok_or("on Earth")?;
/// let estimate = multi_position(&poses, gravity, what)?;
/// // What the poses do not determine is in the interval.
/// let half_width = estimate.half_width_95(Parameter::BiasX);
/// assert!((estimate.model.terms().bias_mps2[0] - 0.2).abs() < half_width);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Errors
/// [`Refusal`] when the poses do not determine the model, or lack the times or temperatures that a term needs. Its text
/// says what to do.
pub fn multi_position(
    poses: &[Pose],
    gravity: Gravity,
    what: MultiPosition,
) -> Result<Estimate, Refusal> {
    check(poses, gravity, what)?;
    if let Some(term) = what.terms.iter().find(|term| !is_shown(*term, poses)) {
        return Err(not_shown(term));
    }
    let shown = Term::ALL.into_iter().filter(|term| what.priors && is_shown(*term, poses));
    let assumed: Terms = shown.filter(|term| term.has_usual_prior()).collect();
    let visits = Visits::of(poses);
    let terms: Terms = what.terms.iter().chain(assumed.iter()).collect();
    fit(poses, &visits, gravity, what, terms, conditions(poses, terms))?.estimate()
}

fn check(poses: &[Pose], gravity: Gravity, what: MultiPosition) -> Result<(), Refusal> {
    let need = what.fewest_poses();
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

/// Whether the poses have the times or temperatures that show a term.
fn is_shown(term: Term, poses: &[Pose]) -> bool {
    let varies = |least: f64, value: fn(&Pose) -> Option<f64>| {
        let range = range(poses, value);
        range.is_some_and(|[low, high]| high > low && high - low >= least)
    };
    match term {
        Term::Drift => varies(0.0, |pose| Some(pose.time_s)),
        Term::BiasTemperature | Term::ScaleTemperature => {
            varies(LEAST_WARMING_K, |pose| pose.temperature_c)
        }
        Term::Quadratic => true,
    }
}

fn not_shown(term: Term) -> Refusal {
    let why = match term {
        Term::Drift => "the poses have no times, or all the same",
        _ => {
            "a pose has no temperature, or all have the same within 1 K: warm or cool the sensor between poses"
        }
    };
    let text = format!("the term {term} is not observable: {why}");
    Refusal::new(Reason::NotObservable, text)
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
