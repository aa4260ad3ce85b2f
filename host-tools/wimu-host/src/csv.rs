//! Sensor data as CSV: how wimu writes tables. [`formats`](crate::formats) reads them, and those of other programs.
//!
//! `Time (s),Accelerometer X (m/s²),Accelerometer Y (m/s²),Accelerometer Z (m/s²),Magnetometer X (µT),…,Temperature (°C)`.
//! Several accelerometers are `Accelerometer 0 X (LSB)`, `Accelerometer 1 X (LSB)`, …. A column
//! `Sensitivity (LSB/g)` is the unit of counts; where it is empty, the unit is unknown.

mod columns;
pub(crate) mod line;
pub(crate) mod number;

use std::io::Write;

pub(crate) use columns::acceleration;
pub use columns::{AccelerationUnit, Header};

use crate::error::{ErrorCode, HostError, Result};

/// The column with the sensitivity of the counts of a row.
pub const SENSITIVITY: &str = "Sensitivity (LSB/g)";

/// One line of a file.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Row {
    /// Time, ns, on the clock of the file; `None` without a time column.
    pub time_ns: Option<i64>,
    /// X, Y, Z per accelerometer, in the order and unit of the header.
    pub accelerations: Vec<[f64; 3]>,
    /// Magnetic field, µT; `None` where the fields are empty.
    pub magnetic_field_ut: Option<[f64; 3]>,
    /// Temperature, °C; `None` where the field is empty.
    pub temperature_c: Option<f64>,
    /// The other columns' fields, in the order of [`Header::other`].
    pub other: Vec<String>,
}

/// Rows to keep: `Run=2,IMU=0` keeps those whose columns `Run` and `IMU` hold these values.
/// Numbers compare as numbers.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Filter(Vec<(String, String)>);

impl Filter {
    /// Columns and the values that they must have.
    pub(crate) fn pairs(&self) -> &[(String, String)] {
        &self.0
    }
}

impl std::str::FromStr for Filter {
    type Err = HostError;

    fn from_str(text: &str) -> Result<Self> {
        text.split(',')
            .map(|pair| match pair.split_once('=') {
                Some((column, value)) if !column.trim().is_empty() => {
                    Ok((column.trim().to_owned(), value.trim().to_owned()))
                }
                _ => Err(ErrorCode::Usage.error(
                    format!("`{pair}` in the row filter is not COLUMN=VALUE"),
                    "write for example --where \"Run=2,IMU=0\"",
                )),
            })
            .collect::<Result<_>>()
            .map(Self)
    }
}

/// Writes rows that [`formats::load`](crate::formats::load) reads back the same.
pub struct CsvWriter<W: Write> {
    name: String,
    sink: W,
    header: Header,
}

impl<W: Write> CsvWriter<W> {
    /// Writes the header; `name` is what errors call the file.
    ///
    /// # Errors
    /// `file_failed`.
    pub fn new(sink: W, name: &str, header: Header) -> Result<Self> {
        let mut writer = Self {
            name: name.to_owned(),
            sink,
            header,
        };
        let names = writer.header.column_names();
        writer.put(&names)?;
        Ok(writer)
    }

    /// Writes one row; fields of the header that the row does not have are left empty.
    ///
    /// # Errors
    /// `file_failed`.
    pub fn write(&mut self, row: &Row) -> Result<()> {
        let mut fields = Vec::new();
        if self.header.time {
            fields.push(row.time_ns.map(number::seconds).unwrap_or_default());
        }
        for sensor in 0..self.header.accelerometers.len() {
            match row.accelerations.get(sensor) {
                Some(axes) => fields.extend(axes.map(|value| value.to_string())),
                None => fields.extend([const { String::new() }; 3]),
            }
        }
        if self.header.magnetometer {
            match row.magnetic_field_ut {
                Some(axes) => fields.extend(axes.map(|value| value.to_string())),
                None => fields.extend([const { String::new() }; 3]),
            }
        }
        if self.header.temperature {
            fields.push(row.temperature_c.map(|c| c.to_string()).unwrap_or_default());
        }
        let others = self.header.other.len();
        fields.extend(
            row.other
                .iter()
                .cloned()
                .chain(std::iter::repeat(String::new()))
                .take(others),
        );
        self.put(&fields)
    }

    /// Writes what is buffered.
    ///
    /// # Errors
    /// `file_failed`.
    pub fn finish(mut self) -> Result<()> {
        self.sink
            .flush()
            .map_err(|error| HostError::file(&self.name, "write", &error))
    }

    fn put(&mut self, fields: &[String]) -> Result<()> {
        self.sink
            .write_all(line::join(fields).as_bytes())
            .map_err(|error| HostError::file(&self.name, "write", &error))
    }
}
