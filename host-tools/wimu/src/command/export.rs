//! `wimu export`.

use std::path::Path;

use serde::Serialize;
use wimu_host::calibration::{
    CalibrationExport, ExportTarget, KalibrNoise, compiled_for, further_sensors, read_parameters,
};
use wimu_host::compare::LinkModel;
use wimu_host::csv::SENSITIVITY;
use wimu_host::export::{self, ExportSource, ExportStream};
use wimu_host::formats::{self, ReadOptions};
use wimu_host::mcap_file::Wholeness;
use wimu_host::multi_range::{FullScales, Merge, MergedSensor};
use wimu_host::plural::counted;
use wimu_host::problem::without_unit;
use wimu_host::ros::{self, Decoded};
use wimu_host::{Code, Input, OutputFile, Problem, Result};
use wimu_model::CompiledSet;

use crate::arguments::{Export, ExportFormat, Stream};
use crate::command::not_over_input;
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

/// A calibration for other programs.
#[derive(Serialize)]
struct ExportedCalibration {
    /// The file written; null if the output is `text`.
    file: Option<String>,
    text: Option<String>,
}

/// A calibration for a device.
#[derive(Serialize)]
struct CompiledCalibration {
    file: String,
    bytes: usize,
    parameter_id: String,
}

/// Merged accelerometers.
#[derive(Serialize)]
struct Merged {
    file: String,
    rows: usize,
    sensors: Vec<MergedSensor>,
}

#[derive(Serialize)]
struct ExportedTopics {
    file: String,
    #[serde(flatten)]
    decoded: Decoded,
}

pub fn run(arguments: &Export, output: &Output) -> Result<()> {
    not_over_input(&arguments.input, arguments.output.as_deref())?;
    let model = arguments.link_model.as_deref().map(LinkModel::read).transpose()?;
    if let Some(target) = target(arguments) {
        return calibration(arguments, target, output);
    }
    let Some(to) = arguments.output.as_deref() else {
        return Err(usage("no output file is given", "name one with -o FILE"));
    };
    if arguments.format == ExportFormat::Device {
        return compiled(arguments, to, output);
    }
    let file = to.display().to_string();
    if arguments.format == ExportFormat::Ros {
        if to.symlink_metadata().is_ok() {
            let exists = std::io::ErrorKind::AlreadyExists.into();
            return Err(Problem::file(&file, "create", &exists));
        }
        let decoded = ros::decode(&arguments.input, to, model.as_ref())?;
        for (topic, count) in &decoded.messages {
            output.print(format!("{file}: {count} messages on {topic}"));
        }
        output.findings(&decoded.findings);
        output.object(&ExportedTopics { file, decoded });
        return Ok(());
    }
    if arguments.merge {
        return merged(arguments, to, output);
    }
    let stream = match arguments.stream {
        Stream::Raw => ExportStream::Raw,
        Stream::Corrected => ExportStream::Corrected,
        Stream::Navigation => ExportStream::Navigation,
    };
    let source = ExportSource {
        role: arguments.link.map(Into::into),
        sensor: arguments.sensor,
        link_model: model.as_ref(),
    };
    let table = export::to_csv(&arguments.input, &source, stream, to)?;
    let (rows, link) = (table.rows, table.role.to_string());
    let counted_rows = counted(rows, "row");
    output.print(format!("{file}: {counted_rows} of the {link} link"));
    let what = match model {
        Some(_) => "left out",
        None => "without a sensitivity",
    };
    let changes = format!("the range changes; column `{SENSITIVITY}` gives the value of each row");
    let sensors = format!("the file has the sensors {:?}", table.sensors);
    let sensors = Code::TrackChosen.note(sensors);
    let sensors = sensors.remedy("--sensor selects one of them");
    let findings = [
        table.wholeness.finding(),
        without_unit(table.without_unit, "raw sample", what),
        (table.ranges_differ).then(|| Code::UnitInferred.note(changes)),
        (table.sensors.len() > 1).then_some(sensors),
    ];
    output.findings(&Vec::from_iter(findings.into_iter().flatten()));
    let exported = Exported {
        file,
        link,
        rows,
        without_unit: table.without_unit,
        sensors: table.sensors,
        wholeness: table.wholeness,
    };
    output.object(&exported);
    Ok(())
}

/// Writes merged accelerometers.
fn merged(arguments: &Export, to: &Path, output: &Output) -> Result<()> {
    let mut load = ReadOptions::default();
    load.role = arguments.link.map(Into::into);
    let recording = formats::load(&arguments.input, &load)?;
    let Some(merge) = Merge::of(&recording, &FullScales::default())? else {
        return Err(usage(
            "--merge: there are not two or three accelerometers of different full scale",
            "`wimu info FILE` lists them",
        ));
    };
    merge.recording.write_table(to)?;
    let merged = Merged {
        file: to.display().to_string(),
        rows: merge.deviations_mps2.len(),
        sensors: merge.sensors,
    };
    output.print(format!("{}: {}", merged.file, counted(merged.rows, "row")));
    output.findings(&merge.findings);
    output.object(&merged);
    Ok(())
}

/// What reads the exported calibration; `None` for a recording.
fn target(arguments: &Export) -> Option<ExportTarget> {
    Some(match arguments.format {
        ExportFormat::Csv | ExportFormat::Device => return None,
        ExportFormat::Ros => {
            let input = Input::parse(&arguments.input.to_string_lossy());
            return (!matches!(input, Ok(Input::Recording(_)))).then_some(ExportTarget::Ros);
        }
        ExportFormat::Rust => ExportTarget::Rust,
        ExportFormat::C => ExportTarget::C,
        ExportFormat::Numpy => ExportTarget::Numpy,
        ExportFormat::Matlab => ExportTarget::Matlab,
        ExportFormat::Kalibr => ExportTarget::Kalibr,
        ExportFormat::Px4 => ExportTarget::Px4,
        ExportFormat::Ardupilot => ExportTarget::Ardupilot,
    })
}

/// Writes a calibration in integers, for any device with its sensor.
fn compiled(arguments: &Export, to: &Path, output: &Output) -> Result<()> {
    let set = read_parameters(&arguments.input)?;
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
    let mut findings = Vec::from_iter(further_left_out(&arguments.input));
    if set.magnetometer.is_some() && compiled.compass().is_none() {
        let text =
            "the magnetometer's calibration is left out: a device with a gyroscope does not use it";
        findings.push(Code::NotExpressible.warning(text));
    }
    output.findings(&findings);
    let parameter_id = compiled.source().to_string();
    output.object(&CompiledCalibration { file, bytes, parameter_id });
    Ok(())
}

/// The sensors of a calibration that an export leaves out.
fn further_left_out(input: &Path) -> Option<Problem> {
    let further = further_sensors(input);
    let text = format!("sensors {further:?} of the calibration are left out");
    (!further.is_empty()).then(|| Code::NotExpressible.warning(text))
}

/// Writes a calibration for other programs, or prints it.
fn calibration(arguments: &Export, target: ExportTarget, output: &Output) -> Result<()> {
    let export = CalibrationExport::read(&arguments.input)?;
    let noise = arguments.noise.as_deref();
    let text = export.text(target, noise.map(KalibrNoise::read).transpose()?);
    let mut findings = export.findings(target);
    findings.extend(further_left_out(&arguments.input));
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
    output.object(&ExportedCalibration { text: file.is_none().then_some(text), file });
    Ok(())
}
