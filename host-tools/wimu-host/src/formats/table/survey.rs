//! A first pass over a table: what its columns hold.

use std::borrow::Cow;
use std::collections::BTreeSet;

use super::clock;
use super::header::Table;
use super::layout::Layout;
use super::rows::{self, Count, Fault, Next, Values, each_row, values};
use super::text::{Field, field};
use crate::formats::Source;
use crate::series::thin_out;
use crate::{Code, Result};

/// Rows after which the survey ends.
const MAX_ROWS: u64 = 1 << 20;
/// Values kept of all tracks together, at most; beyond, every other sample is dropped.
const MAX_SAMPLES: usize = 1 << 19;
/// Different texts of a column that are kept.
const MAX_TEXTS: usize = 65;

/// What a column holds.
#[derive(Clone, Debug, Default)]
pub struct Column {
    pub numbers: u64,
    pub texts: u64,
    /// Whether a number has a decimal mark or an exponent.
    pub is_fractional: bool,
    /// Whether a number is not whole.
    pub has_fraction: bool,
    /// The first two numbers.
    pub first: [Option<f64>; 2],
    /// Different contents, up to a number.
    pub contents: BTreeSet<String>,
    last: String,
    /// Rows whose content is not that of the row before, and of them those whose time goes back.
    changes: u64,
    changes_back: u64,
}

/// Numbers of the time column.
#[derive(Clone, Copy, Debug, Default)]
pub struct Times {
    pub dates: u64,
    pub first: Option<f64>,
    pub last: f64,
    pub steps: u64,
    pub restarts: u64,
    /// Whether the last step is back.
    is_back: bool,
    /// Steps of 0.
    pub equal: u64,
    /// Most digits of a fraction, and times that go back if each has its leading zeros.
    digits: usize,
    padded: Option<f64>,
    padded_restarts: u64,
}

/// Samples of a track, thinned out evenly.
#[derive(Clone, Debug, Default)]
pub struct Samples {
    pub rows: Vec<[f64; 3]>,
    stride: u64,
    seen: u64,
    limit: usize,
    /// Rows in which all fields are empty.
    pub empty: u64,
}

impl Samples {
    fn add(&mut self, row: [f64; 3]) {
        self.seen += 1;
        if !self.seen.is_multiple_of(self.stride) || !row.iter().all(|value| value.is_finite()) {
            return;
        }
        self.rows.push(row);
        if self.rows.len() >= self.limit {
            thin_out(&mut self.rows);
            self.stride *= 2;
        }
    }
}

/// Result of the first pass.
#[derive(Clone, Debug)]
pub struct Survey {
    pub count: Count,
    pub columns: Vec<Column>,
    pub times: Times,
    /// Of the tracks of the layout, in their order; empty for those that are not inertial.
    pub samples: Vec<Samples>,
}

/// Columns whose contents identify a sensor or a run.
const SENSORS: [&str; 6] = ["imu", "sensor", "device", "device name", "unit", "board"];
const MAX_SENSORS: usize = 16;
/// Times that go back by which fractions without leading zeros are known, at least.
const MIN_UNPADDED: u64 = 5;
const RUNS: [&str; 4] = ["run", "trial", "session", "recording"];

/// Reads the table once.
///
/// # Errors
/// `file_failed`.
pub fn survey(
    source: &Source,
    table: &Table,
    layout: &Layout,
    filter: &[(usize, String)],
) -> Result<Survey> {
    let inertial = layout.groups.iter().filter(|group| group.is_inertial());
    let inertial = inertial.count();
    let empty = Samples {
        stride: 1,
        limit: (MAX_SAMPLES / inertial.max(1)).max(1024),
        ..Samples::default()
    };
    let mut survey = Survey {
        count: Count::default(),
        columns: vec![Column::default(); table.names.len()],
        times: Times::default(),
        samples: vec![empty; layout.groups.len()],
    };
    let is_name = |name: &String| is_one_of(name, &SENSORS) || is_one_of(name, &RUNS);
    let is_name: Vec<bool> = table.names.iter().map(is_name).collect();
    let mut rows = 0;
    survey.count = each_row(source, table, |fields, fault| {
        if rows >= MAX_ROWS {
            return Next::Stop;
        }
        if !rows::passes(filter, fields) {
            return Next::Skip;
        }
        rows += 1;
        let fault = fault.or_else(|| survey.fault(table, layout, fields));
        if fault.is_none() {
            survey.add(table, layout, fields, &is_name);
        }
        Next::Count(fault)
    })?;
    Ok(survey)
}

fn is_one_of(name: &str, known: &[&str]) -> bool {
    known.contains(&name.to_lowercase().as_str())
}

impl Survey {
    /// Refuses rows of several sensors, and, of a series in time, of several runs whose times start again.
    ///
    /// # Errors
    /// `usage`, which asks for `--where`.
    pub fn one_source(&self, table: &Table, in_order: bool) -> Result<()> {
        let (mut several, mut selected, mut refused) = (Vec::new(), Vec::new(), false);
        let restarts = in_order && self.times.restarts > 0;
        for (name, column) in table.names.iter().zip(&self.columns) {
            let (sensor, run) = (is_one_of(name, &SENSORS), is_one_of(name, &RUNS));
            let sensor = sensor || self.is_cycle(column) || in_order && self.is_block(column);
            if !(sensor || run) || !(2..MAX_TEXTS).contains(&column.contents.len()) {
                continue;
            }
            refused |= sensor || restarts;
            let contents: Vec<&str> = column.contents.iter().map(String::as_str).collect();
            several.push(format!("`{name}` is {}", contents.join(", ")));
            selected.push(format!("{name}={}", contents[0]));
        }
        if !refused {
            return Ok(());
        }
        let (several, selected) = (several.join("; "), selected.join(","));
        Err(Code::Usage.error(
            format!("the rows are of several sensors or runs: {several}"),
            format!("select one with --where \"{selected}\", or remove the other rows"),
        ))
    }

    /// Step of the times in the unit of their column: the first one, unless it is 0 or back, else the mean.
    pub fn step(&self, column: usize) -> Option<f64> {
        let first = match self.columns[column].first {
            [Some(first), Some(second)] if second > first => Some(second - first),
            _ => None,
        };
        let mean = self.times.mean_step()?;
        // The mean is not that of neighbours where a counter wraps or a clock restarts.
        let is_one = self.times.restarts == 0;
        Some(first.filter(|_| !is_one).unwrap_or(mean))
    }

    /// Whether a column cycles through N contents while times come N times.
    fn is_cycle(&self, column: &Column) -> bool {
        let (rows, sensors) = (self.times.steps as f64, column.contents.len() as f64);
        let repeated = self.times.equal as f64 / rows.max(1.0);
        (2..=MAX_SENSORS).contains(&column.contents.len())
            && column.changes as f64 >= 0.9 * rows
            && (repeated - (1.0 - 1.0 / sensors)).abs() < 0.1
    }

    /// Whether a column changes where the times start again, and only there.
    fn is_block(&self, column: &Column) -> bool {
        self.times.restarts > 0
            && column.changes_back == self.times.restarts
            && column.changes == self.times.restarts + 1
    }

    fn fault(&mut self, table: &Table, layout: &Layout, fields: &[Cow<str>]) -> Option<Fault> {
        if rows::has_text(layout, fields, table.comma) {
            return Some(Fault::NoNumber);
        }
        let (column, _) = layout.time?;
        let text = fields.get(column).map_or("", |text| text);
        match field(text, table.comma) {
            Field::Number(time) => self.times.add(time, text),
            _ if clock::date(None, text).is_some() => self.times.dates += 1,
            _ => return Some(Fault::NoTime),
        }
        None
    }

    fn add(&mut self, table: &Table, layout: &Layout, fields: &[Cow<str>], is_name: &[bool]) {
        for ((column, text), is_name) in self.columns.iter_mut().zip(fields).zip(is_name) {
            match field(text, table.comma) {
                Field::Number(value) => {
                    if let Some(first) = column.first.get_mut(column.numbers as usize) {
                        *first = Some(value);
                    }
                    column.numbers += 1;
                    column.is_fractional |= text.contains(['.', ',', 'e', 'E']);
                    column.has_fraction |= value.fract() != 0.0;
                }
                Field::Text => column.texts += 1,
                Field::Empty => continue,
            }
            let most = if *is_name { MAX_TEXTS } else { MAX_SENSORS + 1 };
            if column.contents.len() < most && column.last != **text {
                column.changes += 1;
                column.changes_back += u64::from(self.times.is_back);
                column.last.clear();
                column.last.push_str(text);
                if !column.contents.contains(&**text) {
                    column.contents.insert(text.to_string());
                }
            }
        }
        for (group, samples) in layout.groups.iter().zip(&mut self.samples) {
            if group.is_inertial() {
                match values(group, fields, table.comma) {
                    Values::Some([x, y, z, _]) => samples.add([x, y, z]),
                    _ => samples.empty += 1,
                }
            }
        }
    }
}

impl Times {
    fn add(&mut self, time: f64, text: &str) {
        let fraction = text.split_once('.').map_or("0", |(_, fraction)| fraction);
        if fraction.len() > self.digits {
            (self.digits, self.padded) = (fraction.len(), None);
        }
        let padded = fraction.parse::<f64>().unwrap_or(0.0) / 10_f64.powi(self.digits as i32);
        let padded = time.trunc() + padded;
        self.padded_restarts += u64::from(self.padded.is_some_and(|before| padded < before));
        self.padded = Some(padded);
        if self.first.is_some() {
            self.steps += 1;
            self.is_back = time < self.last;
            self.restarts += u64::from(self.is_back);
            self.equal += u64::from(time == self.last);
        }
        self.first.get_or_insert(time);
        self.last = time;
    }

    /// Digits of a fraction whose leading zeros were not written, `28.16` for `28.016`: with them the times do not go back.
    pub fn unpadded_digits(&self) -> Option<usize> {
        let is_better =
            10 * self.padded_restarts < self.restarts && 100 * self.restarts > self.steps;
        (is_better && self.restarts >= MIN_UNPADDED).then_some(self.digits)
    }

    /// Mean step in the unit of the column.
    pub fn mean_step(&self) -> Option<f64> {
        let first = self.first?;
        (self.steps > 0).then(|| (self.last - first).abs() / self.steps as f64)
    }
}
