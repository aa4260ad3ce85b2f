//! `wimu calibrate`.

mod array;
mod guide;
mod magnetometer;

use std::path::Path;
use std::time::{SystemTime, UNIX_EPOCH};

use wimu_host::calibration::{self, CalibrateOptions, Calibration, CalibrationReport, Paired};
use wimu_host::capture;
use wimu_host::formats::{self, ReadOptions};
use wimu_host::recording::{Recording, Samples, Selection};
use wimu_host::{Code, Input, Problem, Result};
use wimu_model::{CalibrationMethod, Sensitivity};

use crate::arguments::{Calibrate, Method, Setup};
use crate::command::{Connection, connect_for};
use crate::output::{Output, usage};

/// Returns the exit code: 0, or 3 if the data do not support an answer.
pub fn run(arguments: &Calibrate, output: &Output) -> Result<u8> {
    let setup = Setup::read(&arguments.setup)?;
    if let Some(key) = setup.given.iter().find(|key| *key != "geometry") {
        let message = format!("--setup: {key} has no use in a calibration");
        return Err(usage(message, "give the geometry alone"));
    }
    match (&setup.geometry, arguments.method) {
        (Some(geometry), _) => array::run(arguments, geometry, output).map(|()| 0),
        (_, Method::Magnetometer) => magnetometer::run(arguments, output),
        (_, Method::Update) => update(arguments, output),
        (_, Method::Reference) => against_reference(arguments, output),
        _ if !arguments.more.is_empty() => several(arguments, output),
        _ => with_gravity(arguments, output),
    }
}

/// Prints a report, writes its calibration to `file`, and does the rest. Returns the exit code.
pub fn finish(
    report: &CalibrationReport,
    file: Option<&Path>,
    output: &Output,
    rest: impl FnOnce() -> Result<()>,
) -> Result<u8> {
    output.print(report.to_string());
    output.findings(&report.outcome.findings);
    let exit_code = report.outcome.exit_code();
    if let (0, Some(path), Some(calibration)) = (exit_code, file, &report.file) {
        calibration.write(path)?;
        output.print(format!("wrote {}", path.display()));
    }
    rest()?;
    output.object(report);
    Ok(exit_code)
}

/// The same, with the page of the report if it was asked for, which shows `samples`.
fn finish_with_page(
    arguments: &Calibrate,
    report: &CalibrationReport,
    samples: Option<&Samples<'_>>,
    output: &Output,
) -> Result<u8> {
    finish(report, arguments.output.as_deref(), output, || {
        let Some(path) = &arguments.report else { return Ok(()) };
        samples.map_or(report.page.clone(), |samples| report.page_with(samples)).write(path)?;
        output.print(format!("wrote {}", path.display()));
        Ok(())
    })
}

/// Reads the samples of `input` and the calibration that belongs to them: `given`, else that of the recording or of the
/// device. `checked` refuses a calibration that does not serve, before `listen` collects the samples of a LINK.
pub fn read_calibrated(
    input: &str,
    load: &ReadOptions,
    given: Option<&Path>,
    push: bool,
    checked: impl Fn(Option<Calibration>) -> Result<Calibration>,
    listen: impl FnOnce(&mut Connection, &Calibration) -> Result<Recording>,
    output: &Output,
) -> Result<(Recording, Calibration, Option<Connection>)> {
    let mut load = load.clone();
    let given = given.map(Calibration::read).transpose()?;
    let accelerometer = given.as_ref().map(|file| &file.sensor().accelerometer);
    load.stored_zero_count = accelerometer.and_then(|own| own.zero_count);
    match Input::parse(input)? {
        Input::File(path) => Ok((formats::load(&path, &load)?, checked(given)?, None)),
        Input::Recording(path) => {
            let recording = capture::Capture::load(&path)?;
            let link = recording.link(load.role)?;
            let data = Recording::of_link(link, &recording.name)?;
            let calibration = match given {
                None => {
                    output.findings(link.unknown_source().as_slice());
                    link.last_parameters()?.as_ref().map(Calibration::held)
                }
                given => given,
            };
            Ok((data, checked(calibration)?, None))
        }
        Input::Link(_) => {
            let mut client = connect_for(input, push)?;
            let device_id = client.hello().device_id;
            given.as_ref().map_or(Ok(()), |given| given.check_device(device_id))?;
            let calibration = match given {
                None => {
                    let reported = client.parameters()?;
                    if push && reported.lacks_gyroscope() {
                        return Err(erases_gyroscope().at(client.name()));
                    }
                    output.findings(reported.unknown_source().as_slice());
                    client.held_parameters()?.map(|(_, set)| Calibration::held(&set))
                }
                given => given,
            };
            let calibration = checked(calibration)?;
            Ok((listen(&mut client, &calibration)?, calibration, Some(client)))
        }
    }
}

/// The error where a push would replace a calibration whose source is not known here.
fn erases_gyroscope() -> Problem {
    Code::DataRefused.error(
        "the source of the board's calibration is not known here: a push would erase that of its gyroscope",
        "name its CAL.json, or push from the computer that pushed it",
    )
}

/// How to read the input, and which of its samples.
fn reading(arguments: &Calibrate) -> (ReadOptions, Selection) {
    let selection = Selection { accelerometer: arguments.sensor, poses: arguments.poses };
    (arguments.reading.options(arguments.poses), selection)
}

/// Calibrates with poses, by the magnitude or the direction of gravity.
fn with_gravity(arguments: &Calibrate, output: &Output) -> Result<u8> {
    let options = options(arguments)?;
    let (load, selection) = reading(arguments);
    let data = match Input::parse(&arguments.input)? {
        Input::File(path) | Input::Recording(path) => formats::load(&path, &load)?,
        Input::Link(_) => return guide::run(arguments, &options, output),
    };
    let samples = data.samples(selection)?;
    let report = calibration::calibrate(&samples, &options)?;
    finish_with_page(arguments, &report, Some(&samples), output)
}

/// Calibrates with several sessions of one sensor.
fn several(arguments: &Calibrate, output: &Output) -> Result<u8> {
    let options = options(arguments)?;
    let (load, selection) = reading(arguments);
    let first = Path::new(&arguments.input);
    let files = std::iter::once(first).chain(arguments.more.iter().map(AsRef::as_ref));
    let sessions: Vec<Recording> =
        files.map(|file| formats::load(file, &load)).collect::<Result<_>>()?;
    let data: Vec<_> =
        sessions.iter().map(|session| session.samples(selection)).collect::<Result<_>>()?;
    let report = calibration::calibrate_several(&data, &options)?;
    finish_with_page(arguments, &report, None, output)
}

/// Calibrates one stream with another of the same motion.
fn against_reference(arguments: &Calibrate, output: &Output) -> Result<u8> {
    let sensitivity = arguments.sensitivity.map(Sensitivity::from_lsb_per_g);
    let sensitivity =
        sensitivity.transpose().map_err(|error| usage(error.to_string(), "check --sensitivity"))?;
    let data = match Input::parse(&arguments.input)? {
        Input::File(path) => {
            let recording = formats::load(&path, &reading(arguments).0)?;
            let chosen = [arguments.reference, arguments.sensor];
            Paired::of_recording(&recording, chosen, sensitivity, arguments.range)?
        }
        Input::Recording(path) => Paired::of_links(&capture::Capture::load(&path)?)?,
        Input::Link(_) => {
            return Err(usage(
                "--method reference needs a recording of both links, or a CSV file",
                "record with `wimu record LINK LINK -o FILE.mcap` first",
            ));
        }
    };
    let report = calibration::compare_with_reference(&data, utc_s());
    finish_with_page(arguments, &report, None, output)
}

/// Checks and updates a stored calibration with later rests.
fn update(arguments: &Calibrate, output: &Output) -> Result<u8> {
    let not_live = || {
        usage(
            "--method update needs a recording or a CSV file",
            "record with `wimu record LINK -o FILE.mcap` first",
        )
    };
    if let Ok(Input::Link(_)) = Input::parse(&arguments.input) {
        return Err(not_live());
    }
    let checked = |set: Option<_>| {
        set.ok_or_else(|| usage("there is no calibration to update", "add --with CAL.json"))
    };
    let (load, selection) = reading(arguments);
    let (data, calibration, _) = read_calibrated(
        &arguments.input,
        &load,
        arguments.with.as_deref(),
        false,
        checked,
        |_, _| Err(not_live()),
        output,
    )?;
    let samples = data.samples(selection)?;
    let report = calibration::update(&samples, &calibration, arguments.gravity, utc_s())?;
    finish_with_page(arguments, &report, None, output)
}

/// Now, s since 1970 UTC.
pub fn utc_s() -> Option<u64> {
    let since = SystemTime::now().duration_since(UNIX_EPOCH);
    since.ok().map(|since| since.as_secs())
}

fn options(arguments: &Calibrate) -> Result<CalibrateOptions> {
    let method = match arguments.method {
        Method::SixPosition => CalibrationMethod::SixPosition,
        Method::FourAngle => CalibrationMethod::FourAngle,
        Method::ThreeAngle => CalibrationMethod::ThreeAngle,
        _ => CalibrationMethod::MultiPosition,
    };
    let text = arguments.model.as_deref().unwrap_or_default();
    let model = calibration::parse_model(text, method)?;
    let datasheet = arguments.chip.as_deref();
    Ok(CalibrateOptions {
        method,
        model,
        sides: arguments.sides.clone(),
        gravity_mps2: arguments.gravity,
        place: arguments.latitude,
        sensitivity_lsb_per_g: arguments.sensitivity,
        range_g: arguments.range,
        placement_sd_deg: arguments.placement_sd,
        datasheet: datasheet.map(calibration::datasheet).transpose()?,
        target_mps2: arguments.target,
        utc_s: utc_s(),
    })
}
