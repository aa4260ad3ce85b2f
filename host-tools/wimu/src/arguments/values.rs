//! Values of options, each parsed and checked in one place.

use std::time::Duration;

use wimu_calib::Face;
use wimu_model::Sensitivity;

/// A parser of numbers from `least` to `most`.
pub fn from_to(
    least: f64,
    most: f64,
) -> impl Fn(&str) -> Result<f64, String> + Clone + Send + Sync + 'static {
    move |text| match text.parse() {
        Ok(value) if (least..=most).contains(&value) => Ok(value),
        _ => Err(format!("give a number from {least} to {most}")),
    }
}

/// A finite number above zero.
pub fn positive(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(value) if value > 0.0 && value.is_finite() => Ok(value),
        _ => Err("give a number above 0".to_owned()),
    }
}

/// A duration in seconds.
pub fn seconds(text: &str) -> Result<Duration, String> {
    text.parse()
        .ok()
        .and_then(|seconds| Duration::try_from_secs_f64(seconds).ok())
        .ok_or_else(|| "give seconds, 0 or more".to_owned())
}

/// A nominal sensitivity, LSB/g.
pub fn sensitivity(text: &str) -> Result<Sensitivity, String> {
    let value = text.parse().map_err(|_| "give a number of LSB/g")?;
    Sensitivity::from_lsb_per_g(value).map_err(|error| error.to_string())
}

/// A side that is up: `x`, `-x`, ….
pub fn side(text: &str) -> Result<Face, String> {
    let text = text.trim().to_ascii_lowercase();
    let (sign, axis) = match text.strip_prefix('-') {
        Some(axis) => (1, axis),
        None => (0, text.strip_prefix('+').unwrap_or(&text)),
    };
    ["x", "y", "z"]
        .iter()
        .position(|name| *name == axis)
        .map(|axis| Face::ALL[2 * axis + sign])
        .ok_or_else(|| "the sides are x, -x, y, -y, z and -z, separated by commas".to_owned())
}
