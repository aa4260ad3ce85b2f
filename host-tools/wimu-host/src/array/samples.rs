//! The samples of an array: of one table, or of several boards brought to one time.

use std::path::Path;

use nalgebra::Vector3;

use super::ArrayGeometry;
use super::units::{ArrayUnit, Part, UnitOptions};
use crate::calibration::Correction;
use crate::imu::{Reference, Truth};
use crate::series::{Flags, Interp, Ns, Series};
use crate::{Code, Result};

/// A recording's sensors are counted in the bits of a word.
const MOST_SENSORS: usize = 32;
/// Fewest samples: a cubic needs as many.
const FEWEST: usize = 4;

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

impl Array {
    /// Reads a file of any format with all accelerometers, or one of each board in the order of the geometry.
    ///
    /// # Errors
    /// Those of [`formats::load`](crate::formats::load) and [`of`](Self::of); `data_refused` where nothing tells the clock of a
    /// board.
    pub fn read(paths: &[&Path], options: &UnitOptions) -> Result<Self> {
        let parts = paths.iter().map(|path| Part::read(path, options));
        let mut parts = parts.collect::<Result<Vec<Part>>>()?;
        if let [only] = &mut *parts {
            let part = std::mem::take(only);
            let array = Self::of(part.units)?;
            let remarks = part.remarks.into_iter().chain(array.remarks).collect();
            let Part { reference, has_magnetometer, .. } = part;
            return Ok(Self { reference, has_magnetometer, remarks, ..array });
        }
        for (part, path) in parts.iter().zip(paths) {
            if part.units.len() != 1 {
                let message = format!("it has {} accelerometers", part.units.len());
                let remedy = "one of several boards has one; give a table of all by itself";
                return Err(Code::Usage.error(message, remedy).at(crate::untrusted::name(path)));
            }
        }
        let remarks: Vec<String> = parts.iter().flat_map(|part| part.remarks.clone()).collect();
        let array = Self::of(parts.into_iter().flat_map(|part| part.units).collect())?;
        Ok(Self { remarks: remarks.into_iter().chain(array.remarks).collect(), ..array })
    }

    /// Of sensors. Where their times differ, they are brought to those of the slowest one: each of the others is interpolated
    /// between the four samples around (cubic). Faults of their outputs are [left out](Self::judged).
    ///
    /// # Errors
    /// `usage` for fewer than two sensors or more than 32; `data_refused` where their times do not overlap; `no_rows` for fewer
    /// than four samples.
    pub fn of(units: Vec<ArrayUnit>) -> Result<Self> {
        let mut names: Vec<&str> = units.iter().map(|unit| unit.name.as_str()).collect();
        names.dedup();
        let name = names.join(", ");
        if !(2..=MOST_SENSORS).contains(&units.len()) {
            let message = format!(
                "an array is made of 2 to {MOST_SENSORS} accelerometers, and there are {}",
                units.len()
            );
            let remedy =
                "give a table of all, or the recording of each board in the order of the geometry";
            return Err(Code::Usage.error(message, remedy).at(name));
        }
        let times = units[0].force.t.clone();
        if units.iter().all(|unit| unit.force.t == times) {
            if times.len() < FEWEST {
                let error =
                    Code::NoRows.error("there are fewer than four samples", "check the file");
                return Err(error.at(name));
            }
            return Ok(Self { name, units, ..Self::default() }.judged());
        }
        let times = common_times(&units)?;
        let mut array = Self { name, units, ..Self::default() };
        array.remarks = array.units.iter().flat_map(ArrayUnit::remarks).collect();
        array.interpolate(&times);
        Ok(array.judged())
    }

    /// Interpolates each sensor to the same times.
    fn interpolate(&mut self, times: &[Ns]) {
        let (mut squares, mut count, mut missing) = (0.0, 0.0, 0_usize);
        for unit in &mut self.units {
            let values = unit.force.on(times.iter().copied(), Interp::Cubic);
            let rows = times.iter().zip(values).map(|(time, at)| {
                let Some(at) = at else {
                    missing += 1;
                    return (*time, Vector3::repeat(f64::NAN), Flags::NONE);
                };
                squares += at.error * at.error;
                count += 1.0;
                (*time, at.value, at.flags)
            });
            let force = Series::flagged(rows);
            unit.force = force;
        }
        if count > 0.0 {
            let missing = match missing {
                0 => String::new(),
                some => format!(", {some} values missing"),
            };
            self.remarks.push(format!(
                "interpolated to common times: at most {:.4} m/s² rms wrong{missing}",
                f64::sqrt(squares / count)
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
            unit.force = unit.force.retimed(|time| time.after_s(*delay_s));
        }
        self.interpolate(&kept);
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

/// Times of the slowest sensor at which all have samples.
fn common_times(units: &[ArrayUnit]) -> Result<Vec<Ns>> {
    let series = || units.iter().map(|unit| &unit.force);
    let slowest = series().max_by(|a, b| a.period_s().total_cmp(&b.period_s()));
    let spans = || series().filter_map(Series::span);
    let (from, to) = (spans().map(|[from, _]| from).max(), spans().map(|[_, to]| to).min());
    let begin = spans().map(|[from, _]| from).min().unwrap_or_default();
    let (from, to) = (from.unwrap_or_default(), to.unwrap_or_default());
    let times = slowest.into_iter().flat_map(|series| &series.t).copied();
    let times: Vec<Ns> = times.filter(|time| (from..=to).contains(time)).collect();
    if times.len() >= FEWEST {
        return Ok(times);
    }
    let message = format!(
        "the boards' recordings have no time in common: from the first, the last begins after {:.1} s and one ends after \
         {:.1} s",
        from.since_s(begin),
        to.since_s(begin)
    );
    let remedy = "record all boards at once, on one computer or on computers whose clocks agree";
    Err(Code::DataRefused.error(message, remedy))
}
