//! `wimu navigate` with its own estimators, on CSV files, recordings and arrays.

use std::path::{Path, PathBuf};

use wimu_host::calibration::Calibration;
use wimu_host::capture::Capture;
use wimu_host::formats;
use wimu_host::imu::{Imu, ImuOptions};
use wimu_host::inertial::aids::Mounting;
use wimu_host::inertial::{Aids, Choice, InertialPath, navigate};
use wimu_host::multi_range::{FullScales, Merge};
use wimu_host::plural::counted;
use wimu_host::{Code, Input, Problem, Result, navigation};

use super::array;
use crate::arguments::{Aids as Options, Navigate, Smoothing, ZeroVelocity};
use crate::output::{Output, usage};

/// Navigates a recording of one unit, or an array.
pub fn run(arguments: &Navigate, output: &Output) -> Result<()> {
    let source = wimu_host::untrusted::name(&arguments.input);
    let found = match &arguments.aids.setup.geometry {
        Some(geometry) => {
            let choice = choice(arguments)?;
            let path = array::path(arguments, geometry, &choice)?;
            present(arguments, path, None, Some(&choice), source, output)?
        }
        None => {
            let motion = calibrated(arguments, &arguments.input, arguments.with.first())?;
            one_unit(arguments, &motion, source, output)?
        }
    };
    output.object(&found);
    Ok(())
}

/// A recording of a unit, of any format; of a board the longest start.
pub fn unit(arguments: &Navigate, file: &Path, calibration: Option<&PathBuf>) -> Result<Imu> {
    match Input::parse(&file.to_string_lossy())? {
        Input::Link(_) => Err(usage(
            "a LINK cannot be combined with a recording",
            "record the board: wimu record LINK -o A.mcap",
        )),
        Input::Recording(_) => {
            let recording = Capture::load(file)?;
            let link = recording.link(arguments.reading.role())?;
            let longest = link.longest().ok_or_else(|| {
                Code::NoRows
                    .error("the recording has no samples", "record again")
                    .at(&recording.name)
            })?;
            let calibration = calibration.map(|file| Calibration::read(file)).transpose()?;
            let calibration = calibration.as_ref().map(Calibration::sensor);
            navigation::motion(&recording.name, longest, calibration)
        }
        _ => calibrated(arguments, file, calibration),
    }
}

/// Reads a recording of one unit and corrects it with a calibration.
fn calibrated(arguments: &Navigate, file: &Path, calibration: Option<&PathBuf>) -> Result<Imu> {
    let calibration = calibration.map(|file| Calibration::read(file)).transpose()?;
    let calibration = calibration.map(|file| file.sensor().clone());
    let mut load = arguments.reading.options(false);
    let accelerometer = calibration.as_ref().map(|sensor| &sensor.accelerometer);
    load.stored_zero_count = accelerometer.and_then(|own| own.zero_count);
    let options = ImuOptions { calibration, sensitivity_lsb_per_g: arguments.sensitivity };
    let mut recording = formats::load(file, &load)?;
    if arguments.aids.setup.full_scales_g.is_empty() {
        return Imu::of(&recording, &options);
    }
    for other in &arguments.boards {
        recording.add_accelerometer(&formats::load(other, &load)?)?;
    }
    let scales = FullScales::of(&arguments.aids.setup.full_scales_g)?;
    let Some(merge) = Merge::of(&recording, &scales)? else {
        return Imu::of(&recording, &options);
    };
    let mut motion = Imu::of(&merge.recording, &options)?;
    motion.findings.splice(0..0, merge.findings);
    Ok(motion)
}

/// Computes, prints and writes the path of one unit; returns its object.
pub fn one_unit(
    arguments: &Navigate,
    recording: &Imu,
    source: String,
    output: &Output,
) -> Result<InertialPath> {
    let choice = choice(arguments)?;
    let path = navigate(recording, &choice)?;
    present(arguments, path, None, Some(&choice), source, output)
}

/// What the options say.
pub fn choice(arguments: &Navigate) -> Result<Choice> {
    let mut aided = aided_choice(&arguments.aids)?;
    if let Some(odometry) = &arguments.odometry {
        aided.aids.extend(Aids::read_odometry(odometry)?);
    }
    Ok(Choice {
        zupt: ZeroVelocity::of(arguments.zupt),
        limit_m: arguments.limit_m(),
        within_m: arguments.within,
        rests_s: arguments.rests.clone(),
        start: arguments.start,
        smooth: arguments.smooth == Smoothing::On,
        loop_m: arguments.closes,
        ..aided
    })
}

/// What the options of the aids say, and the defaults.
pub fn aided_choice(options: &Options) -> Result<Choice> {
    let mut aids = Aids::default();
    if let Some(from) = &options.fixes
        && !matches!(Input::parse(&from.to_string_lossy())?, Input::Link(_))
    {
        aids = Aids::read(from, &mounting(options))?;
    }
    Ok(Choice { profile: options.profile.into(), aids, ..Choice::default() })
}

/// How the other system is mounted.
pub fn mounting(options: &Options) -> Mounting {
    let setup = &options.setup;
    Mounting {
        lever_arm_m: setup.lever_arm_m.unwrap_or_default(),
        delay_s: setup.fix_delay_s,
        time_sd_s: setup.fix_time_sd_s,
    }
}

/// Prints a path with its findings, or those that are `new` to the user, and writes it; returns its object. `choice` is that of
/// a path from inertial samples.
pub fn present(
    arguments: &Navigate,
    path: InertialPath,
    new: Option<&[Problem]>,
    choice: Option<&Choice>,
    source: String,
    output: &Output,
) -> Result<InertialPath> {
    let text = path.text(choice, arguments.aids.fixes.is_some());
    output.print(text.trim_end());
    output.findings(new.unwrap_or(&path.findings));
    if let Some(file) = &arguments.output {
        path.write(file)?;
        output.print(format!("wrote {} to {}", counted(path.points.len(), "row"), file.display()));
    }
    if let Some(file) = &arguments.report {
        let fixes = choice.map_or_else(Aids::default, |choice| choice.aids.clone());
        path.page(&source, &text, &fixes).write(file)?;
        output.print(format!("wrote {}", file.display()));
    }
    Ok(InertialPath { source, ..path })
}
