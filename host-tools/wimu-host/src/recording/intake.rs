//! What the rows of every format go through on their way to a sink: one clock, the units that the user gives, checks, and
//! gravity that a phone reports apart.

use super::checks::Checks;
use super::gravity::Gravity;
use super::stamps::Clock;
use super::{Quantity, Recording, Sink, Stamped, TrackId, TrackInfo};
use crate::problem::Severity;
use crate::{Code, Problem, Result};

/// How rows are taken in.
pub(crate) struct How {
    /// Whether rows are in order of time: means over static poses are not.
    pub in_order: bool,
    /// Factors of the units that the user gives: of accelerations and of angular rates.
    pub factors: [f64; 2],
    /// Whether all tracks come before the first row.
    pub is_one_table: bool,
}

/// Hands rows on to a sink in order of time, with those that cannot be used as not a number.
pub(crate) struct Intake<'a> {
    clocks: Vec<Clock>,
    /// Index of the clock of each track.
    of_track: Vec<Option<usize>>,
    onward: Onward<'a>,
}

/// What follows once the time of a row is known.
struct Onward<'a> {
    sink: &'a mut dyn Sink,
    how: How,
    tracks: Vec<Checks>,
    gravity: Gravity,
    start_ns: Option<i64>,
}

impl<'a> Intake<'a> {
    pub(crate) fn new(sink: &'a mut dyn Sink, how: How) -> Self {
        let gravity = Gravity::new(how.is_one_table);
        let onward = Onward { sink, how, tracks: Vec::new(), gravity, start_ns: None };
        Self { clocks: Vec::new(), of_track: Vec::new(), onward }
    }

    /// Hands on what is left, and reports what was found in the recording `name`.
    ///
    /// # Errors
    /// `data_refused` when more than half of the rows of an accelerometer cannot be used.
    pub(crate) fn finish(mut self, name: &str) -> Result<()> {
        let is_one = self.clocks.len() == 1;
        for mut clock in std::mem::take(&mut self.clocks) {
            clock.finish(&mut |track, time_ns, values| self.onward.row(track, time_ns, values));
            for mut problem in clock.problems() {
                if !is_one {
                    problem.text = format!("{}: {}", clock.name, problem.text);
                }
                self.onward.sink.finding(problem);
            }
        }
        self.onward.finish(name)
    }
}

impl Sink for Intake<'_> {
    fn track(&mut self, info: TrackInfo) -> TrackId {
        let clock = match info.stamps.filter(|_| self.onward.how.in_order) {
            None => None,
            Some(Stamped::Like(track)) => self.of_track.get(track.0).copied().flatten(),
            Some(Stamped::By(tick_ns)) => {
                self.clocks.push(Clock::new(&info.name, tick_ns));
                Some(self.clocks.len() - 1)
            }
        };
        self.of_track.push(clock);
        self.onward.track(info)
    }

    fn row(&mut self, track: TrackId, time_ns: i64, values: &[f64]) {
        let onward = &mut self.onward;
        match self.of_track.get(track.0).copied().flatten() {
            Some(clock) => {
                self.clocks[clock].push(track, time_ns, values, &mut |track, time_ns, values| {
                    onward.row(track, time_ns, values);
                })
            }
            None => onward.row(track, time_ns, values),
        }
    }

    fn gap(&mut self, track: TrackId) {
        self.onward.sink.gap(track);
    }

    fn finding(&mut self, problem: Problem) {
        if let Some(problem) = self.onward.gravity.keep(problem) {
            self.onward.sink.finding(problem);
        }
    }

    fn takes_any(&self) -> bool {
        self.onward.sink.takes_any()
    }
}

impl Onward<'_> {
    fn track(&mut self, info: TrackInfo) -> TrackId {
        let [force, rate] = self.how.factors;
        let factor = match info.quantity {
            Quantity::SpecificForce | Quantity::LinearAcceleration => force,
            Quantity::AngularRate => rate,
            _ => 1.0,
        };
        self.tracks.push(Checks::new(info.clone(), factor));
        let track = self.sink.track(info.clone());
        self.gravity.track(info, track);
        track
    }

    fn row(&mut self, track: TrackId, time_ns: i64, values: &[f64]) {
        let Some(checks) = self.tracks.get_mut(track.0) else { return };
        let (time_ns, row) = checks.see(time_ns, values, self.how.in_order);
        let row = &row[..checks.info.quantity.width()];
        self.start_ns = Some(self.start_ns.map_or(time_ns, |start| start.min(time_ns)));
        self.gravity.row(track, time_ns, row);
        self.sink.row(track, time_ns, row);
    }

    fn finish(self, name: &str) -> Result<()> {
        let start_ns = self.start_ns.unwrap_or_default();
        let (mut left_out, mut refusal) = (Vec::new(), None);
        for (track, checks) in self.tracks.iter().enumerate() {
            // Drivers fill the fields of a sensor that a message does not have.
            let is_other = |other: &&Checks| other.info.quantity == checks.info.quantity;
            let mut others = self.tracks.iter().filter(is_other);
            if checks.is_zero() && others.any(|other| other.has_rows() && !other.is_zero()) {
                left_out.push(TrackId(track));
                let (what, track) = (checks.info.quantity.name(), &checks.info.name);
                let text = format!("the {what} of {track} is 0 throughout");
                self.sink.finding(Code::TrackChosen.note(text).remedy("it is left out"));
                continue;
            }
            checks.problems(start_ns).into_iter().for_each(|problem| self.sink.finding(problem));
            refusal = refusal.or(checks.refusal());
        }
        self.gravity.finish(self.sink);
        left_out.into_iter().rev().for_each(|track| self.sink.leave_out(track));
        match refusal {
            Some(mut refusal) if self.sink.takes_any() => {
                (refusal.code, refusal.severity) = (Code::TimesUnordered, Severity::Error);
                self.sink.finding(refusal);
                Ok(())
            }
            Some(refusal) => Err(refusal.at(name)),
            None => Ok(()),
        }
    }
}

impl Recording {
    /// The same, taken in like a recording of a file: rows that cannot be used are masked and reported. `in_order` is false for
    /// means over poses.
    ///
    /// # Errors
    /// `data_refused` when more than half of the rows of an accelerometer cannot be used.
    pub fn checked(&self, in_order: bool) -> Result<Self> {
        let mut checked = Self { format: self.format, ..Self::new(&self.name) };
        let how = How { in_order, factors: [1.0; 2], is_one_table: true };
        let mut intake = Intake::new(&mut checked, how);
        self.hand_on(&mut intake);
        intake.finish(&self.name)?;
        Ok(checked)
    }
}
