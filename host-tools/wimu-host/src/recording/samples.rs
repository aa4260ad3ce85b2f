//! The samples of one accelerometer with what was measured beside them.

use std::iter;

use wimu_calib::{Pose, SixAxisSample, find_poses};
use wimu_link::hello::sensor;
use wimu_model::{
    Counts, ParameterSet, STANDARD_GRAVITY_MPS2, Sensitivity, SensorId, TemperatureTerms,
};

use super::times::rate_and_gaps;
use super::{Origin, Quantity, Recording, Track, TrackInfo, Unit};
use crate::calibration::{Datasheet, SensorCalibration};
use crate::plural::counted;
use crate::{Code, Problem, Result};

/// Assumed sample rate of data without times, Hz.
pub(crate) const ASSUMED_RATE_HZ: f64 = 100.0;
/// Extrapolation beyond the temperatures of a calibration without a warning, K. Chosen.
const BEYOND_K: f64 = 5.0;
/// More rows than this at a higher rate than this, Hz, are samples, not means over poses, which take seconds each.
const MAX_POSES: usize = 100;
const MAX_POSE_RATE_HZ: f64 = 5.0;

/// Unit of [`Output::value`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum OutputUnit {
    /// Counts, LSB.
    Counts {
        /// Nominal sensitivity, where the device knows it.
        nominal: Option<Sensitivity>,
        /// Full-scale range, ± *g*, where it is known.
        range_g: Option<u8>,
    },
    /// m/s².
    Mps2,
}

/// Source of a sample rate.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize)]
#[serde(rename_all = "snake_case")]
pub enum RateSource {
    /// The device's settings.
    Device,
    /// The file's times.
    Times,
    /// Assumed.
    Assumed,
}

/// One row: a sample, or the mean of a static pose.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Output {
    /// X, Y, Z, sensor axes.
    pub value: [f64; 3],
    /// The latest temperature, °C; before the first one, that.
    pub temperature_c: Option<f64>,
    /// Number of samples in a mean; 1 for a sample.
    pub samples: u32,
    /// Whether samples are missing before this one.
    pub after_gap: bool,
    /// Output of the magnetometer, nT, with the first sample at or after its time.
    pub magnetic_field_nt: Option<[f64; 3]>,
}

/// Which samples of a recording.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Selection {
    /// The index of the accelerometer, where there are several.
    pub accelerometer: Option<u8>,
    /// Whether the rows are means over static poses, in any order of time.
    pub poses: bool,
}

/// The samples of one accelerometer, not corrected, with what was measured beside them.
#[derive(Clone, Debug)]
pub struct Samples<'a> {
    /// Name of the data in errors.
    pub name: &'a str,
    /// Unit of the values.
    pub unit: OutputUnit,
    /// Whether the rows are static-pose means.
    pub poses: bool,
    /// Sample rate, Hz.
    pub rate_hz: f64,
    /// Source of the rate.
    pub rate_source: RateSource,
    /// The accelerometer, where a device identified it.
    pub sensor: Option<SensorId>,
    /// The gyroscope beside it, not corrected.
    pub(crate) rate: Option<&'a Track>,
    /// Warnings and assumptions of reading.
    pub(crate) findings: Vec<Problem>,
    force: &'a Track,
    /// Valid rows of `force`.
    rows: Vec<usize>,
    /// Indices of `rows` before which samples are missing, ascending.
    gaps: Vec<usize>,
    temperature: Option<&'a Track>,
    field: Option<&'a Track>,
    weights: Option<&'a Track>,
}

impl Recording {
    /// The samples of an accelerometer.
    ///
    /// # Errors
    /// `no_rows` without samples; `usage` when there are several accelerometers and none is selected, or rows that
    /// are no means are taken for means over poses.
    pub fn samples(&self, selection: Selection) -> Result<Samples<'_>> {
        let force = self.accelerometer(selection.accelerometer)?;
        let rows: Vec<usize> = (0..force.len()).filter(|row| force.valid[*row]).collect();
        if rows.is_empty() {
            return Err(no_usable_row(&self.name, &force.info));
        }
        let times: Vec<i64> = rows.iter().map(|row| force.times_ns[*row]).collect();
        let by_times = (!force.info.timeless).then(|| rate_and_gaps(&times));
        let (rate_hz, rate_source, seen) = match (force.info.rate_hz, by_times.flatten()) {
            (Some(rate), _) if !force.info.timeless => (rate, RateSource::Device, Vec::new()),
            (_, Some((rate, gaps))) => (rate, RateSource::Times, gaps),
            _ => (ASSUMED_RATE_HZ, RateSource::Assumed, Vec::new()),
        };
        let is_gap = |(index, row): (usize, &usize)| {
            let stated = force.gaps.binary_search(row).is_ok() && index > 0;
            (stated || seen.binary_search(&index).is_ok()).then_some(index)
        };
        // Pose means are not a time series: no samples are missing between them.
        let gaps = if selection.poses {
            Vec::new()
        } else {
            rows.iter().enumerate().filter_map(is_gap).collect()
        };
        let sampled = rate_source == RateSource::Times
            && rate_hz > MAX_POSE_RATE_HZ
            && rows.len() > MAX_POSES;
        if selection.poses && sampled {
            let rows = rows.len();
            let error = Code::Usage.error(
                format!(
                    "its {rows} rows look like a continuous recording, not means over static poses"
                ),
                "leave out --poses: the rests are found in the recording",
            );
            return Err(error.at(&self.name));
        }
        let of_sensor = |quantity| {
            self.of(quantity).find(|track| {
                let info = &track.info;
                let same = info.sensor == force.info.sensor || quantity != Quantity::MagneticField;
                same && info.origin == Origin::Sensor && !info.corrected
            })
        };
        let weights =
            self.of(Quantity::Scalar).find(|track| selection.poses && track.info.name == "Samples");
        if let Some(track) = weights {
            let is_count = |value: &f64| value.trunc() == *value && (1.0..=4e9).contains(value);
            let whole = track.valid().filter(|(_, row)| is_count(&row[0])).count();
            if whole < rows.len() {
                let error = Code::CsvBadNumber.error(
                    format!("{} of {} values of `Samples` are no numbers of samples", rows.len() - whole, rows.len()),
                    "write the number of samples in each mean, a whole number from 1 on, or remove the column",
                );
                return Err(error.at(&self.name));
            }
        }
        Ok(Samples {
            name: &self.name,
            unit: unit_of(&force.info),
            poses: selection.poses,
            rate_hz,
            rate_source,
            sensor: force.info.device,
            // The rate is in the reports.
            findings: self.relevant(&[Code::Rate]),
            rate: of_sensor(Quantity::AngularRate),
            force,
            rows,
            gaps,
            temperature: of_sensor(Quantity::Temperature),
            field: of_sensor(Quantity::MagneticField),
            weights,
        })
    }

    /// The accelerometer with this index, or the only one.
    pub(crate) fn accelerometer(&self, wanted: Option<u8>) -> Result<&Track> {
        let forces = self.of(Quantity::SpecificForce);
        let mut all: Vec<&Track> =
            forces.filter(|track| track.info.origin == Origin::Sensor).collect();
        // Corrected samples only where there are no others.
        if all.iter().any(|track| !track.info.corrected) {
            all.retain(|track| !track.info.corrected);
        }
        let fail =
            |code: Code, text: &str, remedy: String| Err(code.error(text, remedy).at(&self.name));
        let Some(first) = all.first() else {
            let missing = self.findings.iter().find(|finding| finding.code == Code::GravityMissing);
            let (text, remedy) = match missing {
                Some(missing) => (&*missing.text, missing.remedy.clone()),
                None => (
                    "there is no accelerometer in it",
                    "`wimu info FILE` lists what it has".to_owned(),
                ),
            };
            return fail(Code::NoRows, text, remedy);
        };
        let sensor = wanted.unwrap_or(first.info.sensor);
        let same = |track: &&&Track| track.info.sensor == sensor;
        let of_sensor: Vec<&Track> = all.iter().filter(same).copied().collect();
        let range = |track: &&Track| match track.info.unit {
            Unit::Counts { si_per_lsb } => Some((STANDARD_GRAVITY_MPS2 / si_per_lsb?).to_string()),
            _ => None,
        };
        let ranges: Vec<String> = of_sensor.iter().filter_map(range).collect();
        if let [first, _, ..] = ranges.as_slice() {
            let text = format!("the range changes: 1 g is {} LSB", ranges.join(", then "));
            let remedy = format!(
                "select the rows of one range with --where \"Sensitivity (LSB/g)={first}\", or record at one range"
            );
            return fail(Code::CsvMixedUnits, &text, remedy);
        }
        if ranges.is_empty() && of_sensor.len() > 1 {
            let mut names: Vec<&str> = all.iter().map(|t| t.info.name.as_str()).collect();
            names.dedup();
            let (count, names) = (of_sensor.len(), names.join(", "));
            let text = format!("{count} accelerometers have the same number: {names}");
            let remedy = "give one file of the folder or archive, or choose with --topic";
            return fail(Code::Usage, &text, remedy.to_owned());
        }
        let numbers: Vec<_> = all.iter().map(|t| t.info.sensor.to_string()).collect();
        let numbers = numbers.join(", ");
        // A board corrects its first sensor.
        let is_chosen = wanted.is_some() || all.len() == 1 || self.format == super::OF_WIMU;
        match of_sensor.first() {
            Some(track) if is_chosen => Ok(track),
            None => {
                let text = format!("it has no accelerometer {sensor}");
                fail(Code::Usage, &text, format!("choose from: {numbers}"))
            }
            Some(_) => fail(
                Code::Usage,
                &format!("it has {} accelerometers", all.len()),
                format!(
                    "choose one with --sensor: {numbers}; the accelerometers of an array are calibrated together with \
                     --setup geometry=FILE"
                ),
            ),
        }
    }
}

/// Problem on a number of gaps and their total length, s; `None` without gaps.
pub(crate) fn gaps_finding((count, total_s): (usize, f64)) -> Option<Problem> {
    (count > 0).then(|| {
        Code::Rate.warning(format!(
            "samples are missing: {}, {total_s:.1} s in total; no mean includes a gap",
            counted(count, "gap")
        ))
    })
}

pub(crate) fn no_usable_row(name: &str, force: &TrackInfo) -> Problem {
    let message = format!("{} has no usable row", force.name);
    (Code::NoRows.error(message, "check the file, and --where")).at(name)
}

/// Unit of the samples of a track.
pub(crate) fn unit_of(force: &TrackInfo) -> OutputUnit {
    let Unit::Counts { si_per_lsb } = force.unit else {
        return OutputUnit::Mps2;
    };
    let sensitivity = |scale: f64| Sensitivity::from_lsb_per_g(STANDARD_GRAVITY_MPS2 / scale).ok();
    let range = |mps2: f64| (mps2 / STANDARD_GRAVITY_MPS2).round() as u8;
    OutputUnit::Counts {
        nominal: si_per_lsb.and_then(sensitivity),
        range_g: force.full_scale.map(range),
    }
}

impl<'a> Samples<'a> {
    /// Description of the accelerometer's track.
    pub fn info(&self) -> &'a TrackInfo {
        &self.force.info
    }

    /// Number of samples; at least one.
    pub fn len(&self) -> usize {
        self.rows.len()
    }

    /// Never true.
    pub fn is_empty(&self) -> bool {
        self.rows.is_empty()
    }

    /// The output of a sample, sensor axes, in its unit.
    pub fn value(&self, index: usize) -> Option<[f64; 3]> {
        self.force.row(*self.rows.get(index)?)?.try_into().ok()
    }

    /// The outputs, in order.
    pub fn values(&self) -> impl Iterator<Item = [f64; 3]> + Clone {
        self.force.vectors().map(|(_, value)| value)
    }

    /// The outputs at the times at which another accelerometer has one, too, and the other's.
    pub(crate) fn values_with(&self, other: &Self) -> impl Iterator<Item = ([f64; 3], [f64; 3])> {
        let time = |row: &(i64, [f64; 3])| row.0;
        let mut theirs = other.force.vectors().peekable();
        self.force.vectors().filter_map(move |ours| {
            while theirs.next_if(|row| time(row) < time(&ours)).is_some() {}
            let same = theirs.next_if(|row| time(row) == time(&ours))?;
            Some((ours.1, same.1))
        })
    }

    /// The samples with what was measured beside them, in order.
    pub fn iter(&self) -> impl Iterator<Item = Output> + Clone + use<'_, 'a> {
        let mut temperature = self.temperature.map(|track| track.beside::<1>(self.force));
        let mut field = self.field.map(|track| track.beside::<3>(self.force));
        let mut weights = self.weights.map(|track| track.beside::<1>(self.force));
        let first = self.temperature.and_then(|track| track.valid().next());
        let mut celsius = first.map(|(_, row)| row[0]);
        let mut gaps = self.gaps.iter().peekable();
        let rows = self.rows.iter().zip(self.values()).enumerate();
        rows.map(move |(index, (row, value))| {
            let time_ns = self.force.times_ns[*row];
            let now = temperature.as_mut().and_then(|track| track.latest(*row, time_ns));
            celsius = now.map(|[celsius]| celsius).or(celsius);
            let weight = weights.as_mut().and_then(|track| track.latest(*row, time_ns));
            let tesla = field.as_mut().and_then(|track| track.latest(*row, time_ns));
            Output {
                value,
                temperature_c: celsius,
                samples: weight.map_or(1, |[count]| count as u32),
                after_gap: gaps.next_if(|gap| **gap == index).is_some(),
                magnetic_field_nt: tesla.map(|tesla| tesla.map(|axis| axis * 1e9)),
            }
        })
    }

    /// Datasheet of the sensor, where the device identified it and it is known.
    pub fn datasheet(&self) -> Option<&'static Datasheet> {
        match self.sensor?.0 {
            sensor::LSM303AGR => Datasheet::of("LSM303AGR"),
            sensor::ADXL345 => Datasheet::of("ADXL345"),
            _ => None,
        }
    }

    /// Whether each is the mean of a static pose.
    pub fn are_poses(&self) -> bool {
        self.poses
    }

    /// Whether the samples have times.
    pub fn is_timed(&self) -> bool {
        !self.force.info.timeless
    }

    /// Time of a sample, s on the clock of the data.
    pub fn time_s(&self, index: usize) -> Option<f64> {
        let row = self.rows.get(index).filter(|_| self.is_timed())?;
        Some(self.force.times_ns[*row] as f64 * 1e-9)
    }

    /// Time of a sample, s since the first one, by the data's times, else by the rate.
    pub fn since_start_s(&self, index: usize) -> f64 {
        match (self.time_s(0), self.time_s(index)) {
            (Some(first), Some(time)) => time - first,
            _ => index as f64 / self.rate_hz,
        }
    }

    /// The samples, `mps2` m/s² per unit, with the angular rate of `rate`, `rad_s` rad/s per unit; NaN where it has no
    /// row.
    pub(crate) fn six_axis(&self, rate: &Track, mps2: f64, rad_s: f64) -> Vec<SixAxisSample> {
        let rates = rate.beside(self.force);
        let mut last_s = 0.0;
        let rows = self.rows.iter().zip(self.values()).enumerate();
        rows.map(|(index, (row, value))| {
            let now_s = self.since_start_s(index);
            let rate = rates.at(*row, self.force.times_ns[*row]).unwrap_or([f64::NAN; 3]);
            SixAxisSample {
                step_s: now_s - std::mem::replace(&mut last_s, now_s),
                rate_rad_s: rate.map(|axis| axis * rad_s),
                output_mps2: value.map(|axis| axis * mps2),
            }
        })
        .collect()
    }

    /// Whether samples are missing in a range of indices.
    pub(crate) fn has_gap(&self, within: std::ops::Range<usize>) -> bool {
        let from = self.gaps.partition_point(|gap| *gap < within.start);
        self.gaps.get(from).is_some_and(|gap| *gap < within.end)
    }

    /// Number of gaps, and their total length, s.
    pub fn gaps(&self) -> (usize, f64) {
        let length_s = |index: &usize| {
            let step_s = self.since_start_s(*index) - self.since_start_s(index - 1);
            (step_s - 1.0 / self.rate_hz).max(0.0)
        };
        (self.gaps.len(), self.gaps.iter().map(length_s).sum())
    }

    /// What was found while reading, an assumed rate, and missing samples.
    pub(crate) fn findings(&self) -> Vec<Problem> {
        let mut findings = self.findings.clone();
        if self.rate_source == RateSource::Assumed && !self.poses {
            let why = if self.is_timed() {
                "the times are more than a second apart (check their unit)"
            } else {
                "the data have no times"
            };
            let text = format!("{why}: {} Hz assumed", self.rate_hz);
            findings.push(Code::Rate.warning(text));
        }
        findings.extend(gaps_finding(self.gaps()));
        findings
    }

    /// The outputs corrected by `calibration`, each at its temperature, m/s², sensor axes.
    ///
    /// # Errors
    /// Those of [`SensorCalibration::compile`].
    pub(crate) fn corrected(&self, calibration: &SensorCalibration) -> Result<Vec<[f64; 3]>> {
        let correction = calibration.compile(self.info()).map_err(|error| error.at(self.name))?;
        let correction = correction.in_sensor_axes();
        let correct = |output: Output| correction.sample(output.value, output.temperature_c);
        Ok(self.iter().map(correct).collect())
    }

    /// Temperatures that are missing or outside the range of the calibration `set`.
    pub(crate) fn temperature_finding(&self, set: &ParameterSet) -> Option<Problem> {
        let terms = set.model.terms().temperature;
        let moves =
            TemperatureTerms { reference_c: TemperatureTerms::default().reference_c, ..terms }
                != TemperatureTerms::default();
        let known = self.temperature.into_iter().flat_map(Track::valid);
        let (lowest, highest) = known
            .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), (_, row)| {
                (low.min(row[0]), high.max(row[0]))
            });
        if lowest > highest {
            return moves.then(|| {
                Code::Temperature.warning(format!(
                    "the calibration depends on temperature and the data have none: {:.1} °C assumed",
                    terms.reference_c
                ))
            });
        }
        let made = set.quality?.terms().temperature?;
        let (from, to) = (f64::from(made.lowest_c), f64::from(made.highest_c));
        (lowest < from - BEYOND_K || highest > to + BEYOND_K).then(|| {
            Code::Temperature.warning(format!(
                "the data are from {lowest:.1} to {highest:.1} °C, the calibration from {from:.1} to {to:.1} °C: ± does not \
                 include the error of this extrapolation"
            ))
        })
    }

    /// The rests among `forces`, m/s², one for each sample. A gap ends a rest.
    ///
    /// [`Pose::first_sample`] is an index of a sample, [`Pose::time_s`] is relative to the first one.
    pub(crate) fn rests(&self, forces: &[[f64; 3]]) -> Vec<Pose> {
        // A NaN ends a rest.
        let with_gaps = self.iter().zip(forces).flat_map(|(output, force)| {
            let gap = output.after_gap.then_some(([f64::NAN; 3], None));
            gap.into_iter().chain(iter::once((*force, output.temperature_c)))
        });
        let mut rests = find_poses(with_gaps, self.rate_hz);
        // Indices of the NaNs in the sequence given to the detector.
        let gaps: Vec<usize> = self.gaps.iter().enumerate().map(|(k, gap)| gap + k).collect();
        for rest in &mut rests {
            let counted = rest.first_sample as usize;
            let first = counted - gaps.partition_point(|gap| *gap < counted);
            let last = first + (rest.samples as usize).saturating_sub(1);
            rest.first_sample = first as u64;
            rest.time_s = 0.5 * (self.since_start_s(first) + self.since_start_s(last));
        }
        rests
    }

    /// The outputs as counts of a sensor's registers.
    ///
    /// # Errors
    /// `unknown_format` when they are not counts; `csv_bad_number` when one does not fit 16 bits.
    pub fn counts(&self) -> Result<Vec<Counts>> {
        if self.unit == OutputUnit::Mps2 {
            let error = Code::UnknownFormat.error(
                "its accelerations are not raw counts",
                "give a file whose accelerometer columns are in LSB",
            );
            return Err(error.at(self.name));
        }
        let count = |value: f64| {
            let exact = value.trunc() == value && (-32768.0..=32767.0).contains(&value);
            exact.then_some(value as i16).ok_or_else(|| {
                let error = Code::CsvBadNumber.error(
                    format!("{value} is not a count of a 16-bit sensor"),
                    "raw counts are whole numbers from -32768 to 32767",
                );
                error.at(self.name)
            })
        };
        self.values().map(|[x, y, z]| Ok(Counts([count(x)?, count(y)?, count(z)?]))).collect()
    }
}
