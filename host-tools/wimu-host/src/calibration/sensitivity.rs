//! Check of the nominal sensitivity, and of data that were normalised.

use wimu_calib::{Datasheet, Estimate, Gravity, Parameter, Refusal, UnitHint};

use super::input::{Poses, magnitude, median, rms, same_orientation};
use crate::{Code, Problem};

/// Departure of a scale factor from 1 that is reported: three times the tolerance of usual datasheets, 3 %.
const UNUSUAL: f64 = 0.1;
/// Departure of the magnitude at rest from gravity that is refused.
const WRONG: f64 = 0.25;
/// Relative difference of the data's sensitivity to a usual one that is taken for it.
const NEAR: f64 = 0.1;
/// Largest relative departure of magnitudes from their median that indicates normalised data, as after rounding to four
/// digits. Chosen: a sensor differs by more.
const ROUNDING: f64 = 5e-5;
/// Fewest orientations for that test.
const MIN_ORIENTATIONS: usize = 6;

/// A magnitude at rest that a wrong sensitivity explains, or one that is the same in every pose; `mps2_per_unit` is that of a
/// unit of the data.
pub(super) fn refusal(found: &Poses, gravity: Gravity, mps2_per_unit: f64) -> Option<Refusal> {
    let sizes = || found.poses.iter().map(|pose| magnitude(pose.mean_mps2));
    let mean_mps2 = median(sizes())?;
    let refused = |hint| Some(Refusal::unexpected_magnitude(mean_mps2, hint));
    let ratio = mean_mps2 / gravity.mps2();
    let apart = rms(sizes().map(|size| size / mean_mps2 - 1.0))?;
    // Beyond, it is another unit; where the magnitudes differ, it is one axis.
    if (ratio - 1.0).abs() > WRONG && (0.4..=2.1).contains(&ratio) && apart < UNUSUAL {
        return refused(UnitHint::Sensitivity);
    }
    let mut apart: Vec<usize> = Vec::new();
    for (k, pose) in found.poses.iter().enumerate() {
        if !apart.iter().any(|other| same_orientation(&found.poses[*other], pose)) {
            apart.push(k);
        }
    }
    let alike = sizes().all(|size| (size / mean_mps2 - 1.0).abs() < ROUNDING);
    // Coarse counts of an accurate sensor are equal too, but whole numbers.
    let counts = |value: &f64| value / mps2_per_unit;
    let is_whole = |value: &f64| (counts(value) - counts(value).round()).abs() < 1e-6;
    let mut values = found.poses.iter().flat_map(|pose| &pose.mean_mps2);
    if alike && !values.all(is_whole) && apart.len() >= MIN_ORIENTATIONS {
        return refused(UnitHint::Normalised);
    }
    None
}

/// What the sensitivity probably is, where that in use is wrong by the factor `ratio`.
pub(super) fn likely(
    ratio: f64,
    used_lsb_per_g: Option<f64>,
    sensor: Option<&Datasheet>,
) -> String {
    let Some(used) = used_lsb_per_g else {
        return format!("the sensitivity that converted the data is {ratio:.3} times too small");
    };
    let fitted = used * ratio;
    let shown = (10.0 * used).round() / 10.0;
    let known = Datasheet::KNOWN.iter().flat_map(|sheet| sheet.sensitivities_lsb_per_g);
    let usual: Vec<f64> = match sensor {
        Some(sheet) => sheet.sensitivities_lsb_per_g.to_vec(),
        None => (0..11).map(|k| 256.0 * f64::from(1 << k)).chain(known.copied()).collect(),
    };
    let away = |lsb_per_g: &f64| (fitted / lsb_per_g - 1.0).abs();
    let nearest = usual.into_iter().min_by(|a, b| away(a).total_cmp(&away(b)));
    match nearest.filter(|nearest| away(nearest) < NEAR && away(nearest) < away(&used)) {
        Some(nearest) => {
            format!("{nearest} LSB/g is likely instead of {shown}: --sensitivity {nearest}")
        }
        None => format!("the fit gives {fitted:.0} LSB/g instead of {shown}"),
    }
}

/// A scale factor far from 1.
pub(super) fn finding(
    estimate: &Estimate,
    used_lsb_per_g: Option<f64>,
    sensor: Option<&Datasheet>,
) -> Option<Problem> {
    let matrix = estimate.model.terms().matrix;
    let fitted = |axis: &usize| estimate.fitted.contains(Parameter::ALL[3 + 4 * axis]);
    let far: Vec<String> = (0..3)
        .filter(fitted)
        .filter(|axis| (matrix[*axis][*axis] - 1.0).abs() > UNUSUAL)
        .map(|axis| format!("{} {:.3}", ["X", "Y", "Z"][axis], matrix[axis][axis]))
        .collect();
    let mean = (matrix[0][0] + matrix[1][1] + matrix[2][2]) / 3.0;
    let remedy = match (mean - 1.0).abs() > UNUSUAL {
        true => likely(mean, used_lsb_per_g, sensor),
        false => "check these axes for damage or saturation".to_owned(),
    };
    let text = || format!("scale factors more than 10 % from 1: {}", far.join(", "));
    (!far.is_empty()).then(|| Code::Sensitivity.warning(text()).remedy(remedy))
}
