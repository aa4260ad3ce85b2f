//! The samples of an array: the accelerometers of one recording at common times.

use std::path::Path;

use nalgebra::Vector3;
use wimu_model::STANDARD_GRAVITY_MPS2;

use super::ArrayGeometry;
use crate::calibration::Correction;
use crate::formats::{self, ReadOptions};
use crate::imu::{Reference, Truth};
use crate::inertial::FULL_SCALE_MPS2;
use crate::plural::counted;
use crate::recording::{Quantity, Recording, Track, Unit};
use crate::series::{Flags, Interp, Ns, Series};
use crate::{Code, Result};

/// A recording's sensors are counted in the bits of a word.
const MOST_SENSORS: usize = 32;
/// Fewest samples: a cubic needs as many.
const FEWEST: usize = 4;
/// Sensitivity of counts where nothing says it, LSB/g: 16 bits at ± 16 g.
const SENSITIVITY_LSB_PER_G: f64 = 2048.0;
/// Counts of a 16-bit sensor from which on an axis is at its limit.
const LIMIT_COUNTS: f64 = 32_700.0;

/// Several accelerometers of one body, at common times.
#[derive(Clone, Debug, Default)]
pub struct Array {
    /// What errors call it.
    pub name: String,
    /// The sensors. All have the same times; outputs that are missing are not numbers.
    pub units: Vec<ArrayUnit>,
    /// Where the body truly was, where the file has it.
    pub reference: Reference,
    /// Whether the file has a magnetic field.
    pub has_magnetometer: bool,
    /// What was noticed on the way.
    pub remarks: Vec<String>,
}

/// One sensor of an array: a triad in its own axes.
#[derive(Clone, Debug, Default)]
pub struct ArrayUnit {
    /// Its output, m/s².
    pub force: Series<Vector3<f64>>,
    /// The sensitivity by which counts were scaled, LSB/g; `None` of output in m/s² or g.
    pub sensitivity_lsb_per_g: Option<f64>,
}

impl Array {
    /// Reads a file of any format with all accelerometers, at the times of the first one. Faults of their outputs are
    /// [left out](Self::judged). `sensitivity_lsb_per_g` is that of counts,
    /// instead of the file's.
    ///
    /// # Errors
    /// Those of [`formats::load`]; `csv_missing_column` without times; `usage` for fewer than two sensors or more than 32;
    /// `no_rows` for fewer than four samples.
    pub fn read(
        path: &Path,
        options: &ReadOptions,
        sensitivity_lsb_per_g: Option<f64>,
    ) -> Result<Self> {
        let file = formats::load(path, options)?;
        Self::of(&file, sensitivity_lsb_per_g).map_err(|error| error.at(&file.name))
    }

    fn of(file: &Recording, sensitivity_lsb_per_g: Option<f64>) -> Result<Self> {
        let forces: Vec<&Track> = file.of(Quantity::SpecificForce).collect();
        let Some(time) = forces.first().filter(|track| !track.info.timeless) else {
            let message =
                format!("an array needs times and accelerometers; there are {}", forces.len());
            let remedy = "name the columns `Time (s)`, `Accelerometer 0 X (LSB)`, `Accelerometer 1 X (LSB)`, …";
            return Err(Code::CsvMissingColumn.error(message, remedy));
        };
        if !(2..=MOST_SENSORS).contains(&forces.len()) {
            let message = format!(
                "an array is made of 2 to {MOST_SENSORS} accelerometers, and there are {}",
                forces.len()
            );
            return Err(Code::Usage.error(message, "give a table of all"));
        }
        if time.len() < FEWEST {
            return Err(Code::NoRows.error("there are fewer than four samples", "check the file"));
        }
        let masked = file.relevant(&[Code::RowsMasked, Code::Frozen]);
        let unit = |force: &&Track| ArrayUnit::of_track(force, time, sensitivity_lsb_per_g);
        let mut array = Self {
            name: file.name.clone(),
            units: forces.iter().map(unit).collect(),
            reference: Reference::of(file),
            has_magnetometer: file.first(Quantity::MagneticField).is_some(),
            remarks: masked.iter().map(ToString::to_string).collect(),
        };
        array.report_absent();
        array.leave_out_beyond();
        Ok(array.judged())
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

    /// The same in body axes, with the errors that `geometry` has a model of and the delays of the sensors
    /// taken off.
    ///
    /// # Errors
    /// `usage` when the numbers of sensors differ.
    pub fn arranged(mut self, geometry: &ArrayGeometry) -> Result<Self> {
        super::motion::check(&self, geometry)?;
        for (unit, sensor) in self.units.iter_mut().zip(&geometry.sensors) {
            let correction: Correction = sensor.correction(unit.sensitivity_lsb_per_g);
            unit.force = unit.force.map(|output| correction.sample((*output).into(), None).into());
        }
        let delays: Vec<f64> = geometry.sensors.iter().map(|s| s.delay_us * 1e-6).collect();
        self.shift(&delays);
        Ok(self)
    }

    /// Takes each sensor's samples as so much later than their times, s, where all sensors still have samples around: the
    /// first and last ones are cut off.
    fn shift(&mut self, delays_s: &[f64]) {
        let (times, count) = (self.times().to_vec(), self.len());
        let moves = |delay: &&f64| **delay != 0.0;
        let (least, most) = (delays_s.iter().filter(moves))
            .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), d| (low.min(*d), high.max(*d)));
        if count < FEWEST || least > most {
            return;
        }
        // A cubic wants a sample more on either side.
        let (from, to) = (times[1].after_s(most), times[count - 2].after_s(least));
        let kept: Vec<Ns> = times.into_iter().filter(|time| (from..to).contains(time)).collect();
        for (unit, delay_s) in self.units.iter_mut().zip(delays_s) {
            let late = unit.force.retimed(|time| time.after_s(*delay_s));
            let values = late.on(kept.iter().copied(), Interp::Cubic);
            unit.force = Series::flagged(kept.iter().zip(values).map(|(time, at)| {
                at.map_or((*time, Vector3::repeat(f64::NAN), Flags::NONE), |at| {
                    (*time, at.value, at.flags)
                })
            }));
        }
    }

    /// Times of the samples.
    pub fn times(&self) -> &[Ns] {
        self.units.first().map_or(&[], |unit| &unit.force.t)
    }

    /// Times since the first sample, s.
    pub fn times_s(&self) -> Vec<f64> {
        let times = self.times();
        times.iter().map(|time| time.since_s(times[0])).collect()
    }

    /// Number of samples of each sensor.
    pub fn len(&self) -> usize {
        self.times().len()
    }

    /// Whether there is no sample.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// How many accelerometers there are.
    pub fn sensors(&self) -> usize {
        self.units.len()
    }

    /// Output of a sensor in a sample, m/s².
    pub fn output(&self, index: usize, sensor: usize) -> Vector3<f64> {
        self.units[sensor].force.v[index]
    }

    /// Whether a sensor is at its limit in a sample.
    pub fn is_saturated(&self, index: usize, sensor: usize) -> bool {
        self.units[sensor].force.flags[index].is_saturated()
    }

    /// Whether a sensor's output at a sample is a number and not at the sensor's limit.
    pub fn has(&self, index: usize, sensor: usize) -> bool {
        !self.is_saturated(index, sensor)
            && self.output(index, sensor).iter().all(|v| v.is_finite())
    }

    /// Median time between samples, s.
    pub fn period_s(&self) -> f64 {
        self.units.first().map_or(0.0, |unit| unit.force.period_s())
    }

    /// Where the body truly was at each sample.
    pub fn truth(&self) -> Vec<Option<Truth>> {
        self.reference.on(self.times())
    }

    /// Values of a series of the reference at each sample.
    pub fn beside(&self, series: &Series<Vector3<f64>>) -> Vec<Option<[f64; 3]>> {
        let values = series.on(self.times().iter().copied(), Interp::Linear);
        values.map(|at| Some(at?.value.into())).collect()
    }
}

impl ArrayUnit {
    /// The accelerometer of a track at the times of another one.
    fn of_track(force: &Track, time: &Track, given_lsb_per_g: Option<f64>) -> Self {
        let lsb_per_g = match force.info.unit {
            Unit::Counts { si_per_lsb } => {
                let own = si_per_lsb.map(|si| STANDARD_GRAVITY_MPS2 / si);
                Some(given_lsb_per_g.or(own).unwrap_or(SENSITIVITY_LSB_PER_G))
            }
            _ => None,
        };
        let factor = lsb_per_g.map_or(1.0, |lsb_per_g| STANDARD_GRAVITY_MPS2 / lsb_per_g);
        let values = force.beside(time);
        let rows = time.times_ns().iter().enumerate().map(|(row, time_ns)| {
            let value = Vector3::from(values.at(row, *time_ns).unwrap_or([f64::NAN; 3]));
            let flags = Flags::saturated(lsb_per_g.is_some() && value.amax() >= LIMIT_COUNTS);
            (Ns(*time_ns), value * factor, flags)
        });
        Self { force: Series::flagged(rows), sensitivity_lsb_per_g: lsb_per_g }
    }
}
