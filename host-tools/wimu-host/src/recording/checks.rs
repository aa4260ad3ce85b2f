//! Checks that hold for recordings of every format.

use super::{Quantity, Recording, Track, TrackInfo};
use crate::plural::counted;
use crate::{Code, Problem, Result};

/// Rows of a track that cannot be used, counted in the order of the file.
#[derive(Clone, Debug, Default)]
pub(crate) struct Unusable {
    rows: usize,
    not_finite: usize,
    first_not_finite_ns: Option<i64>,
    /// Rows that are earlier than a row before.
    early: usize,
    first_early_ns: Option<i64>,
    latest_ns: Option<i64>,
}

impl Unusable {
    /// Counts a row and whether its values are usable numbers; returns the latest time so far, and whether the row can
    /// be used. Means over poses are in any order of time.
    pub(crate) fn see(&mut self, time_ns: i64, is_valid: bool, in_order: bool) -> (i64, bool) {
        self.rows += 1;
        if !is_valid {
            self.not_finite += 1;
            self.first_not_finite_ns.get_or_insert(time_ns);
        }
        let latest_ns = self.latest_ns.filter(|latest| in_order && time_ns < *latest);
        if let Some(latest_ns) = latest_ns {
            self.early += usize::from(is_valid);
            self.first_early_ns.get_or_insert(latest_ns);
            return (latest_ns, false);
        }
        self.latest_ns = Some(time_ns);
        (time_ns, is_valid)
    }

    /// Reports the rows of an accelerometer in `findings`; `name` is that of the recording.
    ///
    /// # Errors
    /// `data_refused` when more than half of the rows cannot be used.
    pub(crate) fn report(
        &self,
        info: &TrackInfo,
        start_ns: Option<i64>,
        name: &str,
        findings: &mut Vec<Problem>,
    ) -> Result<()> {
        if info.quantity != Quantity::SpecificForce {
            return Ok(());
        }
        let (rows, track) = (self.rows, &info.name);
        let since_s = |time: i64| time.saturating_sub(start_ns.unwrap_or_default()) as f64 * 1e-9;
        if let Some(first) = self.first_not_finite_ns {
            let evidence = format!(
                "{} of {rows} of {track} not finite numbers, the first at {:.2} s",
                counted(self.not_finite, "row"),
                since_s(first)
            );
            let finding = Code::RowsMasked.warning(evidence).remedy("they are left out");
            findings.push(finding.of_sensor(info.sensor));
        }
        let is_reported = |finding: &Problem| finding.code == Code::TimesUnordered;
        let is_news = !findings.iter().any(is_reported);
        if let Some(first) = self.first_early_ns.filter(|_| is_news) {
            let evidence = format!(
                "time goes back: {} earlier than a row before, the first after {:.2} s",
                counted(self.early, "row"),
                since_s(first)
            );
            let remedy =
                "they are left out; sort the rows, or select one of several runs with --where";
            findings.push(Code::TimesUnordered.warning(evidence).remedy(remedy));
        }
        if 2 * (self.not_finite + self.early) <= rows {
            return Ok(());
        }
        let message = format!(
            "most rows of {track} cannot be used: {} of {rows} are not finite numbers, {} are earlier than a row before",
            self.not_finite, self.early
        );
        let remedy = "check the file; if it contains several runs, select one with --where; if its rows are means over static \
                      poses, add --poses";
        Err(Code::DataRefused.error(message, remedy).at(name))
    }
}

impl Recording {
    /// Removes inertial tracks of zeros where another track of the quantity has values: drivers fill the fields of a sensor
    /// that a message does not have.
    pub fn remove_zeros(&mut self) {
        let is_zero = |track: &Track| track.valid().all(|(_, row)| row.iter().all(|v| *v == 0.0));
        for quantity in [Quantity::SpecificForce, Quantity::AngularRate] {
            let of = |track: &Track| track.info.quantity == quantity;
            if self.tracks.iter().filter(|track| of(track)).all(is_zero) {
                continue;
            }
            let (empty, kept) = std::mem::take(&mut self.tracks)
                .into_iter()
                .partition(|track| of(track) && !track.is_empty() && is_zero(track));
            self.tracks = kept;
            let empty: Vec<Track> = empty;
            for track in empty {
                let text =
                    format!("the {} of {} is 0 throughout", quantity.name(), track.info.name);
                let finding = Code::TrackChosen.note(text).remedy("it is left out");
                self.findings.push(finding);
            }
        }
    }

    /// Masks rows whose time is earlier than that of a row before, which they are given, and reports masked rows of
    /// accelerometers. `in_order` is false for means over poses.
    ///
    /// # Errors
    /// `data_refused` when more than half of the rows of an accelerometer cannot be used.
    pub fn check(&mut self, in_order: bool) -> Result<()> {
        let start_ns = self.start_ns();
        for track in &mut self.tracks {
            let mut unusable = Unusable::default();
            for (time, valid) in track.times_ns.iter_mut().zip(&mut track.valid) {
                (*time, *valid) = unusable.see(*time, *valid, in_order);
            }
            unusable.report(&track.info, start_ns, &self.name, &mut self.findings)?;
        }
        Ok(())
    }
}
