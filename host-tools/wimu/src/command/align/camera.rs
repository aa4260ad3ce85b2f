//! `wimu align --camera`: the pose of a camera in the body.

use std::path::Path;

use wimu_host::calibration::Calibration;
use wimu_host::formats;
use wimu_host::hand_eye::{HandEyeOptions, PoseStream, hand_eye};
use wimu_host::imu::{Imu, ImuOptions};
use wimu_host::{Code, Result};

use crate::arguments::Align;
use crate::output::{Output, usage};

/// Returns the exit code: 0, or 3 if the motion does not show the rotation.
pub fn run(arguments: &Align, camera: &Path, output: &Output) -> Result<u8> {
    let file = Path::new(&arguments.input);
    let options = HandEyeOptions::default();
    let streams = [PoseStream::read(camera)?, body(arguments, file)?];
    if streams[0].poses().eq(streams[1].poses()) {
        let remedy = "name the poses of the camera with --camera, those of the body first";
        return Err(usage("both files have the same poses", remedy));
    }
    let report = hand_eye(&streams[0], &streams[1], &options);
    let text = report.to_string();
    output.print(&text);
    output.findings(&report.outcome.findings);
    if let Some(path) = &arguments.report {
        report.page(&text).write(path)?;
    }
    output.object(&report);
    Ok(report.outcome.exit_code())
}

/// Poses of the body: as the file has them, or the dead reckoning of its inertial data.
fn body(arguments: &Align, file: &Path) -> Result<PoseStream> {
    match PoseStream::read(file) {
        Err(error) if error.code == Code::CsvMissingColumn || !is_text(file) => {
            let calibration = arguments.with.as_deref().map(Calibration::read).transpose()?;
            let calibration = calibration.map(|file| file.sensor().clone());
            let mut load = arguments.reading.options(false);
            let accelerometer = calibration.as_ref().map(|sensor| &sensor.accelerometer);
            load.stored_zero_count = accelerometer.and_then(|own| own.zero_count);
            let table = ImuOptions { calibration, sensitivity_lsb_per_g: None };
            PoseStream::of_inertial(&Imu::of(&formats::load(file, &load)?, &table)?)
        }
        read => read,
    }
}

/// Whether a file is text, which a table of poses is.
fn is_text(file: &Path) -> bool {
    std::fs::read_to_string(file).is_ok()
}
