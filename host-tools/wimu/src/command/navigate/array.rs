//! `wimu navigate --setup geometry=…`: an array of accelerometers, in one table or on several boards.

use std::path::Path;

use wimu_calib::Gravity;
use wimu_host::Result;
use wimu_host::array::{ArrayCalibration, ArrayGeometry, refine};
use wimu_host::inertial::{Choice, InertialPath, navigate_array};

use crate::arguments::Navigate;
use crate::command::array::{self, Refined};
use crate::output::Output;

/// Navigates an array.
pub fn path(
    arguments: &Navigate,
    geometry: &Path,
    choice: &Choice,
    output: &Output,
) -> Result<(InertialPath, Option<Refined>)> {
    let mut geometry = ArrayGeometry::read(geometry)?;
    if !arguments.with.is_empty() {
        geometry = geometry.with_models(&arguments.with)?;
    }
    let options =
        array::prior(arguments.aids.setup.place_sd_mm, arguments.aids.setup.delay_sd_us, &geometry);
    let read = array::read(
        &arguments.input,
        &arguments.boards,
        arguments.sensitivity,
        arguments.reading.role(),
        geometry.has_models(),
    )?;
    let mut recording = read.clone().arranged(&geometry)?;
    let mut calibration = ArrayCalibration::of(&recording, &geometry, Gravity::UNKNOWN_PLACE)?;
    calibration.place_sd_m = options.place_sd_m;
    calibration.delay_sd_s = options.delay_sd_s;
    let mut refined = None;
    if let Some(file) = &arguments.aids.setup.refine {
        let found = refine(&recording, &geometry, &calibration, &options)?;
        let shown = refined.insert(Refined::of(&found, output));
        if found.accepted {
            let (place_sd_m, delay_sd_s) = (found.known_place_m(), found.known_delay_s());
            geometry = found.geometry;
            geometry.place_sd_mm = Some(place_sd_m * 1e3);
            geometry.delay_sd_us = Some(delay_sd_s * 1e6);
            geometry.write(file)?;
            output.print(format!("wrote {}", file.display()));
            shown.file = Some(file.display().to_string());
            recording = read.arranged(&geometry)?;
            calibration = ArrayCalibration::of(&recording, &geometry, Gravity::UNKNOWN_PLACE)?;
            calibration.place_sd_m = place_sd_m;
            calibration.delay_sd_s = delay_sd_s;
        }
    }
    let path = navigate_array(&recording, &geometry, &calibration, choice)?;
    Ok((path, refined))
}
