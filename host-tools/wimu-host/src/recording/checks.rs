//! Checks that hold for recordings of every format.

use super::{Quantity, Recording, Track};
use crate::error::{ErrorCode, Result};
use crate::finding::{Finding, FindingCode};
use crate::plural::counted;

impl Recording {
    /// Masks rows whose time is earlier than that of a row before, and reports masked rows of accelerometers.
    /// `in_order` is false for means over poses.
    ///
    /// # Errors
    /// `data_refused` when more than half of the rows of an accelerometer cannot be used.
    pub fn check(&mut self, in_order: bool) -> Result<()> {
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
                let finding = FindingCode::RowsMasked.warning(evidence);
                self.findings
                    .push(finding.of_sensor(sensor).remedy("they are left out"));
            }
            let (early, first) = match in_order {
                true => track.mask_early(),
                false => (0, None),
            };
            let is_told = |finding: &Finding| finding.code == FindingCode::TimesUnordered;
            let is_news = is_force && !self.findings.iter().any(is_told);
            if let Some(first) = first.filter(|_| is_news) {
                let evidence = format!(
                    "time goes back: {} earlier than a row before, the first after {:.2} s",
                    counted(early, "row"),
                    since_s(first, track)
                );
                let finding = FindingCode::TimesUnordered.warning(evidence);
                self.findings.push(finding.remedy(
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
        Ok(())
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
