//! Calibration of one stream against another of the same motion, as reference.

use serde_json::json;
use wimu_calib::{AxisTransfer, Covariance, NoiseFrom, Parameter, ReferenceTransfer, Transfer};
use wimu_model::{
    Alignment, CalibrationMethod, CalibrationQuality, ErrorModel, ModelCovariance, QualityTerms,
    Sensitivity, TermDeviations,
};

use super::checks::no_sensitivity;
use super::file::Quality;
use super::paired::Paired;
use super::poses::range_note;
use super::report::{AXES, CalibrationReport};
use super::{
    AccelerometerCalibration, Calibration, Correction, SensorCalibration, Session, Source,
};
use crate::chart::{Chart, Series};
use crate::csv::AccelerationUnit;
use crate::digits::{signed_with_sd, with_sd};
use crate::plural::counted;
use crate::problem::{Outcome, without_unit};
use crate::{Code, Problem};

/// Standard deviations typical of datasheets, for what was not observed.
const USUAL_SCALE: f64 = 0.03;
const USUAL_CROSS_AXIS: f64 = 0.02;

/// Bias and scale factor of one stream against the other.
///
/// Their noises are those of neighbouring samples. `utc_s`, s since 1970 UTC, is stored in the parameter set. Data that do not
/// support an answer give a report with status `refused`.
pub fn compare_with_reference(data: &Paired, utc_s: Option<u64>) -> CalibrationReport {
    let mut transfer = ReferenceTransfer::new();
    if data.one_sensor {
        transfer = transfer.of_one_sensor();
    }
    for [reference, output] in &data.pairs {
        transfer.push(*reference, *output);
    }
    let mut json = json!({
        "source": data.name,
        "method": "reference",
        "reference": data.reference,
        "output": data.output,
        "samples": data.pairs.len(),
        "sensitivity_lsb_per_g": data.sensitivity.map(Sensitivity::lsb_per_g),
    });
    let (mut outcome, mut answer, mut file) = (Outcome::default(), Vec::new(), None);
    let found = transfer.result().map_err(|refusal| refusal.to_string());
    if let Ok(found) = &found {
        json["dof"] = json!(dof(found));
        json["axes"] = Vec::from_iter(found.axes.iter().map(axis_json)).into();
    }
    let fitted = found.and_then(|found| match found.model() {
        Ok(model) => Ok((found, model)),
        Err(error) => Err(format!(
            "the result is not possible for an accelerometer: {error}; check the units of both streams"
        )),
    });
    let mut charts = Vec::new();
    match fitted {
        Ok((found, model)) => {
            let covariance = covariance(&found);
            let calibration = calibration(data, &found, model, &covariance, utc_s);
            json["not_observed"] = json!(not_observed(&found));
            json["range_source"] = json!(calibration.sensor().accelerometer.range_source);
            json["model"] = json!(model.terms());
            json["sd"] = json!(covariance.deviations(&Default::default()));
            json["covariance"] = json!(covariance.matrix());
            outcome.findings = findings(data, &found);
            answer = lines(&found, &covariance);
            charts = [0, 1, 2].map(|axis| chart(data, model, axis)).into();
            file = Some(calibration);
        }
        Err(reason) => outcome.refuse(reason),
    }
    let (output, reference) = (&data.output, &data.reference);
    let pairs = data.pairs.len();
    let head = format!("{}: {output} against {reference}, {pairs} pairs of samples", data.name);
    let title = format!("{output} against {reference}");
    CalibrationReport::new(title, outcome, head, answer, json, file).draw(charts)
}

/// Sensitivity and range of a board that takes the calibration.
fn board(data: &Paired) -> Option<(Sensitivity, (u8, Source))> {
    data.sensitivity.zip(data.range)
}

fn findings(data: &Paired, found: &Transfer) -> Vec<Problem> {
    let mut findings = Vec::from_iter(without_unit(data.without_unit, "sample", "left out"));
    findings.extend(of_axes(found, data.one_sensor));
    match board(data) {
        Some((sensitivity, range)) => findings.extend(range_note(range, sensitivity)),
        None => findings.push(no_sensitivity()),
    }
    findings
}

fn axis_json(axis: &AxisTransfer) -> serde_json::Value {
    json!({
        "offset_m_s2": axis.offset_mps2,
        "offset_sd_m_s2": axis.offset_sd_mps2,
        "at_m_s2": axis.at_mps2,
        "motion_m_s2": axis.motion_mps2,
        "rms_mm_s2": axis.rms_mps2 * 1e3,
        "separated": axis.line.is_some(),
        "noise_from": axis.line.map(|line| match line.noise_from {
            NoiseFrom::Neighbours => "neighbours",
            NoiseFrom::Bounds => "bounds",
        }),
    })
}

/// The calibration of the output, in the unit of the reference.
fn calibration(
    data: &Paired,
    found: &Transfer,
    model: ErrorModel,
    covariance: &Covariance,
    utc_s: Option<u64>,
) -> Calibration {
    let range = board(data).map(|(_, range)| range);
    let quality = quality(found, covariance, utc_s);
    let accelerometer = AccelerometerCalibration {
        unit: data.sensitivity.map_or(AccelerationUnit::Mps2, |_| AccelerationUnit::Lsb),
        range_g: range.map(|(g, _)| g),
        range_source: range.map(|(_, source)| source),
        sensitivity_lsb_per_g: data.sensitivity.map(Sensitivity::lsb_per_g),
        zero_count: None,
        model,
        quality: quality.as_ref().map(Quality::from),
        sessions: vec![Session {
            utc_s,
            file: Some(data.name.clone()),
            poses: quality.map_or(0, |quality| quality.terms().poses),
        }],
    };
    let sensor = SensorCalibration::new(data.sensor, accelerometer);
    Calibration::of(sensor).of_device(data.device_id)
}

/// The parameters of A that were not fitted, by name.
fn not_observed(found: &Transfer) -> Vec<String> {
    let is_unobserved = |parameter: &Parameter| {
        let Some(k) = parameter.index().checked_sub(3) else { return false };
        found.axes[k / 3].line.is_none_or(|line| !line.fitted[k % 3])
    };
    let unobserved = Parameter::ALL.into_iter().filter(is_unobserved);
    unobserved.map(|parameter| parameter.to_string()).collect()
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
        let Some(line) = transfer.line.filter(|line| !one_sensor && line.fitted != [true; 3])
        else {
            continue;
        };
        let unseen = AXES.into_iter().zip(line.fitted).filter(|(_, seen)| !seen);
        let text = format!(
            "{} of the reference hardly moved on its own: a cross-axis sensitivity of {axis} to it of 2 % (1 σ) is included in \
             ±",
            Vec::from_iter(unseen.map(|(name, _)| name)).join(" and ")
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
    covariance: &Covariance,
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
        covariance: ModelCovariance::from_matrix(covariance.matrix()).ok()?,
        other_sd: TermDeviations::default(),
    })
    .ok()
}

/// That of all parameters, those that were not observed included.
fn covariance(found: &Transfer) -> Covariance {
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
    Covariance::from_matrix(&covariance)
}

/// A line for each axis, those of the noise, and what ± is.
fn lines(found: &Transfer, covariance: &Covariance) -> Vec<String> {
    let axis = |(k, axis): (usize, &AxisTransfer)| {
        let name = AXES[k];
        let Some(line) = axis.line else {
            let offset = signed_with_sd(axis.offset_mps2, axis.offset_sd_mps2);
            return format!(
                "{name}: offset {offset} m/s² at {:+.2} m/s²; bias and scale factor not separable: specific force varied by \
                 only {:.2} m/s² rms",
                axis.at_mps2, axis.motion_mps2
            );
        };
        let [bias_sd, scale_sd] = [k, 3 + 4 * k].map(|place| covariance.sd(Parameter::ALL[place]));
        format!(
            "{name}: bias {} m/s², scale factor {}; residual {:.2} mm/s² rms",
            signed_with_sd(line.bias_mps2, bias_sd),
            with_sd(line.row[k], scale_sd),
            axis.rms_mps2 * 1e3,
        )
    };
    let mut lines = Vec::from_iter(found.axes.iter().enumerate().map(axis));
    for (from, text) in [
        (NoiseFrom::Neighbours, "noise estimated from neighbouring samples"),
        (NoiseFrom::Bounds, "noise unknown, ± covers all on either side: move more slowly"),
    ] {
        let is_so = |axis: &AxisTransfer| axis.line.is_some_and(|line| line.noise_from == from);
        let axes = AXES.into_iter().zip(&found.axes).filter(|(_, axis)| is_so(axis));
        let names = Vec::from_iter(axes.map(|(name, _)| name));
        if !names.is_empty() {
            lines.push(format!("{}: {text}", names.join(", ")));
        }
    }
    lines.push(format!("± is 1 σ with {} of freedom", counted(dof(found), "degree")));
    lines
}

/// The difference of an axis from the reference, before and after correction.
fn chart(data: &Paired, model: ErrorModel, axis: usize) -> Chart {
    let correction = Correction::of_model(model, 1.0, Alignment::IDENTITY.matrix());
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
    let title = format!("{}: output less reference", AXES[axis]);
    Chart::new(title, "time, s", "mm/s²", series).decimated()
}
