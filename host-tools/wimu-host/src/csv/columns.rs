//! Tables of measurements: columns `NAME (UNIT)` in any order, read in SI units.

use std::path::Path;

use super::number::{finite, is_none};
use crate::{Code, Problem, Result};

/// Names of units and their size in SI units.
pub(crate) type Units = &'static [(&'static str, f64)];
/// A number without a unit.
pub(crate) const NUMBER: Units = &[("", 1.0)];
pub(crate) const LENGTH: Units = &[("m", 1.0), ("cm", 1e-2), ("mm", 1e-3)];
pub(crate) const TIME: Units =
    &[("s", 1.0), ("ms", 1e-3), ("us", 1e-6), ("µs", 1e-6), ("ns", 1e-9)];
pub(crate) const SPEED: Units = &[("m/s", 1.0), ("km/h", 1.0 / 3.6)];
pub(crate) const ANGLE: Units = &[("rad", 1.0), ("deg", std::f64::consts::PI / 180.0)];

/// A CSV file in memory.
pub(crate) struct Table {
    pub name: String,
    pub header: Vec<String>,
    pub rows: Vec<csv::StringRecord>,
}

/// A column and the size of its unit.
#[derive(Clone, Copy)]
pub(crate) struct Column(usize, f64);

impl Table {
    pub fn read(path: &Path) -> Result<Self> {
        Self::read_or(path, |_| None)
    }

    /// The same of a file that `converted` may turn into a CSV table with a header.
    pub fn read_or(path: &Path, converted: impl Fn(&str) -> Option<String>) -> Result<Self> {
        let name = path.display().to_string();
        let text = std::fs::read_to_string(path).map_err(|e| Problem::file(&name, "read", &e))?;
        Self::of(name, &converted(&text).unwrap_or(text))
    }

    /// The table that a text is.
    pub fn of(name: String, text: &str) -> Result<Self> {
        let text = text.strip_prefix('\u{feff}').unwrap_or(text);
        let mut reader = csv::ReaderBuilder::new()
            .flexible(true)
            .trim(csv::Trim::All)
            .comment(Some(b'#'))
            .from_reader(text.as_bytes());
        let bad = |error: csv::Error| {
            let remedy = "check that it is a CSV table with a header";
            Code::CsvBadNumber.error(error.to_string(), remedy).at(&name)
        };
        let header = reader.headers().map_err(bad)?;
        let header = header.iter().map(str::to_owned).collect();
        let rows = reader.records().collect::<std::result::Result<_, _>>().map_err(bad)?;
        Ok(Self { name, header, rows })
    }

    /// The column `NAME (UNIT)`, or `NAME` without a unit, for one of several names.
    pub fn column(&self, names: &[&str], units: Units) -> Option<Column> {
        self.header.iter().enumerate().find_map(|(at, column)| {
            let united = column.strip_suffix(')').and_then(|c| c.split_once(" ("));
            let (name, unit) = united.unwrap_or((column, ""));
            let known = names.iter().any(|n| n.eq_ignore_ascii_case(name));
            let size = units.iter().find(|(u, _)| *u == unit)?.1;
            known.then_some(Column(at, size))
        })
    }

    pub fn needed(&self, names: &[&str], units: Units) -> Result<Column> {
        self.column(names, units).ok_or_else(|| {
            self.missing(&match units[0].0 {
                "" => names[0].to_owned(),
                unit => format!("{} ({unit})", names[0]),
            })
        })
    }

    /// Names of the columns that none of `used` is.
    pub fn others(&self, used: impl Iterator<Item = Column>) -> Vec<&str> {
        let used: Vec<usize> = used.map(|column| column.0).collect();
        let others = self.header.iter().enumerate();
        let others = others.filter(|(at, name)| !used.contains(at) && !name.is_empty());
        others.map(|(_, name)| name.as_str()).collect()
    }

    pub fn missing(&self, column: &str) -> Problem {
        let found = self.header.join(", ");
        let remedy = format!("name a column `{column}`; the file has: {found}");
        let message = format!("the column `{column}` is missing");
        Code::CsvMissingColumn.error(message, remedy).at(&self.name)
    }

    /// A table without what is looked for.
    pub fn empty(&self, message: &str, remedy: &str) -> Problem {
        Code::NoRows.error(message, remedy).at(&self.name)
    }

    /// Value of a row in SI units; `None` if the field is empty or not finite.
    pub fn value(&self, row: usize, column: Column) -> Result<Option<f64>> {
        let text = self.rows[row].get(column.0).unwrap_or("");
        if is_none(text) {
            return Ok(None);
        }
        let bad = || {
            let line = self.rows[row].position().map_or(0, csv::Position::line);
            let message = format!("`{text}` is not a number");
            let place = format!("{} line {line}, {}", self.name, self.header[column.0]);
            Code::CsvBadNumber.error(message, "correct the field, or leave it empty").at(place)
        };
        finite(text).map(|value| Some(value * column.1)).ok_or_else(bad)
    }

    pub fn text(&self, row: usize, column: usize) -> &str {
        self.rows[row].get(column).unwrap_or("")
    }

    pub fn named(&self, name: &str) -> Option<usize> {
        self.header.iter().position(|column| column.eq_ignore_ascii_case(name))
    }
}
