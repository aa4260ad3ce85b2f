//! `wimu device params`.

use std::path::Path;

use serde::Serialize;
use wimu_host::calibration::{self, Calibration, Difference};
use wimu_host::{Code, Result};
use wimu_model::{ParameterId, ParameterSet};

use crate::arguments::Params;
use crate::command::{Connection, connect_to_read, connect_to_write};
use crate::output::Output;

/// Parameters that a device holds.
#[derive(Serialize)]
struct Held {
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

pub fn run(action: &Params, output: &Output) -> Result<()> {
    match action {
        Params::Get { link, output: file } => {
            let (mut client, authenticated) = connect_to_read(link, output)?;
            let file = file.as_deref();
            show(&mut client, authenticated, file, Vec::new(), output)
        }
        Params::Push { link, calibration, dry_run, force } => {
            let calibration = Calibration::read(calibration)?;
            let set = calibration.parameters()?;
            let mut client = connect_to_write(link)?;
            if !force {
                calibration.check_device(client.hello().device_id)?;
            }
            if *dry_run {
                let before = client.held_parameters()?.map(|(_, set)| set);
                print_difference(before.as_ref(), &set, output);
                output.print("nothing was written");
            } else {
                push(&mut client, &set, output)?;
            }
            let not_pushed = calibration.further();
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
pub fn push(client: &mut Connection, set: &ParameterSet, output: &Output) -> Result<()> {
    let before = client.held_parameters()?.map(|(_, set)| set);
    print_difference(before.as_ref(), set, output);
    let id = client.push_verified(set)?;
    output.print(format!("pushed {id}"));
    Ok(())
}

/// Prints the terms that a push changes.
fn print_difference(before: Option<&ParameterSet>, after: &ParameterSet, output: &Output) {
    let difference = Difference::of(before, after);
    output.print(&difference.result);
    for [name, before, after] in &difference.changed {
        output.print(format!("{name:24} {before} → {after}"));
    }
    difference.notes.iter().for_each(|note| output.print(note));
}

/// Writes the parameters to a file for `device params push`.
fn save(path: &Path, parameters: Option<&ParameterSet>, device_id: u64) -> Result<()> {
    let Some(set) = parameters else {
        return Err(Code::DataRefused.error(
            "the device is uncalibrated, so there are no parameters to write",
            "calibrate with `wimu calibrate LINK --push`",
        ));
    };
    Calibration::held(set).of_device(Some(device_id)).write(path)
}

/// Prints the parameters that a device holds, and writes them to `file`.
fn show(
    client: &mut Connection,
    authenticated: Option<bool>,
    file: Option<&Path>,
    not_pushed: Vec<u8>,
    output: &Output,
) -> Result<()> {
    let held = client.held_parameters()?;
    let (id, parameters) =
        (held.map_or(ParameterId::UNCALIBRATED, |(id, _)| id), held.map(|(_, set)| set));
    // Before anything is printed: an error is the only JSON object.
    if let Some(file) = file {
        save(file, parameters.as_ref(), client.hello().device_id)?;
    }
    let in_use = applies(parameters.as_ref(), client.settings()?.range_g, output);
    match &parameters {
        None => output.print("the device is uncalibrated"),
        Some(set) => {
            output.print(format!(
                "parameters {id} for ±{} g, {:.2} LSB/g",
                set.range_g,
                set.sensitivity.lsb_per_g()
            ));
            for (name, values) in calibration::parameter_figures(set).iter().take(3) {
                output.print(format!("{name}: {}", calibration::values_text(values)));
            }
            for line in calibration::describe(set) {
                output.print(line);
            }
            if calibration::source::find(id).is_none() {
                output.print(
                    "the calibration itself is not on this computer: these are the board's integers, without uncertainty",
                );
            }
        }
    }
    output.object(&Held {
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
pub fn applies(parameters: Option<&ParameterSet>, range_g: u8, output: &Output) -> bool {
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
