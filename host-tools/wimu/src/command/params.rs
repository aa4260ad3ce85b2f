//! `wimu params`.

use std::path::Path;

use serde::Serialize;
use wimu_host::calibration::{self, HELD_SCHEMA, read_parameters};
use wimu_host::client::Client;
use wimu_host::transport::Transport;
use wimu_host::{ErrorCode, HostError, Result};
use wimu_link::message::ActiveParameters;
use wimu_model::{ParameterId, ParameterSet};

use crate::arguments::Params;
use crate::command::{connect_to_read, connect_to_write};
use crate::output::Output;

/// What a device corrects with.
#[derive(Serialize)]
struct Held {
    schema: &'static str,
    status: &'static str,
    calibrated: bool,
    parameter_id: String,
    parameters: Option<ParameterSet>,
    /// Whether they are for the range that the device is set to.
    in_use: bool,
    /// Whether the device has signed this; null if this computer has no key of it.
    authenticated: Option<bool>,
}

pub fn run(action: &Params, output: Output) -> Result<()> {
    match action {
        Params::Get { link, output: file } => {
            let (mut client, authenticated) = connect_to_read(link, output)?;
            let held = show(&mut client, authenticated, output)?;
            match file {
                Some(path) => save(path, &held),
                None => Ok(()),
            }
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
                say_difference(before.as_ref(), &set, output);
                output.say("nothing was written");
            } else {
                push(&mut client, &set, output)?;
            }
            show_written(&mut client, output)
        }
        Params::FactoryReset { link } => {
            let mut client = connect_to_write(link)?;
            client.factory_reset()?;
            output.say("the device has forgotten its calibration and its settings");
            show_written(&mut client, output)
        }
    }
}

/// Says what changes, pushes a calibration, and makes sure that the device holds it.
pub fn push<T: Transport>(
    client: &mut Client<T>,
    set: &ParameterSet,
    output: Output,
) -> Result<()> {
    let before = held(client)?;
    say_difference(before.as_ref(), set, output);
    let unseen = calibration::not_observed(set);
    if !unseen.is_empty() {
        output.say(format!(
            "not observed, pushed as those of a perfect sensor: {}",
            unseen.join(", ")
        ));
    }
    let id = client.push_parameters(set)?;
    let found = client.parameters().map_err(|error| {
        let message = format!("the device has taken {id}; after that {}", error.message());
        HostError::new(error.code(), message, error.remedy()).at(client.name())
    })?;
    if found.id != id.0 {
        return Err(HostError::new(
            ErrorCode::VerifyFailed,
            format!(
                "the device holds parameters {:08x}, pushed were {id}",
                found.id
            ),
            "push again; another computer may be pushing too",
        ));
    }
    output.say(format!("pushed {id}"));
    Ok(())
}

/// What a push changes: only the terms that do.
fn say_difference(before: Option<&ParameterSet>, after: &ParameterSet, output: Output) {
    let Some(before) = before else {
        output.say("the device is uncalibrated");
        return;
    };
    let name = |set| wimu_link::message::parameter_id(set);
    if name(before) == name(after) {
        output.say(format!("the device holds {} already", name(after)));
        return;
    }
    output.say(format!("{} → {}", name(before), name(after)));
    let (old, new) = (before.model.terms(), after.model.terms());
    let mut vectors = vec![("bias, m/s²", old.bias_mps2, new.bias_mps2)];
    let rows = ["matrix, row X", "matrix, row Y", "matrix, row Z"];
    for (row, (old, new)) in rows.into_iter().zip(old.matrix.into_iter().zip(new.matrix)) {
        vectors.push((row, old, new));
    }
    let (warm, warmer) = (old.temperature, new.temperature);
    vectors.extend([
        (
            "bias slope, m/s²/K",
            warm.bias_mps2_per_k,
            warmer.bias_mps2_per_k,
        ),
        (
            "bias curvature, m/s²/K²",
            warm.bias_mps2_per_k2,
            warmer.bias_mps2_per_k2,
        ),
        ("scale slope, 1/K", warm.scale_per_k, warmer.scale_per_k),
        ("nonlinearity, s²/m", old.nonlinearity, new.nonlinearity),
    ]);
    for (name, old, new) in vectors {
        if old != new {
            output.say(format!("{name:24} {} → {}", vector(old), vector(new)));
        }
    }
    let numbers = [
        (
            "sensitivity, LSB/g",
            before.sensitivity.lsb_per_g(),
            after.sensitivity.lsb_per_g(),
        ),
        ("range, ± g", before.range_g.into(), after.range_g.into()),
        ("reference, °C", warm.reference_c, warmer.reference_c),
    ];
    for (name, old, new) in numbers {
        if old != new {
            output.say(format!("{name:24} {old} → {new}"));
        }
    }
    let others = [
        ("alignment", before.alignment != after.alignment),
        ("magnetometer", before.magnetometer != after.magnetometer),
        ("quality", before.quality != after.quality),
        ("sensor", before.sensor != after.sensor),
    ];
    for (name, changes) in others {
        if changes {
            output.say(format!("{name:24} changes"));
        }
    }
}

/// The parameters that a device holds.
pub fn held<T: Transport>(client: &mut Client<T>) -> Result<Option<ParameterSet>> {
    let ActiveParameters { active, .. } = client.parameters()?;
    active
        .as_ref()
        .map(ParameterSet::try_from)
        .transpose()
        .map_err(|fault| {
            HostError::new(
                ErrorCode::VerifyFailed,
                format!("the device holds parameters that are none: {fault}"),
                "calibrate and push again",
            )
        })
}

/// Writes what a device holds as a file that `params push` reads.
fn save(path: &Path, held: &Held) -> Result<()> {
    if !held.calibrated {
        return Err(HostError::new(
            ErrorCode::DataRefused,
            "the device is uncalibrated: there is nothing to write",
            "calibrate with `wimu calibrate LINK --push`",
        ));
    }
    calibration::write_report(path, held)
}

/// Shows what a device holds whose key, if this computer has it, has signed everything.
fn show_written<T: Transport>(client: &mut Client<T>, output: Output) -> Result<()> {
    let authenticated = client.signs().then_some(true);
    show(client, authenticated, output).map(drop)
}

fn show<T: Transport>(
    client: &mut Client<T>,
    authenticated: Option<bool>,
    output: Output,
) -> Result<Held> {
    let parameters = held(client)?;
    let in_use = applies(parameters.as_ref(), client.settings()?.range_g, output);
    let id = parameters.map_or(ParameterId::UNCALIBRATED, |set| {
        wimu_link::message::parameter_id(&set)
    });
    match &parameters {
        None => output.say("the device is uncalibrated"),
        Some(set) => {
            let terms = set.model.terms();
            output.say(format!(
                "parameters {id} for ±{} g, {:.2} LSB/g\nbias   {} m/s²",
                set.range_g,
                set.sensitivity.lsb_per_g(),
                vector(terms.bias_mps2)
            ));
            for (name, row) in ["matrix", "", ""].iter().zip(terms.matrix) {
                output.say(format!("{name:6} {}", vector(row)));
            }
            for line in calibration::describe(set) {
                output.say(line);
            }
        }
    }
    let held = Held {
        schema: HELD_SCHEMA,
        status: "ok",
        calibrated: parameters.is_some(),
        parameter_id: id.to_string(),
        parameters,
        in_use,
        authenticated,
    };
    output.object(&held);
    Ok(held)
}

/// Whether a device set to `range_g` corrects with these parameters; says so if not.
pub fn applies(parameters: Option<&ParameterSet>, range_g: u8, output: Output) -> bool {
    match parameters {
        Some(set) if set.range_g != range_g => {
            output.say(format!(
                "not in use: the parameters are for ±{} g and the device is set to ±{range_g} g; \
                 it runs uncalibrated",
                set.range_g
            ));
            false
        }
        other => other.is_some(),
    }
}

fn vector(values: [f64; 3]) -> String {
    let [x, y, z] = values;
    format!("{x:+.5} {y:+.5} {z:+.5}")
}
