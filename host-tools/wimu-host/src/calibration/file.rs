//! Calibration files.

use std::path::Path;

use serde::{Deserialize, Serialize};
use wimu_model::{
    Alignment, ErrorModel, ErrorTerms, MagnetometerModel, ParameterSet, STANDARD_GRAVITY_MPS2,
};

use super::Source;
use super::range::Range;
use super::report::{CalibrationReport, HELD_SCHEMA};
use crate::OutputFile;
use crate::csv::AccelerationUnit;
use crate::error::{ErrorCode, HostError, Result};

/// Reads the parameters of a calibration file, for a board.
///
/// # Errors
/// `file_unreadable`; `bad_calibration` when it is not a calibration, was refused, has no sensitivity
/// or contains numbers that are out of bounds.
pub fn read_parameters(path: &Path) -> Result<ParameterSet> {
    #[derive(Deserialize)]
    struct File {
        schema: Option<String>,
        status: Option<String>,
        reason: Option<String>,
        parameters: Option<ParameterSet>,
        parameter_id: Option<String>,
        model: Option<ErrorTerms>,
        sensitivity_lsb_per_g: Option<f64>,
    }
    let name = path.display().to_string();
    let bad = |message: String, remedy: &str| ErrorCode::BadCalibration.error(message, remedy);
    let held = |file: &File| file.schema.as_deref() == Some(HELD_SCHEMA);
    let make = "make it with `wimu calibrate … -o CAL.json`";
    let text = std::fs::read_to_string(path).map_err(|e| HostError::file(&name, "read", &e))?;
    let file: File = serde_json::from_str(&text).map_err(|error| {
        bad(format!("this is not a calibration file: {error}"), make).at(format!(
            "{name} line {}, column {}",
            error.line(),
            error.column()
        ))
    })?;
    if file.schema.as_deref() != Some(CalibrationReport::SCHEMA) && !held(&file) {
        return Err(bad(
            format!(
                "its schema is {}, not {}",
                file.schema.as_deref().unwrap_or("missing"),
                CalibrationReport::SCHEMA
            ),
            make,
        )
        .at(name));
    }
    if file.status.as_deref() != Some("ok") {
        let reason = file
            .reason
            .unwrap_or_else(|| "no reason is given".to_owned());
        return Err(bad(
            format!("the calibration was refused: {reason}"),
            "calibrate again with other poses",
        )
        .at(name));
    }
    let has_model = !held(&file);
    let set = file.parameters.ok_or_else(|| {
        let why = match file.sensitivity_lsb_per_g {
            Some(own) => format!("{own:.1} LSB/g is outside the range of boards"),
            None => "its data were in m/s² or g".to_owned(),
        };
        bad(
            format!("it has no parameters for a board: {why}"),
            "calibrate again with --sensitivity, the nominal LSB/g of the board's range",
        )
        .at(&name)
    })?;
    // The file contains the model twice; where both differ, it is unknown which one is meant.
    let id_agrees =
        file.parameter_id.as_deref() == Some(&wimu_link::message::parameter_id(&set).to_string());
    if !id_agrees || (has_model && file.model.as_ref() != Some(set.model.terms())) {
        return Err(bad(
            "the file was edited: its model, parameters and parameter_id differ".to_owned(),
            "undo the change, or calibrate again",
        )
        .at(name));
    }
    Ok(set)
}

/// The error model in a calibration file.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StoredModel {
    /// The error model, sensor axes.
    pub model: ErrorModel,
    /// Sensitivity that converts counts into its output; `None` where its data were in m/s² or g and none was given.
    pub sensitivity_lsb_per_g: Option<f64>,
    /// Whether it was estimated from counts: then it does not apply to output in m/s², which was scaled elsewhere.
    pub of_counts: bool,
    /// Standard deviation of the specific force at 1 *g* on the worst axis, m/s², of bias, scale factor and misalignment
    /// together; 0 where the file does not contain it.
    pub bias_sd_mps2: f64,
    /// Sensor axes to body axes.
    pub alignment: Alignment,
    /// Model of the magnetometer beside it.
    pub magnetometer: Option<MagnetometerModel>,
}

/// Reads the error model of a calibration file, of any sensor.
///
/// # Errors
/// `file_unreadable`; `bad_calibration` when it is not a calibration, was refused, or contains numbers that are
/// out of bounds.
pub fn read_model(path: &Path) -> Result<StoredModel> {
    #[derive(Deserialize)]
    struct File {
        schema: Option<String>,
        status: Option<String>,
        unit: Option<String>,
        model: Option<ErrorModel>,
        sd: Option<ErrorTerms>,
        sensitivity_lsb_per_g: Option<f64>,
        parameters: Option<serde_json::Value>,
    }
    let name = path.display().to_string();
    let text = std::fs::read_to_string(path).map_err(|e| HostError::file(&name, "read", &e))?;
    let file = serde_json::from_str::<File>(&text).ok();
    let of_counts = match file.as_ref().and_then(|file| file.unit.as_deref()) {
        Some(unit) => unit == AccelerationUnit::Lsb.as_str(),
        // A board's, or a file of an earlier version.
        None => file.as_ref().is_none_or(|file| {
            let parameters = file.parameters.as_ref().is_some_and(|p| !p.is_null());
            parameters || file.sensitivity_lsb_per_g.is_some()
        }),
    };
    let bias_sd_mps2 = file.as_ref().and_then(|f| f.sd).map_or(0.0, |sd| {
        let of_axis = |axis: usize| {
            let row = sd.matrix[axis].iter().map(|s| s * STANDARD_GRAVITY_MPS2);
            row.fold(sd.bias_mps2[axis], f64::hypot)
        };
        (0..3).map(of_axis).fold(0.0, f64::max)
    });
    let plain = file.filter(|file| {
        file.schema.as_deref() == Some(CalibrationReport::SCHEMA)
            && file.status.as_deref() == Some("ok")
            && file
                .parameters
                .as_ref()
                .is_none_or(serde_json::Value::is_null)
    });
    match plain {
        Some(File {
            model: Some(model),
            sensitivity_lsb_per_g,
            ..
        }) => Ok(StoredModel {
            model,
            sensitivity_lsb_per_g,
            of_counts,
            bias_sd_mps2,
            alignment: Alignment::IDENTITY,
            magnetometer: None,
        }),
        // It contains a board's parameters, or an error.
        _ => read_parameters(path).map(|set| StoredModel {
            model: set.model,
            sensitivity_lsb_per_g: Some(set.sensitivity.lsb_per_g()),
            of_counts,
            bias_sd_mps2,
            alignment: set.alignment,
            magnetometer: set.magnetometer,
        }),
    }
}

/// Remark on a calibration file whose range was assumed.
pub fn range_remark(path: &Path, set: &ParameterSet) -> Option<String> {
    let text = std::fs::read_to_string(path).ok()?;
    let file: serde_json::Value = serde_json::from_str(&text).ok()?;
    let likely = Range {
        g: set.range_g,
        source: Source::SixteenBits,
    };
    (file["range_source"] == "sixteen_bits").then(|| likely.remark(set.sensitivity))?
}

/// Writes a report as the file that [`read_parameters`] reads.
///
/// # Errors
/// `file_failed`, `file_unreadable`.
pub fn write_report(path: &Path, report: &impl Serialize) -> Result<()> {
    let json = serde_json::to_string_pretty(report).map_err(|error| {
        ErrorCode::FileFailed.error(
            format!("the report cannot be written as JSON: {error}"),
            "report this as a fault of wimu",
        )
    })?;
    OutputFile::write(path, json + "\n")
}
