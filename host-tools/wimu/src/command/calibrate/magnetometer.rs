//! `wimu calibrate --method magnetometer`.

use wimu_host::calibration::{CalibrateOptions, Calibration, calibrate_magnetometer};
use wimu_host::{Code, Result};
use wimu_model::ErrorModel;

use super::guide::{begin, collect};
use super::{finish_with_page, read_calibrated, reading};
use crate::arguments::Calibrate;
use crate::command::params;
use crate::output::Output;
use crate::text_view::typed;

/// Returns the exit code: 0, or 3 if the data do not support an answer.
pub fn run(arguments: &Calibrate, output: &Output) -> Result<u8> {
    let (load, selection) = reading(arguments);
    let (data, calibration, mut client) = read_calibrated(
        &arguments.input,
        &load,
        arguments.with.as_deref(),
        arguments.push,
        calibrated,
        |client, _| {
            let mut guided = begin(client, arguments, &CalibrateOptions::default())?;
            collect(client, &mut guided, &typed(), output)?;
            guided.recording()
        },
        output,
    )?;
    let data = data.samples(selection)?;
    let report = calibrate_magnetometer(&data, &calibration, arguments.dip.map(f64::to_radians))?;
    let code = finish_with_page(arguments, &report, None, output)?;
    if let (Some(client), Some(set), true) = (&mut client, &report.parameters, arguments.push) {
        params::push(client, set, output)?;
    }
    Ok(code)
}

/// The accelerometer's calibration. Without one, its bias tilts the measured gravity and changes the dip.
fn calibrated(calibration: Option<Calibration>) -> Result<Calibration> {
    let is_ideal = |calibration: &Calibration| {
        calibration.sensor().accelerometer.model == ErrorModel::default()
    };
    calibration.filter(|calibration| !is_ideal(calibration)).ok_or_else(|| {
        Code::DataRefused.error(
            "there is no calibration of the accelerometer beside the magnetometer",
            "calibrate it with `wimu calibrate … -o CAL.json` and add --with CAL.json",
        )
    })
}
