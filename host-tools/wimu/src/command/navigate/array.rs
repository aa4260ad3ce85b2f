//! `wimu navigate --setup geometry=…`: an array of accelerometers.

use std::path::Path;

use wimu_calib::Gravity;
use wimu_host::Result;
use wimu_host::array::{Array, ArrayCalibration, ArrayGeometry};
use wimu_host::inertial::{Choice, InertialPath, navigate_array};

use crate::arguments::Navigate;

/// Navigates an array.
pub fn path(arguments: &Navigate, geometry: &Path, choice: &Choice) -> Result<InertialPath> {
    let mut geometry = ArrayGeometry::read(geometry)?;
    if !arguments.with.is_empty() {
        geometry = geometry.with_models(&arguments.with)?;
    }
    let setup = &arguments.aids.setup;
    geometry.place_sd_mm = setup.place_sd_mm.or(geometry.place_sd_mm);
    geometry.delay_sd_us = setup.delay_sd_us.or(geometry.delay_sd_us);
    let reading = arguments.reading.options(false);
    let recording = Array::read(&arguments.input, &reading, arguments.sensitivity)?;
    let recording = recording.arranged(&geometry)?;
    let calibration = ArrayCalibration::of(&recording, &geometry, Gravity::UNKNOWN_PLACE)?;
    navigate_array(&recording, &geometry, &calibration, choice)
}
