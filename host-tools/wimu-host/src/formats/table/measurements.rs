//! Tables of measurements that are no recordings, such as fixes, ranges and poses: columns `NAME (UNIT)` in any order, read in SI
//! units.

use std::path::Path;

use super::header::SEPARATORS;
use super::names::split_unit;
use super::text::{Lines, field, is_comment, is_text, split};
use super::units::{Sizes, size};
use crate::formats::Source;
use crate::{Code, Problem, Result};

/// A table in memory.
pub(crate) struct Measurements {
    /// What errors call it.
    pub name: String,
    /// Names of the columns, with their units.
    pub header: Vec<String>,
    rows: Vec<Row>,
    /// Whether the decimal mark is a comma.
    comma: bool,
}

/// Fields of a row, and its line.
struct Row {
    line: u64,
    fields: Vec<String>,
}

/// A column and the size of its unit.
#[derive(Clone, Copy)]
pub(crate) struct Column(pub(super) usize, f64);

impl Column {
    /// A column, from 0, of numbers in SI units.
    pub fn of_si(column: usize) -> Self {
        Self(column, 1.0)
    }
}

impl Measurements {
    /// Reads a file.
    ///
    /// # Errors
    /// `file_unreadable`, `file_failed`, `csv_empty`.
    pub fn read(path: &Path) -> Result<Self> {
        Self::read_or(path, &[])
    }

    /// The same of a file that may have no header: its columns are then these, if it has as many.
    ///
    /// # Errors
    /// Those of [`read`](Self::read).
    pub fn read_or(path: &Path, without_header: &[&str]) -> Result<Self> {
        let table = Self::of_source(&Source::open(path)?, without_header)?;
        Ok(Self { name: path.display().to_string(), ..table })
    }

    /// The table that a text is.
    ///
    /// # Errors
    /// `csv_empty`.
    pub fn of(name: &str, text: &str) -> Result<Self> {
        let table = Self::of_source(&Source::of_bytes(name, text.as_bytes()), &[])?;
        Ok(Self { name: name.to_owned(), ..table })
    }

    fn of_source(source: &Source, without_header: &[&str]) -> Result<Self> {
        let mut lines = Lines::of(source)?;
        let mut separator = None;
        let mut rows = Vec::new();
        loop {
            let line = lines.number + 1;
            let Some(text) = lines.next_line()? else {
                break;
            };
            if text.trim().is_empty() || is_comment(&text) {
                continue;
            }
            let separator = *separator.get_or_insert_with(|| separator_of(&text));
            let fields = split(&text, separator).into_iter().map(String::from).collect();
            rows.push(Row { line, fields });
        }
        let first = rows.first().ok_or_else(|| {
            let remedy = "a table starts with a line of column names and units";
            Code::CsvEmpty.error("the file is empty", remedy).at(source.name())
        })?;
        let is_row = first.fields.iter().all(|text| !is_text(text, true));
        let header = if is_row && first.fields.len() == without_header.len() {
            without_header.iter().map(|name| (*name).to_owned()).collect()
        } else {
            rows.remove(0).fields
        };
        let comma = separator.is_some_and(|separator| separator != ',');
        Ok(Self { name: source.name().to_owned(), header, rows, comma })
    }

    /// Number of rows.
    pub fn len(&self) -> usize {
        self.rows.len()
    }

    /// The column `NAME (UNIT)`, or `NAME` of a number without a unit, for one of several names.
    pub fn column(&self, names: &[&str], units: Sizes) -> Option<Column> {
        self.header.iter().enumerate().find_map(|(at, column)| {
            let (name, unit) = split_unit(column);
            let is_known = names.iter().any(|known| known.eq_ignore_ascii_case(name));
            let size = size(units, unit.unwrap_or(""))?;
            is_known.then_some(Column(at, size))
        })
    }

    /// The same of a column that must be there.
    ///
    /// # Errors
    /// `csv_missing_column`.
    pub fn needed(&self, names: &[&str], units: Sizes) -> Result<Column> {
        let unit = units[0].1.split(' ').next().unwrap_or("");
        self.column(names, units).ok_or_else(|| match unit {
            "" => self.missing(names[0]),
            unit => self.missing(&format!("{} ({unit})", names[0])),
        })
    }

    /// Names of the columns that none of `used` is.
    pub fn others(&self, used: impl Iterator<Item = Column>) -> Vec<&str> {
        let used: Vec<usize> = used.map(|column| column.0).collect();
        let others = self.header.iter().enumerate();
        let others = others.filter(|(at, name)| !used.contains(at) && !name.is_empty());
        others.map(|(_, name)| name.as_str()).collect()
    }

    /// The error of a table without a column.
    pub fn missing(&self, column: &str) -> Problem {
        let found = self.header.join(", ");
        let remedy = format!("name a column `{column}`; the file has: {found}");
        let message = format!("the column `{column}` is missing");
        Code::CsvMissingColumn.error(message, remedy).at(&self.name)
    }

    /// The error of a table without what is looked for.
    pub fn empty(&self, message: &str, remedy: &str) -> Problem {
        Code::NoRows.error(message, remedy).at(&self.name)
    }

    /// Value of a row in SI units; `None` if the field is empty or not finite.
    ///
    /// # Errors
    /// `csv_bad_number`.
    pub fn value(&self, row: usize, column: Column) -> Result<Option<f64>> {
        let text = self.text(row, column.0);
        let value = field(text, self.comma).ok_or_else(|| {
            let message = format!("`{text}` is not a number");
            let remedy = "correct the field, or leave it empty";
            Code::CsvBadNumber.error(message, remedy).at(self.place(row, column))
        })?;
        Ok(Some(value * column.1).filter(|value| value.is_finite()))
    }

    /// Where the field of a row is.
    pub fn place(&self, row: usize, column: Column) -> String {
        format!("{} line {}, {}", self.name, self.rows[row].line, self.header[column.0])
    }

    /// Puts a value in SI units in the place of a field; none makes it empty.
    pub fn set(&mut self, row: usize, column: Column, value: Option<f64>) {
        if let Some(field) = self.rows[row].fields.get_mut(column.0) {
            *field = value.map_or_else(String::new, |value| format!("{value}"));
        }
    }

    /// Renames a column.
    pub fn rename(&mut self, column: Column, name: &str) {
        name.clone_into(&mut self.header[column.0]);
    }

    /// Text of a field.
    pub fn text(&self, row: usize, column: usize) -> &str {
        self.rows[row].fields.get(column).map_or("", String::as_str)
    }

    /// The column of a name without a unit.
    pub fn named(&self, name: &str) -> Option<usize> {
        self.header.iter().position(|column| column.eq_ignore_ascii_case(name))
    }
}

/// The separator in a header, or a row: the first one of those that a table may have. White space is one only of a row of
/// numbers, as names contain it.
fn separator_of(line: &str) -> char {
    let found =
        SEPARATORS.into_iter().find(|separator| *separator != ' ' && line.contains(*separator));
    let is_row = line.split_whitespace().all(|field| !is_text(field, false));
    found.unwrap_or(if is_row { ' ' } else { ',' })
}
