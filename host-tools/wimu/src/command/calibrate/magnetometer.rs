//! `wimu calibrate --sensor magnetometer`.

use std::path::Path;

use wimu_host::calibration::{
    CalibrateOptions, calibrate_magnetometer, read_parameters, write_report,
};
use wimu_host::dataset::{Dataset, LoadOptions};
use wimu_host::history::Recording;
use wimu_host::{ErrorCode, HostError, Input, Result};
use wimu_model::ParameterSet;

use crate::arguments::{Calibrate, Method};
use crate::command::{connect, connect_to_write, not_over_input, params};
use crate::output::Output;

/// Returns the exit code: 0, or 3 when the data do not support an answer.
pub fn run(arguments: &Calibrate, output: Output) -> Result<u8> {
    let usage = |message: String, remedy: &str| HostError::new(ErrorCode::Usage, message, remedy);
    let others = [
        ("--method", arguments.method != Method::MultiPosition),
        ("--model", arguments.model.is_some()),
        ("--gravity", arguments.gravity.is_some()),
        ("--sensitivity", arguments.sensitivity.is_some()),
        ("--placement-sd", arguments.placement_sd.is_some()),
        ("--sides", arguments.sides.is_some()),
        ("--reference", arguments.reference.is_some()),
        ("--sensor-model", arguments.sensor_model.is_some()),
    ];
    if let Some((flag, _)) = others.into_iter().find(|(_, given)| *given) {
        return Err(usage(
            format!("{flag} does not go with --sensor magnetometer"),
            "leave it out",
        ));
    }
    let load = LoadOptions {
        filter: arguments.filter.as_deref().map(str::parse).transpose()?,
        accelerometer: arguments.accelerometer,
        poses: arguments.poses,
        role: arguments.link.map(Into::into),
    };
    let right = -90.0..=90.0;
    if arguments.dip.is_some_and(|dip| !right.contains(&dip)) {
        return Err(usage(
            "--dip is outside -90 to 90 degrees".to_owned(),
            "give the angle of the field below the horizontal: maps of the field have it",
        ));
    }
    let dip_rad = arguments.dip.map(f64::to_radians);
    not_over_input(Path::new(&arguments.input), arguments.output.as_deref())?;
    let given = arguments.with.as_deref().map(read_parameters).transpose()?;
    let input = Input::parse(&arguments.input)?;
    if arguments.push && !matches!(input, Input::Link(_)) {
        return Err(usage(
            "--push needs a LINK".to_owned(),
            "write the calibration with -o and push it with `wimu params push LINK CAL.json`",
        ));
    }
    let mut client = None;
    let (data, set) = match input {
        Input::Csv(path) => (Dataset::from_csv(&path, &load)?, calibrated(given)?),
        Input::Recording(path) => {
            let recording = Recording::load(&path)?;
            let link = recording.link(load.role)?;
            let data = Dataset::from_link(link, &recording.name)?;
            let set = match given {
                Some(set) => Some(set),
                None => link.last_parameters()?,
            };
            (data, calibrated(set)?)
        }
        Input::Link(_) => {
            let connected = if arguments.push {
                connect_to_write(&arguments.input)
            } else {
                connect(&arguments.input)
            };
            let client = client.insert(connected?);
            let held = match given {
                Some(set) => Some(set),
                None => params::held(client)?,
            };
            // Before anyone holds it still for nothing.
            let set = calibrated(held)?;
            let options = CalibrateOptions::default();
            (super::collect(client, arguments, &options, output)?, set)
        }
    };
    let report = calibrate_magnetometer(&data, &set, dip_rad)?;
    output.say(report.to_string());
    if report.exit_code() == 0
        && let Some(path) = &arguments.output
    {
        write_report(path, &report)?;
    }
    if let Some(path) = &arguments.report {
        report.page()?.write(path)?;
    }
    if arguments.push
        && let Some(client) = &mut client
        && let Some(set) = &report.parameters
    {
        params::push(client, set, output)?;
    }
    output.object(&report);
    Ok(report.exit_code())
}

/// The accelerometer's calibration: without one its bias tilts gravity, and the dip with it.
fn calibrated(set: Option<ParameterSet>) -> Result<ParameterSet> {
    set.filter(|set| *set != ParameterSet::uncalibrated(set.range_g, set.sensitivity))
        .ok_or_else(|| {
            HostError::new(
                ErrorCode::DataRefused,
                "nothing says how the accelerometer beside the magnetometer is calibrated",
                "calibrate it with `wimu calibrate … -o CAL.json` and add --with CAL.json",
            )
        })
}
