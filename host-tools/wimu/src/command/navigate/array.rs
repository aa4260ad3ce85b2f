//! `wimu navigate --setup geometry=…`: an array of accelerometers.

use std::path::Path;

use wimu_calib::Gravity;
use wimu_host::Result;
use wimu_host::array::{Array, ArrayCalibration, ArrayGeometry};
use wimu_host::inertial::{Choice, InertialPath, navigate_array};

use crate::arguments::Navigate;
use crate::command::array;

/// Navigates an array.
pub fn path(arguments: &Navigate, geometry: &Path, choice: &Choice) -> Result<InertialPath> {
    let mut geometry = ArrayGeometry::read(geometry)?;
    if !arguments.with.is_empty() {
        geometry = geometry.with_models(&arguments.with)?;
    }
    let setup = &arguments.aids.setup;
    let options = array::prior(setup.place_sd_mm, setup.delay_sd_us, &geometry);
    let reading = arguments.reading.options(false);
    let recording = Array::read(&arguments.input, &reading, arguments.sensitivity)?;
    let recording = recording.arranged(&geometry)?;
    let mut calibration = ArrayCalibration::of(&recording, &geometry, Gravity::UNKNOWN_PLACE)?;
    calibration.place_sd_m = options.place_sd_m;
    calibration.delay_sd_s = options.delay_sd_s;
    navigate_array(&recording, &geometry, &calibration, choice)
}
