//! `wimu align`.

use std::path::Path;

use wimu_host::alignment::{self, AlignOptions};
use wimu_host::calibration::{read_parameters, write_report};
use wimu_host::client::Client;
use wimu_host::dataset::{Dataset, LoadOptions};
use wimu_host::decode::Event;
use wimu_host::history::{LinkHistory, Recording};
use wimu_host::transport::Transport;
use wimu_host::{ErrorCode, HostError, Input, Result};
use wimu_model::ParameterSet;

use crate::arguments::Align;
use crate::command::{connect, connect_to_write, live, not_over_input, params};
use crate::output::Output;

/// Returns the exit code: 0, or 3 when the data do not support an answer.
pub fn run(arguments: &Align, output: Output) -> Result<u8> {
    let usage = |message: &str, remedy: &str| HostError::new(ErrorCode::Usage, message, remedy);
    let options = AlignOptions {
        up: arguments
            .up
            .iter()
            .map(|axis| axis.parse())
            .collect::<Result<_>>()?,
        rests: arguments.rests.clone(),
        forward: arguments.forward,
        placement_sd_rad: arguments.placement_sd.to_radians(),
    };
    if !(0.01..=20.0).contains(&arguments.placement_sd) {
        return Err(usage(
            "--placement-sd is outside 0.01 to 20 degrees",
            "give how well the body was placed, 1 σ",
        ));
    }
    if options.up.len() < 2 && !options.forward {
        return Err(usage(
            "one direction leaves a rotation about it open",
            "name a second rest, `--up z,x`, or add --forward",
        ));
    }
    if let Some(rests) = &options.rests
        && (rests.len() != options.up.len() || !rests.is_sorted_by(|a, b| a < b))
    {
        return Err(usage(
            "--rests does not name one rest for each axis of --up, in order",
            "such as --up z,x --rests 0,2: the first rest is 0",
        ));
    }
    not_over_input(Path::new(&arguments.input), arguments.output.as_deref())?;
    let load = LoadOptions {
        role: arguments.link.map(Into::into),
        ..LoadOptions::default()
    };
    let given = arguments
        .calibration
        .as_deref()
        .map(read_parameters)
        .transpose()?;
    let input = Input::parse(&arguments.input)?;
    for (flag, given) in [
        ("--push", arguments.push),
        ("--for", arguments.seconds.is_some()),
    ] {
        if given && !matches!(input, Input::Link(_)) {
            let remedy = "leave it out; push with `wimu params push LINK CAL.json`";
            return Err(live::needs_link(flag, remedy));
        }
    }
    let mut client = None;
    let (data, set) = match (input, given) {
        (Input::Csv(path), Some(set)) => (Dataset::from_csv(&path, &load)?, set),
        (Input::Csv(_), None) => {
            return Err(usage(
                "a CSV file does not say how its sensor is calibrated",
                "add --calibration CAL.json",
            ));
        }
        (Input::Recording(path), given) => {
            let recording = Recording::load(&path)?;
            let link = recording.link(load.role)?;
            let data = Dataset::from_link(link, &recording.name)?;
            let set = match given {
                Some(set) => set,
                None => link.last_parameters()?.ok_or_else(|| {
                    usage(
                        "the recording does not say how its sensor is calibrated",
                        "add --calibration CAL.json",
                    )
                })?,
            };
            (data, set)
        }
        (Input::Link(_), given) => {
            let connected = if arguments.push {
                connect_to_write(&arguments.input)
            } else {
                connect(&arguments.input)
            };
            let client = client.insert(connected?);
            let set = match given {
                Some(set) => set,
                None => params::held(client)?.ok_or_else(|| {
                    usage(
                        "the device is uncalibrated",
                        "calibrate it first, or add --calibration CAL.json",
                    )
                })?,
            };
            (listen(client, arguments, &set, &options, output)?, set)
        }
    };
    let report = alignment::alignment(&data, &set, &options);
    output.say(report.to_string());
    if report.exit_code() == 0
        && let Some(path) = &arguments.output
    {
        write_report(path, &report)?;
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

/// Listens until what has come can be answered, or the time is over, or Ctrl-C.
fn listen<T: Transport>(
    client: &mut Client<T>,
    arguments: &Align,
    set: &ParameterSet,
    options: &AlignOptions,
    output: Output,
) -> Result<Dataset> {
    let ask = |rests: usize| match arguments.up.get(rests) {
        Some(up) => output.say(format!("hold the body still with its {up} up")),
        None if options.forward => {
            output.say("push it straight ahead, briskly, and hold it still again");
        }
        None => {}
    };
    ask(0);
    let name = client.name().to_owned();
    let mut record = LinkHistory::new(client.hello().role);
    let (mut looked, mut asked) = (0, 0);
    live::listen(client, arguments.seconds, |arrival| {
        record.take(arrival);
        let samples = record.boots.iter().map(|boot| boot.raw.len()).sum();
        let rate_hz = match &arrival.event {
            Event::Samples(samples) => 1e9 / f64::from(samples.period.0.max(1)),
            _ => return Ok(true),
        };
        if samples < looked + rate_hz as usize {
            return Ok(true);
        }
        looked = samples;
        let report = alignment::alignment(&Dataset::from_link(&record, &name)?, set, options);
        if report.rests > asked {
            asked = report.rests;
            ask(asked);
        }
        Ok(report.exit_code() != 0)
    })?;
    Dataset::from_link(&record, &name)
}
