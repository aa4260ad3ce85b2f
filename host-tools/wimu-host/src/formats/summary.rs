//! What a recording holds, found in one pass that keeps no samples.

use serde::Serialize;
use wimu_calib::PoseFinder;
use wimu_model::STANDARD_GRAVITY_MPS2;

use super::{ReadOptions, Source, read};
use crate::plural::counted;
use crate::recording::{Origin, Quantity, Sink, TrackId, TrackInfo, Unit};
use crate::stats::{median, norm};
use crate::{Code, Problem, Result, Severity};

/// Rows by which the sample rate and the unit of a track are judged.
const FIRST_ROWS: usize = 1000;
/// Steps longer than this many usual ones are gaps: three samples are missing.
const GAP_STEPS: f64 = 3.5;

/// What a recording holds.
#[derive(Clone, Debug, Serialize)]
#[non_exhaustive]
pub struct Summary {
    /// The file.
    pub source: String,
    /// Its format, as docs/FORMATS.md names it.
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
    /// Rows that are earlier than a row before.
    pub unordered: u64,
    /// Median rate of the first rows, Hz.
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
        let mut counter = Counter::default();
        let format = read(source, options, &mut counter)?;
        let span = |of: fn(&TrackCounter) -> Option<i64>| counter.tracks.iter().filter_map(of);
        let from = span(|track| track.first_ns).min();
        let to = span(|track| track.latest_ns).max();
        let duration_ns = from.zip(to).map_or(0, |(from, to)| to.saturating_sub(from));
        let tracks = counter.tracks.into_iter();
        let tracks: Vec<TrackSummary> = tracks.map(TrackCounter::summary).collect();
        let mut findings = counter.findings;
        findings.extend(tracks.iter().filter_map(TrackSummary::finding));
        Ok(Self {
            source: source.name().to_owned(),
            format,
            duration_s: duration_ns as f64 * 1e-9,
            tracks,
            findings,
        })
    }

    /// Names of the other columns.
    pub fn other_columns(&self) -> Vec<&str> {
        let is_other = |track: &&TrackSummary| track.quantity == Quantity::Scalar.name();
        let others = self.tracks.iter().filter(is_other);
        others.map(|track| track.name.as_str()).collect()
    }
}

/// The sink of [`Summary::read`].
#[derive(Default)]
struct Counter {
    tracks: Vec<TrackCounter>,
    findings: Vec<Problem>,
}

impl Sink for Counter {
    fn track(&mut self, info: TrackInfo) -> TrackId {
        self.tracks.push(TrackCounter::new(info));
        TrackId(self.tracks.len() - 1)
    }

    fn row(&mut self, track: TrackId, time_ns: i64, values: &[f64]) {
        if let Some(track) = self.tracks.get_mut(track.0) {
            track.push(time_ns, values);
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

struct TrackCounter {
    info: TrackInfo,
    summary: TrackSummary,
    first_ns: Option<i64>,
    latest_ns: Option<i64>,
    /// The first rows, until the rate is judged.
    first_rows: Vec<(i64, [f64; 3])>,
    /// Usual step, ns.
    step_ns: Option<f64>,
    /// For an accelerometer: m/s² per unit of the values, and the rests.
    rests: Option<(f64, PoseFinder)>,
    magnitudes: (usize, f64),
}

impl TrackCounter {
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
            first_ns: None,
            latest_ns: None,
            first_rows: Vec::new(),
            step_ns: None,
            rests: None,
            magnitudes: (0, 0.0),
        }
    }

    fn push(&mut self, time_ns: i64, values: &[f64]) {
        self.summary.rows += 1;
        self.first_ns = self.first_ns.or(Some(time_ns));
        let is_finite = values.iter().all(|value| value.is_finite());
        self.summary.not_finite += u64::from(!is_finite);
        if self.latest_ns.is_some_and(|latest| time_ns < latest) {
            self.summary.unordered += 1;
            return;
        }
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
        let Some(step_ns) = median(steps) else {
            return;
        };
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

impl TrackSummary {
    /// Rows of an accelerometer that are left out.
    fn finding(&self) -> Option<Problem> {
        let is_force = self.quantity == Quantity::SpecificForce.name();
        let out = self.not_finite + self.unordered;
        (is_force && out > 0).then(|| {
            let (code, severity) = match self.unordered {
                0 => (Code::RowsMasked, Severity::Warning),
                _ if 2 * out > self.rows => (Code::TimesUnordered, Severity::Error),
                _ => (Code::TimesUnordered, Severity::Warning),
            };
            let evidence = format!(
                "{}: {} of {} rows are not finite numbers, {} are earlier than a row before",
                self.name, self.not_finite, self.rows, self.unordered
            );
            let remedy = match severity {
                Severity::Error => "most rows cannot be used: sort them, or select one of several runs with --where",
                _ => "they are left out",
            };
            Problem::new(code, severity, evidence).of_sensor(self.sensor).remedy(remedy)
        })
    }
}

impl std::fmt::Display for TrackSummary {
    /// One line.
    fn fmt(&self, out: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        if self.origin == Origin::Sensor.name() {
            write!(out, "sensor {} {}", self.sensor, self.quantity)?;
        } else {
            write!(out, "{} of {}", self.origin, self.quantity)?;
        }
        let rows = counted(self.rows as usize, "row");
        write!(out, " ({}, {}): {rows}", self.name, self.unit)?;
        if let Some(rate) = self.rate_hz {
            write!(out, ", {rate:.1} Hz")?;
        }
        if self.gaps > 0 {
            let gaps = counted(self.gaps as usize, "gap");
            write!(out, ", {gaps} (longest {:.2} s)", self.longest_step_s)?;
        }
        let counts = [(self.not_finite, "not finite"), (self.unordered, "out of order")];
        for (count, what) in counts.into_iter().filter(|(count, _)| *count > 0) {
            write!(out, ", {count} {what}")?;
        }
        match (self.rests, self.mean_at_rest) {
            (Some(rests), Some(mean)) => {
                let digits = if mean < 100.0 { 3 } else { 0 };
                let unit = self.unit;
                let rests = counted(rests, "rest");
                write!(out, ", {rests} with mean magnitude {mean:.digits$} {unit}")
            }
            (Some(_), None) => write!(out, ", no rests"),
            _ => Ok(()),
        }
    }
}
