//! Selection of one sensor and one run among the rows and columns of a CSV file.

use std::collections::BTreeSet;
use std::path::Path;

use wimu_link::LinkRole;

use crate::csv::{CsvReader, Filter, Header};
use crate::error::{ErrorCode, Result};

/// Options of reading a file.
#[derive(Clone, Debug, Default)]
pub struct LoadOptions {
    /// Rows of a CSV file to keep.
    pub filter: Option<Filter>,
    /// The accelerometer of a CSV file with several.
    pub accelerometer: Option<u32>,
    /// Whether the rows of a CSV file are static-pose means, not a time series.
    pub poses: bool,
    /// Link of a recording; see [`Recording::link`](crate::history::Recording::link).
    pub role: Option<LinkRole>,
}

/// Largest number of columns that an error lists.
const MAX_NAMED: usize = 12;
/// Names of columns that identify a sensor, and a run.
const SENSORS: [&str; 5] = ["imu", "sensor", "device", "unit", "board"];
const RUNS: [&str; 4] = ["run", "trial", "session", "recording"];
/// Largest number of values of such a column.
const MAX_VALUES: usize = 64;

/// Refuses a file with rows of several sensors, or of several runs whose times start again.
pub(crate) fn one_sensor(path: &Path, options: &LoadOptions) -> Result<()> {
    let mut reader = CsvReader::open(path)?.with_holes().in_any_order();
    let names = reader.header().other.clone();
    let is_one_of = |k: usize, known: &[&str]| known.contains(&names[k].to_lowercase().as_str());
    let named = (0..names.len()).filter(|k| is_one_of(*k, &SENSORS) || is_one_of(*k, &RUNS));
    let mut found: Vec<(usize, BTreeSet<String>)> = named.map(|k| (k, BTreeSet::new())).collect();
    if found.is_empty() {
        return Ok(());
    }
    if let Some(filter) = &options.filter {
        reader = reader.select(filter)?;
    }
    let (mut last_ns, mut restarts) = (None, false);
    // Errors in rows are reported where the rows are used.
    for row in reader.flatten() {
        restarts |= !options.poses && row.time_ns < last_ns;
        last_ns = row.time_ns;
        for (k, values) in found.iter_mut().filter(|(_, v)| v.len() <= MAX_VALUES) {
            values.extend(row.other.get(*k).cloned());
        }
    }
    let (mut several, mut selected) = (Vec::new(), Vec::new());
    for (k, values) in found {
        let differ = (2..=MAX_VALUES).contains(&values.len());
        if differ && (restarts || is_one_of(k, &SENSORS)) {
            let values: Vec<String> = values.into_iter().collect();
            several.push(format!("`{}` is {}", names[k], values.join(", ")));
            selected.push(format!("{}={}", names[k], values[0]));
        }
    }
    if several.is_empty() {
        return Ok(());
    }
    let (several, selected) = (several.join("; "), selected.join(","));
    Err(ErrorCode::Usage
        .error(
            format!("the rows are of several sensors or runs: {several}"),
            format!("select one with --where \"{selected}\", or remove the other rows"),
        )
        .at(path.display().to_string()))
}

/// Number of samples in a mean.
pub(super) fn samples_of(field: Option<&String>, line: u64, name: &str) -> Result<u32> {
    let text = field.map_or("", String::as_str);
    // 1434.0 is accepted.
    let number = text.parse::<f64>().ok();
    let whole = number.filter(|n| n.trunc() == *n && (1.0..=f64::from(u32::MAX)).contains(n));
    whole.map(|n| n as u32).ok_or_else(|| {
        ErrorCode::CsvBadNumber.error(format!("`{text}` is not a number of samples"),
                "write the number of samples in the mean, a whole number from 1 on, or remove the column",
        )
        .at(format!("{name} line {line}, column `Samples`"))
    })
}

/// Index of the accelerometer to read.
pub(super) fn choose(name: &str, header: &Header, wanted: Option<u32>) -> Result<usize> {
    let sensors = header.accelerometers.as_slice();
    let list = || {
        let numbers: Vec<_> = sensors.iter().flatten().map(u32::to_string).collect();
        numbers.join(", ")
    };
    match (sensors, wanted) {
        ([], _) => Err(ErrorCode::CsvMissingColumn.error(match header.other.as_slice() {
                    [] => "there is no accelerometer in it".to_owned(),
                others => format!(
                    "there is no accelerometer with a unit among its columns: {}{}",
                        others[..others.len().min(MAX_NAMED)].join(", "),
                        if others.len() > MAX_NAMED { ", …" } else { "" }
                ),
            },
                "name the columns `Accelerometer X (g)`, `Accelerometer Y (g)` and `Accelerometer Z (g)`, in LSB, g, \
                 mg or m/s²; linear acceleration (gravity removed) cannot be used",
        )
        .at(format!("{name} line 1"))),
        ([_], None) => Ok(0),
        (_, None) => Err(ErrorCode::Usage.error(format!("it has {} accelerometers", sensors.len()),
            format!(
                    "choose one with --accelerometer: {}; the accelerometers of an array are calibrated together with --geometry",
                list()
            ),
        )
        .at(name)),
        ([None], Some(number)) => Err(ErrorCode::Usage.error(format!("its only accelerometer has no number and is not accelerometer {number}"),
                "leave out --accelerometer",
        )
        .at(name)),
        (_, Some(number)) => sensors
            .iter()
            .position(|sensor| *sensor == Some(number))
            .ok_or_else(|| {
                ErrorCode::Usage.error(format!("it has no accelerometer {number}"),
                    format!("choose from: {}", list()),
                )
                .at(name)
            }),
    }
}
