//! Rows of a table, and what of them cannot be used.

use std::borrow::Cow;

use super::header::{Table, splits_decimals};
use super::layout::{Group, Layout};
use super::text::{Field, Lines, field, is_comment, split};
use crate::formats::Source;
use crate::{Code, Problem, Result};

/// Rows after which a table is refused if most of them are unusable.
const EARLY: u64 = 1000;

/// Why a row cannot be used.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Fault {
    FieldCount(usize),
    NoNumber,
    NoTime,
}

/// Rows so far, and those that are unusable.
#[derive(Clone, Debug, Default)]
pub struct Count {
    pub rows: u64,
    faults: [u64; 3],
    /// Line and fault of the first unusable row.
    first: Option<(u64, Fault)>,
    /// Whether the last line is unusable and has no end.
    is_cut: bool,
}

impl Count {
    fn add(&mut self, fault: Option<Fault>, lines: &Lines) {
        self.rows += 1;
        self.is_cut = fault.is_some() && !lines.is_ended;
        if let Some(fault) = fault {
            self.faults[match fault {
                Fault::FieldCount(_) => 0,
                Fault::NoNumber => 1,
                Fault::NoTime => 2,
            }] += 1;
            self.first.get_or_insert((lines.number, fault));
        }
    }

    fn unusable(&self) -> u64 {
        self.faults.iter().sum()
    }

    fn is_hopeless(&self) -> bool {
        self.rows >= EARLY && 2 * self.unusable() > self.rows
    }

    /// Refuses a table without rows, or most of whose rows are unusable.
    ///
    /// # Errors
    /// `no_rows`, `bad_recording`.
    pub fn check(&self, name: &str, table: &Table) -> Result<()> {
        if self.rows == 0 {
            let error = Code::NoRows.error(
                "there are no rows below the header, or none passes the filter",
                "check the file and --where",
            );
            return Err(error.at(name));
        }
        match self.first {
            Some((line, fault)) if 2 * self.unusable() > self.rows => {
                let (unusable, rows) = (self.unusable(), self.rows);
                let rows = match self.is_hopeless() {
                    true => format!(
                        "{unusable} of the first {rows} rows are unusable (reading stopped there)"
                    ),
                    false => format!("{unusable} of {rows} rows are unusable"),
                };
                let is_split = matches!(fault, Fault::FieldCount(fields)
                    if table.separator == ',' && splits_decimals(fields, table.names.len()));
                let (cause, remedy) = match is_split {
                    true => (
                        "; decimal commas between commas are likely",
                        "export with semicolons as separators, or with decimal points",
                    ),
                    false => (
                        "",
                        "check the header and the separators, or name the columns: --columns \"t=1:s,x=2:g,y=3:g,z=4:g\"",
                    ),
                };
                let text = format!("{rows}; first: {}{cause}", text_of(fault, table));
                Err(Code::BadRecording.error(text, remedy).at(format!("{name} line {line}")))
            }
            _ => Ok(()),
        }
    }

    /// Findings on unusable rows.
    pub fn findings(&self, table: &Table) -> Vec<Problem> {
        let Some((line, fault)) = self.first else {
            return Vec::new();
        };
        let mut findings = Vec::new();
        if self.unusable() > u64::from(self.is_cut) {
            let [width, number, time] = self.faults;
            let evidence = format!(
                "{} of {} rows are unusable (number of fields {width}, not a number {number}, no time {time}), first in line \
                 {line}: {}",
                self.unusable(),
                self.rows,
                text_of(fault, table)
            );
            let finding = Code::RowsMasked.warning(evidence).remedy("they are left out");
            findings.push(finding);
        }
        if self.is_cut {
            let (evidence, remedy) = ("the last line is incomplete", "it is left out");
            findings.push(Code::Truncated.warning(evidence).remedy(remedy));
        }
        findings
    }
}

fn text_of(fault: Fault, table: &Table) -> String {
    match fault {
        Fault::FieldCount(count) => {
            format!("{count} fields, and the header has {}", table.names.len())
        }
        Fault::NoNumber => "a field is not a number".to_owned(),
        Fault::NoTime => "it has no time".to_owned(),
    }
}

/// What to do after a row.
pub enum Next {
    /// It is counted, with its fault.
    Count(Option<Fault>),
    /// It does not pass the filter.
    Skip,
    Stop,
}

/// Calls `each` with the fields of each row and the fault of their number, until it stops or the table is hopeless.
///
/// # Errors
/// `file_failed`.
pub fn each_row(
    source: &Source,
    table: &Table,
    mut each: impl FnMut(&[Cow<str>], Option<Fault>) -> Next,
) -> Result<Count> {
    let mut lines = Lines::of(source)?;
    let mut count = Count::default();
    while !count.is_hopeless() {
        let number = lines.number + 1;
        let Some(line) = lines.next_line()? else {
            break;
        };
        if number < table.first_row || line.trim().is_empty() || is_comment(&line) {
            continue;
        }
        let fields = split(&line, table.separator);
        let width = table.names.len();
        let beyond = fields.iter().skip(width).any(|field| !field.is_empty());
        let fault = (fields.len() < width || beyond).then_some(Fault::FieldCount(fields.len()));
        let next = each(&fields, fault);
        drop(fields);
        drop(line);
        match next {
            Next::Count(fault) => count.add(fault, &lines),
            Next::Skip => {}
            Next::Stop => break,
        }
    }
    Ok(count)
}

/// Values of a track in a row.
pub enum Values {
    /// All fields are empty.
    Empty,
    /// With NaN for an empty field.
    Some([f64; 4]),
    /// A field is not a number.
    Text,
}

/// The values of `group` in a row, in the units of the file.
pub fn values(group: &Group, fields: &[Cow<str>], comma: bool) -> Values {
    let mut row = [f64::NAN; 4];
    let mut empty = true;
    for (value, column) in row.iter_mut().zip(&group.columns) {
        match field(fields.get(*column).map_or("", |text| text), comma) {
            Field::Empty => {}
            Field::Number(number) => (*value, empty) = (number, false),
            Field::Text => return Values::Text,
        }
    }
    if empty { Values::Empty } else { Values::Some(row) }
}

/// Indices of columns and the values that rows must have there.
///
/// # Errors
/// `csv_missing_column`.
pub fn filter(table: &Table, pairs: &[(String, String)]) -> Result<Vec<(usize, String)>> {
    let find = |(name, value): &(String, String)| {
        let column = super::layout::find_column(&table.names, name).ok_or_else(|| {
            Code::CsvMissingColumn.error(
                format!("there is no column `{name}` to filter by"),
                format!("choose from: {}", table.names.join(", ")),
            )
        })?;
        Ok((column, value.clone()))
    };
    pairs.iter().map(find).collect()
}

/// Whether a row passes the filter; numbers compare as numbers.
pub fn passes(filter: &[(usize, String)], fields: &[Cow<str>]) -> bool {
    filter.iter().all(|(column, value)| {
        fields.get(*column).is_some_and(|text| {
            text == value
                || matches!((text.parse::<f64>(), value.parse::<f64>()), (Ok(a), Ok(b)) if a == b)
        })
    })
}

/// Whether an inertial track has text in the row.
pub fn has_text(layout: &Layout, fields: &[Cow<str>], comma: bool) -> bool {
    let mut inertial = layout.groups.iter().filter(|group| group.is_inertial());
    inertial.any(|group| matches!(values(group, fields, comma), Values::Text))
}
