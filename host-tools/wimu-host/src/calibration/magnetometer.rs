//! Calibration of a magnetometer: hard and soft iron, and its rotation to the calibrated accelerometer beside it.

use serde_json::{Value, json};
use wimu_calib::{Guide, MagneticEstimate, MagneticPose, Pose, Reason, magnetometer};
use wimu_model::{MagneticFieldNt, MagnetometerModel, ParameterSet};

use super::report::{CalibrationReport, NextPose};
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
/// `csv_missing_column`, `data_refused` without a magnetic field; those of [`Calibration::parameters`] and
/// [`SensorCalibration::compile`](super::SensorCalibration::compile).
pub fn calibrate_magnetometer(
    data: &Samples<'_>,
    calibration: &Calibration,
    dip_rad: Option<f64>,
) -> Result<CalibrationReport> {
    check(data)?;
    let set = calibration.parameters()?;
    let rests = rests(data, calibration)?;
    let poses = field_poses(data, &rests);
    let fitted = Vec::from_iter(poses.iter().map(|pose| pose.pose));
    let estimate = magnetometer(&fitted, dip_rad);
    let mut outcome = Outcome::default();
    outcome.findings.extend(data.findings());
    outcome.findings.extend(data.temperature_finding(&set));
    let few = poses.iter().filter(|pose| pose.fields < 2).count();
    if few > 0 && !data.poses {
        let text = format!("{few} of {} poses have only one measurement of the field", poses.len());
        outcome.findings.push(Code::MagneticField.warning(text).remedy("hold them longer"));
    }
    let mut guide = Guide::default();
    fitted.iter().for_each(|pose| guide.take(pose.up));
    let mut more = guide.worth(|_| true);
    let next = std::iter::from_fn(|| {
        let next = guide.next(|_| true)?;
        guide.take(next.up());
        Some(NextPose::from(next))
    });
    let mut next = Vec::from_iter(next.take(MAX_ADVISED));
    let (mut answer, mut file) = (Vec::new(), None);
    let model = estimate.as_ref().ok().map(|found| found.model);
    match &estimate {
        Ok(found) => {
            outcome.findings.extend(disturbed(&poses, found));
            outcome.findings.extend(of_dip(found, dip_rad));
            let after = ParameterSet { magnetometer: Some(found.model), ..set };
            file = Some(calibration.after(&after, data.name).of_device(data.info().device_id));
            answer = lines(found);
            if more > 0 {
                answer.push(format!("{more} more poses are worthwhile"));
            } else {
                answer.push("more poses would improve it little".to_owned());
                next.clear();
            }
        }
        Err(refusal) => {
            let option = if refusal.reason == Reason::Axes { ": --dip DEG" } else { "" };
            outcome.refuse(format!("{refusal}{option}"));
            // Other refusals are not resolved by more poses.
            if !refusal.needs_poses() {
                (more, next) = (0, Vec::new());
            }
        }
    }
    answer.extend(
        next.iter().map(|pose| format!("{pose}, and another side to the north than before")),
    );
    let json = json!({
        "source": data.name,
        "sensor": "magnetometer",
        "rests": rests.len(),
        "poses": Vec::from_iter(poses.iter().map(|pose| json!({
            "first_sample": pose.first_sample,
            "fields": pose.fields,
            "output_ut": pose.pose.output_nt.map(|nt| nt / 1e3),
            "residual_ut": model.map(|model| pose.residual_ut(&model)),
        }))),
        "rejected_poses": estimate.as_ref().map_or(&[][..], |found| &found.rejected),
        "next_poses": next,
        "poses_worth_adding": more,
        "magnetometer": model.map(|model| *model.terms()),
        "half_width_95": estimate.as_ref().ok().map(half_widths),
        "dip_deg": model.and_then(|model| dip_deg(&model)),
    });
    let (name, all) = (data.name, poses.len());
    let head = format!("{name}: {} rests, {all} with a magnetic field", rests.len());
    let title = format!("Magnetometer of {name}");
    let mut report = CalibrationReport::new(title, outcome, head, answer, json, file);
    if !poses.is_empty() {
        report.page.chart(&chart("|B| before correction", &poses, FieldPose::output_ut));
    }
    if let Some(model) = model {
        let title = "|B| less the mean field after correction";
        report.page.chart(&chart(title, &poses, |pose| pose.residual_ut(&model)));
    }
    Ok(report)
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

/// Half widths of the 95 % intervals, by Student's t.
fn half_widths(found: &MagneticEstimate) -> Value {
    json!({
        "hard_iron_ut": found.hard_iron_half_width_95_nt().map(|nt| nt / 1e3),
        "soft_iron": found.soft_iron_half_width_95(),
        "rotation_deg": found.rotation_half_width_95_rad().map(|axes| axes.map(f64::to_degrees)),
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
