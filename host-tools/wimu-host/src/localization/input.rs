//! Ranges, anchors and odometry from CSV files.

use std::collections::BTreeMap;
use std::path::Path;

use super::{AnchorPosition, Increment, RangeRecording};
use crate::formats::table::{ANGLE, LENGTH, MeasuredColumn, Measurements, TIME};
use crate::inertial::aids::Aid;
use crate::plural::counted;
use crate::{Code, Problem, Result};

/// Anchors, at most: the time of an update grows with the square of their number.
const MOST_ANCHORS: usize = 64;

/// Anchors, and whether they have no height.
pub(super) fn anchors(path: &Path) -> Result<(Vec<AnchorPosition>, bool)> {
    let table = Measurements::read(path)?;
    let id = table.named("Anchor").ok_or_else(|| table.missing("Anchor"))?;
    let east = table.needed(&["Position E", "X"], LENGTH)?;
    let north = table.needed(&["Position N", "Y"], LENGTH)?;
    let up = table.column(&["Position U", "Z"], LENGTH);
    let mut anchors: Vec<AnchorPosition> = Vec::new();
    let bad = |message: String, remedy: &str| {
        Err(Code::CsvBadNumber.error(message, remedy).at(&table.name))
    };
    for row in 0..table.len() {
        let id = table.text(row, id).to_owned();
        let value =
            |column: Option<MeasuredColumn>| column.map_or(Ok(Some(0.0)), |c| table.value(row, c));
        let [Some(e), Some(n), Some(u)] = [value(Some(east))?, value(Some(north))?, value(up)?]
        else {
            let message = format!("the position of anchor {id} is incomplete");
            return bad(message, "give all coordinates");
        };
        if anchors.iter().any(|known| known.id == id) {
            let message = format!("anchor {id} is given twice");
            return bad(message, "give each anchor once");
        }
        anchors.push(AnchorPosition { id, position_m: [e, n, u] });
    }
    if anchors.is_empty() {
        return Err(table.empty("there are no anchors", "give one row each"));
    }
    if anchors.len() > MOST_ANCHORS {
        let message = format!("{} anchors are too many: {MOST_ANCHORS} at most", anchors.len());
        let remedy = "leave out those that no range is to";
        return Err(Code::DataRefused.error(message, remedy).at(&table.name));
    }
    Ok((anchors, up.is_none()))
}

/// Ranges of a table to anchors of the file `known`, and what was left out. `arrived_s`: the time of rows without one.
pub(super) fn samples(
    table: &Measurements,
    anchors: &[AnchorPosition],
    known: &str,
    arrived_s: Option<f64>,
) -> Result<(Vec<Aid>, Vec<Problem>)> {
    let time = match arrived_s {
        Some(_) => table.column(&["Time"], TIME),
        None => Some(table.needed(&["Time"], TIME)?),
    };
    let of = |id: &str| anchors.iter().position(|anchor| anchor.id == id);
    let id = table.named("Anchor");
    let columns: Vec<(String, MeasuredColumn)> = match id {
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
    let (mut samples, mut left_out) = (Vec::new(), BTreeMap::<String, usize>::new());
    for row in 0..table.len() {
        let time_s = time.map_or(Ok(None), |time| table.value(row, time))?;
        let time_s = time_s.or(arrived_s);
        for (name, column) in &columns {
            let name = id.map_or(name.as_str(), |id| table.text(row, id));
            let why = match (time_s, table.value(row, *column)?, of(name)) {
                (_, None, _) => continue,
                (None, ..) => "no time".to_owned(),
                (.., None) => format!("anchor {name} is not in {known}"),
                (_, Some(range_m), _) if range_m <= 0.0 => "zero or negative".to_owned(),
                (Some(time_s), Some(range_m), Some(anchor)) => {
                    samples.push(Aid::range(time_s, anchor, range_m));
                    continue;
                }
            };
            *left_out.entry(why).or_default() += 1;
        }
    }
    let left_out = left_out.into_iter().map(|(why, count)| {
        let text = format!("{} left out: {why}", counted(count, "range"));
        Code::SamplesLeftOut.warning(text)
    });
    Ok((samples, left_out.collect()))
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
        let table = Measurements::read(ranges)?;
        let known = anchors_file.display().to_string();
        let (mut samples, mut findings) = samples(&table, &anchors, &known, None)?;
        if !samples.is_sorted_by(|a, b| a.time_s <= b.time_s) {
            samples.sort_by(|a, b| a.time_s.total_cmp(&b.time_s));
            findings.push(
                Code::TimesUnordered.warning("the ranges were not in the order of time: sorted"),
            );
        }
        if samples.is_empty() {
            let remedy = "check the ranges, and the names of the anchors in both files";
            let why = findings.first().map_or_else(String::new, |f| format!(": {}", f.text));
            let message = format!("there is no range to a known anchor{why}");
            return Err(table.empty(&message, remedy));
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

    /// The same, if each range was measured `delay_s` before its time.
    #[must_use]
    pub fn delayed(mut self, delay_s: f64) -> Self {
        for range in &mut self.ranges {
            range.time_s -= delay_s;
        }
        self
    }

    /// The same with wheel odometry: columns `Time (s)`, `Distance Increment (m)`, `Heading Increment (rad)`. Each increment
    /// is that of the interval which ends at its time.
    ///
    /// # Errors
    /// Those of [`read`](Self::read).
    pub fn with_odometry(mut self, path: &Path) -> Result<Self> {
        let table = Measurements::read(path)?;
        let time = table.needed(&["Time"], TIME)?;
        let distance = table.needed(&["Distance Increment"], LENGTH)?;
        let heading = table.needed(&["Heading Increment"], ANGLE)?;
        let mut rows: Vec<[f64; 3]> = Vec::new();
        for row in 0..table.len() {
            let value = |column| table.value(row, column);
            let [Some(time_s), Some(distance_m), Some(rotation_rad)] =
                [value(time)?, value(distance)?, value(heading)?]
            else {
                continue;
            };
            if rows.last().is_none_or(|last| last[0] < time_s) {
                rows.push([time_s, distance_m, rotation_rad]);
            }
        }
        let left_out = table.len() - rows.len();
        if left_out > 0 {
            let text = format!(
                "{} of the odometry left out: incomplete, or not after the one before",
                counted(left_out, "row")
            );
            self.findings.push(Code::SamplesLeftOut.warning(text));
        }
        let times_s: Vec<f64> = rows.iter().map(|row| row[0]).collect();
        let usual_s = crate::inertial::median_step_s(&times_s);
        if usual_s <= 0.0 {
            return Err(table.empty("there are fewer than two increments", "check the file"));
        }
        let before = std::iter::once(times_s[0] - usual_s).chain(times_s.iter().copied());
        let increment = |([time_s, distance_m, rotation_rad], before_s): ([f64; 3], f64)| {
            Increment { time_s, interval_s: time_s - before_s, distance_m, rotation_rad }
        };
        self.increments = rows.into_iter().zip(before).map(increment).collect();
        Ok(self)
    }
}
