//! What a recording holds, and pictures of it, found in one pass that keeps no samples.

use serde::Serialize;
use wimu_calib::PoseFinder;
use wimu_model::STANDARD_GRAVITY_MPS2;

use super::{ReadOptions, Source, read};
use crate::chart::{Chart, Series};
use crate::document::{Document, ToDocument};
use crate::plural::counted;
use crate::recording::{Origin, Quantity, Sink, TrackId, TrackInfo, Unit};
use crate::stats::{median, norm};
use crate::{Problem, Result};

/// Rows by which the sample rate and the unit of a track are judged.
const FIRST_ROWS: usize = 1000;
/// Steps longer than this many usual ones are gaps: three samples are missing.
const GAP_STEPS: f64 = 3.5;
/// Intervals of a track: at least half of them are filled.
const INTERVALS: usize = 2048;
/// Tracks that are drawn.
const MOST_TRACKS: usize = 12;
/// Rows between two calls of the observer.
const ROWS: u64 = 20_000;

/// What a recording holds.
#[derive(Clone, Debug, Serialize)]
#[non_exhaustive]
pub struct Summary {
    /// The file.
    pub source: String,
    /// Its format, as docs/reference/formats.md names it.
    pub format: &'static str,
    /// From the first row of any track to the last, s.
    pub duration_s: f64,
    /// Its tracks.
    pub tracks: Vec<TrackSummary>,
    /// What was noticed.
    #[serde(skip)]
    pub findings: Vec<Problem>,
}

/// What a track holds.
#[derive(Clone, Debug, Default, Serialize)]
#[non_exhaustive]
pub struct TrackSummary {
    /// Topic, message or columns.
    pub name: String,
    /// What it measures.
    pub quantity: &'static str,
    /// Index of the sensor.
    pub sensor: u8,
    /// `sensor`, `estimate` or `truth`.
    pub origin: &'static str,
    /// Unit of the values.
    pub unit: &'static str,
    /// Rows.
    pub rows: u64,
    /// Rows that are not finite numbers.
    pub not_finite: u64,
    /// Mean rate of the first rows without gaps, Hz.
    pub rate_hz: Option<f64>,
    /// Steps in which three samples and more are missing.
    pub gaps: u64,
    /// The longest step, s.
    pub longest_step_s: f64,
    /// Rests of an accelerometer.
    pub rests: Option<usize>,
    /// Mean magnitude at the rests, in the unit of the values.
    pub mean_at_rest: Option<f64>,
}

impl Summary {
    /// Reads a file, or a folder.
    ///
    /// # Errors
    /// Those of [`read`].
    pub fn read(source: &Source, options: &ReadOptions) -> Result<Self> {
        let mut contents = Overview::default();
        let format = contents.read(source, options)?;
        Ok(Self {
            source: source.name().to_owned(),
            format,
            duration_s: contents.duration_s(),
            tracks: contents.tracks.into_iter().map(TrackContents::summary).collect(),
            findings: contents.findings,
        })
    }

    /// Names of the other columns.
    pub fn other_columns(&self) -> Vec<&str> {
        let is_other = |track: &&TrackSummary| track.quantity == Quantity::Scalar.name();
        let others = self.tracks.iter().filter(is_other);
        others.map(|track| track.name.as_str()).collect()
    }
}

/// What the tracks of a recording of any length hold, found in one pass in constant memory.
#[derive(Default)]
pub struct Overview<'a> {
    tracks: Vec<TrackContents>,
    findings: Vec<Problem>,
    rows: u64,
    span_ns: Option<[i64; 2]>,
    observer: Option<Observer<'a>>,
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
        let is_other = |track: &&TrackContents| track.info.quantity == Quantity::Scalar;
        let filled = || self.tracks.iter().filter(|track| track.summary.rows > 0);
        let sensors = filled().filter(|track| !is_other(track));
        let all = sensors.chain(filled().filter(is_other));
        let charts = all.take(MOST_TRACKS).map(|track| track.extremes.chart(&track.info, first_ns));
        charts.collect()
    }
}

impl Sink for Overview<'_> {
    fn track(&mut self, info: TrackInfo) -> TrackId {
        self.tracks.push(TrackContents::new(info));
        TrackId(self.tracks.len() - 1)
    }

    fn row(&mut self, track: TrackId, time_ns: i64, values: &[f64]) {
        let Some(track) = self.tracks.get_mut(track.0) else {
            return;
        };
        track.push(time_ns, values);
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

    fn leave_out(&mut self, track: TrackId) {
        self.tracks.remove(track.0);
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

/// What a track holds, while its rows come.
struct TrackContents {
    info: TrackInfo,
    summary: TrackSummary,
    extremes: Extremes,
    latest_ns: Option<i64>,
    /// The first rows, until the rate is judged.
    first_rows: Vec<(i64, [f64; 3])>,
    /// Usual step, ns.
    step_ns: Option<f64>,
    /// For an accelerometer: m/s² per unit of the values, and the rests.
    rests: Option<(f64, PoseFinder)>,
    magnitudes: (usize, f64),
}

impl TrackContents {
    fn new(info: TrackInfo) -> Self {
        let summary = TrackSummary {
            name: info.name.clone(),
            quantity: info.quantity.name(),
            sensor: info.sensor,
            origin: info.origin.name(),
            unit: match info.unit {
                Unit::Si => info.quantity.si(),
                Unit::Counts { .. } => "LSB",
                Unit::Unknown => "unknown",
            },
            ..TrackSummary::default()
        };
        Self {
            info,
            summary,
            extremes: Extremes { every: 1, ..Extremes::default() },
            latest_ns: None,
            first_rows: Vec::new(),
            step_ns: None,
            rests: None,
            magnitudes: (0, 0.0),
        }
    }

    fn push(&mut self, time_ns: i64, values: &[f64]) {
        self.summary.rows += 1;
        self.extremes.push(time_ns, values);
        let is_finite = values.iter().all(|value| value.is_finite());
        self.summary.not_finite += u64::from(!is_finite);
        let vector = <[f64; 3]>::try_from(values).unwrap_or([f64::NAN; 3]);
        let before_ns = self.latest_ns.replace(time_ns);
        match self.step_ns {
            Some(_) => self.take(before_ns, time_ns, vector),
            None => {
                self.first_rows.push((time_ns, vector));
                if self.first_rows.len() == FIRST_ROWS {
                    self.judge();
                }
            }
        }
    }

    /// Finds the usual step and the scale, and counts the first rows.
    fn judge(&mut self) {
        let rows = std::mem::take(&mut self.first_rows);
        let steps = (rows.windows(2)).map(|pair| pair[1].0.saturating_sub(pair[0].0));
        let steps = steps.filter(|step| *step > 0).map(|step| step as f64);
        let Some(median_ns) = median(steps.clone()) else {
            return;
        };
        // Times of whole milliseconds make every step a little wrong, and their mean right.
        let (mut sum_ns, mut count) = (0.0, 0.0);
        for step_ns in steps.filter(|step| (0.5..1.5).contains(&(step / median_ns))) {
            (sum_ns, count) = (sum_ns + step_ns, count + 1.0);
        }
        let step_ns = sum_ns / count;
        self.step_ns = Some(step_ns);
        self.summary.rate_hz = Some(1e9 / step_ns);
        if self.info.quantity == Quantity::SpecificForce {
            let finder = PoseFinder::new(1e9 / step_ns);
            self.rests = Some((self.mps2_per_unit(&rows), finder));
        }
        let mut before_ns = None;
        for (time_ns, vector) in rows {
            self.take(before_ns, time_ns, vector);
            before_ns = Some(time_ns);
        }
    }

    fn mps2_per_unit(&self, rows: &[(i64, [f64; 3])]) -> f64 {
        match self.info.unit {
            Unit::Si => return 1.0,
            Unit::Counts { si_per_lsb: Some(scale) } => return scale,
            _ => {}
        }
        let norms = rows.iter().map(|(_, vector)| norm(*vector));
        let median = median(norms.filter(|norm| *norm > 0.0));
        median.map_or(1.0, |median| STANDARD_GRAVITY_MPS2 / median)
    }

    fn take(&mut self, before_ns: Option<i64>, time_ns: i64, vector: [f64; 3]) {
        let step = time_ns.saturating_sub(before_ns.unwrap_or(time_ns)) as f64;
        self.summary.longest_step_s = self.summary.longest_step_s.max(step * 1e-9);
        let is_gap = self.step_ns.is_some_and(|usual| step > GAP_STEPS * usual);
        self.summary.gaps += u64::from(is_gap);
        let Some((scale, finder)) = &mut self.rests else {
            return;
        };
        let interruption = is_gap.then_some([f64::NAN; 3]);
        for value in interruption.into_iter().chain([vector]) {
            if let Some(pose) = finder.push(value.map(|axis| axis * *scale)) {
                self.magnitudes.0 += 1;
                self.magnitudes.1 += norm(pose.mean_mps2) / *scale;
            }
        }
    }

    fn summary(mut self) -> TrackSummary {
        if self.step_ns.is_none() {
            self.judge();
        }
        if let Some((scale, finder)) = &mut self.rests {
            while let Some(pose) = finder.finish() {
                self.magnitudes.0 += 1;
                self.magnitudes.1 += norm(pose.mean_mps2) / *scale;
            }
            let (rests, sum) = self.magnitudes;
            self.summary.rests = Some(rests);
            self.summary.mean_at_rest = (rests > 0).then(|| sum / rests as f64);
        }
        self.summary
    }
}

/// Called while a file is read.
type Observer<'a> = Box<dyn FnMut(&Overview<'a>) + 'a>;

/// The extremes of a track over equal intervals; where it is longer, the intervals double.
#[derive(Default)]
struct Extremes {
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

    fn chart(&self, info: &TrackInfo, first_ns: i64) -> Chart {
        let width = info.quantity.width().min(3);
        let (unit, scale) = match info.unit {
            Unit::Si => (info.quantity.si(), 1.0),
            Unit::Counts { si_per_lsb } => match si_per_lsb {
                Some(scale) => (info.quantity.si(), scale),
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
        let title = format!("{} {}", info.name, info.quantity.name());
        Chart::new(title, "time, s", unit, series.collect())
    }
}

impl ToDocument for Summary {
    fn document(&self) -> Document {
        let mut document = Document::new(&self.source);
        let seconds = self.duration_s;
        document.result(&format!("{}: {}, {seconds:.1} s", self.source, self.format));
        let others = self.other_columns();
        for track in self.tracks.iter().filter(|track| !others.contains(&track.name.as_str())) {
            document.key(&track.title(), &track.contents());
        }
        if !others.is_empty() {
            document.key("other columns", &others.join(", "));
        }
        document.findings(&self.findings);
        document
    }
}

impl TrackSummary {
    /// Sensor, quantity, name and unit.
    fn title(&self) -> String {
        let (quantity, name, unit) = (self.quantity, &self.name, self.unit);
        if self.origin == Origin::Sensor.name() {
            format!("sensor {} {quantity} ({name}, {unit})", self.sensor)
        } else {
            format!("{} of {quantity} ({name}, {unit})", self.origin)
        }
    }

    /// Rows, rate, gaps and rests.
    fn contents(&self) -> String {
        let mut text = counted(self.rows as usize, "row");
        if let Some(rate) = self.rate_hz {
            text += &format!(", {rate:.1} Hz");
        }
        if self.gaps > 0 {
            let gaps = counted(self.gaps as usize, "gap");
            text += &format!(", {gaps} (longest {:.2} s)", self.longest_step_s);
        }
        if self.not_finite > 0 {
            text += &format!(", {} not finite", self.not_finite);
        }
        match (self.rests, self.mean_at_rest) {
            (Some(rests), Some(mean)) => {
                let digits = if mean < 100.0 { 3 } else { 0 };
                let rests = counted(rests, "rest");
                text += &format!(", {rests} with mean magnitude {mean:.digits$} {}", self.unit);
            }
            (Some(_), None) => text += ", no rests",
            _ => {}
        }
        text
    }
}
