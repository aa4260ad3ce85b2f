//! Calibration of a magnetometer: hard and soft iron, and its rotation to the calibrated accelerometer beside it.

use std::fmt;

use super::{Calibration, parameter_id};
use serde::Serialize;
use wimu_calib::{Guide, MagneticEstimate, MagneticPose, Orientation, Pose, Reason, magnetometer};
use wimu_model::{MagneticFieldNt, MagnetometerModel, MagnetometerTerms, ParameterSet};

use super::magnitude;
use super::report::NextPose;
use crate::chart::{Chart, Series};
use crate::digits::significant;
use crate::document::Document;
use crate::problem::Outcome;
use crate::recording::{RateSource, Samples};
use crate::{Code, Problem, Result};

/// The report of `wimu calibrate --method magnetometer`, and a file that `wimu device params push` reads.
#[derive(Clone, Debug, Default, Serialize)]
pub struct MagnetometerReport {
    /// Status and findings.
    #[serde(skip)]
    pub outcome: Outcome,
    /// The data.
    pub source: String,
    /// `magnetometer`.
    pub sensor: &'static str,
    /// Rests found, with and without a magnetic field.
    pub rests: usize,
    /// Those with a magnetic field.
    pub poses: Vec<FieldPose>,
    /// Poses left out of the fit because the field was disturbed, by index from 0.
    pub rejected_poses: Vec<usize>,
    /// Recommended orientations, the most useful first, each with another side to the north.
    pub next_poses: Vec<NextPose>,
    /// How many more orientations are worthwhile.
    pub poses_worth_adding: usize,
    /// Hard and soft iron with their standard deviations, residuals, condition and rotation.
    pub magnetometer: Option<MagnetometerTerms>,
    /// Standard deviation of the rotation's error about the accelerometer's axes, degrees.
    pub rotation_sd_deg: Option<[f64; 3]>,
    /// Half widths of the 95 % intervals.
    pub half_width_95: Option<MagneticHalfWidths>,
    /// Angle of the field below the horizontal, degrees.
    pub dip_deg: Option<f64>,
    /// The accelerometer's set with the magnetometer.
    pub parameters: Option<ParameterSet>,
    /// Its id.
    pub parameter_id: Option<String>,
}

/// Half widths of 95 % intervals, by Student's t.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct MagneticHalfWidths {
    /// Of the hard iron, µT.
    pub hard_iron_ut: [f64; 3],
    /// Of the soft iron, xx yy zz xy xz yz.
    pub soft_iron: [f64; 6],
    /// Of the rotation's error about the accelerometer's axes, degrees.
    pub rotation_deg: Option<[f64; 3]>,
}

/// The magnetic field at one rest.
#[derive(Clone, Debug, Serialize)]
pub struct FieldPose {
    /// Index of the rest's first sample.
    pub first_sample: u64,
    /// Number of measurements of the field in it.
    pub fields: usize,
    /// Their median per axis, raw output, µT.
    pub output_ut: [f64; 3],
    /// Magnitude of the corrected field less the mean magnitude, µT.
    pub residual_ut: Option<f64>,
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
) -> Result<MagnetometerReport> {
    check(data)?;
    let set = &calibration.parameters()?;
    let forces = data.corrected(calibration.sensor())?;
    let rests = if data.poses {
        let rest = |(index, force): (usize, &[f64; 3])| Pose {
            first_sample: index as u64,
            ..Pose::from_mean(*force)
        };
        forces.iter().enumerate().map(rest).collect()
    } else {
        data.rests(&forces)
    };
    let all_fields: Vec<Option<[f64; 3]>> = data.iter().map(|o| o.magnetic_field_nt).collect();
    let mut fitted = Vec::new();
    let mut guide = Guide::default();
    let mut poses = Vec::new();
    for rest in &rests {
        let first = rest.first_sample as usize;
        let part = all_fields.get(first..).unwrap_or(&[]);
        let part = &part[..part.len().min(rest.samples as usize)];
        let fields: Vec<[f64; 3]> = part
            .iter()
            .flatten()
            .copied()
            // Registers read before the first conversion hold zeros.
            .filter(|field| *field != [0.0; 3] && field.iter().all(|axis| axis.is_finite()))
            .collect();
        let Some(output_nt) = median(&fields) else {
            continue;
        };
        guide.take(rest.mean_mps2);
        fitted.push(MagneticPose { output_nt, up: rest.mean_mps2 });
        poses.push(FieldPose {
            first_sample: rest.first_sample,
            fields: fields.len(),
            output_ut: output_nt.map(|nt| nt / 1e3),
            residual_ut: None,
        });
    }
    let mut findings = data.findings();
    findings.extend(data.temperature_finding(set));
    let mut report = MagnetometerReport {
        source: data.name.to_owned(),
        sensor: "magnetometer",
        rests: rests.len(),
        poses,
        next_poses: advice(&guide),
        poses_worth_adding: guide.worth(|_| true),
        ..MagnetometerReport::default()
    };
    match magnetometer(&fitted, dip_rad) {
        Err(refusal) => {
            report.outcome.refuse(match refusal.reason {
                Reason::Axes => format!("{refusal}: --dip DEG"),
                _ => refusal.to_string(),
            });
            // Other refusals are not resolved by more poses.
            if !refusal.needs_poses() {
                report.next_poses.clear();
                report.poses_worth_adding = 0;
            }
        }
        Ok(found) => report.accept(&found, set, &fitted),
    }
    findings.extend(report.of_field(data, dip_rad));
    report.outcome.findings.append(&mut findings);
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

/// Below this dip the signs of the axes are not observable, degrees. Chosen.
const MIN_DIP_DEG: f64 = 5.0;
/// Largest distortion of the dip by walls and floors, degrees. Chosen.
const MAX_DISTORTION_DEG: f64 = 15.0;

/// Largest number of recommended orientations.
const MAX_ADVISED: usize = 3;

/// The most useful orientations. Any rotation that changes the direction of gravity changes that of the field too.
fn advice(guide: &Guide) -> Vec<NextPose> {
    let mut guide = guide.clone();
    let next = std::iter::from_fn(|| {
        let next: Orientation = guide.next(|_| true)?;
        guide.take(next.up());
        Some(next.into())
    });
    next.take(MAX_ADVISED).collect()
}

/// Median per axis: robust against a reading from before the rest.
fn median(fields: &[[f64; 3]]) -> Option<[f64; 3]> {
    let last = fields.len().checked_sub(1)?;
    Some([0, 1, 2].map(|axis| {
        let mut values: Vec<f64> = fields.iter().map(|field| field[axis]).collect();
        values.sort_by(f64::total_cmp);
        0.5 * (values[last / 2] + values[last.div_ceil(2)])
    }))
}

impl MagnetometerReport {
    /// Findings of the magnetic field.
    fn of_field(&self, data: &Samples<'_>, dip_rad: Option<f64>) -> Vec<Problem> {
        let (code, mut findings) = (Code::MagneticField, Vec::new());
        for &pose in &self.rejected_poses {
            let off = self.poses.get(pose).and_then(|pose| pose.residual_ut);
            findings.push(Code::PosesLeftOut.warning(format!(
                "pose {pose} (from 0) left out: field disturbed, |B| differs by {:+.2} µT",
                off.unwrap_or_default()
            )));
        }
        let few = self.poses.iter().filter(|pose| pose.fields < 2).count();
        if few > 0 && !data.poses {
            let all = self.poses.len();
            let text = format!("{few} of {all} poses have only one measurement of the field");
            findings.push(code.warning(text).remedy("hold them longer"));
        }
        let Some(dip) = self.dip_deg else {
            return findings;
        };
        findings.extend(match dip_rad.map(f64::to_degrees) {
            _ if dip.abs() < MIN_DIP_DEG => Some(code.warning(
                "the field is nearly horizontal: a negated or exchanged axis of the magnetometer cannot be detected",
            )),
            None => Some(
                code.note("the field is assumed to point down, as north of the magnetic equator")
                    .remedy("south of it give --dip, such as --dip -60, to detect a negated axis"),
            ),
            Some(place) if (dip - place).abs() > MAX_DISTORTION_DEG => {
                let text = format!("the estimated dip is {dip:+.1}°, the given one {place:+.1}°");
                Some(code.warning(text).remedy(
                    "check --dip, iron nearby, the signs of the axes, and that --with is of this sensor",
                ))
            }
            Some(_) => None,
        });
        findings
    }

    fn write_next(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        for pose in &self.next_poses {
            write!(
                out,
                "\nadd a pose with {}: {}, and another side to the north than before",
                pose.text, pose.instruction
            )?;
        }
        Ok(())
    }

    /// The report as one HTML page: the text, |B| of each pose before and after correction, and a table of the poses.
    pub fn page(&self) -> Document {
        let mut page = Document::new(format!("Magnetometer of {}", self.source));
        let (text, ut) = (self.to_string(), |value: f64| format!("{} µT", significant(value, 3)));
        page.result(text.lines().next().unwrap_or_default());
        if let Some(found) = &self.magnetometer {
            let hard_iron = magnitude(found.hard_iron_nt.map(|axis| f64::from(axis) / 1e3));
            page.key("hard iron", &ut(hard_iron))
                .key("field", &ut(f64::from(found.field_nt) / 1e3))
                .key("|B| less the mean field, rms", &ut(f64::from(found.rms_nt) / 1e3));
        }
        page.printed(&text).findings(&self.outcome.findings);
        let numbered = |value: &dyn Fn(&FieldPose) -> Option<f64>| -> Vec<(f64, f64)> {
            let values = self.poses.iter().enumerate();
            values.filter_map(|(k, pose)| Some((k as f64, value(pose)?))).collect()
        };
        let before = numbered(&|pose| Some(magnitude(pose.output_ut)));
        let after = numbered(&|pose| pose.residual_ut);
        for (title, name, points) in [
            ("|B| before correction", "before", before),
            ("|B| less the mean field after correction", "after", after),
        ] {
            if points.is_empty() {
                continue;
            }
            let series = vec![Series::dots(name, points)];
            page.chart(&Chart::new(title, "pose", "µT", series));
        }
        let rows: Vec<Vec<String>> = self
            .poses
            .iter()
            .enumerate()
            .map(|(k, pose)| {
                let [x, y, z] = pose.output_ut;
                let left_out = self.rejected_poses.contains(&k);
                vec![
                    k.to_string(),
                    format!("{x:+.2} {y:+.2} {z:+.2}"),
                    pose.fields.to_string(),
                    pose.residual_ut.map_or(String::new(), |residual| format!("{residual:+.3}")),
                    if left_out { "left out" } else { "" }.to_owned(),
                ]
            })
            .collect();
        page.table(
            "Poses",
            &["pose", "output, µT", "readings", "|B| less the mean field, µT", ""],
            &rows,
        );
        page
    }

    fn accept(&mut self, found: &MagneticEstimate, set: &ParameterSet, fitted: &[MagneticPose]) {
        let model: MagnetometerModel = found.model;
        self.rejected_poses = found.rejected.clone();
        let terms = *model.terms();
        for (pose, fitted) in self.poses.iter_mut().zip(fitted) {
            let length = magnitude(
                model.correct(MagneticFieldNt(fitted.output_nt.map(|nt| nt.round() as i32))),
            );
            pose.residual_ut = Some((length - f64::from(terms.field_nt)) / 1e3);
        }
        let with = ParameterSet { magnetometer: Some(model), ..*set };
        self.rotation_sd_deg = terms
            .to_accelerometer
            .map(|r| [0, 1, 2].map(|axis| r.covariance.sd(axis).to_degrees()));
        self.half_width_95 = Some(MagneticHalfWidths {
            hard_iron_ut: found.hard_iron_half_width_95_nt().map(|nt| nt / 1e3),
            soft_iron: found.soft_iron_half_width_95(),
            rotation_deg: found.rotation_half_width_95_rad().map(|axes| axes.map(f64::to_degrees)),
        });
        self.dip_deg = terms.to_accelerometer.map(|r| f64::from(r.dip_rad).to_degrees());
        self.magnetometer = Some(terms);
        self.parameter_id = Some(parameter_id(&with).to_string());
        self.parameters = Some(with);
    }
}

impl fmt::Display for MagnetometerReport {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (source, rests, poses) = (&self.source, self.rests, self.poses.len());
        write!(out, "{source}: {rests} rests, {poses} with a magnetic field")?;
        let Some(m) = &self.magnetometer else {
            write!(out, "\n{}", self.outcome)?;
            return self.write_next(out);
        };
        let list = |values: &[f32], digits: usize| {
            let each = values.iter().map(|value| format!("{value:+.digits$}"));
            each.collect::<Vec<_>>().join(" ")
        };
        let ut = |nt: [f32; 3]| list(&nt.map(|axis| axis / 1e3), 3);
        write!(
            out,
            "\nhard iron {} µT, 1 σ {}{}\nsoft iron xx yy zz xy xz yz {}\n     1 σ {}\n\
             field {:.2} µT, {:.3} µT rms, leave-one-out {:.3}, condition {:.1}",
            ut(m.hard_iron_nt),
            ut(m.hard_iron_sd_nt),
            self.half_width_95.map_or(String::new(), |half_width| {
                let [x, y, z] = half_width.hard_iron_ut;
                format!(", 95 % ± {x:.3} {y:.3} {z:.3}")
            }),
            list(&m.soft_iron, 5),
            list(&m.soft_iron_sd, 5),
            m.field_nt / 1e3,
            m.rms_nt / 1e3,
            m.loo_rms_nt / 1e3,
            m.condition
        )?;
        if let (Some(r), Some([x, y, z])) = (&m.to_accelerometer, self.rotation_sd_deg) {
            let [w, i, j, k] = r.rotation.quaternion();
            write!(
                out,
                "\nrotation quaternion (w x y z), magnetometer to accelerometer: {w:+.5} {i:+.5} {j:+.5} {k:+.5} ± {x:.2} {y:.2} {z:.2}°, \
                 dip {:+.2}° ({:.2}° rms over the poses)",
                r.dip_rad.to_degrees(),
                r.dip_rms_rad.to_degrees()
            )?;
        }
        match self.poses_worth_adding {
            0 => write!(out, "\nmore poses would improve it little"),
            more => {
                write!(out, "\n{more} more poses are worthwhile")?;
                self.write_next(out)
            }
        }
    }
}
