//! `wimu align`.

mod camera;

use wimu_host::Result;
use wimu_host::alignment::{self, AlignOptions};
use wimu_host::calibration::Calibration;
use wimu_host::capture::Link;
use wimu_host::decode::Event;
use wimu_host::recording::{Recording, Selection};

use crate::arguments::Align;
use crate::command::calibrate::{finish, read_calibrated};
use crate::command::{Connection, listen_until, params};
use crate::output::{Output, usage};

/// Returns the exit code: 0, or 3 if the data do not support an answer.
pub fn run(arguments: &Align, output: &Output) -> Result<u8> {
    if let Some(camera) = &arguments.camera {
        return camera::run(arguments, camera, output);
    }
    let options = AlignOptions {
        up: arguments.up.iter().map(|axis| axis.parse()).collect::<Result<_>>()?,
        rests: arguments.rests.clone(),
        forward: arguments.forward,
        placement_sd_rad: arguments.placement_sd.to_radians(),
    };
    if options.up.len() < 2 && !options.forward {
        return Err(usage(
            "one direction does not determine the rotation about it",
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
    let (data, calibration, mut client) = read_calibrated(
        &arguments.input,
        &arguments.reading.options(false),
        arguments.with.as_deref(),
        arguments.push,
        |calibration| {
            calibration.ok_or_else(|| {
                usage(
                    "there is no calibration of the accelerometer",
                    "calibrate it first, and add --with CAL.json",
                )
            })
        },
        |client, calibration| listen(client, arguments, calibration, &options, output),
        output,
    )?;
    let samples = data.samples(Selection::default())?;
    let report = alignment::alignment(&samples, &calibration, &options)?;
    finish(&report, arguments.output.as_deref(), output, || {
        match (&mut client, &report.parameters) {
            (Some(client), Some(set)) if arguments.push => params::push(client, set, output),
            _ => Ok(()),
        }
    })
}

/// Listens until the alignment is known, the time is over, or Ctrl-C.
fn listen(
    client: &mut Connection,
    arguments: &Align,
    calibration: &Calibration,
    options: &AlignOptions,
    output: &Output,
) -> Result<Recording> {
    let ask = |rests: usize| match arguments.up.get(rests) {
        Some(up) => output.print(format!("hold the body still with its {up} axis up")),
        None if options.forward => {
            output.print("push the body straight ahead, briskly, and hold it still again");
        }
        None => {}
    };
    ask(0);
    let name = client.name().to_owned();
    let mut record = Link::new(client.hello().role);
    let (mut looked, mut asked) = (0, 0);
    listen_until(client, arguments.seconds, |arrival| {
        record.take(arrival);
        let samples = record.boots.iter().map(|boot| boot.raw().len()).sum();
        let rate_hz = match &arrival.event {
            Event::Samples(samples) if samples.sensor == 0 => {
                1e9 / f64::from(samples.period.0.max(1))
            }
            _ => return Ok(true),
        };
        if samples < looked + rate_hz as usize {
            return Ok(true);
        }
        looked = samples;
        let data = Recording::of_link(&record, &name)?;
        let samples = data.samples(Selection::default())?;
        let report = alignment::alignment(&samples, calibration, options)?;
        if report.poses.len() > asked {
            asked = report.poses.len();
            ask(asked);
        }
        Ok(report.outcome.exit_code() != 0)
    })?;
    Recording::of_link(&record, &name)
}
