//! Noise of an accelerometer, of the gyroscope beside it, or of a gyroscope alone in a file, while the file is read.

use std::path::Path;

use wimu_calib::AllanVariance;
use wimu_model::{STANDARD_GRAVITY_MPS2, Sensitivity};

use super::NoiseReport;
use crate::formats::{self, ReadOptions, Source};
use crate::recording::{
    ASSUMED_RATE_HZ, Origin, OutputUnit, Quantity, REACH, RateSource, Recording, Sink, Track,
    TrackId, TrackInfo, Unit, gaps_finding, no_usable_row, rate_and_gaps, unit_of,
};
use crate::series::thin_out;
use crate::stats::{median, norm};
use crate::{Code, Problem, Result};

/// Reads a file and measures the noise of an accelerometer and a gyroscope in it, in memory that does not grow with the file.
/// `sensitivity` is for counts; without it and a sensitivity of the board, the median magnitude of the first
/// 65,536 samples is taken as 1 g.
///
/// Data that do not support an answer give a report with status `refused`.
///
/// # Errors
/// Those of [`formats::load`] and [`Recording::samples`].
pub fn noise(
    path: &Path,
    options: &ReadOptions,
    accelerometer: Option<u8>,
    sensitivity: Option<Sensitivity>,
) -> Result<NoiseReport> {
    let source = Source::open(path)?;
    let mut stream = NoiseOfTracks::new(source.name(), sensitivity);
    formats::read(&source, options, &mut stream)?;
    stream.finish(accelerometer)
}

/// The same of a recording that is in memory.
///
/// # Errors
/// Those of [`Recording::samples`].
pub fn noise_of(
    recording: &Recording,
    accelerometer: Option<u8>,
    sensitivity: Option<Sensitivity>,
) -> Result<NoiseReport> {
    let mut stream = NoiseOfTracks::new(&recording.name, sensitivity);
    recording.hand_on(&mut stream);
    stream.finish(accelerometer)
}

/// Samples among which rate and gaps are judged at a time.
const BLOCK: usize = 1 << 16;
/// Steps of which a median is taken, and medians that are kept, at most.
const STEPS: usize = 32;
const MOST_MEDIANS: usize = 1 << 14;
/// Ratio of sample rates that are not the same; a tenth less than a step of usual output data rates, which is 1.4.
const RATE_CHANGE: f64 = 1.3;

/// The tracks of a file, without their rows, and the noise of the accelerometers.
struct NoiseOfTracks {
    recording: Recording,
    /// One for each track.
    meters: Vec<TrackMeter>,
    sensitivity: Option<Sensitivity>,
}

impl NoiseOfTracks {
    fn new(name: &str, sensitivity: Option<Sensitivity>) -> Self {
        Self { recording: Recording::new(name), meters: Vec::new(), sensitivity }
    }

    /// The noise of the chosen accelerometer and of its gyroscope, or of a gyroscope where there is no accelerometer.
    fn finish(mut self, accelerometer: Option<u8>) -> Result<NoiseReport> {
        let recording = &self.recording;
        let chosen = recording.accelerometer(accelerometer);
        let sensor = chosen.as_ref().ok().map(|track| track.info.sensor);
        let is_gyroscope = |info: &TrackInfo| {
            let is_raw = info.origin == Origin::Sensor && !info.corrected && is_known(info.unit);
            let is_beside = sensor.is_none_or(|sensor| info.sensor == sensor);
            info.quantity == Quantity::AngularRate && is_beside && is_raw
        };
        let index = |is: &dyn Fn(&Track) -> bool| recording.tracks().iter().position(is);
        let force = chosen.as_ref().ok().and_then(|track| index(&|one| std::ptr::eq(one, *track)));
        let rate = index(&|track| is_gyroscope(&track.info));
        let serves_without = rate.is_some() && accelerometer.is_none();
        if let Err(error) = chosen
            && !(serves_without && error.code == Code::NoRows)
        {
            return Err(error);
        }
        let mut rates = Vec::new();
        for index in [force, rate].into_iter().flatten() {
            let info = &recording.tracks()[index].info;
            match self.meters[index].finish(info) {
                Some(found) => rates.push(found),
                None if rates.is_empty() => return Err(no_usable_row(&recording.name, info)),
                None => {}
            }
        }
        let (rate_hz, source) = rates[0];
        let name = &recording.name;
        if source == RateSource::Assumed {
            let is_cause = |finding: &&Problem| finding.code == Code::TimesUnordered;
            let cause = recording.findings.iter().find(is_cause);
            let text = cause.map_or("the data have no times", |finding| &finding.text);
            return Err(Code::DataRefused.error(text, "give --rate HZ").at(name));
        }
        if let Some([before, after]) = force.or(rate).and_then(|k| self.meters[k].changed_rates()) {
            let text = format!("the sample rate changes from {before:.4} to {after:.4} Hz");
            let remedy = "cut the recording where it changes, and measure both parts";
            return Err(Code::DataRefused.error(text, remedy).at(name));
        }
        let measured = |index: usize| Some(&*self.meters[index].allan).filter(|a| a.samples() > 0);
        let allans = [force, rate].map(|index| index.and_then(measured));
        let mut report = NoiseReport::new(&recording.name, rate_hz, source, allans);
        // The rate is in the report.
        let read = recording.findings.iter();
        let read = read.filter(|finding| finding.code != Code::Rate).cloned();
        let gaps = force.or(rate).and_then(|index| gaps_finding(self.meters[index].gaps));
        let before: Vec<Problem> = read.chain(gaps).collect();
        report.outcome.findings.splice(0..0, before);
        Ok(report)
    }
}

impl Sink for NoiseOfTracks {
    fn track(&mut self, info: TrackInfo) -> TrackId {
        self.meters.push(TrackMeter::new(self.sensitivity));
        self.recording.track(info)
    }

    fn row(&mut self, track: TrackId, time_ns: i64, values: &[f64]) {
        let info = &self.recording.tracks()[track.0].info;
        if matches!(info.quantity, Quantity::SpecificForce | Quantity::AngularRate) {
            self.meters[track.0].take(info, time_ns, values);
        }
    }

    fn gap(&mut self, track: TrackId) {
        self.meters[track.0].after_gap = true;
    }

    fn leave_out(&mut self, track: TrackId) {
        self.meters.remove(track.0);
        self.recording.leave_out(track);
    }

    fn finding(&mut self, finding: Problem) {
        self.recording.finding(finding);
    }
}

/// The noise of a track while its rows are read.
struct TrackMeter {
    sensitivity: Option<Sensitivity>,
    /// Times, values and whether the file says that samples are missing before. The first `done` of them were measured and
    /// are kept for the judgement of the next ones.
    rows: Vec<(i64, [f64; 3], bool)>,
    done: usize,
    after_gap: bool,
    allan: Box<AllanVariance>,
    /// m/s² of one unit, once it is known.
    scale: Option<f64>,
    /// Time and number of the samples with times, s.
    sampled: (f64, u64),
    /// Number of gaps and their total length, s.
    gaps: (usize, f64),
    /// Latest steps, and the median of each [`STEPS`] of them, ns.
    recent: Vec<i64>,
    medians: Vec<i64>,
    last_ns: Option<i64>,
}

impl TrackMeter {
    fn new(sensitivity: Option<Sensitivity>) -> Self {
        Self {
            sensitivity,
            rows: Vec::new(),
            done: 0,
            after_gap: false,
            allan: Box::new(AllanVariance::new(1.0)),
            scale: None,
            sampled: (0.0, 0),
            gaps: (0, 0.0),
            recent: Vec::new(),
            medians: Vec::new(),
            last_ns: None,
        }
    }

    fn take(&mut self, info: &TrackInfo, time_ns: i64, values: &[f64]) {
        let vector = <[f64; 3]>::try_from(values).unwrap_or([f64::NAN; 3]);
        if !vector.iter().all(|axis| axis.is_finite()) {
            return;
        }
        if let Some(last_ns) = self.last_ns.replace(time_ns) {
            self.recent.push(time_ns.saturating_sub(last_ns));
        }
        if self.recent.len() >= STEPS {
            self.recent.sort_unstable();
            self.medians.push(self.recent[STEPS / 2]);
            self.recent.clear();
        }
        if self.medians.len() >= MOST_MEDIANS {
            thin_out(&mut self.medians);
        }
        let after_gap = std::mem::take(&mut self.after_gap);
        self.rows.push((time_ns, vector, after_gap));
        if self.rows.len() >= BLOCK {
            // The rows after a step tell whether it is a gap.
            self.measure(info, self.rows.len() - REACH);
            self.rows.drain(..self.done - REACH);
            self.done = REACH;
        }
    }

    /// Measures the rows up to an index.
    fn measure(&mut self, info: &TrackInfo, end: usize) {
        let times: Vec<i64> = self.rows.iter().map(|row| row.0).collect();
        let by_times = rate_and_gaps(&times).filter(|_| !info.timeless);
        if let Some((rate_hz, _)) = by_times {
            let count = end - self.done;
            self.sampled.0 += count as f64 / rate_hz;
            self.sampled.1 += count as u64;
        }
        let (rate_hz, gaps) = by_times.unwrap_or((ASSUMED_RATE_HZ, Vec::new()));
        let stated_hz = info.rate_hz.filter(|_| !info.timeless);
        let scale = *self.scale.get_or_insert_with(|| {
            let of = match info.quantity {
                Quantity::AngularRate => AllanVariance::of_gyroscope,
                _ => AllanVariance::new,
            };
            *self.allan = of(stated_hz.unwrap_or(rate_hz));
            scale_of(info, self.sensitivity, &self.rows)
        });
        let mut gaps = gaps.into_iter().peekable();
        while gaps.next_if(|gap| *gap < self.done).is_some() {}
        for index in self.done..end {
            let (time_ns, value, after_gap) = self.rows[index];
            let step_ns = time_ns.saturating_sub(times[index.saturating_sub(1)]);
            let is_seen = gaps.next_if_eq(&index).is_some();
            if index > 0 && (is_seen && stated_hz.is_none() || after_gap) {
                self.allan.gap();
                let period_s = 1.0 / stated_hz.unwrap_or(rate_hz);
                let missing_s = (step_ns as f64 * 1e-9 - period_s).max(0.0);
                self.gaps = (self.gaps.0 + 1, self.gaps.1 + missing_s);
            }
            self.allan.push(value.map(|axis| axis * scale));
        }
        self.done = end;
    }

    /// Sample rates of the first and of the last tenth, Hz, where they differ by more than [`RATE_CHANGE`].
    fn changed_rates(&self) -> Option<[f64; 2]> {
        let tenth = (self.medians.len() / 10).max(1);
        let ends = [self.medians.get(..tenth)?, &self.medians[self.medians.len() - tenth..]];
        let rates =
            ends.map(|end| median(end.iter().map(|step| *step as f64)).map(|step| 1e9 / step));
        let [Some(before), Some(after)] = rates else { return None };
        let ratio = before / after;
        (ratio.is_finite() && ratio > 0.0 && !(1.0 / RATE_CHANGE..=RATE_CHANGE).contains(&ratio))
            .then_some([before, after])
    }

    /// Measures the rows that are left; returns the rate, Hz, and its source, or `None` without rows.
    fn finish(&mut self, info: &TrackInfo) -> Option<(f64, RateSource)> {
        self.measure(info, self.rows.len());
        let (time_s, count) = self.sampled;
        let (rate_hz, source) = match info.rate_hz {
            _ if info.timeless => (ASSUMED_RATE_HZ, RateSource::Assumed),
            Some(rate_hz) => (rate_hz, RateSource::Device),
            None if count > 0 => (count as f64 / time_s, RateSource::Times),
            None => (ASSUMED_RATE_HZ, RateSource::Assumed),
        };
        self.allan.set_rate(rate_hz);
        (!self.rows.is_empty()).then_some((rate_hz, source))
    }
}

/// Whether the unit of a rate is known.
fn is_known(unit: Unit) -> bool {
    matches!(unit, Unit::Si | Unit::Counts { si_per_lsb: Some(_) })
}

/// SI units of one unit of a track.
fn scale_of(info: &TrackInfo, given: Option<Sensitivity>, rows: &[(i64, [f64; 3], bool)]) -> f64 {
    if info.quantity == Quantity::AngularRate {
        return match info.unit {
            Unit::Counts { si_per_lsb } => si_per_lsb.unwrap_or(f64::NAN),
            _ => 1.0,
        };
    }
    let known = match unit_of(info) {
        OutputUnit::Mps2 => return 1.0,
        OutputUnit::Counts { nominal, .. } => given.or(nominal),
    };
    let median = median(rows.iter().map(|row| norm(row.1))).unwrap_or_default();
    match known {
        Some(known) => known.mps2_per_lsb(),
        None if median > 0.0 => STANDARD_GRAVITY_MPS2 / median,
        None => STANDARD_GRAVITY_MPS2,
    }
}
