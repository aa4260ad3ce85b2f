//! The header line: quantity and unit of each column.

use crate::error::{ErrorCode, HostError, Result};

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

const AXES: [&str; 3] = ["X", "Y", "Z"];

/// Content of one column.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Quantity {
    /// The value times 10^exponent is in ns.
    Time {
        exponent: i32,
    },
    Acceleration {
        sensor: usize,
        axis: usize,
        /// The header's unit per unit of the column.
        factor: f64,
    },
    MagneticField {
        axis: usize,
        ut_per_unit: f64,
    },
    Temperature,
    Other,
}

/// Name and content of every column.
pub struct Columns {
    names: Vec<String>,
    quantities: Vec<Quantity>,
}

impl Columns {
    pub fn len(&self) -> usize {
        self.names.len()
    }

    pub fn names(&self) -> &[String] {
        &self.names
    }

    pub fn quantity(&self, index: usize) -> Quantity {
        self.quantities[index]
    }

    /// The column called `name`, with or without its unit.
    pub fn find(&self, name: &str) -> Option<usize> {
        self.names
            .iter()
            .position(|column| column.eq_ignore_ascii_case(name))
            .or_else(|| {
                self.names
                    .iter()
                    .position(|column| split_unit(column).0.eq_ignore_ascii_case(name))
            })
    }
}

/// Quantity of a column, without its unit.
#[derive(Clone, Copy, PartialEq)]
enum Kind {
    Time,
    Acceleration { number: Option<u32>, axis: usize },
    MagneticField { axis: usize },
    Temperature,
    Other,
}

/// Parses the fields of the header; the location of an error is the column's name alone.
pub fn parse(names: &[String]) -> Result<(Header, Columns)> {
    if !names.is_empty() && names.iter().all(|name| name.parse::<f64>().is_ok()) {
        return Err(ErrorCode::CsvNoHeader.error("the first line holds numbers, not column names",
            "put a header first, such as `Time (s),Accelerometer X (g),Accelerometer Y (g),Accelerometer Z (g)`",
        ));
    }
    let mut header = Header {
        time: false,
        accelerometers: Vec::new(),
        acceleration_unit: AccelerationUnit::Mps2,
        magnetometer: false,
        temperature: false,
        other: Vec::new(),
    };
    let mut kinds: Vec<Kind> = Vec::with_capacity(names.len());
    let mut quantities = Vec::with_capacity(names.len());
    // The first column of the quantity, whose unit the others must have.
    let mut acceleration: Option<(&str, (AccelerationUnit, f64))> = None;
    let mut magnetic: Option<(&str, f64)> = None;
    for (index, name) in names.iter().enumerate() {
        let (bare, unit) = split_unit(name);
        let is_first = names[..index]
            .iter()
            .all(|earlier| !split_unit(earlier).0.eq_ignore_ascii_case(bare));
        if !is_first && !bare.is_empty() {
            return Err(ErrorCode::CsvDuplicateColumn
                .error(
                    format!("the column `{bare}` occurs twice"),
                    "rename or remove one",
                )
                .at(name));
        }
        let kind = meaning(names, bare, unit);
        quantities.push(match kind {
            Kind::Time => {
                header.time = true;
                Quantity::Time {
                    exponent: lookup(name, unit, &TIME_UNITS)?,
                }
            }
            Kind::Acceleration { number, axis } => {
                let unit = lookup(name, unit, &ACCELERATION_UNITS)?;
                let (first, first_unit) = *acceleration.get_or_insert((name, unit));
                if unit != first_unit {
                    return Err(mixed_units(name, first));
                }
                let (unit, factor) = unit;
                header.acceleration_unit = unit;
                let known = header.accelerometers.iter().position(|n| *n == number);
                let sensor = known.unwrap_or_else(|| {
                    header.accelerometers.push(number);
                    header.accelerometers.len() - 1
                });
                Quantity::Acceleration {
                    sensor,
                    axis,
                    factor,
                }
            }
            Kind::MagneticField { axis } => {
                let ut_per_unit = lookup(name, unit, &MAGNETIC_UNITS)?;
                let (first, first_unit) = *magnetic.get_or_insert((name, ut_per_unit));
                if ut_per_unit != first_unit {
                    return Err(mixed_units(name, first));
                }
                header.magnetometer = true;
                Quantity::MagneticField { axis, ut_per_unit }
            }
            Kind::Temperature => {
                lookup(name, unit, &TEMPERATURE_UNITS)?;
                header.temperature = true;
                Quantity::Temperature
            }
            Kind::Other => {
                header.other.push(name.clone());
                Quantity::Other
            }
        });
        if kind != Kind::Other && kinds.contains(&kind) {
            return Err(ErrorCode::CsvDuplicateColumn
                .error(
                    "another column has the same quantity",
                    "rename or remove one",
                )
                .at(name));
        }
        kinds.push(kind);
    }
    for &number in &header.accelerometers {
        let sensor = number.map_or("Accelerometer".to_owned(), |n| format!("Accelerometer {n}"));
        all_axes(&sensor, header.acceleration_unit.as_str(), |axis| {
            kinds.contains(&Kind::Acceleration { number, axis })
        })?;
    }
    if header.magnetometer {
        all_axes("Magnetometer", "µT", |axis| {
            kinds.contains(&Kind::MagneticField { axis })
        })?;
    }
    let columns = Columns {
        names: names.to_vec(),
        quantities,
    };
    Ok((header, columns))
}

/// Quantity of a column among `names`. Names of other programs are accepted if they have a unit of that quantity and
/// the file has no column of this format for it.
fn meaning(names: &[String], bare: &str, unit: Option<&str>) -> Kind {
    let ours = kind_of_ours(bare);
    if ours != Kind::Other {
        return ours;
    }
    let theirs = kind_of_theirs(bare);
    let goes = match theirs {
        Kind::Time => find(unit, &TIME_UNITS).is_some(),
        Kind::Acceleration { .. } => find(unit, &ACCELERATION_UNITS).is_some(),
        Kind::MagneticField { .. } => find(unit, &MAGNETIC_UNITS).is_some(),
        Kind::Temperature => find(unit, &TEMPERATURE_UNITS).is_some(),
        Kind::Other => false,
    };
    let alike = |kind: Kind| std::mem::discriminant(&kind) == std::mem::discriminant(&theirs);
    let has_ours = || {
        names
            .iter()
            .any(|name| alike(kind_of_ours(split_unit(name).0)))
    };
    if goes && !has_ours() {
        theirs
    } else {
        Kind::Other
    }
}

/// `Time`, `Accelerometer X`, `Accelerometer 2 X`, ….
fn kind_of_ours(bare: &str) -> Kind {
    let bare = bare.to_ascii_lowercase();
    match bare.split_whitespace().collect::<Vec<_>>()[..] {
        ["time"] => Kind::Time,
        ["temperature"] => Kind::Temperature,
        ["accelerometer", word] => axis(word).map_or(Kind::Other, |axis| Kind::Acceleration {
            number: None,
            axis,
        }),
        ["accelerometer", number, word] => match (number.parse(), axis(word)) {
            (Ok(number), Some(axis)) => Kind::Acceleration {
                number: Some(number),
                axis,
            },
            _ => Kind::Other,
        },
        ["magnetometer", word] => {
            axis(word).map_or(Kind::Other, |axis| Kind::MagneticField { axis })
        }
        _ => Kind::Other,
    }
}

/// `Timestamp`, `Acceleration x`, `acc_x`, `AccelX`, `ax`, `Magnetic field x`, `Temp`, ….
fn kind_of_theirs(bare: &str) -> Kind {
    let bare = bare.to_ascii_lowercase().replace('_', " ");
    if ["timestamp", "t"].contains(&bare.as_str()) {
        return Kind::Time;
    }
    if bare == "temp" {
        return Kind::Temperature;
    }
    let Some((at, last)) = bare.char_indices().last() else {
        return Kind::Other;
    };
    let Some(axis) = axis(&last.to_string()) else {
        return Kind::Other;
    };
    match bare[..at].trim_end() {
        "acceleration" | "accelerometer" | "accel" | "acc" | "a" => {
            Kind::Acceleration { number: None, axis }
        }
        "magnetic field" | "magnetometer" | "mag" | "m" => Kind::MagneticField { axis },
        _ => Kind::Other,
    }
}

fn axis(word: &str) -> Option<usize> {
    AXES.iter().position(|axis| axis.eq_ignore_ascii_case(word))
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

const TIME_UNITS: [(&str, i32); 5] = [("s", 9), ("ms", 6), ("us", 3), ("µs", 3), ("ns", 0)];
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
/// µT per unit.
const MAGNETIC_UNITS: [(&str, f64); 4] = [("µT", 1.0), ("uT", 1.0), ("T", 1e6), ("G", 100.0)];
const TEMPERATURE_UNITS: [(&str, ()); 2] = [("°C", ()), ("C", ())];

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

fn mixed_units(name: &str, first: &str) -> HostError {
    ErrorCode::CsvMixedUnits
        .error(
            format!("its unit differs from that of `{first}`"),
            "convert the columns to one unit",
        )
        .at(name)
}

fn all_axes(sensor: &str, unit: &str, has: impl Fn(usize) -> bool) -> Result<()> {
    match (0..3).find(|axis| !has(*axis)) {
        None => Ok(()),
        Some(axis) => Err(ErrorCode::CsvMissingColumn.error(
            format!("there is no column `{sensor} {} ({unit})`", AXES[axis]),
            "all three axes are needed: add it, or rename the others if they are something else",
        )),
    }
}
