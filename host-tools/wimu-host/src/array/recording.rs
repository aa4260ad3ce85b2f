//! A recording of several accelerometers: of one table, or of several boards brought to one time.

use std::path::Path;

use nalgebra::Vector3;
use wimu_link::LinkRole;
use wimu_model::{STANDARD_GRAVITY_MPS2, SpecificForceQ16};

use super::ArrayGeometry;
use crate::calibration::Correction;
use crate::capture::{Boot, Capture, Link};
use crate::formats::{self, ReadOptions};
use crate::motion::{FULL_SCALE_MPS2, Truth, median_step_s};
use crate::plural::counted;
use crate::recording::{Origin, Quantity, Track, Unit};
use crate::series::{Flags, Interp, Ns, Series};
use crate::units::RawUnits;
use crate::{Code, Result};

/// Counts of a 16-bit sensor from which on an axis is at its limit.
const LIMIT_COUNTS: f64 = 32_700.0;
/// Part of a board's range from which on an axis counts as being at its limit.
const LIMIT_SHARE: f64 = 0.995;
/// A recording's sensors are counted in the bits of a word.
const MOST_SENSORS: usize = 32;

/// Samples of several accelerometers at common times.
#[derive(Clone, Debug, Default)]
pub struct ArrayRecording {
    /// Time of the origin of `times_s`, ns, as in the file.
    pub start_ns: i64,
    /// Time of each sample, s.
    pub times_s: Vec<f64>,
    /// X, Y, Z of each sensor, m/s², sample by sample; not a number where a sensor has none.
    pub outputs: Vec<Vec<[f64; 3]>>,
    /// Sensors that were at their limit: bit k for sensor k.
    pub saturated: Vec<u32>,
    /// The sensitivity by which each sensor's counts were scaled, LSB/g; `None` where its output came in
    /// m/s² or g, or the list is shorter.
    pub sensitivities: Vec<Option<f64>>,
    /// The file's other columns, by name.
    pub other: Vec<(String, Vec<f64>)>,
    /// What errors call it.
    pub name: String,
    /// What was noticed on the way.
    pub remarks: Vec<String>,
}

impl ArrayRecording {
    /// Reads a CSV file with columns `Accelerometer 0 X (…)`, `Accelerometer 1 X (…)`, …. Counts are
    /// scaled by `sensitivity_lsb_per_g`.
    ///
    /// # Errors
    /// Those of [`formats::load`]; `csv_missing_column` without times or with one accelerometer only.
    pub fn from_csv(path: &Path, sensitivity_lsb_per_g: f64) -> Result<Self> {
        let mut recording = Self::of_table(path, sensitivity_lsb_per_g, 2)?;
        recording.report_absent();
        recording.leave_out_beyond();
        Ok(recording.judged())
    }

    /// Makes what is beyond any accelerometer's full scale not a number, and says so, but for outputs that are known to be
    /// at their limit.
    fn leave_out_beyond(&mut self) {
        let is_beyond = |output: &[f64; 3]| output.iter().any(|f| f.abs() > FULL_SCALE_MPS2);
        let (mut count, mut first) = (0, None);
        for (k, (row, limited)) in self.outputs.iter_mut().zip(&self.saturated).enumerate() {
            for (sensor, output) in row.iter_mut().enumerate() {
                if limited >> sensor & 1 == 0 && is_beyond(output) {
                    *output = [f64::NAN; 3];
                    count += 1;
                    first.get_or_insert(k);
                }
            }
        }
        if let Some(k) = first {
            self.remarks.push(format!(
                "more than any accelerometer's full scale, {FULL_SCALE_MPS2:.0} m/s², in {}, first at {:.2} s: left \
                 out, as if they were missing",
                counted(count, "output"),
                Ns(self.start_ns).s() + self.times_s[k]
            ));
        }
    }

    /// Brings the samples of several boards to common times: those of the slowest one, each of the
    /// others interpolated between the four samples around (cubic).
    ///
    /// # Errors
    /// `usage` for fewer than two boards or more than 32; `data_refused` where their times do not
    /// overlap.
    pub fn from_boards(boards: &[Board]) -> Result<Self> {
        if !(2..=MOST_SENSORS).contains(&boards.len()) {
            return Err(Code::Usage.error(
                format!("an array is made of 2 to {MOST_SENSORS} boards, not {}", boards.len()),
                "give the recording of each board, in the order of the geometry",
            ));
        }
        let starts = boards.iter().filter_map(|b| Some(b.force.span()?[0]));
        let origin = starts.min().unwrap_or_default();
        let from_origin = |time: &Ns| Ns(time.0 - origin.0);
        let series: Vec<_> = boards.iter().map(|b| b.force.retimed(from_origin)).collect();
        let mut recording = Self::interpolated(&series, common_times_s(&series)?);
        let names: Vec<&str> = boards.iter().map(|b| b.name.as_str()).collect();
        recording.name = names.join(", ");
        recording.sensitivities = boards.iter().map(|b| b.sensitivity_lsb_per_g).collect();
        for (board, series) in boards.iter().zip(&series) {
            let clock = board.clock_sd_s.map_or_else(
                || {
                    "its times are used as in the table; `--setup refine=FILE` estimates a constant delay"
                        .to_owned()
                },
                |sd| format!("its clock known to {:.0} µs", sd * 1e6),
            );
            let rate = 1.0 / series.period_s();
            recording.remarks.push(format!("{}: {rate:.2} Hz, {clock}", board.name));
            if board.without_unit > 0 {
                recording.remarks.push(format!(
                    "{}: {} samples left out: the range may have changed, and its time-reference message (Epoch) is lost",
                    board.name, board.without_unit
                ));
            }
        }
        Ok(recording.judged())
    }

    /// Each series at the same times.
    fn interpolated(series: &[Series<Vector3<f64>>], times_s: Vec<f64>) -> Self {
        let mut recording = Self {
            outputs: vec![Vec::with_capacity(series.len()); times_s.len()],
            saturated: vec![0; times_s.len()],
            ..Self::default()
        };
        let (mut squares, mut count, mut missing) = (0.0, 0.0, 0_usize);
        for (sensor, series) in series.iter().enumerate() {
            let times = times_s.iter().map(|time_s| Ns::from_s(*time_s));
            for (k, at) in series.on(times, Interp::Cubic).enumerate() {
                let Some(at) = at else {
                    recording.outputs[k].push([f64::NAN; 3]);
                    missing += 1;
                    continue;
                };
                recording.outputs[k].push(at.value.into());
                recording.saturated[k] |= u32::from(at.flags.is_saturated()) << sensor;
                squares += at.error * at.error;
                count += 1.0;
            }
        }
        if count > 0.0 {
            let missing = match missing {
                0 => String::new(),
                some => format!(", {some} values missing"),
            };
            recording.remarks.push(format!(
                "interpolated to common times: at most {:.4} m/s² rms wrong{missing}",
                f64::sqrt(squares / count)
            ));
        }
        recording.times_s = times_s;
        recording
    }

    /// The same in body axes, with the errors that `geometry` has a model of and the delays of the sensors
    /// taken off.
    ///
    /// # Errors
    /// `usage` when the numbers of sensors differ.
    pub fn arranged(mut self, geometry: &ArrayGeometry) -> Result<Self> {
        super::motion::check(&self, geometry)?;
        let sensors = &geometry.sensors;
        let scaled_by = |k: usize| self.sensitivities.get(k).copied().flatten();
        let corrections: Vec<Correction> =
            sensors.iter().enumerate().map(|(k, sensor)| sensor.correction(scaled_by(k))).collect();
        for row in &mut self.outputs {
            for (output, correction) in row.iter_mut().zip(&corrections) {
                *output = correction.sample(*output, None);
            }
        }
        let delays: Vec<f64> = sensors.iter().map(|s| s.delay_us * 1e-6).collect();
        Ok(self.shifted(&delays))
    }

    /// The same with each sensor's samples taken so much later than their times say, s, where all sensors still have
    /// samples around: the first and last ones are cut off.
    fn shifted(mut self, delays_s: &[f64]) -> Self {
        let count = self.times_s.len();
        let moves = |delay: &&f64| **delay != 0.0;
        let (least, most) = (delays_s.iter().filter(moves))
            .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), d| (low.min(*d), high.max(*d)));
        if count < 4 || least > most {
            return self;
        }
        // A cubic wants a sample more on either side.
        let (from, to) = (self.times_s[1] + most, self.times_s[count - 2] + least);
        let first = self.times_s.partition_point(|t| *t < from);
        let end = self.times_s.partition_point(|t| *t < to).max(first);
        let late = |(sensor, delay_s): (usize, &f64)| {
            let rows = (0..count).map(|k| {
                let flags = Flags::saturated(self.saturated[k] >> sensor & 1 == 1);
                let time = Ns::from_s(self.times_s[k] + delay_s);
                (time, self.outputs[k][sensor].into(), flags)
            });
            Series::flagged(rows)
        };
        let series: Vec<_> = delays_s.iter().enumerate().map(late).collect();
        let moved = Self::interpolated(&series, self.times_s[first..end].to_vec());
        self.remarks.extend(moved.remarks);
        for (_, values) in &mut self.other {
            values.truncate(end);
            values.drain(..first.min(values.len()));
        }
        Self { times_s: moved.times_s, outputs: moved.outputs, saturated: moved.saturated, ..self }
    }

    /// How many accelerometers there are.
    pub fn sensors(&self) -> usize {
        self.outputs.first().map_or(0, Vec::len)
    }

    /// Whether a sensor's output at a sample is a number and not at the sensor's limit.
    pub fn has(&self, index: usize, sensor: usize) -> bool {
        let limited = self.saturated.get(index).is_some_and(|s| s >> (sensor % 32) & 1 == 1);
        let output = self.outputs.get(index).and_then(|row| row.get(sensor));
        !limited && output.is_some_and(|v| v.iter().all(|axis| axis.is_finite()))
    }

    /// Median time between samples, s.
    pub fn period_s(&self) -> f64 {
        median_step_s(&self.times_s)
    }

    /// Three columns of the file sample by sample, where all are numbers; none without the columns.
    pub fn vectors(&self, names: [String; 3]) -> Vec<Option<[f64; 3]>> {
        let finite = |v: &[f64; 3]| v.iter().all(|c| c.is_finite());
        let rows = self.columns(names).into_iter();
        rows.map(|row| Some(row).filter(finite)).collect()
    }

    /// Values of the columns at each sample; empty if a column is missing.
    fn columns<const N: usize>(&self, names: [String; N]) -> Vec<[f64; N]> {
        let columns = names.map(|name| self.other.iter().find(|(n, _)| *n == name));
        let rows = columns.map(|column| column.map_or(0, |(_, values)| values.len()));
        let value = |k: usize| columns.map(|column| column.map_or(f64::NAN, |(_, v)| v[k]));
        (0..rows.into_iter().min().unwrap_or(0)).map(value).collect()
    }

    /// Where the body truly was, from columns `Truth Position E (m)`, … and `Truth Quaternion W`, ….
    pub fn truth(&self) -> Vec<Option<Truth>> {
        let positions = self.vectors(["E", "N", "U"].map(|a| format!("Truth Position {a} (m)")));
        let quaternion =
            self.columns(["W", "X", "Y", "Z"].map(|a| format!("Truth Quaternion {a}")));
        let truth = |(k, position): (usize, Option<[f64; 3]>)| {
            Some(Truth {
                position_m: position?,
                quaternion: quaternion.get(k).copied().unwrap_or([f64::NAN; 4]),
            })
        };
        positions.into_iter().enumerate().map(truth).collect()
    }

    /// The true angular rate, rad/s, body axes, from columns `Truth Angular Rate X (rad/s)`, ….
    pub fn true_rate_rad_s(&self) -> Vec<Option<[f64; 3]>> {
        self.vectors(["X", "Y", "Z"].map(|a| format!("Truth Angular Rate {a} (rad/s)")))
    }
}

/// Times of the slowest series at which all have samples, s.
fn common_times_s(series: &[Series<Vector3<f64>>]) -> Result<Vec<f64>> {
    let slowest = series.iter().max_by(|a, b| a.period_s().total_cmp(&b.period_s()));
    let spans = || series.iter().filter_map(Series::span);
    let from = spans().map(|[from, _]| from.s()).fold(0.0, f64::max);
    let to = spans().map(|[_, to]| to.s()).fold(f64::INFINITY, f64::min);
    let times = slowest.into_iter().flat_map(|series| &series.t);
    let times_s: Vec<f64> = times.map(|t| t.s()).filter(|t| (from..=to).contains(t)).collect();
    if times_s.len() >= 4 {
        return Ok(times_s);
    }
    let message = format!(
        "the boards' recordings have no time in common: from the first, the last begins after {from:.1} s and one ends after \
         {to:.1} s"
    );
    let remedy = "record all boards at once, on one computer or on computers whose clocks agree";
    Err(Code::DataRefused.error(message, remedy))
}

impl ArrayRecording {
    /// Reads a table of accelerometers, `least` or more, at the times of the first one.
    fn of_table(path: &Path, sensitivity_lsb_per_g: f64, least: usize) -> Result<Self> {
        let file = formats::load(path, &ReadOptions::default())?;
        let forces: Vec<&Track> = file.of(Quantity::SpecificForce).collect();
        let sensors = forces.len();
        let timed = forces.first().filter(|track| !track.info.timeless);
        let Some(time) = timed.filter(|_| (least..=MOST_SENSORS).contains(&sensors)) else {
            let message = format!(
                "an array needs times and {least} to {MOST_SENSORS} accelerometers; there are {sensors}"
            );
            let remedy = "name the columns `Time (s)`, `Accelerometer 0 X (LSB)`, `Accelerometer 1 X (LSB)`, …";
            let error = Code::CsvMissingColumn.error(message, remedy);
            return Err(error.at(format!("{} line 1", file.name)));
        };
        let times = time.times_ns();
        if times.len() < 4 {
            let error = Code::NoRows.error("there are fewer than four samples", "check the file");
            return Err(error.at(&file.name));
        }
        let masked = file.relevant(&[Code::RowsMasked, Code::Frozen]);
        let mut recording = Self {
            name: file.name.clone(),
            start_ns: times[0],
            times_s: times.iter().map(|t| Ns(*t).since_s(Ns(times[0]))).collect(),
            saturated: vec![0; times.len()],
            outputs: vec![Vec::with_capacity(sensors); times.len()],
            remarks: masked.iter().map(ToString::to_string).collect(),
            ..Self::default()
        };
        for (sensor, force) in forces.iter().enumerate() {
            let counts = matches!(force.info.unit, Unit::Counts { .. });
            let factor = if counts { STANDARD_GRAVITY_MPS2 / sensitivity_lsb_per_g } else { 1.0 };
            recording.sensitivities.push(counts.then_some(sensitivity_lsb_per_g));
            let mut values = force.beside(time);
            for (row, time_ns) in times.iter().enumerate() {
                let value = values.at(row, *time_ns).unwrap_or([f64::NAN; 3]);
                let at_limit = counts && value.iter().any(|axis| axis.abs() >= LIMIT_COUNTS);
                recording.saturated[row] |= u32::from(at_limit) << sensor;
                recording.outputs[row].push(value.map(|axis| axis * factor));
            }
        }
        for track in file.tracks() {
            recording.add_columns(track, time);
        }
        Ok(recording)
    }

    /// Adds truth and other columns by name.
    fn add_columns(&mut self, track: &Track, time: &Track) {
        let names: Vec<String> = match (track.info.quantity, track.info.origin) {
            (Quantity::Scalar, _) => vec![track.info.name.clone()],
            (Quantity::Position, Origin::Truth) => {
                ["E", "N", "U"].map(|a| format!("Truth Position {a} (m)")).to_vec()
            }
            (Quantity::Attitude, Origin::Truth) => {
                ["W", "X", "Y", "Z"].map(|a| format!("Truth Quaternion {a}")).to_vec()
            }
            (Quantity::AngularRate, Origin::Truth) => {
                ["X", "Y", "Z"].map(|a| format!("Truth Angular Rate {a} (rad/s)")).to_vec()
            }
            _ => return,
        };
        let mut values = track.beside(time);
        let mut columns = vec![Vec::with_capacity(time.len()); names.len()];
        for (row, time_ns) in time.times_ns().iter().enumerate() {
            let values = values.latest(row, *time_ns);
            for (k, column) in columns.iter_mut().enumerate() {
                column.push(values.and_then(|v| v.get(k)).copied().unwrap_or(f64::NAN));
            }
        }
        self.other.extend(names.into_iter().zip(columns));
    }
}

/// How a board's recording is read.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BoardOptions {
    /// Sensitivity of counts where the recording does not say it.
    pub sensitivity_lsb_per_g: f64,
    /// Of which link; without it, the cable if it was recorded.
    pub link: Option<LinkRole>,
    /// Raw samples even where it has corrected ones: for error models that the geometry has.
    pub raw: bool,
}

/// One board of an array: a triad in its own axes, at host time.
#[derive(Clone, Debug)]
pub struct Board {
    /// What remarks call it.
    pub name: String,
    /// Its output, m/s², at host times (UTC) by the clock model of its link.
    pub force: Series<Vector3<f64>>,
    /// Standard deviation of the times, s: common to all of them, for the most part. `None` of a table.
    pub clock_sd_s: Option<f64>,
    /// Raw samples left out because the range may have changed there and no epoch tells.
    pub without_unit: usize,
    /// The sensitivity by which raw counts were scaled, LSB/g; `None` of corrected samples and tables in m/s².
    pub sensitivity_lsb_per_g: Option<f64>,
}

impl Board {
    /// Reads a recording (corrected samples where it has them and raw ones are not asked for; of the device's
    /// start with most of them), or a CSV file with one accelerometer whose times are the host's.
    ///
    /// # Errors
    /// Those of [`Capture::load`] and [`formats::load`]; `no_rows`; `data_refused` where nothing tells
    /// the board's clock.
    pub fn read(path: &Path, options: &BoardOptions) -> Result<Self> {
        if path.extension().is_some_and(|e| e.eq_ignore_ascii_case("csv")) {
            return Self::of_table(path, options);
        }
        let recording = Capture::load(path)?;
        Self::of_link(&recording, recording.link(options.link)?, options)
            .map_err(|error| error.at(&recording.name))
    }

    fn of_table(path: &Path, options: &BoardOptions) -> Result<Self> {
        let mut table = ArrayRecording::of_table(path, options.sensitivity_lsb_per_g, 1)?;
        table.leave_out_beyond();
        if table.sensors() != 1 {
            let message = format!("it has {} accelerometers", table.sensors());
            let remedy = "one of several boards has one; give a table of all by itself";
            return Err(Code::Usage.error(message, remedy).at(table.name));
        }
        let rows = (0..table.times_s.len()).map(|k| {
            let time = Ns(table.start_ns).after_s(table.times_s[k]);
            (time, table.outputs[k][0].into(), Flags::saturated(table.saturated[k] != 0))
        });
        Ok(Self {
            force: Series::flagged(rows),
            name: table.name,
            clock_sd_s: None,
            without_unit: 0,
            sensitivity_lsb_per_g: table.sensitivities[0],
        })
    }

    fn of_link(recording: &Capture, link: &Link, options: &BoardOptions) -> Result<Self> {
        let samples = |boot: &Boot| {
            let corrected = if options.raw { 0 } else { boot.corrected().len() };
            corrected.max(boot.raw().len())
        };
        let no_rows = || {
            let raw = if options.raw { "raw " } else { "" };
            Code::NoRows.error(
                format!("no {raw}samples came over the {} link", link.role),
                "switch a stream on with `wimu device settings set`, or use the other link",
            )
        };
        let boot = link.boots.iter().max_by_key(|boot| samples(boot)).ok_or_else(no_rows)?;
        let corrected = !boot.corrected().is_empty() && !options.raw;
        let chosen = if corrected { boot.corrected() } else { boot.raw() };
        let last = chosen.last().ok_or_else(no_rows)?;
        let units = RawUnits::of_epochs(boot.epochs().iter().map(|mark| &mark.epoch));
        let nominal = boot.nominal_sensitivity(0).map(|s| s.lsb_per_g());
        let mps2_per_lsb = STANDARD_GRAVITY_MPS2 / options.sensitivity_lsb_per_g;
        let mut board = Self {
            name: recording.name.clone(),
            force: Series::default(),
            clock_sd_s: Some(boot.clock_sd_ns(last.time).unwrap_or_default() * 1e-9),
            without_unit: 0,
            sensitivity_lsb_per_g: (!corrected)
                .then(|| nominal.unwrap_or(options.sensitivity_lsb_per_g)),
        };
        for sample in chosen {
            let utc = |host_ns| recording.anchor.map_or(host_ns, |a| a.to_utc_ns(host_ns));
            let time_ns = boot.host_ns(sample.time).and_then(|ns| i64::try_from(utc(ns)).ok());
            let time_ns = time_ns.ok_or_else(|| {
                Code::DataRefused.error(
                    "it does not relate its samples to the host's clock",
                    "record for some seconds at the least",
                )
            })?;
            let unit = units.of(sample.sequence);
            let (value, range) = match unit {
                _ if corrected => (
                    SpecificForceQ16(sample.value).to_mps2().0,
                    unit.map_or(f64::INFINITY, |unit| unit.range_mps2()),
                ),
                // Counts of a sensor that does not say its sensitivity.
                unit if nominal.is_none() => (
                    sample.value.map(|count| f64::from(count) * mps2_per_lsb),
                    unit.map_or(f64::INFINITY, |u| f64::from(u.full_scale) * mps2_per_lsb),
                ),
                Some(unit) => (unit.mps2(sample.value), unit.range_mps2()),
                None => {
                    board.without_unit += 1;
                    continue;
                }
            };
            let value = Vector3::from(value);
            let flags = Flags::saturated(value.amax() >= LIMIT_SHARE * range);
            board.force.push(Ns(time_ns), value, flags);
        }
        board.force = board.force.even();
        Ok(board)
    }
}
