//! Calibration of one stream against another of the same motion, as reference.

use std::fmt;

use serde::Serialize;
use wimu_calib::{
    AxisTransfer, Line, NoiseFrom, NoiseRatio, Parameter, Pose, ReferenceTransfer, Transfer,
};
use wimu_model::{
    CalibrationMethod, CalibrationQuality, ErrorTerms, ModelCovariance, ParameterSet, QualityTerms,
    Sensitivity, TermDeviations,
};

use super::input::{magnitude, median};
use super::paired::Paired;
use super::range::Range;
use super::words::no_sensitivity;
use super::{CalibrationFile, Source};
use crate::csv::AccelerationUnit;
use crate::digits::{signed_with_sd, with_sd};
use crate::plural::counted;
use crate::problem::{Outcome, without_unit};
use crate::{Code, Result};

/// An axis in a [`ReferenceReport`].
#[derive(Clone, Copy, Debug, Serialize)]
pub struct AxisReport {
    /// Mean of output less reference, m/s².
    pub offset_m_s2: f64,
    /// Its standard deviation, 1 σ, m/s².
    pub offset_sd_m_s2: f64,
    /// Mean of the reference, m/s²: where the offset holds.
    pub at_m_s2: f64,
    /// Motion of the axis, m/s² rms.
    pub motion_m_s2: f64,
    /// What is left, mm/s² rms.
    pub rms_mm_s2: f64,
    /// Whether bias and scale factor could be told apart.
    pub separated: bool,
    /// How the noise ratio was determined, where bias and scale factor were separated.
    pub noise_from: Option<NoiseSource>,
}

/// How the ratio of the noises was determined.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum NoiseSource {
    /// Given by the user.
    Given,
    /// From both streams at rest.
    Rests,
    /// From neighbouring samples, which have the motion in common but not the noise.
    Neighbours,
    /// Not determined: the standard deviations include all noise on either side.
    Bounds,
}

/// The report of `wimu calibrate --method reference`.
#[derive(Clone, Debug, Default, Serialize)]
pub struct ReferenceReport {
    /// Status and findings.
    #[serde(skip)]
    pub outcome: Outcome,
    /// The data.
    pub source: String,
    /// `reference`.
    pub method: &'static str,
    /// What was estimated on every axis.
    pub terms: &'static [&'static str],
    /// The reference.
    pub reference: String,
    /// What was compared with it.
    pub output: String,
    /// Number of pairs of samples.
    pub samples: usize,
    /// Fewest degrees of freedom of any standard deviation.
    pub dof: Option<usize>,
    /// Noise of the output over noise of the reference, as given or as estimated at rest.
    pub noise_ratio: Option<f64>,
    /// Whether it was estimated at rest.
    pub noise_ratio_seen: bool,
    /// Parameters that were not observed, by name.
    pub not_observed: Vec<String>,
    /// X, Y, Z.
    pub axes: Option<[AxisReport; 3]>,
    /// Nominal sensitivity, LSB/g; `None` for data in m/s² without a given one.
    pub sensitivity_lsb_per_g: Option<f64>,
    /// Source of the full-scale range of the parameters.
    pub range_source: Option<Source>,
    /// The error model that maps the reference to the output.
    pub model: Option<ErrorTerms>,
    /// Standard deviations, 1 σ, in the model's shape; those typical of datasheets for what was not observed.
    pub sd: Option<ErrorTerms>,
    /// Covariance of the bias, then A row by row.
    pub covariance: Option<[[f64; Parameter::COUNT]; Parameter::COUNT]>,
    /// The set for a board; `None` without a sensitivity.
    pub parameters: Option<ParameterSet>,
    /// Id of that set.
    pub parameter_id: Option<String>,
    /// The calibration file.
    #[serde(skip)]
    pub file: Option<CalibrationFile>,
}

/// Bias and scale factor of one stream against the other.
///
/// `noise_ratio` is the noise of the output over that of the reference (standard deviations); `None` estimates it at
/// rest, else from neighbouring samples. `utc_s`, s since 1970 UTC, is stored in the parameter set. Data that do not
/// support an answer give a report with status `refused`.
///
/// # Errors
/// `usage` when `noise_ratio` is not positive and finite.
pub fn compare_with_reference(
    data: &Paired,
    noise_ratio: Option<f64>,
    utc_s: Option<u64>,
) -> Result<ReferenceReport> {
    let given = |ratio: f64| {
        NoiseRatio::new(ratio, 1.0).ok_or_else(|| {
            Code::Usage.error(
                format!("a noise ratio of {ratio} is not possible"),
                "hold both still for ten seconds in the recording: that gives the noise of both",
            )
        })
    };
    let (ratio, known_from) = match noise_ratio {
        Some(ratio) => (Some(given(ratio)?), NoiseSource::Given),
        None => (noise_ratio_at([0, 1].map(|which| data.rests(which))), NoiseSource::Rests),
    };
    let mut transfer =
        ratio.map_or_else(ReferenceTransfer::of_unknown_noise, ReferenceTransfer::new);
    if data.one_sensor {
        transfer = transfer.of_one_sensor();
    }
    for [reference, output] in &data.pairs {
        transfer.push(*reference, *output);
    }
    let mut report = ReferenceReport {
        source: data.name.clone(),
        method: "reference",
        reference: data.reference.clone(),
        output: data.output.clone(),
        samples: data.pairs.len(),
        noise_ratio: ratio.map(NoiseRatio::get),
        noise_ratio_seen: ratio.is_some() && known_from == NoiseSource::Rests,
        sensitivity_lsb_per_g: data.sensitivity.map(Sensitivity::lsb_per_g),
        ..ReferenceReport::default()
    };
    let found = match transfer.result() {
        Ok(found) => found,
        Err(refusal) => {
            report.outcome.refuse(refusal.to_string());
            return Ok(report);
        }
    };
    let mut findings = Vec::from_iter(without_unit(data.without_unit, "sample", "left out"));
    report.dof = Some(dof(&found));
    report.axes = Some(found.axes.map(|axis| AxisReport {
        offset_m_s2: axis.offset_mps2,
        offset_sd_m_s2: axis.offset_sd_mps2,
        at_m_s2: axis.at_mps2,
        motion_m_s2: axis.motion_mps2,
        rms_mm_s2: axis.rms_mps2 * 1e3,
        separated: axis.line.is_some(),
        noise_from: axis.line.map(|line| match line.noise_from {
            NoiseFrom::Ratio => known_from,
            NoiseFrom::Neighbours => NoiseSource::Neighbours,
            NoiseFrom::Bounds => NoiseSource::Bounds,
        }),
    }));
    let model = match found.model() {
        Ok(model) => model,
        Err(error) => {
            report.outcome.refuse(format!(
                "the result is not possible for an accelerometer: {error}; check the units of both streams"
            ));
            return Ok(report);
        }
    };
    let names = ["X", "Y", "Z"];
    for (axis, transfer) in names.into_iter().zip(&found.axes) {
        for (other, seen) in names.into_iter().zip(transfer.cross_axis) {
            if seen != 0.0 {
                findings.push(Code::Axes.note(format!(
                    "cross-axis sensitivity of {axis} to {other} of the reference: {:+.1} % (axes not parallel); included in the model",
                    seen * 100.0
                )));
            }
        }
        let unseen = |line: &Line, other: usize| !data.one_sensor && !line.fitted[other];
        if let Some(line) = transfer.line {
            let out: Vec<_> = (0..3).filter(|&other| unseen(&line, other)).collect();
            if !out.is_empty() {
                let others: Vec<_> = out.iter().map(|&other| names[other]).collect();
                let text = format!(
                    "{} of the reference hardly moved on its own: a cross-axis sensitivity of {axis} to it of 2 % (1 σ) is \
                     included in ±",
                    others.join(" and ")
                );
                let finding = Code::Axes.warning(text);
                findings.push(finding.remedy("move it through all orientations"));
            }
        }
    }
    report.not_observed = Parameter::ALL
        .into_iter()
        .filter(|parameter| match parameter.index() {
            0..3 => false,
            of_a => {
                let line = found.axes[(of_a - 3) / 3].line;
                line.is_none_or(|line| !line.fitted[(of_a - 3) % 3])
            }
        })
        .map(|parameter| parameter.to_string())
        .collect();
    let covariance = covariance(&found);
    let sd = |index: usize| covariance[index][index].sqrt();
    let fitted = |axis: &AxisTransfer| axis.line.map_or([false; 3], |line| line.fitted);
    report.terms = if found.axes.iter().all(|axis| fitted(axis) == [true; 3]) {
        &["bias", "scale", "misalignment"]
    } else if found.axes.iter().all(|axis| axis.line.is_some()) {
        &["bias", "scale"]
    } else if found.axes.iter().any(|axis| axis.line.is_some()) {
        &["bias", "scale where it moved"]
    } else {
        &["offset"]
    };
    report.model = Some(*model.terms());
    report.sd = Some(ErrorTerms {
        bias_mps2: [sd(0), sd(1), sd(2)],
        matrix: std::array::from_fn(|row| std::array::from_fn(|col| sd(3 + 3 * row + col))),
        ..super::numbers::no_terms()
    });
    report.covariance = Some(covariance);
    let range = Range::of(data.unit, data.range_g, data.sensitivity);
    let board = data.sensitivity.zip(range);
    report.range_source = board.map(|(_, range)| range.source);
    findings.extend(board.and_then(|(sensitivity, range)| range.finding(sensitivity)));
    findings.extend(board.is_none().then(no_sensitivity));
    report.outcome.findings = findings;
    let quality = quality(&found, &covariance, utc_s);
    report.file = CalibrationFile::of_model(
        model,
        quality,
        data.sensor,
        match data.sensitivity {
            Some(_) => AccelerationUnit::Lsb,
            None => AccelerationUnit::Mps2,
        },
        data.sensitivity.map(Sensitivity::lsb_per_g),
        range.filter(|_| board.is_some()),
        &data.name,
    )
    .map(|file| file.of_device(data.device_id));
    report.parameters = board.map(|(sensitivity, range)| ParameterSet {
        model,
        quality,
        sensor: data.sensor,
        ..ParameterSet::uncalibrated(range.g, sensitivity)
    });
    report.parameter_id =
        report.parameters.as_ref().map(|set| crate::calibration::parameter_id(set).to_string());
    Ok(report)
}

/// Fewest degrees of freedom of any standard deviation.
fn dof(found: &Transfer) -> usize {
    let lines = found.axes.iter().filter_map(|axis| axis.line);
    let least = lines.flat_map(|line| line.dof).fold(f64::INFINITY, f64::min);
    found.dof.min(least as usize)
}

/// Noise of the output over noise of the reference, at rest.
fn noise_ratio_at([reference, output]: [Vec<Pose>; 2]) -> Option<NoiseRatio> {
    let sd = |rests: &[Pose]| median(rests.iter().map(|rest| magnitude(rest.sd_mps2)));
    NoiseRatio::new(sd(&output)?, sd(&reference)?)
}

fn quality(
    found: &Transfer,
    covariance: &[[f64; Parameter::COUNT]; Parameter::COUNT],
    utc_s: Option<u64>,
) -> Option<CalibrationQuality> {
    let count = |count: usize| u32::try_from(count).unwrap_or(u32::MAX);
    let squares = found.axes.iter().map(|axis| axis.rms_mps2 * axis.rms_mps2);
    CalibrationQuality::new(QualityTerms {
        method: CalibrationMethod::Reference,
        utc_s,
        temperature: None,
        poses: count(dof(found) + 1),
        dof: count(dof(found)),
        rms_mps2: squares.sum::<f64>().sqrt() as f32,
        loo_rms_mps2: None,
        condition: None,
        covariance: ModelCovariance::from_matrix(covariance).ok()?,
        other_sd: TermDeviations::default(),
    })
    .ok()
}

/// Standard deviations typical of datasheets, for what was not observed.
const USUAL_SCALE: f64 = 0.03;
const USUAL_CROSS_AXIS: f64 = 0.02;

/// Covariance in the order of [`Parameter::ALL`].
fn covariance(found: &Transfer) -> [[f64; Parameter::COUNT]; Parameter::COUNT] {
    let mut covariance = [[0.0; Parameter::COUNT]; Parameter::COUNT];
    for (axis, transfer) in found.axes.iter().enumerate() {
        // b, then the row of A.
        let row: [usize; 4] = std::array::from_fn(|i| if i == 0 { axis } else { 2 + 3 * axis + i });
        let own = 3 + 4 * axis;
        match transfer.line {
            Some(line) => {
                for (&i, row_of) in row.iter().zip(line.covariance) {
                    for (&j, value) in row.iter().zip(row_of) {
                        covariance[i][j] = value;
                    }
                }
            }
            None => {
                // The scale factor is fixed at 1: its uncertainty is in the bias.
                let (at, unseen) = (transfer.at_mps2, USUAL_SCALE * USUAL_SCALE);
                covariance[axis][axis] = transfer.offset_sd_mps2.powi(2) + at * at * unseen;
                covariance[axis][own] = -at * unseen;
                covariance[own][axis] = -at * unseen;
                covariance[own][own] = unseen;
            }
        }
        for &across in row.iter().skip(1).filter(|&&across| across != own) {
            // Not observed: one sensor over two links, or no line.
            if covariance[across][across] == 0.0 {
                covariance[across][across] = USUAL_CROSS_AXIS * USUAL_CROSS_AXIS;
            }
        }
    }
    covariance
}

impl fmt::Display for ReferenceReport {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(
            out,
            "{}: {} against {}, {} pairs of samples",
            self.source, self.output, self.reference, self.samples,
        )?;
        let (Some(axes), Some(model), Some(sd)) = (&self.axes, &self.model, &self.sd) else {
            return write!(out, "{}", self.outcome);
        };
        let noise = |report: &AxisReport| match report.noise_from {
            Some(NoiseSource::Given) => "noise ratio as given",
            Some(NoiseSource::Rests) => "noise ratio from rests",
            Some(NoiseSource::Neighbours) | None => "noise estimated from neighbouring samples",
            Some(NoiseSource::Bounds) => {
                "noise ratio unknown, ± covers all ratios: hold both still for a while"
            }
        };
        let mut noises: Vec<(&str, Vec<&str>)> = Vec::new();
        for (axis, (name, report)) in ["X", "Y", "Z"].into_iter().zip(axes).enumerate() {
            if report.separated {
                let source = noise(report);
                match noises.iter_mut().find(|(known, _)| *known == source) {
                    Some((_, names)) => names.push(name),
                    None => noises.push((source, vec![name])),
                }
                writeln!(
                    out,
                    "{name}: bias {} m/s², scale factor {}; residual {:.2} mm/s² rms",
                    signed_with_sd(model.bias_mps2[axis], sd.bias_mps2[axis]),
                    with_sd(model.matrix[axis][axis], sd.matrix[axis][axis]),
                    report.rms_mm_s2,
                )?;
            } else {
                writeln!(
                    out,
                    "{name}: offset {} m/s² at {:+.2} m/s²; bias and scale factor not separable: specific force varied by only \
                     {:.2} m/s² rms",
                    signed_with_sd(report.offset_m_s2, report.offset_sd_m_s2),
                    report.at_m_s2,
                    report.motion_m_s2
                )?;
            }
        }
        for (source, names) in &noises {
            writeln!(out, "{}: {source}", names.join(", "))?;
        }
        write!(out, "± is 1 σ with {} of freedom", counted(self.dof.unwrap_or(0), "degree"))
    }
}
