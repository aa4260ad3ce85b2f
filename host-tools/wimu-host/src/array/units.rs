//! The sensors of an array as they were recorded: those of a table, or that of one board.

use std::path::Path;

use nalgebra::Vector3;
use wimu_link::LinkRole;
use wimu_model::{STANDARD_GRAVITY_MPS2, SpecificForceQ16};

use crate::capture::{Boot, Capture, Link};
use crate::formats::{self, ReadOptions, Source};
use crate::imu::Reference;
use crate::inertial::FULL_SCALE_MPS2;
use crate::plural::counted;
use crate::recording::{Quantity, Recording, Track, Unit};
use crate::series::{Flags, Ns, Series};
use crate::units::RawUnits;
use crate::{Code, Result};

/// Counts of a 16-bit sensor from which on an axis is at its limit.
const LIMIT_COUNTS: f64 = 32_700.0;
/// Part of a board's range from which on an axis counts as being at its limit.
const LIMIT_SHARE: f64 = 0.995;

/// How the sensors of an array are read.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct UnitOptions {
    /// Sensitivity of counts where the recording does not say it.
    pub sensitivity_lsb_per_g: f64,
    /// Of which link; without it, the cable if it was recorded.
    pub link: Option<LinkRole>,
    /// Raw samples even where it has corrected ones: for error models that the geometry has.
    pub raw: bool,
}

/// One sensor of an array: a triad in its own axes.
#[derive(Clone, Debug, Default)]
pub struct ArrayUnit {
    /// What remarks call its recording.
    pub name: String,
    /// Its output, m/s²; of a board at host times (UTC) by the clock model of its link.
    pub force: Series<Vector3<f64>>,
    /// The sensitivity by which counts were scaled, LSB/g; `None` of output in m/s² or g.
    pub sensitivity_lsb_per_g: Option<f64>,
    /// Standard deviation of the times of a board, s: common to all of them, for the most part. `None` of a table.
    pub clock_sd_s: Option<f64>,
    /// Raw samples of a board left out because the range may have changed there and no epoch tells.
    pub without_unit: usize,
}

/// What a file has of an array.
#[derive(Default)]
pub(super) struct Part {
    pub units: Vec<ArrayUnit>,
    pub reference: Reference,
    pub has_magnetometer: bool,
    pub remarks: Vec<String>,
}

impl Part {
    /// Reads a recording of a board (corrected samples where it has them and raw ones are not asked for; of the device's
    /// start with most of them), or a file of any other format with times and accelerometers.
    pub fn read(path: &Path, options: &UnitOptions) -> Result<Self> {
        if formats::is_own(&Source::open(path)?) {
            let capture = Capture::load(path)?;
            let unit = ArrayUnit::of_link(&capture, capture.link(options.link)?, options);
            let units = vec![unit.map_err(|error| error.at(&capture.name))?];
            return Ok(Self { units, ..Self::default() });
        }
        Self::of(&formats::load(path, &ReadOptions::default())?, options)
    }

    /// The accelerometers of a recording at the times of the first one.
    fn of(file: &Recording, options: &UnitOptions) -> Result<Self> {
        let forces: Vec<&Track> = file.of(Quantity::SpecificForce).collect();
        let Some(time) = forces.first().filter(|track| !track.info.timeless) else {
            let message =
                format!("an array needs times and accelerometers; there are {}", forces.len());
            let remedy = "name the columns `Time (s)`, `Accelerometer 0 X (LSB)`, `Accelerometer 1 X (LSB)`, …";
            let error = Code::CsvMissingColumn.error(message, remedy);
            return Err(error.at(format!("{} line 1", file.name)));
        };
        let units: Vec<ArrayUnit> = forces
            .iter()
            .map(|force| ArrayUnit::of_track(force, time, &file.name, options))
            .collect();
        let masked = file.relevant(&[Code::RowsMasked, Code::Frozen]);
        let mut part = Self {
            units,
            reference: Reference::of(file),
            has_magnetometer: file.first(Quantity::MagneticField).is_some(),
            remarks: masked.iter().map(ToString::to_string).collect(),
        };
        part.report_absent();
        part.leave_out_beyond();
        Ok(part)
    }

    /// Remarks which sensors give no number, and where.
    fn report_absent(&mut self) {
        let mut places = Vec::new();
        for (sensor, ArrayUnit { force, .. }) in self.units.iter().enumerate() {
            let is_absent = |v: &&Vector3<f64>| v.iter().any(|axis| !axis.is_finite());
            let absent = force.v.iter().filter(is_absent).count();
            let Some(first) = force.v.iter().position(|v| is_absent(&v)) else {
                continue;
            };
            let at_s = force.t[first].s();
            places.push(if force.len() - first == absent {
                format!("sensor {sensor} (from 0) from {at_s:.2} s on")
            } else {
                let samples = counted(absent, "sample");
                format!("{samples} of sensor {sensor} (from 0), first at {at_s:.2} s")
            });
        }
        if !places.is_empty() {
            self.remarks.push(format!("no number, left out there: {}", places.join("; ")));
        }
    }

    /// Makes what is beyond any accelerometer's full scale not a number, and remarks it, but for outputs that are known to
    /// be at their limit.
    fn leave_out_beyond(&mut self) {
        let (mut count, mut first) = (0, Ns(i64::MAX));
        for ArrayUnit { force, .. } in &mut self.units {
            for ((time, output), flags) in force.t.iter().zip(&mut force.v).zip(&force.flags) {
                if !flags.is_saturated() && output.amax() > FULL_SCALE_MPS2 {
                    output.fill(f64::NAN);
                    count += 1;
                    first = first.min(*time);
                }
            }
        }
        if count > 0 {
            self.remarks.push(format!(
                "more than any accelerometer's full scale, {FULL_SCALE_MPS2:.0} m/s², in {}, first at {:.2} s: left \
                 out, as if they were missing",
                counted(count, "output"),
                first.s()
            ));
        }
    }
}

impl ArrayUnit {
    /// The accelerometer of a track at the times of another one.
    fn of_track(force: &Track, time: &Track, name: &str, options: &UnitOptions) -> Self {
        let counts = matches!(force.info.unit, Unit::Counts { .. });
        let lsb_per_g = counts.then_some(options.sensitivity_lsb_per_g);
        let factor = lsb_per_g.map_or(1.0, |lsb_per_g| STANDARD_GRAVITY_MPS2 / lsb_per_g);
        let values = force.beside(time);
        let rows = time.times_ns().iter().enumerate().map(|(row, time_ns)| {
            let value = Vector3::from(values.at(row, *time_ns).unwrap_or([f64::NAN; 3]));
            let flags = Flags::saturated(counts && value.amax() >= LIMIT_COUNTS);
            (Ns(*time_ns), value * factor, flags)
        });
        Self {
            name: name.to_owned(),
            force: Series::flagged(rows),
            sensitivity_lsb_per_g: lsb_per_g,
            ..Self::default()
        }
    }

    fn of_link(recording: &Capture, link: &Link, options: &UnitOptions) -> Result<Self> {
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

    /// What is to be said of the times of one of several boards.
    pub(super) fn remarks(&self) -> Vec<String> {
        let clock = self.clock_sd_s.map_or_else(
            || {
                "its times are used as in the table; `--setup refine=FILE` estimates a constant delay"
                    .to_owned()
            },
            |sd| format!("its clock known to {:.0} µs", sd * 1e6),
        );
        let rate = 1.0 / self.force.period_s();
        let mut remarks = vec![format!("{}: {rate:.2} Hz, {clock}", self.name)];
        if self.without_unit > 0 {
            remarks.push(format!(
                "{}: {} samples left out: the range may have changed, and its time-reference message (Epoch) is lost",
                self.name, self.without_unit
            ));
        }
        remarks
    }
}
