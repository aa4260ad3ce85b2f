//! Sensor data as CSV: one header line with units in parentheses, any column order.
//!
//! `Time (s),Accelerometer X (m/s²),Accelerometer Y (m/s²),Accelerometer Z (m/s²),Magnetometer X (µT),…,Temperature (°C)`.
//! Several accelerometers are `Accelerometer 0 X (LSB)`, `Accelerometer 1 X (LSB)`, …. A byte order
//! mark, CRLF, quotes and both µ characters are accepted. Other columns are kept as text. A column
//! `Sensitivity (LSB/g)` is the unit of counts: a table is read as long as it stays the same, and rows
//! where it is empty, whose unit is unknown, are left out.
//!
//! Files of other programs are read where their columns are unambiguous: `Acceleration x (m/s^2)`, `acc_x [g]`,
//! `AccelX (mg)`, `Timestamp (ms)`, `Magnetic field x (µT)` and the like, always with a unit, and only where
//! no column with a name of this format has the same quantity. Fields may be separated by semicolons or tabs, then with
//! decimal commas too. Lines that begin with `#` are skipped.
//!
//! ```
//! use wimu_host::csv::CsvReader;
//!
//! let text = "Time (ms),Accelerometer X (g),Accelerometer Y (g),Accelerometer Z (g),Pose\n0,0,0.5,1,a\n";
//! let mut reader = CsvReader::new(text.as_bytes(), "poses.csv")?;
//! let row = reader.next_row()?.expect("there is a row");
//! assert_eq!(row.accelerations, [[0.0, 0.5, 1.0]]);
//! assert_eq!(row.other, ["a"]);
//! # Ok::<(), wimu_host::HostError>(())
//! ```

mod columns;
pub(crate) mod line;
pub(crate) mod number;

use std::fs::File;
use std::io::{BufRead, BufReader, Write};
use std::path::Path;

pub(crate) use columns::acceleration;
pub use columns::{AccelerationUnit, Header};
use columns::{Columns, Quantity};
use line::Lines;

use crate::error::{ErrorCode, HostError, Result};
use crate::foreign;

/// The column with the sensitivity of the counts of a row.
pub const SENSITIVITY: &str = "Sensitivity (LSB/g)";

/// One line of a file.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Row {
    /// Its line in the file, from 1; not written.
    pub line: u64,
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

/// Reads rows one at a time; memory does not grow with the file.
pub struct CsvReader<R> {
    name: String,
    lines: Lines<R>,
    fields: Vec<String>,
    header: Header,
    columns: Columns,
    /// Index of a column and the value that it must have.
    filter: Vec<(usize, String)>,
    ordered: bool,
    /// Whether sensor fields may be empty.
    with_holes: bool,
    /// Index of the sensitivity column of a table of counts.
    sensitivity: Option<usize>,
    /// The sensitivity of the rows so far, as written.
    unit: Option<String>,
    /// The decimal mark, once a number has one.
    decimal_mark: Option<char>,
    /// Time and line of the last row.
    last: Option<(i64, u64)>,
}

impl CsvReader<BufReader<File>> {
    /// Opens a file and reads its header.
    ///
    /// # Errors
    /// `file_unreadable`, and those of [`CsvReader::new`].
    pub fn open(path: &Path) -> Result<Self> {
        let name = path.display().to_string();
        let file = File::open(path).map_err(|error| HostError::file(&name, "open", &error))?;
        Self::new(BufReader::new(file), &name)
    }
}

impl<R: BufRead> CsvReader<R> {
    /// Reads the header; `name` is what errors call the file.
    ///
    /// # Errors
    /// `csv_empty`, `csv_no_header`, `csv_missing_column` (an axis whose neighbours are there),
    /// `csv_duplicate_column`, `csv_unknown_unit`, `csv_mixed_units`, `csv_not_utf8`: with the
    /// column's name; `unknown_format`.
    pub fn new(mut source: R, name: &str) -> Result<Self> {
        if let Some(error) = source.fill_buf().ok().and_then(foreign::refused) {
            return Err(error.at(name));
        }
        let mut lines = Lines::new(source);
        let mut fields = Vec::new();
        let location = |error: HostError, line: u64| {
            let column = error.location().filter(|column| !column.is_empty());
            let column = column
                .map(|c| format!(", column `{c}`"))
                .unwrap_or_default();
            error.at(format!("{name} line {line}{column}"))
        };
        let found = lines
            .next_fields(&mut fields)
            .map_err(|error| location(error, lines.number))?;
        if found.is_none() {
            return Err(ErrorCode::CsvEmpty
                .error(
                    "the file is empty",
                    "a CSV file starts with a line of column names and units",
                )
                .at(name));
        }
        if let [only] = fields.as_slice()
            && only.contains('|')
        {
            return Err(location(
                ErrorCode::CsvNoHeader.error(
                    "the fields are separated by '|'",
                    "separate the fields by commas, semicolons or tabs",
                ),
                lines.number,
            ));
        }
        let (header, columns) =
            columns::parse(&fields).map_err(|error| location(error, lines.number))?;
        let counts = header.acceleration_unit == AccelerationUnit::Lsb;
        let sensitivity = columns.names().iter().position(|name| name == SENSITIVITY);
        Ok(Self {
            name: name.to_owned(),
            sensitivity: sensitivity.filter(|_| counts && !header.accelerometers.is_empty()),
            unit: None,
            lines,
            fields,
            header,
            columns,
            filter: Vec::new(),
            ordered: true,
            with_holes: false,
            decimal_mark: None,
            last: None,
        })
    }

    /// Keeps only the rows that `filter` names.
    ///
    /// # Errors
    /// `csv_missing_column` when the file has no such column.
    pub fn select(mut self, filter: &Filter) -> Result<Self> {
        for (column, value) in &filter.0 {
            let index = self.columns.find(column).ok_or_else(|| {
                ErrorCode::CsvMissingColumn
                    .error(
                        format!("there is no column `{column}` to filter by"),
                        format!("choose from: {}", self.columns.names().join(", ")),
                    )
                    .at(format!("{} line 1", self.name))
            })?;
            self.filter.push((index, value.clone()));
        }
        Ok(self)
    }

    /// Accepts rows in any order of time: for pose means, which are not a time series.
    #[must_use]
    pub fn in_any_order(mut self) -> Self {
        self.ordered = false;
        self
    }

    /// Accepts empty sensor fields and `NaN`: as NaN for an accelerometer, as absent for a magnetometer or thermometer.
    #[must_use]
    pub fn with_holes(mut self) -> Self {
        self.with_holes = true;
        self
    }

    /// What the columns are.
    pub fn header(&self) -> &Header {
        &self.header
    }

    /// What errors call the file.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// The next row; `None` at the end.
    ///
    /// # Errors
    /// `csv_bad_number`, `csv_field_count`, `csv_time_backwards`, `csv_mixed_units` where the
    /// sensitivity changes, `csv_not_utf8`, with line and column; `file_failed`. Reading can go on with the next row.
    pub fn next_row(&mut self) -> Result<Option<Row>> {
        loop {
            let found = self
                .lines
                .next_fields(&mut self.fields)
                .map_err(|error| error.at(self.location(None)))?;
            if found.is_none() {
                return Ok(None);
            }
            let fields = self.fields.len();
            if fields != self.columns.len() {
                return Err(ErrorCode::CsvFieldCount
                    .error(
                        format!("{fields} fields, but the header has {}", self.columns.len()),
                        "complete the line or remove it",
                    )
                    .at(self.location(None)));
            }
            if self.passes_filter() && self.has_unit()? {
                self.write_points()?;
                let row = self.parse_row()?;
                self.check_order(&row)?;
                return Ok(Some(row));
            }
        }
    }

    fn passes_filter(&self) -> bool {
        self.filter.iter().all(|(index, value)| {
            let field = &self.fields[*index];
            field == value
                || matches!((field.parse::<f64>(), value.parse::<f64>()), (Ok(a), Ok(b)) if a == b)
        })
    }

    /// Whether the unit of the counts of the line is known.
    fn has_unit(&mut self) -> Result<bool> {
        let Some(index) = self.sensitivity else {
            return Ok(true);
        };
        let field = &self.fields[index];
        if field.is_empty() {
            return Ok(false);
        }
        match &self.unit {
            Some(unit) if unit != field => Err(ErrorCode::CsvMixedUnits.error(format!("the range changes here: 1 g is {field} LSB, before {unit} LSB"),
                format!(
                        "select the rows of one range with --where \"{SENSITIVITY}={unit}\", or record at one range"
                ),
            )
            .at(self.location(Some(index)))),
            Some(_) => Ok(true),
            None => {
                self.unit = Some(field.clone());
                Ok(true)
            }
        }
    }

    /// Replaces decimal commas by points, where the fields are not separated by commas.
    fn write_points(&mut self) -> Result<()> {
        if self.lines.separator() == ',' {
            return Ok(());
        }
        for index in 0..self.fields.len() {
            let text = &self.fields[index];
            let quantity = self.columns.quantity(index);
            let Some(mark) = text.chars().find(|c| matches!(c, ',' | '.')) else {
                continue;
            };
            if quantity == Quantity::Other {
                continue;
            }
            let counts = self.header.acceleration_unit == AccelerationUnit::Lsb
                && matches!(quantity, Quantity::Acceleration { .. });
            let thousands = mark == ',' && counts && number::has_thousands(text);
            if thousands || *self.decimal_mark.get_or_insert(mark) != mark {
                return Err(ErrorCode::CsvBadNumber
                    .error(
                        format!("`{text}` is ambiguous: decimal comma or thousands separator"),
                        "use a decimal point and no thousands separators",
                    )
                    .at(self.location(Some(index))));
            }
            if mark == ',' {
                self.fields[index] = text.replacen(',', ".", 1);
            }
        }
        Ok(())
    }

    fn parse_row(&self) -> Result<Row> {
        let mut row = Row {
            line: self.lines.number,
            accelerations: vec![[0.0; 3]; self.header.accelerometers.len()],
            ..Row::default()
        };
        let mut magnetic = [None; 3];
        for (index, text) in self.fields.iter().enumerate() {
            let is_hole = self.with_holes && number::is_none(text);
            let number = || {
                number::finite(text).ok_or_else(|| {
                    ErrorCode::CsvBadNumber
                        .error(
                            format!("`{text}` is not a finite number"),
                            "correct the field or remove the line",
                        )
                        .at(self.location(Some(index)))
                })
            };
            match self.columns.quantity(index) {
                Quantity::Time { exponent } => {
                    number()?;
                    let time = number::decimal(text, exponent).ok_or_else(|| {
                        ErrorCode::CsvBadNumber
                            .error(
                                format!("the time `{text}` does not fit 64 bits of nanoseconds"),
                                "check the column's unit",
                            )
                            .at(self.location(Some(index)))
                    })?;
                    row.time_ns = Some(time);
                }
                Quantity::Acceleration { sensor, axis, .. } if is_hole => {
                    row.accelerations[sensor][axis] = f64::NAN;
                }
                Quantity::Acceleration {
                    sensor,
                    axis,
                    factor,
                } => row.accelerations[sensor][axis] = number()? * factor,
                Quantity::MagneticField { axis, ut_per_unit } if !is_hole && !text.is_empty() => {
                    magnetic[axis] = Some(number()? * ut_per_unit);
                }
                Quantity::Temperature if !is_hole && !text.is_empty() => {
                    row.temperature_c = Some(number()?);
                }
                Quantity::MagneticField { .. } | Quantity::Temperature => {}
                Quantity::Other => row.other.push(text.clone()),
            }
        }
        row.magnetic_field_ut = match magnetic {
            [Some(x), Some(y), Some(z)] => Some([x, y, z]),
            [None, None, None] => None,
            _ if self.with_holes => None,
            _ => {
                return Err(ErrorCode::CsvBadNumber
                    .error(
                        "some axes of the magnetometer are empty, others are not",
                        "fill in all three or none",
                    )
                    .at(self.location(None)));
            }
        };
        Ok(row)
    }

    fn check_order(&mut self, row: &Row) -> Result<()> {
        let Some(time) = row.time_ns.filter(|_| self.ordered) else {
            return Ok(());
        };
        if let Some((last, last_line)) = self.last
            && time < last
        {
            return Err(ErrorCode::CsvTimeBackwards.error(format!(
                    "time goes back by {} s after line {last_line}",
                    last.abs_diff(time) as f64 / 1e9
                ),
                    "sort the rows; if the file contains several runs, select one with --where; if its rows are means \
                     over static poses, add --poses",
            )
            .at(self.location(None)));
        }
        self.last = Some((time, row.line));
        Ok(())
    }

    /// Location of the line last read, and of a column of it.
    fn location(&self, column: Option<usize>) -> String {
        let column = column
            .and_then(|index| self.columns.names().get(index))
            .map(|name| format!(", column `{name}`"))
            .unwrap_or_default();
        format!("{} line {}{column}", self.name, self.lines.number)
    }
}

impl<R: BufRead> Iterator for CsvReader<R> {
    type Item = Result<Row>;

    fn next(&mut self) -> Option<Result<Row>> {
        self.next_row().transpose()
    }
}

/// Writes rows that [`CsvReader`] reads back the same.
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

#[cfg(test)]
mod tests;
