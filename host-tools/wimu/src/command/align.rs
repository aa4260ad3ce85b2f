//! `wimu align`.

use std::path::Path;

use wimu_host::alignment::{self, AlignOptions};
use wimu_host::calibration::{read_parameters, write_report};
use wimu_host::dataset::{Dataset, LoadOptions};
use wimu_host::history::Recording;
use wimu_host::{ErrorCode, HostError, Input, Result};

use crate::arguments::Align;
use crate::command::not_over_input;
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
    let (data, set) = match (Input::parse(&arguments.input)?, given) {
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
        (Input::Link(_), _) => {
            return Err(usage(
                "wimu align needs a recording or a CSV file",
                "record the rests with `wimu record LINK -o rests.mcap` first, and push the result \
                 with `wimu params push LINK CAL.json`",
            ));
        }
    };
    let report = alignment::alignment(&data, &set, &options);
    output.say(report.to_string());
    if report.exit_code() == 0
        && let Some(path) = &arguments.output
    {
        write_report(path, &report)?;
    }
    output.object(&report);
    Ok(report.exit_code())
}
