//! `wimu allan`.

use std::time::{Duration, Instant};

use wimu_host::allan::{self, NoiseMeter, NoiseReport};
use wimu_host::dataset::{Dataset, LoadOptions};
use wimu_host::{ErrorCode, HostError, Input, Result};
use wimu_model::Sensitivity;

use crate::arguments::Allan;
use crate::command::{connect, live, not_over_input};
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
    let input = Input::parse(&arguments.input)?;
    if arguments.seconds.is_some() && !matches!(input, Input::Link(_)) {
        return Err(live::needs_link("--for", "leave it out"));
    }
    let report = match input {
        Input::Csv(path) => allan::noise(&Dataset::from_csv(&path, &load)?, sensitivity),
        Input::Recording(path) => {
            allan::noise(&Dataset::from_recording(&path, &load)?, sensitivity)
        }
        Input::Link(_) => listen(arguments, sensitivity, output)?,
    };
    output.say(report.to_string());
    if report.exit_code() == 0
        && let Some(path) = &arguments.report
    {
        report.page()?.write(path)?;
    }
    output.object(&report);
    Ok(report.exit_code())
}

/// How often it says how far it is.
const PROGRESS: Duration = Duration::from_secs(5);

/// The noise of a live board, in memory that does not grow.
fn listen(
    arguments: &Allan,
    sensitivity: Option<Sensitivity>,
    output: Output,
) -> Result<NoiseReport> {
    let mut client = connect(&arguments.input)?;
    let mut meter = NoiseMeter::new(client.name(), sensitivity, client.hello().sensitivity_known);
    output.say(match arguments.seconds {
        Some(seconds) => format!("leave the board where it lies for {seconds} s"),
        None => "leave the board where it lies; Ctrl-C ends".to_owned(),
    });
    let mut told = Instant::now();
    live::listen(&mut client, arguments.seconds, |arrival| {
        meter.take(&arrival.event)?;
        if told.elapsed() >= PROGRESS {
            told = Instant::now();
            output.refresh(&meter.progress());
        }
        Ok(true)
    })?;
    output.end_refresh();
    meter.report()
}
