//! Values of options, each parsed and checked in one place.

use std::time::Duration;

use wimu_calib::Face;
use wimu_host::inertial::StartPose;
use wimu_model::{STANDARD_GRAVITY_MPS2, Sensitivity};

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

/// An acceleration with its unit, in m/s².
pub fn acceleration(text: &str) -> Result<f64, String> {
    let units = [("mg", 1e-3 * STANDARD_GRAVITY_MPS2), ("mm/s2", 1e-3), ("m/s2", 1.0)];
    let text = text.replace('²', "2");
    let known = units.into_iter().find_map(|(unit, mps2)| {
        let value: f64 = text.strip_suffix(unit)?.trim().parse().ok()?;
        Some(value * mps2).filter(|value| *value > 0.0 && value.is_finite())
    });
    known.ok_or_else(|| "give a number above 0 with its unit, such as 10mg or 50mm/s2".to_owned())
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

/// A place on the Earth: latitude, degrees, and height above sea level, m.
pub type Place = [f64; 2];

/// `LATITUDE` or `LATITUDE,HEIGHT`.
pub fn place(text: &str) -> Result<Place, String> {
    let (latitude, height) = text.split_once(',').unwrap_or((text, "0"));
    Ok([from_to(-90.0, 90.0)(latitude)?, from_to(-500.0, 9000.0)(height)?])
}

/// Times from–to, s.
pub type TimeSpans = Vec<std::ops::RangeInclusive<f64>>;

/// Spans of time: `0-3,10.5-12`.
pub fn time_spans(text: &str) -> Result<TimeSpans, String> {
    let span = |part: &str| {
        let (from, to) = part.trim().split_once('-')?;
        let (from, to) = (from.trim().parse().ok()?, to.trim().parse().ok()?);
        (0.0 <= from && from < to && f64::is_finite(to)).then_some(from..=to)
    };
    let spans: Option<TimeSpans> = text.split(',').map(span).collect();
    spans.ok_or_else(|| "give times from-to in seconds, such as 0-3,10.5-12".to_owned())
}

/// A start: `E,N,U` in metres, and perhaps the heading in degrees.
pub fn start_pose(text: &str) -> Result<StartPose, String> {
    let numbers: Option<Vec<f64>> = text
        .split(',')
        .map(|part| part.trim().parse().ok().filter(|v: &f64| v.is_finite()))
        .collect();
    let (e, n, u, heading) = match numbers.as_deref() {
        Some([e, n, u]) => (*e, *n, *u, None),
        Some([e, n, u, degrees]) => (*e, *n, *u, Some(degrees.to_radians())),
        _ => return Err("give E,N,U in metres, or E,N,U,HEADING with degrees".to_owned()),
    };
    Ok(StartPose { position_m: [e, n, u], heading_rad: heading })
}
