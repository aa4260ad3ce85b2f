//! Shared code of the commands for an array of accelerometers on one body.

use wimu_host::array::{ArrayGeometry, RefineOptions};

/// Uncertainty of positions and delays: that of the options, of the geometry, or the default.
pub fn prior(
    place_sd_mm: Option<f64>,
    delay_sd_us: Option<f64>,
    geometry: &ArrayGeometry,
) -> RefineOptions {
    let default = RefineOptions::default();
    let place = place_sd_mm.or(geometry.place_sd_mm).map(|mm| mm * 1e-3);
    let delay = delay_sd_us.or(geometry.delay_sd_us).map(|us| us * 1e-6);
    RefineOptions {
        place_sd_m: place.unwrap_or(default.place_sd_m),
        delay_sd_s: delay.unwrap_or(default.delay_sd_s),
    }
}
