//! Calibration of a magnetometer: hard and soft iron, and its rotation to the calibrated accelerometer beside it.

use serde_json::{Value, json};
use wimu_calib::{
    Guide, MagneticEstimate, MagneticPose, Orientation, Pose, Reason, Refusal, magnetometer,
};
use wimu_model::{MagneticFieldNt, MagnetometerModel, ParameterSet};

use super::report::{CalibrationReport, orientation_json, orientation_text};
use super::{Calibration, magnitude};
use crate::chart::{Chart, Series};
use crate::problem::Outcome;
use crate::recording::{RateSource, Samples};
use crate::{Code, Problem, Result};

/// Below this dip the signs of the axes are not observable, degrees. Chosen.
const MIN_DIP_DEG: f64 = 5.0;
/// Largest distortion of the dip by walls and floors, degrees. Chosen.
const MAX_DISTORTION_DEG: f64 = 15.0;
/// Largest number of recommended orientations.
const MAX_ADVISED: usize = 3;

/// The magnetic field at a rest.
struct FieldPose {
    first_sample: u64,
    /// Number of measurements of the field.
    fields: usize,
    /// Median of the output, and the upward direction.
    pose: MagneticPose,
}

impl FieldPose {
    /// Magnitude of the output, µT.
    fn output_ut(&self) -> f64 {
        magnitude(self.pose.output_nt) / 1e3
    }

    /// Magnitude of the corrected field less the mean magnitude, µT.
    fn residual_ut(&self, model: &MagnetometerModel) -> f64 {
        let output = MagneticFieldNt(self.pose.output_nt.map(|nt| nt.round() as i32));
        (magnitude(model.correct(output)) - f64::from(model.terms().field_nt)) / 1e3
    }
}

/// Estimates the magnetometer beside an accelerometer that `calibration` corrects; its model replaces
/// the one in its parameters. `dip_rad` is the dip of the local field, rad, positive down; without it the field
/// is assumed to point down.
///
/// Data that do not support an answer give a report with status `refused`.
///
/// # Errors
/// `csv_missing_column`, `data_refused` without a magnetic field; those of [`Calibration::models`] and
/// [`SensorCalibration::compile`](super::SensorCalibration::compile).
pub fn calibrate_magnetometer(
    data: &Samples<'_>,
    calibration: &Calibration,
    dip_rad: Option<f64>,
) -> Result<CalibrationReport> {
    check(data)?;
    let set = calibration.models()?;
    let rests = rests(data, calibration)?;
    let poses = field_poses(data, &rests);
    let estimate = magnetometer(&Vec::from_iter(poses.iter().map(|pose| pose.pose)), dip_rad);
    let (more, next) = advice(&poses, estimate.as_ref().err());
    let mut outcome = Outcome { findings: findings(data, &set, &poses), ..Outcome::default() };
    let (mut answer, mut file) = (Vec::new(), None);
    match &estimate {
        Ok(found) => {
            outcome.findings.extend(disturbed(&poses, found));
            outcome.findings.extend(of_dip(found, dip_rad));
            let mut after = calibration.clone().of_device(data.info().device_id);
            after.sensor_mut().magnetometer = Some(found.model);
            file = Some(after);
            answer = lines(found);
            answer.push(match more {
                0 => "more poses would improve it little".to_owned(),
                more => format!("{more} more poses are worthwhile"),
            });
        }
        Err(refusal) => {
            let option = if refusal.reason == Reason::Axes { ": --dip DEG" } else { "" };
            outcome.refuse(format!("{refusal}{option}"));
        }
    }
    answer.extend(next.iter().map(|next| {
        format!("{}, and another side to the north than before", orientation_text(next))
    }));
    let mut numbers = numbers(&poses, estimate.as_ref().ok());
    numbers["source"] = json!(data.name);
    numbers["rests"] = json!(rests.len());
    numbers["next_poses"] = Value::from_iter(next.iter().map(orientation_json));
    numbers["poses_worth_adding"] = json!(more);
    let (name, all) = (data.name, poses.len());
    let head = format!("{name}: {} rests, {all} with a magnetic field", rests.len());
    let before = chart("|B| before correction", &poses, FieldPose::output_ut);
    let after = estimate.as_ref().ok().map(|found| {
        let title = "|B| less the mean field after correction";
        chart(title, &poses, |pose| pose.residual_ut(&found.model))
    });
    let title = format!("Magnetometer of {name}");
    let report = CalibrationReport::new(title, outcome, head, answer, numbers, file);
    Ok(report.draw([before].into_iter().chain(after).filter(|_| all > 0)))
}

fn check(data: &Samples<'_>) -> Result<()> {
    if data.iter().any(|o| o.magnetic_field_nt.is_some()) {
        return Ok(());
    }
    let error = match data.rate_source {
        RateSource::Device => Code::DataRefused.error(
            "the link carried no magnetic field: the board has no magnetometer, or does not send it",
            "use a board that has one, and have its link carry `environment`: see `wimu device settings set --help`",
        ),
        _ => Code::CsvMissingColumn.error(
            "the file has no magnetometer",
            "name the columns `Magnetometer X (µT)`, `Magnetometer Y (µT)` and `Magnetometer Z (µT)`",
        ),
    };
    Err(error.at(data.name))
}

/// The rests of the corrected accelerometer, or the rows of pose means.
fn rests(data: &Samples<'_>, calibration: &Calibration) -> Result<Vec<Pose>> {
    let forces = data.corrected(calibration.sensor())?;
    if !data.poses {
        return Ok(data.rests(&forces));
    }
    let rows = (0..).zip(&forces);
    let rest =
        |(first_sample, force): (u64, &[f64; 3])| Pose { first_sample, ..Pose::from_mean(*force) };
    Ok(rows.map(rest).collect())
}

/// The rests with a magnetic field.
fn field_poses(data: &Samples<'_>, rests: &[Pose]) -> Vec<FieldPose> {
    let fields: Vec<Option<[f64; 3]>> = data.iter().map(|o| o.magnetic_field_nt).collect();
    // Registers read before the first conversion hold zeros.
    let is_valid =
        |field: &[f64; 3]| *field != [0.0; 3] && field.iter().all(|axis| axis.is_finite());
    let mut poses = Vec::new();
    for rest in rests {
        let part = fields.iter().skip(rest.first_sample as usize).take(rest.samples as usize);
        let measured = Vec::from_iter(part.flatten().copied().filter(is_valid));
        let Some(output_nt) = median(&measured) else { continue };
        poses.push(FieldPose {
            first_sample: rest.first_sample,
            fields: measured.len(),
            pose: MagneticPose { output_nt, up: rest.mean_mps2 },
        });
    }
    poses
}

/// Median per axis: robust against a reading from before the rest.
fn median(fields: &[[f64; 3]]) -> Option<[f64; 3]> {
    let last = fields.len().checked_sub(1)?;
    Some([0, 1, 2].map(|axis| {
        let mut values = Vec::from_iter(fields.iter().map(|field| field[axis]));
        values.sort_by(f64::total_cmp);
        0.5 * (values[last / 2] + values[last.div_ceil(2)])
    }))
}

/// How many more poses are worthwhile, and the most useful orientations: any rotation that changes the direction of gravity
/// changes that of the field, too.
fn advice(poses: &[FieldPose], refusal: Option<&Refusal>) -> (usize, Vec<Orientation>) {
    // Other refusals are not resolved by more poses.
    if refusal.is_some_and(|refusal| !refusal.needs_poses()) {
        return (0, Vec::new());
    }
    let mut guide = Guide::default();
    poses.iter().for_each(|pose| guide.take(pose.pose.up));
    let more = guide.worth(|_| true);
    if more == 0 && refusal.is_none() {
        return (0, Vec::new());
    }
    let next = std::iter::from_fn(|| {
        let next = guide.next(|_| true)?;
        guide.take(next.up());
        Some(next)
    });
    (more, next.take(MAX_ADVISED).collect())
}

/// Findings of the data.
fn findings(data: &Samples<'_>, set: &ParameterSet, poses: &[FieldPose]) -> Vec<Problem> {
    let mut findings = data.findings();
    findings.extend(data.temperature_finding(set));
    let few = poses.iter().filter(|pose| pose.fields < 2).count();
    if few > 0 && !data.poses {
        let text = format!("{few} of {} poses have only one measurement of the field", poses.len());
        findings.push(Code::MagneticField.warning(text).remedy("hold them longer"));
    }
    findings
}

/// The poses left out of the fit.
fn disturbed(poses: &[FieldPose], found: &MagneticEstimate) -> Vec<Problem> {
    let finding = |&pose: &usize| {
        let off = poses[pose].residual_ut(&found.model);
        Code::PosesLeftOut.warning(format!(
            "pose {pose} (from 0) left out: field disturbed, |B| differs by {off:+.2} µT"
        ))
    };
    found.rejected.iter().map(finding).collect()
}

fn dip_deg(model: &MagnetometerModel) -> Option<f64> {
    model.terms().to_accelerometer.map(|r| f64::from(r.dip_rad).to_degrees())
}

/// What the dip shows, and what it cannot.
fn of_dip(found: &MagneticEstimate, given_rad: Option<f64>) -> Option<Problem> {
    let (dip, code) = (dip_deg(&found.model)?, Code::MagneticField);
    if dip.abs() < MIN_DIP_DEG {
        return Some(code.warning(
            "the field is nearly horizontal: a negated or exchanged axis of the magnetometer cannot be detected",
        ));
    }
    let Some(given) = given_rad.map(f64::to_degrees) else {
        let text = "the field is assumed to point down, as north of the magnetic equator";
        let remedy = "south of it give --dip, such as --dip -60, to detect a negated axis";
        return Some(code.note(text).remedy(remedy));
    };
    ((dip - given).abs() > MAX_DISTORTION_DEG).then(|| {
        let text = format!("the estimated dip is {dip:+.1}°, the given one {given:+.1}°");
        code.warning(text).remedy(
            "check --dip, iron nearby, the signs of the axes, and that --with is of this sensor",
        )
    })
}

/// The poses and the estimate, with the half widths of its 95 % intervals by Student's t.
fn numbers(poses: &[FieldPose], found: Option<&MagneticEstimate>) -> Value {
    let pose = |pose: &FieldPose| {
        json!({
            "first_sample": pose.first_sample,
            "fields": pose.fields,
            "output_ut": pose.pose.output_nt.map(|nt| nt / 1e3),
            "residual_ut": found.map(|found| pose.residual_ut(&found.model)),
        })
    };
    let half_widths = |found: &MagneticEstimate| {
        json!({
            "hard_iron_ut": found.hard_iron_half_width_95_nt().map(|nt| nt / 1e3),
            "soft_iron": found.soft_iron_half_width_95(),
            "rotation_deg": found.rotation_half_width_95_rad().map(|rad| rad.map(f64::to_degrees)),
        })
    };
    json!({
        "sensor": "magnetometer",
        "poses": Value::from_iter(poses.iter().map(pose)),
        "rejected_poses": found.map_or(&[][..], |found| &found.rejected),
        "magnetometer": found.map(|found| *found.model.terms()),
        "half_width_95": found.map(half_widths),
        "dip_deg": found.and_then(|found| dip_deg(&found.model)),
    })
}

/// The model with its deviations.
fn lines(found: &MagneticEstimate) -> Vec<String> {
    let m = found.model.terms();
    let list = |values: &[f32], digits: usize| {
        let each = values.iter().map(|value| format!("{value:+.digits$}"));
        each.collect::<Vec<_>>().join(" ")
    };
    let ut = |nt: [f32; 3]| list(&nt.map(|axis| axis / 1e3), 3);
    let [x, y, z] = found.hard_iron_half_width_95_nt().map(|nt| nt / 1e3);
    let (hard_iron, sd) = (ut(m.hard_iron_nt), ut(m.hard_iron_sd_nt));
    let mut lines = vec![
        format!("hard iron {hard_iron} µT, 1 σ {sd}, 95 % ± {x:.3} {y:.3} {z:.3}"),
        format!("soft iron xx yy zz xy xz yz {}", list(&m.soft_iron, 5)),
        format!("     1 σ {}", list(&m.soft_iron_sd, 5)),
        format!(
            "field {:.2} µT, {:.3} µT rms, leave-one-out {:.3}, condition {:.1}",
            m.field_nt / 1e3,
            m.rms_nt / 1e3,
            m.loo_rms_nt / 1e3,
            m.condition
        ),
    ];
    lines.extend(m.to_accelerometer.map(|r| {
        let [w, i, j, k] = r.rotation.quaternion();
        let [x, y, z] = [0, 1, 2].map(|axis| r.covariance.sd(axis).to_degrees());
        let [dip, dip_rms] = [r.dip_rad, r.dip_rms_rad].map(f32::to_degrees);
        format!(
            "rotation quaternion (w x y z), magnetometer to accelerometer: {w:+.5} {i:+.5} {j:+.5} {k:+.5} ± {x:.2} {y:.2} \
             {z:.2}°, dip {dip:+.2}° ({dip_rms:.2}° rms over the poses)"
        )
    }));
    lines
}

fn chart(title: &str, poses: &[FieldPose], value: impl Fn(&FieldPose) -> f64) -> Chart {
    let points = (0_u32..).map(f64::from).zip(poses.iter().map(value)).collect();
    Chart::new(title, "pose", "µT", vec![Series::dots("pose", points)])
}
