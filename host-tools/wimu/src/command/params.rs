//! `wimu params`.

use std::path::Path;

use serde::Serialize;
use wimu_host::calibration::{
    self, CalibrationFile, HELD_SCHEMA, further_sensors, read_parameters,
};
use wimu_host::client::Client;
use wimu_host::transport::Transport;
use wimu_host::{ErrorCode, HostError, Result};
use wimu_link::message::ActiveParameters;
use wimu_model::{ParameterId, ParameterSet};

use crate::arguments::Params;
use crate::command::{Connection, connect_to_read, connect_to_write};
use crate::output::Output;

/// Parameters that a device holds.
#[derive(Serialize)]
struct Held {
    schema: &'static str,
    status: &'static str,
    calibrated: bool,
    parameter_id: String,
    parameters: Option<ParameterSet>,
    /// Whether they are for the device's present range.
    in_use: bool,
    /// Indices of the sensors whose calibration was not pushed.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    not_pushed: Vec<u8>,
    /// Whether the device has signed its answers; null if this computer has no key of the device.
    authenticated: Option<bool>,
}

pub fn run(action: &Params, output: Output) -> Result<()> {
    match action {
        Params::Get { link, output: file } => {
            let (mut client, authenticated) = connect_to_read(link, output)?;
            let file = file.as_deref();
            show(&mut client, authenticated, file, Vec::new(), output)
        }
        Params::Push {
            link,
            calibration,
            dry_run,
        } => {
            let set = read_parameters(calibration)?;
            let mut client = connect_to_write(link)?;
            if *dry_run {
                let before = held(&mut client)?;
                print_difference(before.as_ref(), &set, output);
                output.print("nothing was written");
            } else {
                push(&mut client, &set, output)?;
            }
            let not_pushed = further_sensors(calibration);
            if !not_pushed.is_empty() {
                output.print(format!(
                    "not pushed: the calibration of sensors {not_pushed:?}, because a board corrects its sensor 0 only"
                ));
            }
            let signed = client.signs().then_some(true);
            show(&mut client, signed, None, not_pushed, output)
        }
        Params::FactoryReset { link } => {
            let mut client = connect_to_write(link)?;
            client.factory_reset()?;
            output.print("calibration and settings of the device are erased");
            let signed = client.signs().then_some(true);
            show(&mut client, signed, None, Vec::new(), output)
        }
    }
}

/// Prints what changes, pushes a calibration, and verifies that the device holds it.
pub fn push(client: &mut Connection, set: &ParameterSet, output: Output) -> Result<()> {
    let before = held(client)?;
    print_difference(before.as_ref(), set, output);
    let unseen = calibration::not_observed(set);
    if !unseen.is_empty() {
        output.print(format!(
            "not observed, pushed with the values of a perfect sensor: {}",
            unseen.join(", ")
        ));
    }
    let id = write(client, set)?;
    output.print(format!("pushed {id}"));
    Ok(())
}

/// Pushes a calibration, and verifies that the device holds it. Returns its id.
pub fn write<T: Transport>(client: &mut Client<T>, set: &ParameterSet) -> Result<ParameterId> {
    let id = client.push_parameters(set)?;
    let found = client.parameters().map_err(|error| {
        let message = format!(
            "the device accepted {id}, but verifying it failed: {}",
            error.message()
        );
        HostError::new(error.code(), message, error.remedy()).at(client.name())
    })?;
    if found.id != id.0 {
        return Err(ErrorCode::VerifyFailed.error(
            format!(
                "the device holds parameters {:08x} instead of the pushed {id}",
                found.id
            ),
            "push again; another computer may have pushed at the same time",
        ));
    }
    Ok(id)
}

/// Prints the terms that a push changes.
fn print_difference(before: Option<&ParameterSet>, after: &ParameterSet, output: Output) {
    let Some(before) = before else {
        output.print("the device is uncalibrated");
        return;
    };
    let name = |set| wimu_link::message::parameter_id(set);
    if name(before) == name(after) {
        output.print(format!("the device already holds {}", name(after)));
        return;
    }
    output.print(format!("{} → {}", name(before), name(after)));
    let mut below_precision = Vec::new();
    for ((name, old), (_, new)) in figures(before).into_iter().zip(figures(after)) {
        let [old_text, new_text] = [&old, &new].map(|values| numbers(values));
        if old_text != new_text {
            output.print(format!("{name:24} {old_text} → {new_text}"));
        } else if old != new {
            below_precision.push(name);
        }
    }
    if !below_precision.is_empty() {
        output.print(format!(
            "differences below the printed precision: {}",
            below_precision.join("; ")
        ));
    }
    let others = [
        ("alignment differs", before.alignment != after.alignment),
        (
            "magnetometer calibration differs",
            before.magnetometer != after.magnetometer,
        ),
        ("fit statistics differ", before.quality != after.quality),
        ("sensor differs", before.sensor != after.sensor),
        (
            "gyroscope calibration differs",
            before.gyroscope != after.gyroscope,
        ),
    ];
    for (text, differs) in others {
        if differs {
            output.print(text);
        }
    }
}

/// The numbers of a parameter set, with their names and units.
fn figures(set: &ParameterSet) -> Vec<(&'static str, Vec<f64>)> {
    let terms = set.model.terms();
    let ([x, y, z], thermal) = (terms.matrix, terms.temperature);
    vec![
        ("bias, m/s²", terms.bias_mps2.to_vec()),
        ("matrix, row X", x.to_vec()),
        ("matrix, row Y", y.to_vec()),
        ("matrix, row Z", z.to_vec()),
        ("bias slope, m/s²/K", thermal.bias_mps2_per_k.to_vec()),
        ("bias curvature, m/s²/K²", thermal.bias_mps2_per_k2.to_vec()),
        ("scale slope, 1/K", thermal.scale_per_k.to_vec()),
        ("nonlinearity, s²/m", terms.nonlinearity.to_vec()),
        ("sensitivity, LSB/g", vec![set.sensitivity.lsb_per_g()]),
        ("range, ± g", vec![set.range_g.into()]),
        ("reference, °C", vec![thermal.reference_c]),
    ]
}

/// The parameters that a device holds.
pub fn held(client: &mut Connection) -> Result<Option<ParameterSet>> {
    let ActiveParameters { active, .. } = client.parameters()?;
    active
        .as_ref()
        .map(ParameterSet::try_from)
        .transpose()
        .map_err(|fault| {
            ErrorCode::VerifyFailed.error(
                format!("the device holds invalid parameters: {fault}"),
                "calibrate and push again",
            )
        })
}

/// Writes the parameters to a file for `params push`.
fn save(path: &Path, parameters: Option<&ParameterSet>) -> Result<()> {
    let Some(set) = parameters else {
        return Err(ErrorCode::DataRefused.error(
            "the device is uncalibrated, so there are no parameters to write",
            "calibrate with `wimu calibrate LINK --push`",
        ));
    };
    CalibrationFile::new(set, &calibration::sessions(None, set), "").write(path)
}

/// Prints the parameters that a device holds, and writes them to `file`.
fn show(
    client: &mut Connection,
    authenticated: Option<bool>,
    file: Option<&Path>,
    not_pushed: Vec<u8>,
    output: Output,
) -> Result<()> {
    let parameters = held(client)?;
    // Before anything is printed: an error is the only JSON object.
    if let Some(file) = file {
        save(file, parameters.as_ref())?;
    }
    let in_use = applies(parameters.as_ref(), client.settings()?.range_g, output);
    let id = parameters.map_or(ParameterId::UNCALIBRATED, |set| {
        wimu_link::message::parameter_id(&set)
    });
    match &parameters {
        None => output.print("the device is uncalibrated"),
        Some(set) => {
            let terms = set.model.terms();
            output.print(format!(
                "parameters {id} for ±{} g, {:.2} LSB/g\nbias   {} m/s²",
                set.range_g,
                set.sensitivity.lsb_per_g(),
                numbers(&terms.bias_mps2)
            ));
            for (name, row) in ["matrix", "", ""].iter().zip(terms.matrix) {
                output.print(format!("{name:6} {}", numbers(&row)));
            }
            for line in calibration::describe(set) {
                output.print(line);
            }
        }
    }
    output.object(&Held {
        schema: HELD_SCHEMA,
        status: "ok",
        calibrated: parameters.is_some(),
        parameter_id: id.to_string(),
        parameters,
        in_use,
        not_pushed,
        authenticated,
    });
    Ok(())
}

/// Whether a device set to `range_g` uses these parameters; prints a note if not.
pub fn applies(parameters: Option<&ParameterSet>, range_g: u8, output: Output) -> bool {
    match parameters {
        Some(set) if set.range_g != range_g => {
            output.print(format!(
                "not in use: the parameters are for ±{} g, the device is set to ±{range_g} g and runs uncalibrated",
                set.range_g
            ));
            false
        }
        other => other.is_some(),
    }
}

fn numbers(values: &[f64]) -> String {
    match values {
        [value] => value.to_string(),
        all => all
            .iter()
            .map(|value| format!("{value:+.5}"))
            .collect::<Vec<_>>()
            .join(" "),
    }
}
