//! A first pass over a table: what its columns hold.

use std::borrow::Cow;
use std::collections::BTreeSet;

use super::header::Table;
use super::layout::{Group, Layout};
use super::names;
use super::rows::{self, Count, Fault, Filter, each_row, values};
use super::text::field;
use super::times;
use crate::formats::Source;
use crate::recording::Quantity;
use crate::series::thin_out;
use crate::stats::{median, norm};
use crate::{Code, Result};

/// Rows after which the survey ends.
const MAX_ROWS: u64 = 1 << 20;
/// Values kept of all tracks together, at most; beyond, every other sample is dropped.
const MAX_SAMPLES: usize = 1 << 19;
/// Different texts of a column that are kept.
const MAX_TEXTS: usize = 65;
/// Sensors that take turns in the rows, at most, and rows by which that is known.
const MAX_SENSORS: usize = 16;
const FIRST_ROWS: usize = 1000;
/// Ratio of the steps between neighbours to those of one sensor, where the rows are of several sensors.
const OTHER_SENSOR: f64 = 3.0;
/// Columns whose contents identify a sensor or a run.
const SENSORS: [&str; 6] = ["imu", "sensor", "device", "device name", "unit", "board"];
const RUNS: [&str; 4] = ["run", "trial", "session", "recording"];
/// Times that go back by which fractions without leading zeros are known, at least.
const MIN_UNPADDED: u64 = 5;

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
    contents: BTreeSet<String>,
    last: String,
    /// Rows whose content is not that of the row before, and of them those whose time goes back.
    changes: u64,
    changes_back: u64,
}

/// Numbers of the time column.
#[derive(Clone, Copy, Debug, Default)]
pub struct Stamps {
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

/// Result of the first pass.
#[derive(Clone, Debug, Default)]
pub struct Survey {
    pub count: Count,
    pub columns: Vec<Column>,
    pub times: Stamps,
    /// Of the tracks of the layout, in their order; empty for those that are not inertial.
    pub samples: Vec<Samples>,
    /// First rows of the first accelerometer.
    first_rows: Vec<[f64; 3]>,
}

/// Reads the table once.
///
/// # Errors
/// `file_failed`.
pub fn survey(source: &Source, table: &Table, layout: &Layout, filter: &Filter) -> Result<Survey> {
    let inertial = layout.groups.iter().filter(|group| group.is_inertial()).count();
    let limit = (MAX_SAMPLES / inertial.max(1)).max(1024);
    let mut survey = Survey {
        columns: vec![Column::default(); table.names.len()],
        samples: vec![Samples { stride: 1, limit, ..Samples::default() }; layout.groups.len()],
        ..Survey::default()
    };
    let is_name = |name: &String| is_one_of(name, &SENSORS) || is_one_of(name, &RUNS);
    let is_name: Vec<bool> = table.names.iter().map(is_name).collect();
    survey.count = each_row(source, table, filter, MAX_ROWS, |fields, fault| {
        let fault = fault.or_else(|| survey.fault(table, layout, fields));
        if fault.is_none() {
            survey.add(table, layout, fields, &is_name);
        }
        fault
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
    pub fn one_source(&self, table: &Table, layout: &Layout, in_order: bool) -> Result<()> {
        let (mut several, mut selected, mut refused) = (Vec::new(), Vec::new(), false);
        let restarts = in_order && self.times.restarts > 0;
        for index in &layout.others {
            let (name, column) = (&table.names[*index], &self.columns[*index]);
            let (sensor, run) = (is_one_of(name, &SENSORS), is_one_of(name, &RUNS));
            let sensor =
                sensor || self.is_cycle(column, in_order) || in_order && self.is_block(column);
            if !(sensor || run) || !(2..MAX_TEXTS).contains(&column.contents.len()) {
                continue;
            }
            refused |= sensor || restarts;
            let contents: Vec<&str> = column.contents.iter().map(String::as_str).collect();
            several.push(format!("`{name}` is {}", contents.join(", ")));
            selected.push(format!("{name}={}", contents[0]));
        }
        let unnamed = (2..=MAX_SENSORS).find(|sensors| self.are_together(*sensors));
        let (several, remedy) = match unnamed {
            _ if refused => (
                several.join("; "),
                format!(
                    "select one with --where \"{}\", or remove the other rows",
                    selected.join(",")
                ),
            ),
            Some(sensors) if in_order && self.take_turns(sensors) => (
                format!("{sensors} rows have one time, and their values take turns"),
                "add a column with the number of the sensor and select one with --where, or give each sensor its own columns"
                    .to_owned(),
            ),
            _ => return Ok(()),
        };
        let text = format!("the rows are of several sensors or runs: {several}");
        Err(Code::Usage.error(text, remedy))
    }

    /// Sensors that the rows name, `Accelerometer` or `Gyroscope`: the column, the name and the quantity.
    pub fn named_sensors(&self, layout: &Layout) -> Vec<(usize, String, Quantity)> {
        for index in &layout.others {
            let mut sensors = Vec::new();
            for name in self.columns[*index].contents.iter().filter(|name| name.len() > 2) {
                let quantity = names::quantity(&names::key(name));
                sensors.extend(quantity.map(|quantity| (*index, name.clone(), quantity)));
            }
            if !sensors.is_empty() {
                return sensors;
            }
        }
        Vec::new()
    }

    /// Step of the times in the unit of their column: the first one, unless it is 0 or back, else the mean.
    pub fn step(&self, column: usize) -> Option<f64> {
        let first = match self.columns[column].first {
            [Some(first), Some(second)] if second > first => Some(second - first),
            _ => None,
        };
        let mean = (self.times.last - self.times.first?).abs() / self.times.steps as f64;
        // The mean is not that of neighbours where a counter wraps or a clock restarts.
        let mean = Some(mean).filter(|_| self.times.steps > 0)?;
        Some(first.filter(|_| self.times.restarts > 0).unwrap_or(mean))
    }

    /// Whether a column cycles through some contents, while times repeat for each of them or the values take turns.
    fn is_cycle(&self, column: &Column, in_order: bool) -> bool {
        let sensors = column.contents.len();
        (2..=MAX_SENSORS).contains(&sensors)
            && column.changes as f64 >= 0.9 * self.count.rows as f64
            && (self.are_together(sensors) || in_order && self.take_turns(sensors))
    }

    /// Whether as many rows have one time.
    fn are_together(&self, sensors: usize) -> bool {
        let repeated = self.times.equal as f64 / self.times.steps.max(1) as f64;
        (repeated - (1.0 - 1.0 / sensors as f64)).abs() < 0.1
    }

    /// Whether values differ more from those of the row before than from those a period of `sensors` rows before.
    fn take_turns(&self, sensors: usize) -> bool {
        let step = |distance: usize| {
            let pairs = self.first_rows.iter().zip(self.first_rows.iter().skip(distance));
            median(pairs.map(|(a, b)| norm([a[0] - b[0], a[1] - b[1], a[2] - b[2]])))
        };
        let [Some(one), Some(all)] = [1, sensors].map(step) else { return false };
        one > OTHER_SENSOR * all
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
        match field(text, table.comma).filter(|time| time.is_finite()) {
            Some(time) => self.times.add(time, text),
            None if times::date(None, text).is_some() => self.times.dates += 1,
            None => return Some(Fault::NoTime),
        }
        None
    }

    fn add(&mut self, table: &Table, layout: &Layout, fields: &[Cow<str>], is_name: &[bool]) {
        for ((column, text), is_name) in self.columns.iter_mut().zip(fields).zip(is_name) {
            let number = field(text, table.comma);
            if number.is_some_and(f64::is_nan) {
                continue;
            }
            column.add(number, text);
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
        let first_force = layout.groups.iter().position(Group::is_acceleration);
        for (k, (group, samples)) in layout.groups.iter().zip(&mut self.samples).enumerate() {
            if !group.is_inertial() {
                continue;
            }
            let Ok(Some([x, y, z, _])) = values(group, fields, table.comma) else {
                samples.empty += 1;
                continue;
            };
            if !samples.add([x, y, z]) {
                continue;
            }
            if Some(k) == first_force && self.first_rows.len() < FIRST_ROWS {
                self.first_rows.push([x, y, z]);
            }
        }
    }
}

impl Column {
    fn add(&mut self, number: Option<f64>, text: &str) {
        let Some(value) = number else {
            self.texts += 1;
            return;
        };
        if let Some(first) = self.first.get_mut(self.numbers as usize) {
            *first = Some(value);
        }
        self.numbers += 1;
        self.is_fractional |= text.contains(['.', ',', 'e', 'E']);
        self.has_fraction |= value.fract() != 0.0;
    }
}

impl Samples {
    /// Keeps a row, unless it is not finite or dropped.
    fn add(&mut self, row: [f64; 3]) -> bool {
        self.seen += 1;
        if !self.seen.is_multiple_of(self.stride) || !row.iter().all(|value| value.is_finite()) {
            return false;
        }
        self.rows.push(row);
        if self.rows.len() >= self.limit {
            thin_out(&mut self.rows);
            self.stride *= 2;
        }
        true
    }
}

impl Stamps {
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
}
