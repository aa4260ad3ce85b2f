//! Calibration of one stream against another of the same motion, as reference.

use std::fmt;

use serde::Serialize;
use wimu_calib::{AxisTransfer, NoiseFrom, Parameter, ReferenceTransfer, Transfer};
use wimu_model::{
    Alignment, CalibrationMethod, CalibrationQuality, ErrorModel, ErrorTerms, ModelCovariance,
    ParameterSet, QualityTerms, Sensitivity, TermDeviations,
};

use super::checks::no_sensitivity;
use super::file::Quality;
use super::paired::Paired;
use super::poses::{range, range_note};
use super::report::{AXES, deviations};
use super::{
    AccelerometerCalibration, Calibration, Correction, SensorCalibration, Session, Source,
    parameter_id,
};
use crate::chart::{Chart, Series};
use crate::csv::AccelerationUnit;
use crate::digits::{signed_with_sd, with_sd};
use crate::document::Document;
use crate::plural::counted;
use crate::problem::{Outcome, without_unit};
use crate::{Code, Problem};

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
    /// How the noise was determined, where bias and scale factor were separated: from `neighbours`, samples that have the
    /// motion in common but not the noise, or not: `bounds` that hold all noise.
    pub noise_from: Option<&'static str>,
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
    pub file: Option<Calibration>,
}

/// Bias and scale factor of one stream against the other.
///
/// Their noises are those of neighbouring samples. `utc_s`, s since 1970 UTC, is stored in the parameter set. Data that do not support an answer give a report with status `refused`.
pub fn compare_with_reference(data: &Paired, utc_s: Option<u64>) -> ReferenceReport {
    let mut transfer = ReferenceTransfer::new();
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
        sensitivity_lsb_per_g: data.sensitivity.map(Sensitivity::lsb_per_g),
        ..ReferenceReport::default()
    };
    let found = match transfer.result() {
        Ok(found) => found,
        Err(refusal) => {
            report.outcome.refuse(refusal.to_string());
            return report;
        }
    };
    report.dof = Some(dof(&found));
    report.axes = Some(found.axes.each_ref().map(AxisReport::new));
    match found.model() {
        Ok(model) => report.complete(data, &found, model, utc_s),
        Err(error) => report.outcome.refuse(format!(
            "the result is not possible for an accelerometer: {error}; check the units of both streams"
        )),
    }
    report
}

impl AxisReport {
    fn new(axis: &AxisTransfer) -> Self {
        Self {
            offset_m_s2: axis.offset_mps2,
            offset_sd_m_s2: axis.offset_sd_mps2,
            at_m_s2: axis.at_mps2,
            motion_m_s2: axis.motion_mps2,
            rms_mm_s2: axis.rms_mps2 * 1e3,
            separated: axis.line.is_some(),
            noise_from: axis.line.map(|line| match line.noise_from {
                NoiseFrom::Neighbours => "neighbours",
                NoiseFrom::Bounds => "bounds",
            }),
        }
    }
}

impl ReferenceReport {
    /// The numbers of the model, and what holds them.
    fn complete(&mut self, data: &Paired, found: &Transfer, model: ErrorModel, utc_s: Option<u64>) {
        let is_unobserved = |parameter: &Parameter| match parameter.index() {
            0..3 => false,
            of_a => {
                let line = found.axes[(of_a - 3) / 3].line;
                line.is_none_or(|line| !line.fitted[(of_a - 3) % 3])
            }
        };
        let unobserved = Parameter::ALL.into_iter().filter(is_unobserved);
        self.not_observed = unobserved.map(|parameter| parameter.to_string()).collect();
        self.terms = terms(found);
        let covariance = covariance(found);
        self.model = Some(*model.terms());
        self.sd = Some(deviations(|place| covariance[place][place].sqrt(), [[0.0; 3]; 2]));
        self.covariance = Some(covariance);
        let range = range(data.unit, data.range_g, data.sensitivity);
        let board = data.sensitivity.zip(range);
        let range = board.map(|(_, range)| range);
        self.range_source = range.map(|(_, source)| source);
        let problems = &mut self.outcome.findings;
        problems.extend(without_unit(data.without_unit, "sample", "left out"));
        problems.extend(of_axes(found, data.one_sensor));
        problems.extend(board.and_then(|(sensitivity, range)| range_note(range, sensitivity)));
        problems.extend(board.is_none().then(no_sensitivity));
        let quality = quality(found, &covariance, utc_s);
        let accelerometer = AccelerometerCalibration {
            unit: data.sensitivity.map_or(AccelerationUnit::Mps2, |_| AccelerationUnit::Lsb),
            range_g: range.map(|(g, _)| g),
            range_source: self.range_source,
            sensitivity_lsb_per_g: self.sensitivity_lsb_per_g,
            zero_count: None,
            model,
            quality: quality.as_ref().map(Quality::from),
            sessions: vec![Session {
                utc_s,
                file: Some(data.name.clone()),
                poses: quality.map_or(0, |quality| quality.terms().poses),
            }],
        };
        let calibration = Calibration::of(SensorCalibration::new(data.sensor, accelerometer));
        let calibration = calibration.of_device(data.device_id);
        self.parameters = calibration.parameters().ok();
        self.parameter_id = self.parameters.as_ref().map(|set| parameter_id(set).to_string());
        self.file = Some(calibration);
    }
}

/// What was estimated on every axis.
fn terms(found: &Transfer) -> &'static [&'static str] {
    let fitted = |axis: &AxisTransfer| axis.line.map_or([false; 3], |line| line.fitted);
    if found.axes.iter().all(|axis| fitted(axis) == [true; 3]) {
        return &["bias", "scale", "misalignment"];
    }
    match found.axes.iter().filter(|axis| axis.line.is_some()).count() {
        3 => &["bias", "scale"],
        0 => &["offset"],
        _ => &["bias", "scale where it moved"],
    }
}

/// Cross-axis sensitivities that were seen, and those that the motion does not show.
fn of_axes(found: &Transfer, one_sensor: bool) -> Vec<Problem> {
    let mut problems = Vec::new();
    for (axis, transfer) in AXES.into_iter().zip(&found.axes) {
        for (other, seen) in AXES.into_iter().zip(transfer.cross_axis) {
            if seen != 0.0 {
                problems.push(Code::Axes.note(format!(
                    "cross-axis sensitivity of {axis} to {other} of the reference: {:+.1} % (axes not parallel); included in \
                     the model",
                    seen * 100.0
                )));
            }
        }
        let Some(line) = transfer.line.filter(|_| !one_sensor) else { continue };
        let unseen: Vec<&str> = AXES
            .into_iter()
            .zip(line.fitted)
            .filter(|(_, seen)| !seen)
            .map(|(name, _)| name)
            .collect();
        if unseen.is_empty() {
            continue;
        }
        let text = format!(
            "{} of the reference hardly moved on its own: a cross-axis sensitivity of {axis} to it of 2 % (1 σ) is included in \
             ±",
            unseen.join(" and ")
        );
        problems.push(Code::Axes.warning(text).remedy("move it through all orientations"));
    }
    problems
}

/// Fewest degrees of freedom of any standard deviation.
fn dof(found: &Transfer) -> usize {
    let lines = found.axes.iter().filter_map(|axis| axis.line);
    let least = lines.flat_map(|line| line.dof).fold(f64::INFINITY, f64::min);
    found.dof.min(least as usize)
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
            Some("bounds") => "noise unknown, ± covers all on either side: move more slowly",
            _ => "noise estimated from neighbouring samples",
        };
        let mut noises: Vec<(&str, Vec<&str>)> = Vec::new();
        for (axis, (name, report)) in AXES.into_iter().zip(axes).enumerate() {
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

impl ReferenceReport {
    /// A page: the difference of each axis from the reference in `data`, before and after correction.
    pub fn page(&self, data: &Paired) -> Document {
        let title = format!("{} against {}", self.output, self.reference);
        let mut page = super::report::page(title, &self.outcome, &self.to_string(), 1);
        let Some(model) = self.model.and_then(|terms| ErrorModel::new(terms).ok()) else {
            return page;
        };
        let correction = Correction::of_model(model, 1.0, Alignment::IDENTITY.matrix());
        for (axis, name) in AXES.into_iter().enumerate() {
            let over_time = |of: &dyn Fn([f64; 3]) -> [f64; 3]| {
                let pairs = data.pairs.iter().enumerate();
                let point = |(k, [reference, output]): (usize, &[[f64; 3]; 2])| {
                    (k as f64 / data.rate_hz, (of(*output)[axis] - reference[axis]) * 1e3)
                };
                pairs.map(point).collect()
            };
            let series = vec![
                Series::line("before correction", over_time(&|output| output)),
                Series::line("after correction", over_time(&|raw| correction.sample(raw, None))),
            ];
            let title = format!("{name}: output less reference");
            page.chart(&Chart::new(title, "time, s", "mm/s²", series));
        }
        page
    }
}
