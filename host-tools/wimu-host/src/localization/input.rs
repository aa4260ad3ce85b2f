//! Ranges, anchors and odometry from CSV files.

use std::collections::BTreeMap;
use std::path::Path;

use super::{AnchorPosition, Increment, RangeRecording, RangeSample};
use crate::csv::columns::{ANGLE, Column, LENGTH, TIME, Table};
use crate::finding::{Finding, FindingCode};
use crate::plural::counted;
use crate::{ErrorCode, Result};

/// Anchors, and whether they have no height.
fn anchors(path: &Path) -> Result<(Vec<AnchorPosition>, bool)> {
    let table = Table::read(path)?;
    let id = table
        .named("Anchor")
        .ok_or_else(|| table.missing("Anchor"))?;
    let axis = |names: &[&str]| table.column(names, LENGTH);
    let east = table.needed(&["Position E", "X"], LENGTH)?;
    let north = table.needed(&["Position N", "Y"], LENGTH)?;
    let up = axis(&["Position U", "Z"]);
    let mut anchors: Vec<AnchorPosition> = Vec::new();
    for row in 0..table.rows.len() {
        let id = table.text(row, id).to_owned();
        let mut position_m = [0.0; 3];
        let columns = [Some(east), Some(north), up];
        for (component, column) in position_m.iter_mut().zip(columns) {
            if let Some(column) = column {
                *component = table.value(row, column)?.ok_or_else(|| {
                    let message = format!("the position of anchor {id} is incomplete");
                    ErrorCode::CsvBadNumber
                        .error(message, "give all coordinates")
                        .at(&table.name)
                })?;
            }
        }
        if anchors.iter().any(|known| known.id == id) {
            let message = format!("anchor {id} is given twice");
            return Err(ErrorCode::CsvBadNumber
                .error(message, "give each anchor once")
                .at(&table.name));
        }
        anchors.push(AnchorPosition { id, position_m });
    }
    if anchors.is_empty() {
        return Err(ErrorCode::NoRows
            .error("there are no anchors", "give one row each")
            .at(&table.name));
    }
    Ok((anchors, up.is_none()))
}

/// Rows that are left out, and why.
#[derive(Default)]
struct LeftOut(BTreeMap<String, usize>);

impl LeftOut {
    fn count(&mut self, why: impl Into<String>) {
        *self.0.entry(why.into()).or_default() += 1;
    }

    fn findings(self) -> Vec<Finding> {
        let one = |(why, count): (String, usize)| {
            let text = format!("{} left out: {why}", counted(count, "range"));
            FindingCode::SamplesLeftOut.warning(text)
        };
        self.0.into_iter().map(one).collect()
    }
}

impl RangeRecording {
    /// Reads ranges and anchors.
    ///
    /// Ranges have the columns `Time (s)`, `Anchor`, `Range (m)`, or one column `Range ID (m)` for each anchor; anchors
    /// `Anchor`, `Position E (m)`, `Position N (m)` and, in space, `Position U (m)`.
    ///
    /// # Errors
    /// `file_unreadable`, `csv_missing_column`, `csv_bad_number`, `no_rows` without a range to a known anchor.
    pub fn read(ranges: &Path, anchors_file: &Path) -> Result<Self> {
        let (anchors, planar) = anchors(anchors_file)?;
        let table = Table::read(ranges)?;
        let time = table.needed(&["Time"], TIME)?;
        let of = |id: &str| anchors.iter().position(|anchor| anchor.id == id);
        let id = table.named("Anchor");
        let columns: Vec<(String, Column)> = match id {
            Some(_) => vec![(String::new(), table.needed(&["Range"], LENGTH)?)],
            None => {
                let wide = |name: &String| {
                    let id = name.strip_prefix("Range ")?.split_once(" (")?.0.to_owned();
                    let column = table.column(&[&format!("Range {id}")], LENGTH)?;
                    Some((id, column))
                };
                table.header.iter().filter_map(wide).collect()
            }
        };
        if columns.is_empty() {
            return Err(table.missing("Anchor"));
        }
        let (mut samples, mut left_out) = (Vec::new(), LeftOut::default());
        for row in 0..table.rows.len() {
            let time_s = table.value(row, time)?;
            for (name, column) in &columns {
                let name = id.map_or(name.as_str(), |id| table.text(row, id));
                match (time_s, table.value(row, *column)?, of(name)) {
                    (_, None, _) => {}
                    (None, ..) => left_out.count("no time"),
                    (_, _, None) => left_out.count(format!(
                        "anchor {name} is not in {}",
                        anchors_file.display()
                    )),
                    (_, Some(range_m), _) if range_m <= 0.0 => left_out.count("zero or negative"),
                    (Some(time_s), Some(range_m), Some(anchor)) => samples.push(RangeSample {
                        time_s,
                        anchor,
                        range_m,
                    }),
                }
            }
        }
        let mut findings = left_out.findings();
        if !samples.is_sorted_by(|a, b| a.time_s <= b.time_s) {
            samples.sort_by(|a, b| a.time_s.total_cmp(&b.time_s));
            findings.push(
                FindingCode::TimesUnordered
                    .warning("the ranges were not in the order of time: sorted"),
            );
        }
        if samples.is_empty() {
            let remedy = "check the names of the anchors in both files";
            return Err(ErrorCode::NoRows
                .error("there is no range to a known anchor", remedy)
                .at(&table.name));
        }
        Ok(Self {
            name: table.name,
            anchors,
            planar,
            ranges: samples,
            increments: Vec::new(),
            motion: None,
            findings,
        })
    }

    /// The same with wheel odometry: columns `Time (s)`, `Distance Increment (m)`, `Heading Increment (rad)`. Each increment
    /// is that of the interval which ends at its time.
    ///
    /// # Errors
    /// Those of [`read`](Self::read).
    pub fn with_odometry(mut self, path: &Path) -> Result<Self> {
        let table = Table::read(path)?;
        let time = table.needed(&["Time"], TIME)?;
        let distance = table.needed(&["Distance Increment"], LENGTH)?;
        let heading = table.needed(&["Heading Increment"], ANGLE)?;
        let mut rows: Vec<[f64; 3]> = Vec::new();
        for row in 0..table.rows.len() {
            let values = [time, distance, heading].map(|column| table.value(row, column));
            let [Some(time_s), Some(distance_m), Some(rotation_rad)] =
                [values[0].clone()?, values[1].clone()?, values[2].clone()?]
            else {
                continue;
            };
            if rows.last().is_none_or(|last| last[0] < time_s) {
                rows.push([time_s, distance_m, rotation_rad]);
            }
        }
        let left_out = table.rows.len() - rows.len();
        if left_out > 0 {
            let text = format!(
                "{} of the odometry left out: incomplete, or not after the one before",
                counted(left_out, "row")
            );
            self.findings
                .push(FindingCode::SamplesLeftOut.warning(text));
        }
        let times_s: Vec<f64> = rows.iter().map(|row| row[0]).collect();
        let usual_s = crate::motion::median_step_s(&times_s);
        if usual_s <= 0.0 {
            return Err(ErrorCode::NoRows
                .error("there are fewer than two increments", "check the file")
                .at(&table.name));
        }
        let mut before_s = times_s[0] - usual_s;
        for [time_s, distance_m, rotation_rad] in rows {
            self.increments.push(Increment {
                time_s,
                interval_s: time_s - before_s,
                distance_m,
                rotation_rad,
            });
            before_s = time_s;
        }
        Ok(self)
    }
}
