//! Check of a stored calibration against later rests, and its update.

use serde_json::{Value, json};
use wimu_calib::{Ageing, Check, Parameter, Pose, SelfCheck};
use wimu_model::{CalibrationQuality, ModelCovariance, QualityTerms};

use super::file::Quality;
use super::poses::{Poses, rms};
use super::report::{AXES, CalibrationReport};
use super::{CalibrateOptions, Calibration, Session, parameter_id};
use crate::chart::{Band, Chart, Series};
use crate::digits::signed_with_sd;
use crate::problem::Outcome;
use crate::recording::Samples;
use crate::{Code, Problem, Result};

/// Checks a calibration with every rest in the data, at least one, in any orientations, and updates it. Its bias may have
/// drifted by [`Ageing`] since it was made. `utc_s`, s since 1970 UTC, is the time of the update.
///
/// # Errors
/// `usage` when gravity is out of bounds; `data_refused` when the calibration has no quality information; those of
/// [`SensorCalibration::compile`](super::SensorCalibration::compile).
pub fn update(
    data: &Samples<'_>,
    calibration: &Calibration,
    gravity_mps2: Option<f64>,
    utc_s: Option<u64>,
) -> Result<CalibrationReport> {
    let (gravity, _) =
        CalibrateOptions { gravity_mps2, ..CalibrateOptions::default() }.gravity()?;
    let stored = &calibration.models()?;
    let check = SelfCheck::of(stored, gravity, Ageing::default());
    let (Some(mut check), Some(quality)) = (check, &stored.quality) else {
        return Err(Code::DataRefused.error(
            "the stored calibration has no standard deviations",
            "give one that was written by `wimu calibrate … -o CAL.json`, with --with CAL.json",
        ));
    };
    let correction = calibration.sensor().compile(data.info());
    let scale = correction.map_err(|error| error.at(data.name))?.mps2_per_unit();
    let found = Poses::find(data, scale).poses;
    let rests: Vec<(&Pose, Check)> =
        found.iter().filter_map(|pose| Some((pose, check.push(pose)?))).collect();
    let mut outcome = Outcome { findings: contradicting(&rests), ..Outcome::default() };
    let (name, count, stored_id) = (data.name, found.len(), parameter_id(stored).to_string());
    let g = gravity.mps2();
    let head = format!("{name}: {count} rests against calibration {stored_id}, g = {g} m/s²");
    let mut numbers = json!({
        "source": name,
        "method": "update",
        "stored_id": stored_id,
        "gravity_m_s2": g,
        "poses": count,
        "contradictions": check.contradictions(),
        "rests": Value::from_iter(rests.iter().map(rest_json)),
    });
    let (mut answer, mut file) = (Vec::new(), None);
    match (refusal(count, &rests), check.model()) {
        (Some(reason), _) => outcome.refuse(reason),
        (None, Err(error)) => {
            outcome.refuse(format!("the update is not possible for an accelerometer: {error}"));
        }
        (None, Ok(model)) => {
            let sd = Parameter::ALL.map(|parameter| check.covariance().sd(parameter));
            let [before, now] = [&stored.model, &model].map(|model| model.terms().bias_mps2);
            let change = [0, 1, 2].map(|axis| now[axis] - before[axis]);
            numbers["bias_change_m_s2"] = json!(change);
            numbers["model"] = json!(model.terms());
            numbers["sd"] = json!(sd);
            answer.push(change_of_bias(change, &sd));
            let rms_mps2 = rms(rests.iter().map(|(_, rest)| rest.residual_mps2));
            let quality = updated(quality, &check, rms_mps2, utc_s);
            let mut after = calibration.clone().of_device(data.info().device_id);
            let own = &mut after.sensor_mut().accelerometer;
            (own.model, own.quality) = (model, quality.as_ref().map(Quality::from));
            let utc_s = quality.and_then(|quality| quality.terms().utc_s);
            let session = Session { utc_s, file: Some(name.to_owned()), poses: check.poses() };
            own.sessions.push(session);
            file = Some(after);
        }
    }
    let title = format!("Calibration {stored_id} against {name}");
    let chart = (!rests.is_empty()).then(|| chart(&rests));
    Ok(CalibrationReport::new(title, outcome, head, answer, numbers, file).draw(chart))
}

fn rest_json((pose, rest): &(&Pose, Check)) -> Value {
    json!({
        "first_sample": pose.first_sample,
        "residual_mm_s2": rest.residual_mps2 * 1e3,
        "expected_sd_mm_s2": rest.expected_sd_mps2 * 1e3,
        "holds": rest.holds,
    })
}

/// The rests that contradict the calibration.
fn contradicting(rests: &[(&Pose, Check)]) -> Vec<Problem> {
    let finding = |(k, (_, rest)): (usize, &(&Pose, Check))| {
        let [residual, sd] = [rest.residual_mps2, rest.expected_sd_mps2].map(|mps2| mps2 * 1e3);
        Code::PosesLeftOut.warning(format!(
            "rest {k} (from 0) contradicts the calibration: |f| − g {residual:+.2} mm/s², {sd:.2} expected (1 σ)"
        ))
    };
    let bad = rests.iter().enumerate().filter(|(_, (_, rest))| !rest.holds);
    bad.map(finding).collect()
}

/// Why the rests do not support an update.
fn refusal(found: usize, rests: &[(&Pose, Check)]) -> Option<String> {
    if found == 0 {
        return Some("no rest was found: hold the sensor still for two seconds or more".to_owned());
    }
    let unusable = found - rests.len();
    // One of ten may be disturbed.
    let allowed = found / 10;
    if unusable > allowed {
        return Some(format!(
            "{unusable} of {found} rests differ too much from gravity: check that it is this sensor, and the unit"
        ));
    }
    let contradicting = rests.iter().enumerate().filter(|(_, (_, rest))| !rest.holds);
    let contradicting = Vec::from_iter(contradicting);
    if contradicting.len() <= allowed {
        return None;
    }
    if let ([(k, (pose, rest))], true) = (&contradicting[..], rests.len() > 2) {
        return Some(format!(
            "rest {k} (from 0, at sample {}) is the only one of {found} that contradicts the calibration, by {:+.0} mm/s²: \
             repeat that position, and calibrate again if it still does",
            pose.first_sample,
            rest.residual_mps2 * 1e3
        ));
    }
    Some(format!(
        "the calibration is no longer valid: {} of {found} rests contradict it; calibrate again",
        contradicting.len()
    ))
}

fn change_of_bias(change: [f64; 3], sd: &[f64; Parameter::COUNT]) -> String {
    let axis = |k: usize| format!("{} {}", AXES[k], signed_with_sd(change[k] * 1e3, sd[k] * 1e3));
    let changes = [0, 1, 2].map(axis).join(", ");
    let significant = (0..3).any(|k| change[k].abs() > 2.0 * sd[k]);
    let remark =
        if significant { "; it is significant (2 σ): use the updated file (-o)" } else { "" };
    format!("the calibration is still valid; change of the bias, mm/s² (1 σ): {changes}{remark}")
}

/// The quality information of the updated model.
fn updated(
    stored: &CalibrationQuality,
    check: &SelfCheck,
    rms_mps2: Option<f64>,
    utc_s: Option<u64>,
) -> Option<CalibrationQuality> {
    let stored = stored.terms();
    let covariance = ModelCovariance::from_matrix(check.covariance().matrix());
    let terms = QualityTerms {
        utc_s: utc_s.or(stored.utc_s),
        poses: stored.poses.saturating_add(check.poses()),
        rms_mps2: rms_mps2.unwrap_or_default() as f32,
        loo_rms_mps2: None,
        covariance: covariance.unwrap_or(stored.covariance),
        ..*stored
    };
    CalibrationQuality::new(terms).ok()
}

/// |f| − g of each rest beside what the stored calibration explains.
fn chart(rests: &[(&Pose, Check)]) -> Chart {
    let numbered = || (0_u32..).map(f64::from).zip(rests.iter().map(|(_, rest)| rest));
    let residuals = numbered().map(|(k, rest)| (k, rest.residual_mps2 * 1e3)).collect();
    let expected = numbered().map(|(k, rest)| (k, rest.expected_sd_mps2 * 1e3));
    let points: Vec<_> = expected.map(|(k, sd)| (k, -sd, sd)).collect();
    let zero = points.iter().map(|(k, ..)| (*k, 0.0)).collect();
    let series = vec![Series::line("expected, ± 1 σ", zero), Series::dots("rest", residuals)];
    let title = "|f| − g of each rest under the stored calibration";
    Chart { bands: vec![Band { series: 0, points }], ..Chart::new(title, "rest", "mm/s²", series) }
}
