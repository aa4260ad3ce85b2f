//! Calibration files of schema 1, and reports, which hold a parameter set in the same form.

use serde::Deserialize;
use wimu_model::{Alignment, ErrorModel, ErrorTerms, ModelCovariance, ParameterSet};

use super::file::{NOT_FOR_A_BOARD, REMEDY, SENSITIVITY_REMEDY, StoredModel, parse};
use super::report::{CalibrationReport, HELD_SCHEMA};
use crate::csv::AccelerationUnit;
use crate::error::{ErrorCode, Result};

/// Its schemas.
pub(super) const SCHEMAS_V1: [&str; 2] = [CalibrationReport::SCHEMA, HELD_SCHEMA];

#[derive(Deserialize)]
struct File {
    schema: String,
    status: Option<String>,
    reason: Option<String>,
    parameters: Option<ParameterSet>,
    parameter_id: Option<String>,
    unit: Option<String>,
    model: Option<ErrorTerms>,
    sensitivity_lsb_per_g: Option<f64>,
}

/// The set for a board.
pub(super) fn parameters(name: &str, text: &str) -> Result<ParameterSet> {
    set(name, parse(name, text)?)
}

fn set(name: &str, file: File) -> Result<ParameterSet> {
    let bad =
        |message: String, remedy: &str| ErrorCode::BadCalibration.error(message, remedy).at(name);
    if file.status.as_deref() != Some("ok") {
        let reason = file.reason.as_deref().unwrap_or("no reason is given");
        return Err(bad(
            format!("the calibration was refused: {reason}"),
            "calibrate again with other poses",
        ));
    }
    let has_model = file.schema != HELD_SCHEMA;
    let set = file.parameters.ok_or_else(|| {
        let why = match file.sensitivity_lsb_per_g {
            Some(own) => format!("{own:.1} LSB/g is outside the range of boards"),
            None => "its data were in m/s² or g".to_owned(),
        };
        bad(format!("{NOT_FOR_A_BOARD}: {why}"), SENSITIVITY_REMEDY)
    })?;
    // The file contains the model twice; where both differ, it is unknown which one is meant.
    let id_agrees =
        file.parameter_id.as_deref() == Some(&wimu_link::message::parameter_id(&set).to_string());
    if !id_agrees || (has_model && file.model.as_ref() != Some(set.model.terms())) {
        return Err(bad(
            "the file was edited: its model, parameters and parameter_id differ".to_owned(),
            "undo the change, or calibrate again",
        ));
    }
    Ok(set)
}

/// The error model.
pub(super) fn model(name: &str, text: &str) -> Result<StoredModel> {
    let file: File = parse(name, text)?;
    // Other reports have other deviations.
    #[derive(Deserialize)]
    struct Deviations {
        sd: ErrorTerms,
    }
    let deviations = serde_json::from_str::<Deviations>(text).ok();
    let covariance = deviations.and_then(|Deviations { sd }| {
        let mut matrix = [[0.0; 12]; 12];
        let all = sd.bias_mps2.iter().chain(sd.matrix.as_flattened());
        for (place, sd) in all.enumerate() {
            matrix[place][place] = sd * sd;
        }
        ModelCovariance::from_matrix(&matrix).ok()
    });
    let of_counts = match &file.unit {
        Some(unit) => unit == AccelerationUnit::Lsb.as_str(),
        // A board's, or a file of an earlier version.
        None => file.parameters.is_some() || file.sensitivity_lsb_per_g.is_some(),
    };
    let stored = |model, sensitivity_lsb_per_g| StoredModel {
        model,
        sensitivity_lsb_per_g,
        of_counts,
        covariance,
        of_sessions: false,
        alignment: Alignment::IDENTITY,
        magnetometer: None,
        gyroscope: None,
    };
    let is_plain = file.parameters.is_none() && file.status.as_deref() == Some("ok");
    if let (true, Some(terms)) = (is_plain, file.model) {
        let model = ErrorModel::new(terms)
            .map_err(|error| ErrorCode::BadCalibration.error(error.to_string(), REMEDY).at(name))?;
        return Ok(stored(model, file.sensitivity_lsb_per_g));
    }
    set(name, file).map(|set| StoredModel {
        alignment: set.alignment,
        magnetometer: set.magnetometer,
        ..stored(set.model, Some(set.sensitivity.lsb_per_g()))
    })
}
