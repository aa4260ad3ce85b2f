//! `wimu allan`.

use wimu_host::allan;
use wimu_host::dataset::{Dataset, LoadOptions};
use wimu_host::{ErrorCode, HostError, Input, Result};
use wimu_model::Sensitivity;

use crate::arguments::Allan;
use crate::command::not_over_input;
use crate::output::Output;

/// Returns the exit code: 0, or 3 when the data do not support an answer.
pub fn run(arguments: &Allan, output: Output) -> Result<u8> {
    let load = LoadOptions {
        filter: arguments.filter.as_deref().map(str::parse).transpose()?,
        accelerometer: arguments.accelerometer,
        poses: false,
        role: arguments.link.map(Into::into),
    };
    let sensitivity = arguments
        .sensitivity
        .map(Sensitivity::from_lsb_per_g)
        .transpose()
        .map_err(|error| {
            HostError::new(ErrorCode::Usage, error.to_string(), "check --sensitivity")
        })?;
    not_over_input(arguments.input.as_ref(), arguments.report.as_deref())?;
    let data = match Input::parse(&arguments.input)? {
        Input::Csv(path) => Dataset::from_csv(&path, &load)?,
        Input::Recording(path) => Dataset::from_recording(&path, &load)?,
        Input::Link(_) => {
            return Err(HostError::new(
                ErrorCode::Usage,
                "wimu allan needs a recording or a CSV file",
                "record the board at rest with `wimu record LINK -o rest.mcap` first",
            ));
        }
    };
    let report = allan::noise(&data, sensitivity);
    output.say(report.to_string());
    if report.exit_code() == 0
        && let Some(path) = &arguments.report
    {
        report.page()?.write(path)?;
    }
    output.object(&report);
    Ok(report.exit_code())
}
