//! `wimu apply`.

use serde::Serialize;
use wimu_host::apply::Correction;
use wimu_host::calibration::{read_model, zero_count};
use wimu_host::{Result, formats};

use crate::arguments::Apply;
use crate::command::not_over_input;
use crate::output::Output;

#[derive(Serialize)]
struct Applied {
    file: String,
    format: &'static str,
    rows: usize,
}

pub fn run(arguments: &Apply, output: &Output) -> Result<()> {
    for input in [&arguments.input, &arguments.calibration] {
        not_over_input(input, Some(&arguments.output))?;
    }
    let calibration = read_model(&arguments.calibration)?;
    let mut options = arguments.reading.options(false);
    options.stored_zero_count = zero_count(&arguments.calibration);
    let recording = formats::load(&arguments.input, &options)?;
    let correction = Correction::new(&calibration, &recording)?;
    let rows = correction.write(&arguments.output)?;
    let applied =
        Applied { file: arguments.output.display().to_string(), format: recording.format, rows };
    output.print(format!("{}: {rows} corrected samples", applied.file));
    output.findings(&[&correction.findings[..], &recording.findings].concat());
    output.object(&applied);
    Ok(())
}
