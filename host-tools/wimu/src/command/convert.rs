//! `wimu convert`.

use std::path::Path;

use serde::Serialize;
use serde_json::json;
use wimu_host::apply::CorrectedRecording;
use wimu_host::calibration::{
    Calibration, CalibrationExport, ExportTarget, KalibrNoise, compiled_for,
};
use wimu_host::compare::LinkModel;
use wimu_host::csv::SENSITIVITY;
use wimu_host::export::{self, ExportSource, ExportStream};
use wimu_host::formats;
use wimu_host::mcap_file::Wholeness;
use wimu_host::plural::counted;
use wimu_host::problem::without_unit;
use wimu_host::ros::{self, Decoded};
use wimu_host::{Code, Input, OutputFile, Problem, Result};
use wimu_model::CompiledSet;

use crate::arguments::{Convert, Target};
use crate::output::{Output, usage};

#[derive(Serialize)]
struct Exported {
    file: String,
    link: String,
    rows: usize,
    /// Raw samples of unknown range.
    without_unit: usize,
    /// Indices of the sensors with raw samples.
    sensors: Vec<u8>,
    #[serde(flatten)]
    wholeness: Wholeness,
}

#[derive(Serialize)]
struct ExportedTopics {
    file: String,
    #[serde(flatten)]
    decoded: Decoded,
}

pub fn run(arguments: &Convert, output: &Output) -> Result<()> {
    if let Some(program) = arguments.to.and_then(Target::program) {
        return calibration(arguments, program, output);
    }
    let Some(to) = arguments.output.as_deref() else {
        if arguments.to.is_none() && Calibration::read(&arguments.input).is_ok() {
            return Err(no_recording(arguments));
        }
        return Err(usage("no output file is given", "name one with -o FILE"));
    };
    if arguments.to == Some(Target::Device) {
        return compiled(arguments, to, output);
    }
    // A file of another schema is a calibration, or refused as one.
    let model = arguments.with.as_deref().and_then(|file| LinkModel::read(file).ok());
    let is_of_wimu =
        matches!(Input::parse(&arguments.input.to_string_lossy()), Ok(Input::Recording(_)));
    match (&arguments.with, is_of_wimu) {
        (Some(file), _) if model.is_none() => {
            corrected(arguments, Some(file.as_path()), to, output)
        }
        (_, true) if is_mcap(to) => topics(arguments, model.as_ref(), to, output),
        (_, true) => stream(arguments, model.as_ref(), to, output),
        (None, false) if Calibration::read(&arguments.input).is_ok() => {
            Err(no_recording(arguments))
        }
        (None, false) => corrected(arguments, None, to, output),
        (Some(file), false) => {
            let message = "this is the model of a link, for recordings of wimu";
            Err(usage(message, "give --with CAL.json").at(file.display().to_string()))
        }
    }
}

/// The error of a calibration without a form.
fn no_recording(arguments: &Convert) -> Problem {
    let remedy = "choose its form with --to; `wimu convert --help` lists them";
    let input = arguments.input.display().to_string();
    usage("this is a calibration and no recording", remedy).at(input)
}

fn is_mcap(path: &Path) -> bool {
    path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("mcap"))
}

/// Refuses options of a recording of wimu.
fn of_wimu_only(arguments: &Convert) -> Result<()> {
    if arguments.stream.is_none() && arguments.sensor.is_none() {
        return Ok(());
    }
    let message = "--stream and --sensor choose what a recording of wimu is converted to";
    Err(usage(message, "leave them out").at(arguments.input.display().to_string()))
}

/// Writes a recording of any format in SI units, corrected by a calibration if one is given.
fn corrected(arguments: &Convert, file: Option<&Path>, to: &Path, output: &Output) -> Result<()> {
    of_wimu_only(arguments)?;
    let calibration = file.map(Calibration::read).transpose()?;
    let sensor = calibration.as_ref().map(Calibration::sensor);
    let mut options = arguments.reading.options(false);
    options.stored_zero_count = sensor.and_then(|sensor| sensor.accelerometer.zero_count);
    let recording = formats::load(&arguments.input, &options)?;
    let corrected = CorrectedRecording::new(sensor, &recording)?;
    let rows = corrected.write(to)?;
    let file = to.display().to_string();
    let what = if sensor.is_some() { "corrected samples" } else { "samples, not corrected" };
    output.print(format!("{file}: {rows} {what}"));
    output.findings(&[&corrected.findings[..], &recording.findings].concat());
    output.object(&json!({"file": file, "format": recording.format, "rows": rows}));
    Ok(())
}

/// Adds decoded ROS 2 topics to a recording.
fn topics(
    arguments: &Convert,
    model: Option<&LinkModel>,
    to: &Path,
    output: &Output,
) -> Result<()> {
    of_wimu_only(arguments)?;
    let file = to.display().to_string();
    if to.symlink_metadata().is_ok() {
        let exists = std::io::ErrorKind::AlreadyExists.into();
        return Err(Problem::file(&file, "create", &exists));
    }
    let decoded = ros::decode(&arguments.input, to, model)?;
    for (topic, count) in &decoded.messages {
        output.print(format!("{file}: {count} messages on {topic}"));
    }
    output.findings(&decoded.findings);
    output.object(&ExportedTopics { file, decoded });
    Ok(())
}

/// Writes a stream of a recording of wimu as a table.
fn stream(
    arguments: &Convert,
    model: Option<&LinkModel>,
    to: &Path,
    output: &Output,
) -> Result<()> {
    let source = ExportSource {
        role: arguments.reading.role(),
        sensor: arguments.sensor.unwrap_or_default(),
        link_model: model,
    };
    let stream = arguments.stream.map_or(ExportStream::Raw, Into::into);
    let table = export::to_csv(&arguments.input, &source, stream, to)?;
    let (rows, link) = (table.rows, table.role.to_string());
    let file = to.display().to_string();
    output.print(format!("{file}: {} of the {link} link", counted(rows, "row")));
    let what = if model.is_some() { "left out" } else { "without a sensitivity" };
    let changes = format!("the range changes; column `{SENSITIVITY}` gives the value of each row");
    let sensors = format!("the file has the sensors {:?}", table.sensors);
    let sensors = Code::TrackChosen.note(sensors).remedy("--sensor selects one of them");
    let findings = [
        table.wholeness.finding(),
        without_unit(table.without_unit, "raw sample", what),
        (table.ranges_differ).then(|| Code::UnitInferred.note(changes)),
        (table.sensors.len() > 1).then_some(sensors),
    ];
    output.findings(&Vec::from_iter(findings.into_iter().flatten()));
    output.object(&Exported {
        file,
        link,
        rows,
        without_unit: table.without_unit,
        sensors: table.sensors,
        wholeness: table.wholeness,
    });
    Ok(())
}

/// Writes a calibration in integers, for any device with its sensor.
fn compiled(arguments: &Convert, to: &Path, output: &Output) -> Result<()> {
    let calibration = Calibration::read(&arguments.input)?;
    let set = calibration.parameters()?;
    let rad_s_per_lsb = set.gyroscope.map(|gyroscope| gyroscope.rad_s_per_lsb);
    let compiled = compiled_for(&set, 0, rad_s_per_lsb, true).map_err(|error| {
        let error = Code::BadCalibration.error(error.to_string(), "calibrate again");
        error.at(arguments.input.display().to_string())
    })?;
    let mut buffer = [0; CompiledSet::MAX_BYTES];
    let bytes = compiled.to_bytes(&mut buffer);
    OutputFile::write(to, &buffer[..bytes])?;

    let file = to.display().to_string();
    output.print(format!("{file}: {bytes} bytes, parameters {}", compiled.source()));
    let mut findings = Vec::from_iter(further_left_out(&calibration));
    if set.magnetometer.is_some() && compiled.compass().is_none() {
        let text =
            "the magnetometer's calibration is left out: a device with a gyroscope does not use it";
        findings.push(Code::NotExpressible.warning(text));
    }
    output.findings(&findings);
    let parameter_id = compiled.source().to_string();
    output.object(&json!({"file": file, "bytes": bytes, "parameter_id": parameter_id}));
    Ok(())
}

/// The sensors of a calibration that an export leaves out.
fn further_left_out(calibration: &Calibration) -> Option<Problem> {
    let further = calibration.further();
    let text = format!("sensors {further:?} of the calibration are left out");
    (!further.is_empty()).then(|| Code::NotExpressible.warning(text))
}

/// Writes a calibration for other programs, or prints it.
fn calibration(arguments: &Convert, program: ExportTarget, output: &Output) -> Result<()> {
    if arguments.noise.is_some() && program != ExportTarget::Kalibr {
        return Err(usage("--noise is for --to kalibr", "leave it out"));
    }
    let calibration = Calibration::read(&arguments.input)?;
    let export = CalibrationExport::new(&calibration);
    let noise = arguments.noise.as_deref().map(KalibrNoise::read).transpose()?;
    let text = export.text(program, noise.as_ref());
    let mut findings = export.findings(program);
    findings.extend(further_left_out(&calibration));
    let file = arguments.output.as_ref().map(|path| path.display().to_string());
    if let Some(path) = &arguments.output {
        OutputFile::write(path, &text)?;
        output.print(format!("{}: {} lines", path.display(), text.lines().count()));
    }
    if file.is_none() && !output.is_json() {
        // The text itself holds the findings.
        output.print(text.trim_end());
    } else {
        output.findings(&findings);
    }
    // Either the file that was written, or the text.
    output.object(&json!({"text": file.is_none().then_some(text), "file": file}));
    Ok(())
}
