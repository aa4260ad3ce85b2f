//! `wimu allan`.

use std::time::{Duration, Instant};

use wimu_host::allan::{self, NoiseMeter, NoiseReport};
use wimu_host::document::ToDocument;
use wimu_host::{Input, Result};

use crate::arguments::Allan;
use crate::command::{connect, listen_until, not_over_input};
use crate::output::Output;

/// Returns the exit code: 0, or 3 if the data do not support an answer.
pub fn run(arguments: &Allan, output: &Output) -> Result<u8> {
    not_over_input(arguments.input.as_ref(), arguments.report.as_deref())?;
    let report = match Input::parse(&arguments.input)? {
        Input::File(path) | Input::Recording(path) => {
            let options = arguments.reading.options(false);
            allan::noise(&path, &options, arguments.sensor, arguments.sensitivity)?
        }
        Input::Link(_) => listen(arguments, output)?,
    };
    let document = report.document();
    output.print(document.to_string());
    output.findings(&report.outcome.findings);
    if report.measured().next().is_some()
        && let Some(path) = &arguments.report
    {
        document.write(path)?;
    }
    output.object(&report);
    Ok(report.outcome.exit_code())
}

/// Interval between progress lines.
const PROGRESS: Duration = Duration::from_secs(5);

/// Measures the noise of a live board, in constant memory.
fn listen(arguments: &Allan, output: &Output) -> Result<NoiseReport> {
    let mut client = connect(&arguments.input)?;
    let mut meter =
        NoiseMeter::new(client.name(), arguments.sensitivity, client.hello().sensitivity_known);
    output.print(match arguments.seconds {
        Some(time) => format!("keep the board at rest for {} s", time.as_secs_f64()),
        None => "keep the board at rest; Ctrl-C stops".to_owned(),
    });
    let mut shown = Instant::now();
    listen_until(&mut client, arguments.seconds, |arrival| {
        meter.take(&arrival.event)?;
        if shown.elapsed() >= PROGRESS {
            shown = Instant::now();
            output.refresh(&meter.progress());
        }
        Ok(true)
    })?;
    output.end_refresh();
    meter.report()
}
