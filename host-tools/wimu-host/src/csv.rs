//! Sensor data as CSV: how wimu writes tables. [`formats`](crate::formats) reads them, and those of other programs.
//!
//! `Time (s),Accelerometer X (m/s²),Accelerometer Y (m/s²),Accelerometer Z (m/s²),Magnetometer X (µT),…,Temperature (°C)`.
//! Several accelerometers are `Accelerometer 0 X (LSB)`, `Accelerometer 1 X (LSB)`, …. A column
//! `Sensitivity (LSB/g)` is the unit of counts; where it is empty, the unit is unknown.

pub(crate) mod number;

use std::io::Write;

use serde::{Deserialize, Serialize};

use crate::{Code, Problem, Result};

/// The column of times.
pub const TIME: &str = "Time (s)";
/// The column with the sensitivity of the counts of a row.
pub const SENSITIVITY: &str = "Sensitivity (LSB/g)";
/// The column with the unit of the angular rates of a row.
pub const GYROSCOPE_SCALE: &str = "Gyroscope Scale (rad/s/LSB)";
/// The column of temperatures.
pub const TEMPERATURE: &str = "Temperature (°C)";

/// The columns of the three axes of a sensor: `Accelerometer X (LSB)`, ….
pub fn axes(sensor: &str, unit: &str) -> [String; 3] {
    ["X", "Y", "Z"].map(|axis| format!("{sensor} {axis} ({unit})"))
}

/// Unit of all accelerometer columns of a file.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum AccelerationUnit {
    /// Raw counts.
    #[serde(rename = "LSB")]
    Lsb,
    /// m/s².
    #[serde(rename = "m/s²")]
    Mps2,
}

impl AccelerationUnit {
    /// The unit's name as written to files.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Lsb => "LSB",
            Self::Mps2 => "m/s²",
        }
    }
}

/// Rows to keep: `Run=2,IMU=0` keeps those whose columns `Run` and `IMU` hold these values.
/// Numbers compare as numbers.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Filter(Vec<(String, String)>);

impl Filter {
    /// Of these rows, those with this content of a column.
    pub(crate) fn with(mut self, column: &str, content: &str) -> Self {
        self.0.push((column.to_owned(), content.to_owned()));
        self
    }

    /// Columns and the values that they must have.
    pub(crate) fn pairs(&self) -> &[(String, String)] {
        &self.0
    }
}

impl std::str::FromStr for Filter {
    type Err = Problem;

    fn from_str(text: &str) -> Result<Self> {
        let pair = |pair: &str| match pair.split_once('=') {
            Some((column, value)) if !column.trim().is_empty() => {
                Ok((column.trim().to_owned(), value.trim().to_owned()))
            }
            _ => Err(Code::Usage.error(
                format!("`{pair}` in the row filter is not COLUMN=VALUE"),
                "write for example --where \"Run=2,IMU=0\"",
            )),
        };
        text.split(',').map(pair).collect::<Result<_>>().map(Self)
    }
}

/// Writes rows that [`formats::load`](crate::formats::load) reads back the same.
pub struct CsvWriter<W: Write> {
    name: String,
    writer: csv::Writer<W>,
    fields: Vec<String>,
    columns: usize,
}

impl<W: Write> CsvWriter<W> {
    /// Writes the header; `name` is what errors call the file.
    ///
    /// # Errors
    /// `file_failed`.
    pub fn new(sink: W, name: &str, columns: &[String]) -> Result<Self> {
        let mut writer = Self {
            name: name.to_owned(),
            writer: csv::Writer::from_writer(sink),
            fields: columns.to_vec(),
            columns: columns.len(),
        };
        writer.end_row()?;
        Ok(writer)
    }

    /// Adds a field to the row; an empty one of a number that is not finite.
    pub fn field(&mut self, value: impl ToString) -> &mut Self {
        let text = value.to_string();
        let is_finite = !matches!(text.as_str(), "inf" | "-inf" | "NaN");
        self.fields.push(if is_finite { text } else { String::new() });
        self
    }

    /// Adds a number; an empty field without one.
    pub fn number(&mut self, value: Option<f64>) -> &mut Self {
        self.field(value.map_or_else(String::new, |value| value.to_string()))
    }

    /// Adds the components of a vector; empty fields without one.
    pub fn vector<const N: usize>(&mut self, vector: Option<[f64; N]>) -> &mut Self {
        for axis in 0..N {
            self.number(vector.map(|vector| vector[axis]));
        }
        self
    }

    /// Adds a time, ns, in seconds.
    pub fn time(&mut self, ns: Option<i64>) -> &mut Self {
        self.field(ns.map(number::seconds).unwrap_or_default())
    }

    /// Writes the row, with empty fields for those that are missing at its end.
    ///
    /// # Errors
    /// `file_failed`.
    pub fn end_row(&mut self) -> Result<()> {
        self.fields.resize(self.columns, String::new());
        let written = self.writer.write_record(&self.fields);
        self.fields.clear();
        written.map_err(|error| Problem::file(&self.name, "write", &error.into()))
    }

    /// Writes what is buffered.
    ///
    /// # Errors
    /// `file_failed`.
    pub fn finish(mut self) -> Result<()> {
        let flushed = self.writer.flush();
        flushed.map_err(|error| Problem::file(&self.name, "write", &error))
    }
}
