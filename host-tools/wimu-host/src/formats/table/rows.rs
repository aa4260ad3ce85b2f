//! Rows of a table, and what of them cannot be used.

use std::borrow::Cow;
use std::collections::BTreeSet;

use super::header::{Table, splits_decimals};
use super::layout::{Group, Layout, find_column};
use super::text::{Lines, field, is_comment, split};
use crate::formats::Source;
use crate::{Code, Problem, Result};

/// Rows after which a table is refused if most of them are unusable.
const EARLY: u64 = 1000;
/// Contents of a column that a message names, at most.
const MOST_CONTENTS: usize = 8;

/// Why a row cannot be used.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Fault {
    FieldCount(usize),
    NoNumber,
    NoTime,
}

/// Columns and the values that rows must have there.
pub type Filter = [(usize, String)];

/// Rows so far, and those that are unusable.
#[derive(Clone, Debug, Default)]
pub struct Count {
    pub rows: u64,
    unusable: u64,
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
            self.unusable += 1;
            self.first.get_or_insert((lines.number, fault));
        }
    }

    fn is_hopeless(&self) -> bool {
        self.rows >= EARLY && 2 * self.unusable > self.rows
    }

    /// Refuses a table without rows, or most of whose rows are unusable.
    ///
    /// # Errors
    /// `no_rows`, `bad_recording`.
    pub fn check(&self, name: &str, table: &Table) -> Result<()> {
        let (unusable, rows) = (self.unusable, self.rows);
        if rows == 0 {
            let error = Code::NoRows.error("there are no rows below the header", "check the file");
            return Err(error.at(name));
        }
        let Some((line, fault)) = self.first.filter(|_| 2 * unusable > rows) else {
            return Ok(());
        };
        let counts = if self.is_hopeless() {
            format!("{unusable} of the first {rows} rows are unusable (reading stopped there)")
        } else {
            format!("{unusable} of {rows} rows are unusable")
        };
        let is_split = matches!(fault, Fault::FieldCount(fields)
            if table.separator == ',' && splits_decimals(fields, table.names.len()));
        let (cause, remedy) = if is_split {
            (
                "; decimal commas between commas are likely",
                "export with semicolons as separators, or with decimal points",
            )
        } else {
            (
                "",
                "check the header and the separators, or name the columns: --columns \"t=1:s,x=2:g,y=3:g,z=4:g\"",
            )
        };
        let text = format!("{counts}; first: {}{cause}", text_of(fault, table));
        Err(Code::BadRecording.error(text, remedy).at(format!("{name} line {line}")))
    }

    /// Findings on unusable rows.
    pub fn findings(&self, table: &Table) -> Vec<Problem> {
        let Some((line, fault)) = self.first else {
            return Vec::new();
        };
        let mut findings = Vec::new();
        if self.unusable > u64::from(self.is_cut) {
            let text = format!(
                "{} of {} rows are unusable, first in line {line}: {}",
                self.unusable,
                self.rows,
                text_of(fault, table)
            );
            findings.push(Code::RowsMasked.warning(text).remedy("they are left out"));
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

/// The error of a filter that no row passes: it names the contents of its columns.
///
/// # Errors
/// `file_failed`.
pub fn nothing_passes(source: &Source, table: &Table, filter: &Filter) -> Result<Problem> {
    let mut found = vec![BTreeSet::new(); filter.len()];
    each_row(source, table, &[], u64::MAX, |fields, _| {
        for ((column, _), found) in filter.iter().zip(&mut found) {
            let text = fields.get(*column).filter(|_| found.len() <= MOST_CONTENTS);
            found.extend(text.map(|text| text.to_string()));
        }
        None
    })?;
    let listed = filter.iter().zip(&found).map(|((column, _), found)| {
        let first: Vec<&str> = found.iter().take(MOST_CONTENTS).map(String::as_str).collect();
        let more = if found.len() > MOST_CONTENTS { ", …" } else { "" };
        format!("`{}` is {}{more}", table.names[*column], first.join(", "))
    });
    let listed = listed.collect::<Vec<_>>().join("; ");
    Ok(Code::NoRows.error("no row passes --where", format!("in the file {listed}")))
}

/// Calls `each` with the fields of each row that passes the filter and the fault of their number, and counts the fault that it
/// returns, for at most `most` rows or until the table is hopeless.
///
/// # Errors
/// `file_failed`.
pub fn each_row(
    source: &Source,
    table: &Table,
    filter: &Filter,
    most: u64,
    mut each: impl FnMut(&[Cow<str>], Option<Fault>) -> Option<Fault>,
) -> Result<Count> {
    let mut lines = Lines::of(source)?;
    let mut count = Count::default();
    let width = table.names.len();
    while !count.is_hopeless() && count.rows < most {
        let number = lines.number + 1;
        let Some(line) = lines.next_line()? else {
            break;
        };
        if number < table.first_row || line.trim().is_empty() || is_comment(&line) {
            continue;
        }
        let fields = split(&line, table.separator);
        if !passes(filter, &fields) {
            continue;
        }
        let beyond = fields.iter().skip(width).any(|field| !field.is_empty());
        let fault = (fields.len() < width || beyond).then_some(Fault::FieldCount(fields.len()));
        let fault = each(&fields, fault);
        drop(fields);
        drop(line);
        count.add(fault, &lines);
    }
    Ok(count)
}

/// The values of `group` in a row, in the units of the file, not a number where a field is empty; `None` where all are.
///
/// # Errors
/// A field is not a number.
pub fn values(group: &Group, fields: &[Cow<str>], comma: bool) -> Result<Option<[f64; 4]>, Fault> {
    let mut row = [f64::NAN; 4];
    for (value, column) in row.iter_mut().zip(&group.columns) {
        let text = fields.get(*column).map_or("", |text| text);
        *value = field(text, comma).ok_or(Fault::NoNumber)?;
    }
    Ok(row.iter().any(|value| value.is_finite()).then_some(row))
}

/// Columns and values of a filter.
///
/// # Errors
/// `csv_missing_column`.
pub fn filter(table: &Table, pairs: &[(String, String)]) -> Result<Vec<(usize, String)>> {
    let find = |(name, value): &(String, String)| {
        let column = find_column(&table.names, name).ok_or_else(|| {
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
fn passes(filter: &Filter, fields: &[Cow<str>]) -> bool {
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
    inertial.any(|group| values(group, fields, comma).is_err())
}
