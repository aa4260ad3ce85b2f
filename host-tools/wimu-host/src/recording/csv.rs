//! A table in wimu's own columns as a recording.

use super::{Quantity, Recording, Sink, TrackInfo, Unit};
use crate::csv::{AccelerationUnit, CsvReader};
use crate::error::Result;

/// TEMPORARY until formats::table.
pub(crate) fn read(
    path: &std::path::Path,
    options: &crate::formats::ReadOptions,
) -> Result<Recording> {
    let (poses, filter) = (options.poses, options.filter.as_ref());
    one_sensor(path, options)?;
    let mut reader = CsvReader::open(path)?.with_holes();
    if let Some(filter) = filter {
        reader = reader.select(filter)?;
    }
    if poses {
        reader = reader.in_any_order();
    }
    let header = reader.header().clone();
    let mut recording = Recording::new(reader.name());
    let unit = match header.acceleration_unit {
        AccelerationUnit::Lsb => Unit::Counts { si_per_lsb: None },
        _ => Unit::Si,
    };
    let factor = header.acceleration_unit.mps2().unwrap_or(1.0);
    let forces: Vec<_> = header
        .accelerometers
        .iter()
        .map(|sensor| {
            let mut info = TrackInfo::new("accelerometer", Quantity::SpecificForce, unit)
                .of_sensor(sensor.unwrap_or(0) as u8);
            info.timeless = !header.time;
            recording.track(info)
        })
        .collect();
    let field = header.magnetometer.then(|| {
        recording.track(TrackInfo::new(
            "magnetometer",
            Quantity::MagneticField,
            Unit::Si,
        ))
    });
    let celsius = header.temperature.then(|| {
        recording.track(TrackInfo::new(
            "temperature",
            Quantity::Temperature,
            Unit::Si,
        ))
    });
    let find = |name: &str| header.other.iter().position(|n| n == name);
    let all = |names: [&str; 3]| {
        let [x, y, z] = names.map(find);
        Some([x?, y?, z?])
    };
    let mut vectors = Vec::new();
    for (names, quantity, factor, origin) in [
        (
            [
                "Gyroscope X (rad/s)",
                "Gyroscope Y (rad/s)",
                "Gyroscope Z (rad/s)",
            ],
            Quantity::AngularRate,
            1.0,
            super::Origin::Sensor,
        ),
        (
            [
                "Gyroscope X (deg/s)",
                "Gyroscope Y (deg/s)",
                "Gyroscope Z (deg/s)",
            ],
            Quantity::AngularRate,
            1f64.to_radians(),
            super::Origin::Sensor,
        ),
        (
            [
                "Gyroscope X (LSB)",
                "Gyroscope Y (LSB)",
                "Gyroscope Z (LSB)",
            ],
            Quantity::AngularRate,
            1.0,
            super::Origin::Sensor,
        ),
        (
            [
                "Truth Position E (m)",
                "Truth Position N (m)",
                "Truth Position U (m)",
            ],
            Quantity::Position,
            1.0,
            super::Origin::Truth,
        ),
    ] {
        if let Some(columns) = all(names) {
            let unit = if names[0].ends_with("(LSB)") {
                Unit::Counts { si_per_lsb: None }
            } else {
                Unit::Si
            };
            let track = recording.track(TrackInfo::new(names[0], quantity, unit).made_by(origin));
            vectors.push((track, columns.to_vec(), factor));
        }
    }
    let q = ["W", "X", "Y", "Z"].map(|a| find(&format!("Truth Quaternion {a}")));
    if let [Some(w), Some(x), Some(y), Some(z)] = q {
        let track = recording.track(
            TrackInfo::new("truth", Quantity::Attitude, Unit::Si).made_by(super::Origin::Truth),
        );
        vectors.push((track, vec![w, x, y, z], 1.0));
    }
    let scale = find("Gyroscope Scale (rad/s/LSB)");
    let sensitivity = find(crate::csv::SENSITIVITY);
    let other: Vec<_> = header
        .other
        .iter()
        .map(|name| recording.track(TrackInfo::new(name, Quantity::Scalar, Unit::Unknown)))
        .collect();
    for (index, row) in reader.enumerate() {
        let row = row?;
        let time = row.time_ns.unwrap_or(index as i64 * 10_000_000);
        for (track, value) in forces.iter().zip(&row.accelerations) {
            recording.row(*track, time, &value.map(|axis| axis * factor));
        }
        if let Some(track) = field {
            let value = row.magnetic_field_ut.unwrap_or([f64::NAN; 3]);
            recording.row(track, time, &value.map(|ut| ut * 1e-6));
        }
        if let Some(track) = celsius {
            recording.row(track, time, &[row.temperature_c.unwrap_or(f64::NAN)]);
        }
        let value = |k: usize| row.other[k].parse::<f64>().unwrap_or(f64::NAN);
        if index == 0 {
            if let (Some(k), Some(track)) = (sensitivity, forces.first())
                && value(k) > 0.0
                && unit != Unit::Si
            {
                recording.tracks[track.0].info.unit = Unit::Counts {
                    si_per_lsb: Some(9.80665 / value(k)),
                };
            }
            if let Some(k) = scale {
                for track in &mut recording.tracks {
                    if track.info.quantity == Quantity::AngularRate && track.info.unit != Unit::Si {
                        track.info.unit = Unit::Counts {
                            si_per_lsb: Some(value(k)),
                        };
                    }
                }
            }
        }
        for (track, columns, factor) in &vectors {
            let values: Vec<f64> = columns.iter().map(|k| value(*k) * factor).collect();
            recording.row(*track, time, &values);
        }
        for (track, text) in other.iter().zip(&row.other) {
            recording.row(*track, time, &[text.parse().unwrap_or(f64::NAN)]);
        }
    }
    Ok(recording)
}

/// Names of columns that identify a sensor, and a run.
const SENSORS: [&str; 5] = ["imu", "sensor", "device", "unit", "board"];
const RUNS: [&str; 4] = ["run", "trial", "session", "recording"];
/// Largest number of values of such a column.
const MAX_VALUES: usize = 64;

/// Refuses a file with rows of several sensors, or of several runs whose times start again.
fn one_sensor(path: &std::path::Path, options: &crate::formats::ReadOptions) -> Result<()> {
    let mut reader = CsvReader::open(path)?.with_holes().in_any_order();
    let names = reader.header().other.clone();
    let is_one_of = |k: usize, known: &[&str]| known.contains(&names[k].to_lowercase().as_str());
    let named = (0..names.len()).filter(|k| is_one_of(*k, &SENSORS) || is_one_of(*k, &RUNS));
    let mut found: Vec<(usize, std::collections::BTreeSet<String>)> = named
        .map(|k| (k, std::collections::BTreeSet::new()))
        .collect();
    if found.is_empty() {
        return Ok(());
    }
    if let Some(filter) = &options.filter {
        reader = reader.select(filter)?;
    }
    let (mut last_ns, mut restarts) = (None, false);
    // Errors in rows are reported where the rows are used.
    for row in reader.flatten() {
        restarts |= !options.poses && row.time_ns < last_ns;
        last_ns = row.time_ns;
        for (k, values) in found.iter_mut().filter(|(_, v)| v.len() <= MAX_VALUES) {
            values.extend(row.other.get(*k).cloned());
        }
    }
    let (mut several, mut selected) = (Vec::new(), Vec::new());
    for (k, values) in found {
        let differ = (2..=MAX_VALUES).contains(&values.len());
        if differ && (restarts || is_one_of(k, &SENSORS)) {
            let values: Vec<String> = values.into_iter().collect();
            several.push(format!("`{}` is {}", names[k], values.join(", ")));
            selected.push(format!("{}={}", names[k], values[0]));
        }
    }
    if several.is_empty() {
        return Ok(());
    }
    let (several, selected) = (several.join("; "), selected.join(","));
    Err(crate::ErrorCode::Usage
        .error(
            format!("the rows are of several sensors or runs: {several}"),
            format!("select one with --where \"{selected}\", or remove the other rows"),
        )
        .at(path.display().to_string()))
}
