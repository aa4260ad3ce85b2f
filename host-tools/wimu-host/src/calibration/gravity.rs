//! Reference gravity of a calibration.

use wimu_calib::{Covariance, Estimate, Gravity, Parameter, Parameters};
use wimu_model::ErrorTerms;

use super::{CalibrateOptions, Source};
use crate::{Code, Problem, Result};

/// Percentage of the scale factors' variance from which on gravity dominates it.
const DOMINATES_PERCENT: f64 = 50.0;

/// Gravity, and where it comes from.
pub(super) fn gravity(options: &CalibrateOptions) -> Result<(Gravity, Source)> {
    let (gravity, source, flag) = match (options.gravity_mps2, options.place) {
        (Some(_), Some(_)) => {
            return Err(Code::Usage.error(
                "gravity is given twice, by its value and by a latitude",
                "give --gravity or --latitude",
            ));
        }
        (Some(mps2), None) => (Gravity::new(mps2, 0.0), Source::Given, "--gravity"),
        (None, Some([latitude, height])) => {
            (Gravity::at(latitude, height), Source::Latitude, "--latitude")
        }
        (None, None) => return Ok((Gravity::UNKNOWN_PLACE, Source::Default)),
    };
    let gravity = gravity.map_err(|e| Code::Usage.error(e.to_string(), format!("check {flag}")))?;
    Ok((gravity, source))
}

/// That the default gravity dominates the intervals of the scale factors of an estimate.
pub(super) fn finding_of(estimate: &Estimate, source: Source) -> Option<Problem> {
    let gravity = [estimate.gravity.mps2(), estimate.gravity.sd_mps2()];
    let (model, fitted) = (estimate.model.terms(), estimate.fitted);
    finding(model, &estimate.covariance, fitted, gravity, source)
}

/// The same of a model with its covariance; `gravity` and its standard deviation in m/s².
pub(super) fn finding(
    model: &ErrorTerms,
    covariance: &Covariance,
    fitted: Parameters,
    gravity: [f64; 2],
    source: Source,
) -> Option<Problem> {
    let percent = |(axis, parameter): (usize, Parameter)| {
        let of_gravity = model.matrix[axis][axis] * gravity[1] / gravity[0];
        100.0 * (of_gravity / covariance.sd(parameter)).powi(2)
    };
    let scales = [Parameter::ScaleX, Parameter::ScaleY, Parameter::ScaleZ];
    let scales = scales.into_iter().enumerate();
    let scales = scales.filter(|(_, scale)| fitted.contains(*scale));
    let percent = scales.map(percent).reduce(f64::min)?;
    (source == Source::Default && percent > DOMINATES_PERCENT).then(|| {
        let text = format!(
            "local gravity is not known: 9.80665 ± 0.015 m/s² causes {:.0} % of the variance of the scale factors",
            percent.min(100.0)
        );
        let finding = Code::GravityAssumed.note(text);
        finding.remedy("give --latitude DEG,HEIGHT of the place, or --gravity")
    })
}
