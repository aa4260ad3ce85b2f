//! A recording of several accelerometers: of one table, or of several boards brought to one time.

use std::ops::Range;
use std::path::Path;

use wimu_link::LinkRole;
use wimu_model::{STANDARD_GRAVITY_MPS2, SpecificForceQ16};

use super::ArrayGeometry;
use crate::capture::{Boot, Capture};
use crate::formats::{self, ReadOptions};
use crate::motion::{FULL_SCALE_MPS2, Truth};
use crate::plural::counted;
use crate::recording::{Origin, Quantity, Track, Unit};
use crate::series::{Series, period_s};
use crate::stats::norm;
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
    /// Time of the origin of `times_s`, s, as in the file.
    pub start_s: f64,
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
        let table = Table::read(path, sensitivity_lsb_per_g, 2)?;
        let mut recording = table.recording;
        recording.start_s = table.first_ns as f64 * 1e-9;
        recording.say_absent();
        recording.leave_out_beyond();
        Ok(recording.judged())
    }

    /// Reads a CSV file with the columns that the single axes of a geometry name, `Accelerometer 0 (m/s²)`, … where they name
    /// none: each axis is the X of a sensor, whose Y and Z are not numbers.
    ///
    /// # Errors
    /// Those of [`formats::load`]; `csv_missing_column` without times or a column that is named.
    pub fn axes_from_csv(
        path: &Path,
        geometry: &ArrayGeometry,
        sensitivity_lsb_per_g: f64,
    ) -> Result<Self> {
        let table = Table::read(path, sensitivity_lsb_per_g, 0)?;
        let mut recording = table.recording;
        recording.start_s = table.first_ns as f64 * 1e-9;
        let count = recording.times_s.len();
        recording.outputs = vec![Vec::with_capacity(geometry.axes.len()); count];
        recording.saturated = vec![0; count];
        for (k, axis) in geometry.axes.iter().enumerate() {
            let name = axis.column_name(k);
            let mut found = None;
            for (column, values) in &recording.other {
                if let Some(unit) = formats::acceleration_unit(column, &name)? {
                    found = Some((unit, values));
                }
            }
            let Some((unit, values)) = found else {
                return Err(Code::CsvMissingColumn.error(format!("there is no column `{name}` for axis {k} (from 0)"),
                    "name the columns of single axes `Accelerometer 0 (m/s²)`, `Accelerometer 1 (m/s²)`, … in the order of \
                     the geometry, or give each axis its `column` in the geometry's JSON",
                )
                .at(format!("{} line 1", recording.name)));
            };
            let mps2 = unit.unwrap_or(STANDARD_GRAVITY_MPS2 / sensitivity_lsb_per_g);
            let rows = recording.outputs.iter_mut().zip(&mut recording.saturated);
            for ((row, bits), value) in rows.zip(values) {
                let at_limit = unit.is_none() && value.abs() >= LIMIT_COUNTS;
                *bits |= u32::from(at_limit) << k;
                row.push([value * mps2, f64::NAN, f64::NAN]);
            }
        }
        recording.leave_out_beyond();
        Ok(recording.judged_axes())
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
                self.start_s + self.times_s[k]
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
        let origin = boards.iter().map(|b| b.origin_ns).min().unwrap_or_default();
        let series: Vec<Series> = boards.iter().map(|b| b.series(origin)).collect();
        let slowest = series.iter().max_by(|a, b| a.period_s.total_cmp(&b.period_s));
        let from = series.iter().filter_map(|s| s.times_s.first().copied());
        let to = series.iter().filter_map(|s| s.times_s.last().copied());
        let (from, to) = (from.fold(0.0, f64::max), to.fold(f64::INFINITY, f64::min));
        let times_s: Vec<f64> = slowest.map_or(Vec::new(), |s| {
            let within = |t: &f64| (from..=to).contains(t);
            s.times_s.iter().copied().filter(within).collect()
        });
        if times_s.len() < 4 {
            return Err(Code::DataRefused.error(format!(
                    "the boards' recordings have no time in common: from the first, the last begins \
                     after {from:.1} s and one ends after {to:.1} s"
                ),
                "record all boards at once, on one computer or on computers whose clocks agree",
            ));
        }
        let names: Vec<&str> = boards.iter().map(|b| b.name.as_str()).collect();
        let mut recording = Self::interpolated(&series, times_s);
        recording.name = names.join(", ");
        recording.sensitivities = boards.iter().map(|b| b.sensitivity_lsb_per_g).collect();
        for (board, series) in boards.iter().zip(&series) {
            let clock = match board.clock_sd_s {
                Some(sd) => format!("its clock known to {:.0} µs", sd * 1e6),
                None => "its times are taken as the table has them: nothing tells how far its clock is off"
                    .to_owned(),
            };
            let rate = 1.0 / series.period_s;
            recording.remarks.push(format!("{}: {rate:.2} Hz, {clock}", board.name));
            if board.without_unit > 0 {
                recording.remarks.push(format!(
                    "{}: {} samples left out: the range may have changed, and the epoch that tells is lost",
                    board.name, board.without_unit
                ));
            }
        }
        let jerk = recording.jerk_rms();
        let clocks: Option<Vec<f64>> = boards.iter().map(|b| b.clock_sd_s).collect();
        recording.remarks.push(match clocks {
            Some(clocks) => format!(
                "at the motion's jerk of {jerk:.0} m/s³ the clocks add up to {:.3} m/s²",
                jerk * clocks.into_iter().fold(0.0, f64::max)
            ),
            None => format!(
                "at the motion's jerk of {jerk:.0} m/s³ each ms by which a clock is off adds {:.3} m/s², which no \
                 deviation says; `--refine` finds constant delays",
                jerk * 1e-3
            ),
        });
        Ok(recording.judged())
    }

    /// Each series at the same times.
    fn interpolated(series: &[Series], times_s: Vec<f64>) -> Self {
        let mut recording = Self {
            outputs: vec![Vec::with_capacity(series.len()); times_s.len()],
            saturated: vec![0; times_s.len()],
            ..Self::default()
        };
        let (mut squares, mut count, mut missing) = (0.0, 0.0, 0_usize);
        for (sensor, series) in series.iter().enumerate() {
            for (k, (value, doubt, limit)) in series.sampled(&times_s).enumerate() {
                recording.outputs[k].push(value);
                recording.saturated[k] |= u32::from(limit) << sensor;
                if value[0].is_nan() {
                    missing += 1;
                } else {
                    squares += doubt * doubt;
                    count += 1.0;
                }
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
        for row in &mut self.outputs {
            for (k, (output, sensor)) in row.iter_mut().zip(sensors).enumerate() {
                *output = sensor.in_body_axes(sensor.corrected(*output, scaled_by(k)));
            }
        }
        let delays: Vec<f64> = sensors.iter().map(|s| s.delay_us * 1e-6).collect();
        Ok(self.shifted(&delays))
    }

    /// The same with each sensor's samples taken so much later than their times say, s, where all sensors still have
    /// samples around: the first and last ones are cut off.
    pub(super) fn shifted(self, delays_s: &[f64]) -> Self {
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
        self.moved(delays_s, first..end)
    }

    /// The same at some of its times.
    fn moved(mut self, delays_s: &[f64], at: Range<usize>) -> Self {
        let period_s = self.period_s();
        let series: Vec<Series> = delays_s
            .iter()
            .enumerate()
            .map(|(sensor, delay)| Series {
                times_s: self.times_s.iter().map(|t| t + delay).collect(),
                values: self.outputs.iter().map(|row| row[sensor]).collect(),
                saturated: self.saturated.iter().map(|s| s >> sensor & 1 == 1).collect(),
                period_s,
            })
            .collect();
        let moved = Self::interpolated(&series, self.times_s[at.clone()].to_vec());
        self.remarks.extend(moved.remarks);
        for (_, values) in &mut self.other {
            values.truncate(at.end);
            values.drain(..at.start.min(values.len()));
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
        period_s(&self.times_s)
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
        let quaternion = self.true_quaternion();
        let truth = |(k, position): (usize, Option<[f64; 3]>)| {
            Some(Truth {
                position_m: position?,
                quaternion: quaternion.get(k).copied().unwrap_or([f64::NAN; 4]),
            })
        };
        positions.into_iter().enumerate().map(truth).collect()
    }

    fn true_quaternion(&self) -> Vec<[f64; 4]> {
        self.columns(["W", "X", "Y", "Z"].map(|a| format!("Truth Quaternion {a}")))
    }

    /// The true angular rate, rad/s, body axes: from columns `Truth Angular Rate X (rad/s)`, …, or else from
    /// the true attitudes before and after each sample.
    pub fn true_rate_rad_s(&self) -> Vec<Option<[f64; 3]>> {
        let given =
            self.vectors(["X", "Y", "Z"].map(|a| format!("Truth Angular Rate {a} (rad/s)")));
        if !given.is_empty() {
            return given;
        }
        let all = self.true_quaternion();
        (0..all.len())
            .map(|k| {
                let [aw, ax, ay, az] = *all.get(k.checked_sub(1)?)?;
                let [bw, bx, by, bz] = *all.get(k + 1)?;
                let step = self.times_s[k + 1] - self.times_s[k - 1];
                // The turn from a to b.
                let w = aw * bw + ax * bx + ay * by + az * bz;
                let v = [
                    aw * bx - ax * bw - ay * bz + az * by,
                    aw * by + ax * bz - ay * bw - az * bx,
                    aw * bz - ax * by + ay * bx - az * bw,
                ];
                let sine = norm(v);
                let by =
                    if sine > 0.0 { 2.0 * sine.atan2(w.abs()) / sine * w.signum() } else { 0.0 };
                Some(v.map(|c| c * by / step)).filter(|r| r.iter().all(|c| c.is_finite()))
            })
            .collect()
    }

    /// Root mean square change of the outputs, m/s³ an axis.
    fn jerk_rms(&self) -> f64 {
        let (mut squares, mut count) = (0.0, 0.0);
        for k in 1..self.outputs.len() {
            let dt = self.times_s[k] - self.times_s[k - 1];
            for (a, b) in self.outputs[k].iter().zip(&self.outputs[k - 1]) {
                for axis in 0..3 {
                    let jerk = (a[axis] - b[axis]) / dt;
                    if jerk.is_finite() {
                        squares += jerk * jerk;
                        count += 1.0;
                    }
                }
            }
        }
        f64::sqrt(squares / f64::max(count, 1.0))
    }
}

/// Samples of accelerometers at the times of the first one.
struct Table {
    recording: ArrayRecording,
    first_ns: i64,
}

impl Table {
    fn read(path: &Path, sensitivity_lsb_per_g: f64, least: usize) -> Result<Self> {
        let file = formats::load(path, &ReadOptions::default())?;
        let forces: Vec<&Track> = file.of(Quantity::SpecificForce).collect();
        let sensors = forces.len();
        let time = forces.first().copied().or(file.tracks().first());
        let timed = time.filter(|track| !track.info.timeless);
        let Some(time) = timed.filter(|_| (least..=MOST_SENSORS).contains(&sensors)) else {
            return Err(Code::CsvMissingColumn.error(format!(
                    "an array needs times and {least} to {MOST_SENSORS} accelerometers; there are \
                     {sensors}"
                ),
                "name the columns `Time (s)`, `Accelerometer 0 X (LSB)`, `Accelerometer 1 X (LSB)`, …",
            )
            .at(format!("{} line 1", file.name)));
        };
        let times = time.times_ns();
        let first_ns = times.first().copied().unwrap_or_default();
        let mut recording = ArrayRecording {
            name: file.name.clone(),
            times_s: times.iter().map(|t| (t - first_ns) as f64 * 1e-9).collect(),
            saturated: vec![0; times.len()],
            outputs: vec![Vec::with_capacity(sensors); times.len()],
            remarks: (file.relevant(&[Code::RowsMasked, Code::Frozen]).iter())
                .map(ToString::to_string)
                .collect(),
            ..ArrayRecording::default()
        };
        if times.len() < 4 {
            let error = Code::NoRows.error("there are fewer than four samples", "check the file");
            return Err(error.at(&file.name));
        }
        for (sensor, force) in forces.iter().enumerate() {
            let counts = matches!(force.info.unit, Unit::Counts { .. });
            let factor = match counts {
                true => STANDARD_GRAVITY_MPS2 / sensitivity_lsb_per_g,
                false => 1.0,
            };
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
        Ok(Self { recording, first_ns })
    }
}

impl ArrayRecording {
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
    /// Host time of `times_s` = 0, ns UTC.
    pub origin_ns: i64,
    /// Host time of each sample by the clock model of its link, s since the origin.
    pub times_s: Vec<f64>,
    /// Its output, m/s².
    pub values: Vec<[f64; 3]>,
    /// Whether an axis was at its limit.
    pub saturated: Vec<bool>,
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
            let table = Table::read(path, options.sensitivity_lsb_per_g, 1)?;
            let mut recording = table.recording;
            recording.leave_out_beyond();
            if recording.sensors() != 1 {
                return Err(Code::Usage
                    .error(
                        format!("it has {} accelerometers", recording.sensors()),
                        "one of several boards has one; give a table of all by itself",
                    )
                    .at(recording.name));
            }
            return Ok(Self {
                name: recording.name,
                origin_ns: table.first_ns,
                times_s: recording.times_s,
                values: recording.outputs.iter().map(|row| row[0]).collect(),
                saturated: recording.saturated.iter().map(|s| *s != 0).collect(),
                clock_sd_s: None,
                without_unit: 0,
                sensitivity_lsb_per_g: recording.sensitivities.first().copied().flatten(),
            });
        }
        let recording = Capture::load(path)?;
        let link = recording.link(options.link)?;
        let samples = |boot: &Boot| match options.raw {
            true => boot.raw().len(),
            false => boot.corrected().len().max(boot.raw().len()),
        };
        let no_rows = || {
            let raw = if options.raw { "raw " } else { "" };
            Code::NoRows
                .error(
                    format!("no {raw}samples came over the {} link", link.role),
                    "switch a stream on with `wimu device settings set`, or use the other link",
                )
                .at(&recording.name)
        };
        let boot = link.boots.iter().max_by_key(|boot| samples(boot)).ok_or_else(no_rows)?;
        let corrected = !boot.corrected().is_empty() && !options.raw;
        let chosen = if corrected { boot.corrected() } else { boot.raw() };
        let (Some(first), Some(last)) = (chosen.first(), chosen.last()) else {
            return Err(no_rows());
        };
        let units = RawUnits::of_epochs(boot.epochs().iter().map(|mark| &mark.epoch));
        let given = boot
            .nominal_sensitivity(0)
            .is_none()
            .then_some(STANDARD_GRAVITY_MPS2 / options.sensitivity_lsb_per_g);
        let host = |time| {
            let host_ns = boot.host_ns(time)?;
            let utc = recording.anchor.map_or(host_ns, |a| a.to_utc_ns(host_ns));
            i64::try_from(utc).ok()
        };
        let no_clock = || {
            Code::DataRefused
                .error(
                    "nothing in it tells when its samples were taken by the host's clock",
                    "record for some seconds at the least",
                )
                .at(&recording.name)
        };
        let origin_ns = host(first.time).ok_or_else(no_clock)?;
        let mut board = Self {
            name: recording.name.clone(),
            origin_ns,
            times_s: Vec::with_capacity(chosen.len()),
            values: Vec::with_capacity(chosen.len()),
            saturated: Vec::with_capacity(chosen.len()),
            clock_sd_s: Some(boot.clock_sd_ns(last.time).unwrap_or_default() * 1e-9),
            without_unit: 0,
            sensitivity_lsb_per_g: (!corrected).then(|| {
                boot.nominal_sensitivity(0).map_or(options.sensitivity_lsb_per_g, |s| s.lsb_per_g())
            }),
        };
        for sample in chosen {
            let time_ns = host(sample.time).ok_or_else(no_clock)?;
            let unit = units.of(sample.sequence);
            let value = match (corrected, given, unit) {
                (true, _, _) => SpecificForceQ16(sample.value).to_mps2().0,
                (false, Some(factor), _) => sample.value.map(|count| f64::from(count) * factor),
                (false, None, Some(unit)) => unit.mps2(sample.value),
                (false, None, None) => {
                    board.without_unit += 1;
                    continue;
                }
            };
            let range = match (given.filter(|_| !corrected), unit) {
                (Some(factor), unit) => {
                    unit.map_or(f64::INFINITY, |unit| f64::from(unit.full_scale) * factor)
                }
                (None, unit) => unit.map_or(f64::INFINITY, |unit| unit.range_mps2()),
            };
            let time_s = (time_ns - origin_ns) as f64 * 1e-9;
            if board.times_s.last().is_none_or(|last| time_s > *last) {
                board.times_s.push(time_s);
                board.values.push(value);
                let at_limit = |axis: &f64| axis.abs() >= LIMIT_SHARE * range;
                board.saturated.push(value.iter().any(at_limit));
            }
        }
        Ok(board)
    }

    fn series(&self, origin_ns: i64) -> Series {
        let later = (self.origin_ns - origin_ns) as f64 * 1e-9;
        Series {
            times_s: self.times_s.iter().map(|t| t + later).collect(),
            values: self.values.clone(),
            saturated: self.saturated.clone(),
            period_s: period_s(&self.times_s),
        }
    }
}
