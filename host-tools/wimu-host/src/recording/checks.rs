//! Checks that hold for recordings of every format.

use super::{Quantity, Recording, Track};
use crate::error::{ErrorCode, Result};
use crate::finding::{Finding, FindingCode, Severity};
use crate::plural::counted;

/// Names of columns that identify a sensor, and a run.
const SENSORS: [&str; 5] = ["imu", "sensor", "device", "unit", "board"];
const RUNS: [&str; 4] = ["run", "trial", "session", "recording"];
/// Largest number of values of such a column.
const MAX_VALUES: usize = 64;

impl Recording {
    /// Masks rows whose time is earlier than that of a row before, and reports masked rows of accelerometers.
    /// `in_order` is false for means over poses.
    ///
    /// # Errors
    /// `usage` for a table with rows of several sensors or runs; `data_refused` when more than half of the rows of an accelerometer cannot be used.
    pub(crate) fn check(&mut self, in_order: bool) -> Result<()> {
        let start_ns = self.start_ns().unwrap_or_default();
        for track in &mut self.tracks {
            let since_s = |row: usize, track: &Track| {
                track.times_ns[row].saturating_sub(start_ns) as f64 * 1e-9
            };
            let is_force = track.info.quantity == Quantity::SpecificForce;
            let sensor = track.info.sensor;
            let masked = |row: &usize| !track.valid[*row];
            let (count, first) = (
                (0..track.len()).filter(masked).count(),
                (0..track.len()).find(masked),
            );
            if let Some(first) = first.filter(|_| is_force) {
                let evidence = format!(
                    "{} of {} of {} not finite numbers, the first at {:.2} s",
                    counted(count, "row"),
                    track.len(),
                    track.info.name,
                    since_s(first, track)
                );
                let finding = Finding::new(FindingCode::RowsMasked, Severity::Warning, evidence);
                self.findings
                    .push(finding.of_sensor(sensor).remedy("they are left out"));
            }
            let (early, first) = match in_order {
                true => track.mask_early(),
                false => (0, None),
            };
            if let Some(first) = first.filter(|_| is_force) {
                let evidence = format!(
                    "time goes back: {} earlier than a row before, the first after {:.2} s",
                    counted(early, "row"),
                    since_s(first, track)
                );
                let finding =
                    Finding::new(FindingCode::TimesUnordered, Severity::Warning, evidence);
                self.findings.push(finding.of_sensor(sensor).remedy(
                    "they are left out; sort the rows, or select one of several runs with --where",
                ));
            }
            if is_force && 2 * (count + early) > track.len() {
                return Err(ErrorCode::DataRefused
                    .error(
                        format!(
                            "most rows of {} cannot be used: {count} of {} are not finite numbers, {early} are earlier \
                             than a row before",
                            track.info.name,
                            track.len()
                        ),
                        "check the file; if it contains several runs, select one with --where; if its rows are means over \
                         static poses, add --poses",
                    )
                    .at(&self.name));
            }
        }
        let restarts = self
            .findings
            .iter()
            .any(|finding| finding.code == FindingCode::TimesUnordered);
        self.of_one_sensor(restarts)
    }

    /// Refuses rows of several sensors, or of several runs if their times start again.
    fn of_one_sensor(&self, restarts: bool) -> Result<()> {
        let (mut several, mut selected) = (Vec::new(), Vec::new());
        for track in self.of(Quantity::Scalar) {
            let name = track.info.name.as_str();
            let is_one_of = |known: &[&str]| known.contains(&name.to_lowercase().as_str());
            if !is_one_of(&SENSORS) && !(restarts && is_one_of(&RUNS)) {
                continue;
            }
            let mut values: Vec<f64> = track.valid().map(|(_, row)| row[0]).collect();
            values.sort_by(f64::total_cmp);
            values.dedup();
            if (2..=MAX_VALUES).contains(&values.len()) {
                let list: Vec<String> = values.iter().map(f64::to_string).collect();
                several.push(format!("`{name}` is {}", list.join(", ")));
                selected.push(format!("{name}={}", list[0]));
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
            .at(&self.name))
    }
}

impl Track {
    /// Masks rows that are earlier than a row before and gives them its time. Returns their number and the first.
    fn mask_early(&mut self) -> (usize, Option<usize>) {
        let (mut latest, mut count, mut first) = (i64::MIN, 0, None);
        let rows = self.times_ns.iter_mut().zip(&mut self.valid);
        for (row, (time, valid)) in rows.enumerate() {
            if *time < latest {
                first = first.or(Some(row));
                count += usize::from(*valid);
                (*time, *valid) = (latest, false);
            }
            latest = *time;
        }
        (count, first)
    }
}
