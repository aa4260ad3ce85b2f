//! Pictures of a recording of any length, in constant memory.

use super::{ReadOptions, Source, read};
use crate::chart::{Chart, Series};
use crate::recording::{Quantity, Sink, TrackId, TrackInfo, Unit};
use crate::{Problem, Result};

/// Intervals of a track: at least half of them are filled.
const INTERVALS: usize = 2048;
/// Tracks that are drawn.
const MOST_TRACKS: usize = 12;
/// Rows between two calls of the observer.
const ROWS: u64 = 20_000;

/// The extremes of every track over equal intervals, found in one pass. Where a track is longer, the intervals double.
#[derive(Default)]
pub struct Overview<'a> {
    tracks: Vec<Extremes>,
    findings: Vec<Problem>,
    rows: u64,
    span_ns: Option<[i64; 2]>,
    observer: Option<Observer<'a>>,
}

/// Called while a file is read.
type Observer<'a> = Box<dyn FnMut(&Overview<'a>) + 'a>;

struct Extremes {
    info: TrackInfo,
    /// Rows of an interval.
    every: u64,
    filled: u64,
    intervals: Vec<Interval>,
}

#[derive(Clone, Copy)]
struct Interval {
    from_ns: i64,
    to_ns: i64,
    low: [f64; 3],
    high: [f64; 3],
}

impl Interval {
    fn join(&mut self, other: &Self) {
        self.to_ns = other.to_ns;
        for axis in 0..3 {
            self.low[axis] = self.low[axis].min(other.low[axis]);
            self.high[axis] = self.high[axis].max(other.high[axis]);
        }
    }
}

impl Extremes {
    fn push(&mut self, time_ns: i64, values: &[f64]) {
        let value = |axis: usize| values.get(axis).copied().unwrap_or(f64::NAN);
        let values = [0, 1, 2].map(value);
        let one = Interval { from_ns: time_ns, to_ns: time_ns, low: values, high: values };
        match self.intervals.last_mut() {
            Some(last) if self.filled < self.every => {
                last.join(&one);
                self.filled += 1;
            }
            _ => {
                self.intervals.push(one);
                self.filled = 1;
            }
        }
        if self.intervals.len() > INTERVALS {
            let pairs = self.intervals.chunks(2);
            self.intervals = pairs
                .map(|pair| {
                    let mut joined = pair[0];
                    pair[1..].iter().for_each(|other| joined.join(other));
                    joined
                })
                .collect();
            // The last one has no pair, because their number was odd.
            self.every *= 2;
        }
    }

    fn chart(&self, first_ns: i64) -> Chart {
        let width = self.info.quantity.width().min(3);
        let (unit, scale) = match self.info.unit {
            Unit::Si => (self.info.quantity.si(), 1.0),
            Unit::Counts { si_per_lsb } => match si_per_lsb {
                Some(scale) => (self.info.quantity.si(), scale),
                None => ("LSB", 1.0),
            },
            Unit::Unknown => ("unit unknown", 1.0),
        };
        let series = (0..width).map(|axis| {
            let points = self.intervals.iter().flat_map(|one| {
                let at = |ns: i64| ns.saturating_sub(first_ns) as f64 * 1e-9;
                [(at(one.from_ns), scale * one.low[axis]), (at(one.to_ns), scale * one.high[axis])]
            });
            let name = if width == 1 { "" } else { ["X", "Y", "Z"][axis] };
            Series::line(name, points.collect())
        });
        let title = format!("{} {}", self.info.name, self.info.quantity.name());
        Chart::new(title, "time, s", unit, series.collect())
    }
}

impl<'a> Overview<'a> {
    /// Calls `observer` every 20,000 rows.
    pub fn observe(&mut self, observer: Box<dyn FnMut(&Overview<'a>) + 'a>) {
        self.observer = Some(observer);
    }

    /// Reads a file; returns the name of its format.
    ///
    /// # Errors
    /// Those of [`read`].
    pub fn read(&mut self, source: &Source, options: &ReadOptions) -> Result<&'static str> {
        read(source, options, self)
    }

    /// Rows so far.
    pub fn rows(&self) -> u64 {
        self.rows
    }

    /// From the first row to the last, s.
    pub fn duration_s(&self) -> f64 {
        let span = self.span_ns.map(|[from, to]| to.saturating_sub(from));
        span.unwrap_or(0) as f64 * 1e-9
    }

    /// What was noticed.
    pub fn findings(&self) -> &[Problem] {
        &self.findings
    }

    /// A chart of each of the first tracks that have rows, sensors before other columns.
    pub fn charts(&self) -> Vec<Chart> {
        let first_ns = self.span_ns.map_or(0, |[from, _]| from);
        let is_other = |track: &&Extremes| track.info.quantity == Quantity::Scalar;
        let filled = || self.tracks.iter().filter(|track| !track.intervals.is_empty());
        let sensors = filled().filter(|track| !is_other(track));
        let all = sensors.chain(filled().filter(is_other));
        let charts = all.take(MOST_TRACKS).map(|track| track.chart(first_ns));
        charts.collect()
    }
}

impl Sink for Overview<'_> {
    fn track(&mut self, info: TrackInfo) -> TrackId {
        self.tracks.push(Extremes { info, every: 1, filled: 0, intervals: Vec::new() });
        TrackId(self.tracks.len() - 1)
    }

    fn row(&mut self, track: TrackId, time_ns: i64, values: &[f64]) {
        let Some(found) = self.tracks.get_mut(track.0) else {
            return;
        };
        found.push(time_ns, values);
        let [from, to] = self.span_ns.unwrap_or([time_ns; 2]);
        self.span_ns = Some([from.min(time_ns), to.max(time_ns)]);
        self.rows += 1;
        if self.rows.is_multiple_of(ROWS)
            && let Some(mut observer) = self.observer.take()
        {
            observer(self);
            self.observer = Some(observer);
        }
    }

    fn finding(&mut self, finding: Problem) {
        if !self.findings.contains(&finding) {
            self.findings.push(finding);
        }
    }

    fn takes_any(&self) -> bool {
        true
    }
}
