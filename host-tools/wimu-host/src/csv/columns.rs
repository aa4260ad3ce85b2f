//! The header line: quantity and unit of each column.

use crate::error::{ErrorCode, Result};

const AXES: [&str; 3] = ["X", "Y", "Z"];

/// Unit of all accelerometer columns of a file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum AccelerationUnit {
    /// Raw counts.
    Lsb,
    /// 9.80665 m/s².
    G,
    /// m/s².
    Mps2,
}

impl AccelerationUnit {
    /// The unit's name as written to files.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Lsb => "LSB",
            Self::G => "g",
            Self::Mps2 => "m/s²",
        }
    }

    /// m/s² per unit; `None` for counts, which need a sensitivity.
    pub fn mps2(self) -> Option<f64> {
        match self {
            Self::Lsb => None,
            Self::G => Some(wimu_model::STANDARD_GRAVITY_MPS2),
            Self::Mps2 => Some(1.0),
        }
    }
}

/// The columns of a file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Header {
    /// Whether it has a time.
    pub time: bool,
    /// The accelerometers' numbers, in the order of [`Row::accelerations`](super::Row); `None` for
    /// one without a number.
    pub accelerometers: Vec<Option<u32>>,
    /// The unit of all accelerometers.
    pub acceleration_unit: AccelerationUnit,
    /// Whether it has a magnetometer.
    pub magnetometer: bool,
    /// Whether it has a temperature.
    pub temperature: bool,
    /// Full names of the other columns.
    pub other: Vec<String>,
}

impl Header {
    /// Column names as [`CsvWriter`](super::CsvWriter) writes them.
    pub(super) fn column_names(&self) -> Vec<String> {
        let mut names = Vec::new();
        if self.time {
            names.push("Time (s)".to_owned());
        }
        for sensor in &self.accelerometers {
            let number = sensor.map(|n| format!("{n} ")).unwrap_or_default();
            let unit = self.acceleration_unit.as_str();
            names.extend(AXES.map(|axis| format!("Accelerometer {number}{axis} ({unit})")));
        }
        if self.magnetometer {
            names.extend(AXES.map(|axis| format!("Magnetometer {axis} (µT)")));
        }
        if self.temperature {
            names.push("Temperature (°C)".to_owned());
        }
        names.extend(self.other.iter().cloned());
        names
    }
}

/// Unit of an acceleration column of this name, with or without its unit, and how many of that unit one of the column's
/// is; `None` for another column.
///
/// # Errors
/// `csv_unknown_unit` for a column of this name with an unknown unit.
pub(crate) fn acceleration(column: &str, name: &str) -> Result<Option<(AccelerationUnit, f64)>> {
    let (bare, unit) = split_unit(column);
    if !bare.eq_ignore_ascii_case(split_unit(name).0) {
        return Ok(None);
    }
    lookup(column, unit, &ACCELERATION_UNITS).map(Some)
}

/// `Name (unit)` or `Name [unit]` in its two parts.
fn split_unit(name: &str) -> (&str, Option<&str>) {
    let within = |open, close| name.strip_suffix(close)?.rsplit_once(open);
    match within('(', ')').or_else(|| within('[', ']')) {
        Some((bare, unit)) => (bare.trim(), Some(unit.trim())),
        None => (name.trim(), None),
    }
}

/// Name, unit, and how many of that unit one is.
const ACCELERATION_UNITS: [(&str, (AccelerationUnit, f64)); 8] = [
    ("LSB", (AccelerationUnit::Lsb, 1.0)),
    ("counts", (AccelerationUnit::Lsb, 1.0)),
    ("g", (AccelerationUnit::G, 1.0)),
    ("mg", (AccelerationUnit::G, 1e-3)),
    ("m/s²", (AccelerationUnit::Mps2, 1.0)),
    ("m/s2", (AccelerationUnit::Mps2, 1.0)),
    ("m/s^2", (AccelerationUnit::Mps2, 1.0)),
    ("m/s/s", (AccelerationUnit::Mps2, 1.0)),
];

fn find<T: Copy>(unit: Option<&str>, known: &[(&str, T)]) -> Option<T> {
    // Both µ characters, Greek mu and micro sign.
    let unit = unit?.replace('\u{3bc}', "\u{b5}");
    let found = known.iter().find(|(text, _)| **text == *unit)?;
    Some(found.1)
}

fn lookup<T: Copy>(name: &str, unit: Option<&str>, known: &[(&str, T)]) -> Result<T> {
    find(unit, known).ok_or_else(|| {
        let message = match unit {
            Some(unit) => format!("the unit `{unit}` is unknown"),
            None => "the unit is missing".to_owned(),
        };
        let known: Vec<_> = known.iter().map(|(text, _)| *text).collect();
        ErrorCode::CsvUnknownUnit
            .error(
                message,
                format!("write one of {} in parentheses", known.join(", ")),
            )
            .at(name)
    })
}
