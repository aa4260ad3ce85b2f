//! One accelerometer's output over time, or static-pose means, from a CSV file or a recording:
//! what a calibration reads.

mod times;

use std::collections::BTreeSet;
use std::path::Path;

use wimu_calib::{Datasheet, Pose, find_poses};
use wimu_link::LinkRole;
use wimu_link::hello::sensor;
use wimu_model::{
    CentiCelsius, Counts, DeviceTimeUs, ParameterSet, Sensitivity, SensorId, SpecificForceMps2,
    TemperatureTerms,
};

use crate::csv::{AccelerationUnit, CsvReader, Filter, Header};
use crate::error::{ErrorCode, HostError, Result};
use crate::history::{Boot, LinkHistory, Recording};
use times::RowTimes;

/// Sample rate of a file without times, Hz.
const ASSUMED_RATE_HZ: f64 = 100.0;
/// So far beyond the temperatures of its poses a calibration is trusted in silence, K.
const BEYOND_K: f64 = 5.0;
/// Most columns that an error lists.
const MOST_NAMED: usize = 12;
/// More rests than anyone holds still for.
const USUAL_RESTS: usize = 1000;
/// More rows than this at more than this rate, Hz, are samples and no means over poses: these take seconds each.
const MOST_POSES: usize = 100;
const MOST_POSES_HZ: f64 = 5.0;

/// Columns that tell sensors apart, and runs.
const SENSORS: [&str; 5] = ["imu", "sensor", "device", "unit", "board"];
const RUNS: [&str; 4] = ["run", "trial", "session", "recording"];
/// A column with more values than this tells nothing apart.
const MOST_VALUES: usize = 64;

/// What to take from a file.
#[derive(Clone, Debug, Default)]
pub struct LoadOptions {
    /// Rows of a CSV file to keep.
    pub filter: Option<Filter>,
    /// Which accelerometer of a CSV file that has several.
    pub accelerometer: Option<u32>,
    /// Rows of a CSV file are static-pose means, not a time series.
    pub poses: bool,
    /// Which link of a recording; see [`Recording::link`].
    pub role: Option<LinkRole>,
}

/// Unit of [`Output::value`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum OutputUnit {
    /// LSB.
    Counts {
        /// Nominal sensitivity, where the device knows it.
        nominal: Option<Sensitivity>,
        /// Full-scale range, ± *g*, where it is known.
        range_g: Option<u8>,
    },
    /// m/s².
    Mps2,
}

/// Where a sample rate comes from.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize)]
#[serde(rename_all = "snake_case")]
pub enum RateSource {
    /// The device's settings.
    Device,
    /// The file's times.
    Times,
    /// Nothing said it.
    Assumed,
}

/// One row: a sample, or the mean of a static pose.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Output {
    /// X, Y, Z, sensor axes.
    pub value: [f64; 3],
    /// Temperature, °C.
    pub temperature_c: Option<f64>,
    /// How many samples a mean is of; 1 for a sample.
    pub samples: u32,
    /// Whether samples are missing before this one.
    pub after_gap: bool,
    /// When it was taken, s, where that is known: in a CSV file as its rows have it, in a recording by the
    /// device's clock from the first sample on, which counts on where the device started again.
    pub time_s: Option<f64>,
    /// What the magnetometer put out, nT: in a recording with the first sample after it was read, in
    /// a CSV file as its rows have it.
    pub magnetic_field_nt: Option<[f64; 3]>,
}

/// One accelerometer's output.
#[derive(Clone, Debug)]
pub struct Dataset {
    /// What errors call it.
    pub name: String,
    /// Unit of the values.
    pub unit: OutputUnit,
    /// Whether the rows are static-pose means.
    pub poses: bool,
    /// Nominal sample rate, Hz.
    pub rate_hz: f64,
    /// Where the rate comes from.
    pub rate_source: RateSource,
    /// The sensor's datasheet, where the device says which sensor it has and it is known.
    pub datasheet: Option<&'static Datasheet>,
    /// The rows, in order; at least one.
    pub outputs: Vec<Output>,
    /// The accelerometer, where a device has said which.
    pub sensor: Option<SensorId>,
}

impl Dataset {
    /// Reads a CSV file.
    ///
    /// # Errors
    /// Those of [`CsvReader`]; `csv_missing_column` without an accelerometer; `usage` when it has
    /// several and none was chosen; `no_rows`.
    pub fn from_csv(path: &Path, options: &LoadOptions) -> Result<Self> {
        let mut reader = CsvReader::open(path)?;
        if let Some(filter) = &options.filter {
            reader = reader.select(filter)?;
        }
        if options.poses {
            reader = reader.in_any_order();
        }
        let header = reader.header().clone();
        let name = reader.name().to_owned();
        one_sensor(path, options)?;
        let sensor = choose(&name, &header, options.accelerometer)?;
        let factor = header.acceleration_unit.mps2().unwrap_or(1.0);
        let weights = header.other.iter().position(|column| column == "Samples");
        let mut outputs = Vec::new();
        let mut times = RowTimes::default();
        for row in reader {
            let row = row?;
            times.push(row.time_ns);
            let samples = match weights.filter(|_| options.poses) {
                Some(column) => samples_of(row.other.get(column), row.line, &name)?,
                None => 1,
            };
            outputs.push(Output {
                value: row.accelerations[sensor].map(|axis| axis * factor),
                temperature_c: row.temperature_c,
                samples,
                after_gap: false,
                time_s: row.time_ns.map(|ns| ns as f64 * 1e-9),
                magnetic_field_nt: row.magnetic_field_ut.map(|field| field.map(|ut| ut * 1e3)),
            });
        }
        if outputs.is_empty() {
            return Err(HostError::new(
                ErrorCode::NoRows,
                match options.filter {
                    Some(_) => "no row passes the filter",
                    None => "there are no rows below the header",
                },
                "check the file and --where",
            )
            .at(name));
        }
        let (rate_hz, rate_source) = match times.rate_and_gaps() {
            Some((rate, gaps)) => {
                // Pose means are no time series: nothing is missing between them.
                for row in gaps.into_iter().filter(|_| !options.poses) {
                    outputs[row].after_gap = true;
                }
                (rate, RateSource::Times)
            }
            None => (ASSUMED_RATE_HZ, RateSource::Assumed),
        };
        let sampled = rate_source == RateSource::Times
            && rate_hz > MOST_POSES_HZ
            && outputs.len() > MOST_POSES;
        if options.poses && sampled {
            return Err(HostError::new(
                ErrorCode::Usage,
                format!(
                    "its {} rows look like a continuous recording, not like means over static poses",
                    outputs.len()
                ),
                "leave --poses out: the rests are found in the recording",
            )
            .at(name));
        }
        Ok(Self {
            name,
            unit: match header.acceleration_unit {
                AccelerationUnit::Lsb => OutputUnit::Counts {
                    nominal: None,
                    range_g: None,
                },
                AccelerationUnit::G | AccelerationUnit::Mps2 => OutputUnit::Mps2,
            },
            poses: options.poses,
            rate_hz,
            rate_source,
            datasheet: None,
            outputs,
            sensor: None,
        })
    }

    /// When an output was taken, s from the first: by the data's own times, else by the rate.
    pub fn since_start_s(&self, index: usize) -> f64 {
        let time = |index: usize| self.outputs.get(index)?.time_s;
        match (time(0), time(index)) {
            (Some(first), Some(time)) => time - first,
            _ => index as f64 / self.rate_hz,
        }
    }

    /// In how many places samples are missing, and for how long in all, s.
    pub fn gaps(&self) -> (usize, f64) {
        let gaps = (1..self.outputs.len()).filter(|index| self.outputs[*index].after_gap);
        gaps.fold((0, 0.0), |(count, total_s), index| {
            let step_s = self.since_start_s(index) - self.since_start_s(index - 1);
            (count + 1, total_s + (step_s - 1.0 / self.rate_hz).max(0.0))
        })
    }

    /// A remark on the places where samples are missing; `None` where there is none.
    pub(crate) fn gaps_remark(&self) -> Option<String> {
        let (count, total_s) = self.gaps();
        (count > 0).then(|| {
            format!(
                "samples are missing in {count} place{}, {total_s:.1} s in all: nothing is averaged across \
                 them",
                if count == 1 { "" } else { "s" }
            )
        })
    }

    /// The outputs as `set` corrects them, each at its temperature, m/s², sensor axes. A row without one
    /// has that of the rows before it.
    pub(crate) fn corrected(&self, set: &ParameterSet) -> Vec<[f64; 3]> {
        let scale = match self.unit {
            OutputUnit::Counts { .. } => set.sensitivity.mps2_per_lsb(),
            OutputUnit::Mps2 => 1.0,
        };
        let mut celsius = self.outputs.iter().find_map(|output| output.temperature_c);
        let correct = |output: &Output| {
            celsius = output.temperature_c.or(celsius);
            let sensed = SpecificForceMps2(output.value.map(|axis| axis * scale));
            let at = celsius.map(CentiCelsius::from_celsius);
            set.model.correct(sensed, at).0
        };
        self.outputs.iter().map(correct).collect()
    }

    /// A remark on what the temperatures, or their lack, leave of a correction by `set`; `None` where they
    /// are those it was made at.
    pub(crate) fn temperature_remark(&self, set: &ParameterSet) -> Option<String> {
        let terms = set.model.terms().temperature;
        let moves = TemperatureTerms {
            reference_c: TemperatureTerms::default().reference_c,
            ..terms
        } != TemperatureTerms::default();
        let known = self
            .outputs
            .iter()
            .filter_map(|output| output.temperature_c);
        let (lowest, highest) = known.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), c| {
            (low.min(c), high.max(c))
        });
        if lowest > highest {
            return moves.then(|| {
                format!(
                    "the calibration goes with the temperature and the data have none: they are corrected as \
                     at {:.1} °C",
                    terms.reference_c
                )
            });
        }
        let made = set.quality?.terms().temperature?;
        let (from, to) = (f64::from(made.lowest_c), f64::from(made.highest_c));
        (lowest < from - BEYOND_K || highest > to + BEYOND_K).then(|| {
            format!(
                "the data are from {lowest:.1} to {highest:.1} °C, the calibration was made from {from:.1} to \
                 {to:.1} °C: what the temperature does beyond is not in the ±"
            )
        })
    }

    /// The rests of the outputs, given as `forces`, m/s², one for each output. A gap ends a rest.
    ///
    /// [`Pose::first_sample`] is the place in [`outputs`](Self::outputs), [`Pose::time_s`] counts from the
    /// first output by the data's own times.
    pub(crate) fn rests(&self, forces: &[[f64; 3]]) -> Vec<Pose> {
        // A sample that is no number ends a hold.
        let samples = self.outputs.iter().zip(forces).flat_map(|(output, force)| {
            let gap = output.after_gap.then_some(([f64::NAN; 3], None));
            gap.into_iter().chain([(*force, output.temperature_c)])
        });
        let mut rests = vec![Pose::default(); USUAL_RESTS];
        let found = find_poses(samples.clone(), self.rate_hz, &mut rests);
        if found > rests.len() {
            rests.resize(found, Pose::default());
            find_poses(samples, self.rate_hz, &mut rests);
        }
        rests.truncate(found);
        let gaps = (0..self.outputs.len()).filter(|index| self.outputs[*index].after_gap);
        // Where the gaps stand among the samples as the finder counted them.
        let gaps: Vec<usize> = gaps.enumerate().map(|(k, index)| index + k).collect();
        for rest in &mut rests {
            let counted = rest.first_sample as usize;
            let first = counted - gaps.partition_point(|gap| *gap < counted);
            let last = first + (rest.samples as usize).saturating_sub(1);
            rest.first_sample = first as u64;
            rest.time_s = 0.5 * (self.since_start_s(first) + self.since_start_s(last));
        }
        rests
    }

    /// The outputs as a sensor's registers held them.
    ///
    /// # Errors
    /// `unknown_format` when they are no counts; `csv_bad_number` when one does not fit 16 bits.
    pub fn counts(&self) -> Result<Vec<Counts>> {
        if self.unit == OutputUnit::Mps2 {
            return Err(HostError::new(
                ErrorCode::UnknownFormat,
                "its accelerations are no raw counts",
                "give a file whose accelerometer columns are in LSB",
            )
            .at(&self.name));
        }
        let count = |value: f64| {
            let exact = value.trunc() == value && (-32768.0..=32767.0).contains(&value);
            exact.then_some(value as i16).ok_or_else(|| {
                HostError::new(
                    ErrorCode::CsvBadNumber,
                    format!("{value} is no count of a 16-bit sensor"),
                    "raw counts are whole numbers from -32768 to 32767",
                )
                .at(&self.name)
            })
        };
        self.outputs
            .iter()
            .map(|output| {
                let [x, y, z] = output.value;
                Ok(Counts([count(x)?, count(y)?, count(z)?]))
            })
            .collect()
    }

    /// Reads a recording's raw samples.
    ///
    /// # Errors
    /// Those of [`Recording::load`] and [`Dataset::from_link`].
    pub fn from_recording(path: &Path, options: &LoadOptions) -> Result<Self> {
        let recording = Recording::load(path)?;
        Self::from_link(recording.link(options.role)?, &recording.name)
    }

    /// The raw samples that a link has brought; `name` is what errors call it.
    ///
    /// # Errors
    /// `no_rows` when there are none, `data_refused` when the range changed meanwhile.
    pub fn from_link(link: &LinkHistory, name: &str) -> Result<Self> {
        let boots: Vec<&Boot> = link
            .boots
            .iter()
            .filter(|boot| !boot.raw.is_empty())
            .collect();
        let Some(first) = boots.first() else {
            return Err(HostError::new(
                ErrorCode::NoRows,
                format!("no raw samples came over the {} link", link.role),
                "switch the raw stream on with `wimu settings set`, or use the other link",
            )
            .at(name));
        };
        let range_g = first.epochs.first().map(|mark| mark.epoch.range_g);
        let changed = boots
            .iter()
            .flat_map(|boot| &boot.epochs)
            .find(|mark| Some(mark.epoch.range_g) != range_g);
        if let Some(mark) = changed {
            return Err(HostError::new(
                ErrorCode::DataRefused,
                format!(
                    "the range changes from ±{} g to ±{} g at sample {}",
                    range_g.unwrap_or_default(),
                    mark.epoch.range_g,
                    mark.epoch.sequence
                ),
                "record at one range: a calibration holds at one range only",
            )
            .at(name));
        }
        let rate_hz = match (first.settings.first(), first.epochs.first()) {
            (Some(settings), _) => f64::from(settings.rate_hz),
            (None, Some(mark)) => 1e9 / f64::from(mark.epoch.period_ns.max(1)),
            (None, None) => ASSUMED_RATE_HZ,
        };
        let mut outputs: Vec<Output> = Vec::new();
        for boot in &boots {
            let mut next = None;
            let before_s = outputs.last().and_then(|output| output.time_s);
            let begin_us = boot.raw.first().map_or(0, |sample| sample.time.0);
            let mut surroundings = Surroundings::new(boot);
            for sample in &boot.raw {
                outputs.push(Output {
                    value: sample.value.map(f64::from),
                    magnetic_field_nt: surroundings.field_until(sample.time),
                    temperature_c: surroundings.temperature,
                    samples: 1,
                    after_gap: next != Some(sample.sequence) && !outputs.is_empty(),
                    time_s: Some(
                        before_s.map_or(0.0, |before| before + 1.0 / rate_hz)
                            + sample.time.0.saturating_sub(begin_us).saturating_mul(1000) as f64
                                * 1e-9,
                    ),
                });
                next = Some(sample.sequence.wrapping_add(1));
            }
        }
        Ok(Self {
            name: name.to_owned(),
            unit: OutputUnit::Counts {
                nominal: first.nominal_sensitivity(),
                range_g,
            },
            poses: false,
            rate_hz,
            rate_source: RateSource::Device,
            datasheet: first.hello.and_then(|hello| match hello.sensor.number {
                sensor::LSM303AGR => Datasheet::of("LSM303AGR"),
                sensor::ADXL345 => Datasheet::of("ADXL345"),
                _ => None,
            }),
            outputs,
            sensor: first.sensor(),
        })
    }
}

/// Refuses a file whose rows are of several sensors, or of several runs with times that start anew.
pub(crate) fn one_sensor(path: &Path, options: &LoadOptions) -> Result<()> {
    let mut reader = CsvReader::open(path)?.with_holes().in_any_order();
    let names = reader.header().other.clone();
    let is_one_of = |k: usize, known: &[&str]| known.contains(&names[k].to_lowercase().as_str());
    let named = (0..names.len()).filter(|k| is_one_of(*k, &SENSORS) || is_one_of(*k, &RUNS));
    let mut found: Vec<(usize, BTreeSet<String>)> = named.map(|k| (k, BTreeSet::new())).collect();
    if found.is_empty() {
        return Ok(());
    }
    if let Some(filter) = &options.filter {
        reader = reader.select(filter)?;
    }
    let (mut last_ns, mut anew) = (None, false);
    // What is wrong with a row is reported where the rows are used.
    for row in reader.flatten() {
        anew |= !options.poses && row.time_ns < last_ns;
        last_ns = row.time_ns;
        for (k, values) in found.iter_mut().filter(|(_, v)| v.len() <= MOST_VALUES) {
            values.extend(row.other.get(*k).cloned());
        }
    }
    let (mut said, mut chosen) = (Vec::new(), Vec::new());
    for (k, values) in found {
        let several = (2..=MOST_VALUES).contains(&values.len());
        if several && (anew || is_one_of(k, &SENSORS)) {
            let values: Vec<String> = values.into_iter().collect();
            said.push(format!("`{}` is {}", names[k], values.join(", ")));
            chosen.push(format!("{}={}", names[k], values[0]));
        }
    }
    if said.is_empty() {
        return Ok(());
    }
    let (said, chosen) = (said.join("; "), chosen.join(","));
    Err(HostError::new(
        ErrorCode::Usage,
        format!("its rows are of several sensors or runs: {said}"),
        format!(
            "choose with --where \"{chosen}\"; where the command has no --where, leave the other rows out of the file"
        ),
    )
    .at(path.display().to_string()))
}

/// How many samples a mean is of.
fn samples_of(field: Option<&String>, line: u64, name: &str) -> Result<u32> {
    let text = field.map_or("", String::as_str);
    // 1434.0 is as good.
    let number = text.parse::<f64>().ok();
    let whole = number.filter(|n| n.trunc() == *n && (1.0..=f64::from(u32::MAX)).contains(n));
    whole.map(|n| n as u32).ok_or_else(|| {
        HostError::new(
            ErrorCode::CsvBadNumber,
            format!("`{text}` is no number of samples"),
            "write how many samples the mean is of, a whole number from 1 on, or remove the column",
        )
        .at(format!("{name} line {line}, column `Samples`"))
    })
}

/// Index of the accelerometer to read.
fn choose(name: &str, header: &Header, wanted: Option<u32>) -> Result<usize> {
    let sensors = header.accelerometers.as_slice();
    let list = || {
        let numbers: Vec<_> = sensors.iter().flatten().map(u32::to_string).collect();
        numbers.join(", ")
    };
    match (sensors, wanted) {
        ([], _) => Err(HostError::new(
            ErrorCode::CsvMissingColumn,
            match header.other.as_slice() {
                [] => "there is no accelerometer in it".to_owned(),
                others => format!(
                    "there is no accelerometer with a unit among its columns: {}{}",
                    others[..others.len().min(MOST_NAMED)].join(", "),
                    if others.len() > MOST_NAMED { ", …" } else { "" }
                ),
            },
            "name the columns `Accelerometer X (g)`, `Accelerometer Y (g)` and `Accelerometer Z (g)`, in LSB, g, \
             mg or m/s²; an acceleration without gravity is none",
        )
        .at(format!("{name} line 1"))),
        ([_], None) => Ok(0),
        (_, None) => Err(HostError::new(
            ErrorCode::Usage,
            format!("it has {} accelerometers", sensors.len()),
            format!(
                "choose one with --accelerometer: {}; an array's are calibrated at once with --geometry",
                list()
            ),
        )
        .at(name)),
        ([None], Some(number)) => Err(HostError::new(
            ErrorCode::Usage,
            format!("its one accelerometer has no number, and is not accelerometer {number}"),
            "leave --accelerometer out",
        )
        .at(name)),
        (_, Some(number)) => sensors
            .iter()
            .position(|sensor| *sensor == Some(number))
            .ok_or_else(|| {
                HostError::new(
                    ErrorCode::Usage,
                    format!("it has no accelerometer {number}"),
                    format!("choose from: {}", list()),
                )
                .at(name)
            }),
    }
}

/// Magnetic field and temperature at growing times.
struct Surroundings<'a> {
    rest: &'a [wimu_link::message::Environment],
    /// The latest, °C.
    temperature: Option<f64>,
}

impl<'a> Surroundings<'a> {
    fn new(boot: &'a Boot) -> Self {
        // A board that replays another sensor's counts has a thermometer and a magnetometer that were
        // not there.
        let replays = boot
            .hello
            .is_some_and(|hello| hello.sensor.number == sensor::REPLAY);
        let rest: &[_] = if replays { &[] } else { &boot.environment };
        Self {
            rest,
            temperature: rest.iter().find_map(|e| e.temperature_centi_c).map(celsius),
        }
    }

    /// The last field, nT, that was read since the time before.
    fn field_until(&mut self, time: DeviceTimeUs) -> Option<[f64; 3]> {
        let mut field = None;
        while let [first, rest @ ..] = self.rest
            && first.time_us <= time.0
        {
            self.temperature = first.temperature_centi_c.map(celsius).or(self.temperature);
            field = first
                .magnetic_field_nt
                .map(|nt| nt.map(f64::from))
                .or(field);
            self.rest = rest;
        }
        field
    }
}

fn celsius(centi_c: i16) -> f64 {
    f64::from(centi_c) / 100.0
}

#[cfg(test)]
mod tests {
    use super::*;

    fn load(text: &str, options: &LoadOptions) -> Result<Dataset> {
        // Tests run at once: each text has a file of its own.
        let name = format!(
            "wimu-host-dataset-{}-{:p}.csv",
            std::process::id(),
            text.as_ptr()
        );
        let path = std::env::temp_dir().join(name);
        std::fs::write(&path, text).unwrap();
        let outcome = Dataset::from_csv(&path, options);
        std::fs::remove_file(&path).unwrap();
        outcome
    }

    const XYZ: &str = "Accelerometer X (g),Accelerometer Y (g),Accelerometer Z (g)";

    #[test]
    fn rows_come_in_si_with_their_rate_and_temperature() {
        let text = format!(
            "Time (ms),{XYZ},Temperature (C)\n0,0,0,1,20\n20,0,0.5,1,\n5020,1,0,0,22\n5040,0,0,0,22\n"
        );
        let data = load(&text, &LoadOptions::default()).unwrap();
        assert_eq!(data.unit, OutputUnit::Mps2);
        assert_eq!(data.outputs[1].value, [0.0, 0.5 * 9.80665, 9.80665]);
        assert_eq!(data.outputs[1].temperature_c, None);
        assert_eq!(data.outputs[2].temperature_c, Some(22.0));
        // The pause of 5 s is no sample period.
        assert_eq!((data.rate_hz, data.rate_source), (50.0, RateSource::Times));
        let data = load(&format!("{XYZ}\n0,0,1\n"), &LoadOptions::default()).unwrap();
        assert_eq!(
            (data.rate_hz, data.rate_source),
            (100.0, RateSource::Assumed)
        );
    }

    #[test]
    fn pose_means_have_weights_and_any_order() {
        let text = format!("Time (s),Samples,{XYZ}\n9,1434,0,0,1\n1,20,0,1,0\n");
        let options = LoadOptions {
            poses: true,
            ..LoadOptions::default()
        };
        let data = load(&text, &options).unwrap();
        assert_eq!(data.outputs[0].samples, 1434);
        let error = load(&text, &LoadOptions::default()).unwrap_err();
        assert_eq!(error.code(), ErrorCode::CsvTimeBackwards);
    }

    #[test]
    fn one_of_several_accelerometers_is_chosen_by_number() {
        let two = "Accelerometer 3 X (LSB),Accelerometer 3 Y (LSB),Accelerometer 3 Z (LSB),\
                   Accelerometer 1 X (LSB),Accelerometer 1 Y (LSB),Accelerometer 1 Z (LSB)\n1,2,3,4,5,6\n";
        let chosen = |accelerometer| {
            load(
                two,
                &LoadOptions {
                    accelerometer,
                    ..LoadOptions::default()
                },
            )
        };
        assert_eq!(chosen(Some(1)).unwrap().outputs[0].value, [4.0, 5.0, 6.0]);
        let error = chosen(None).unwrap_err();
        assert_eq!(error.code(), ErrorCode::Usage);
        assert!(error.remedy().contains("3, 1"), "{error}");
        assert_eq!(chosen(Some(0)).unwrap_err().code(), ErrorCode::Usage);
    }

    #[test]
    fn a_file_without_accelerometer_or_rows_says_so() {
        let error = load("Time (s),Range (m)\n1,2\n", &LoadOptions::default()).unwrap_err();
        assert_eq!(error.code(), ErrorCode::CsvMissingColumn);
        assert!(error.remedy().contains("Accelerometer X (g)"));
        let error = load(&format!("{XYZ}\n"), &LoadOptions::default()).unwrap_err();
        assert_eq!(error.code(), ErrorCode::NoRows);
        let options = LoadOptions {
            filter: Some("Run=9".parse().unwrap()),
            ..LoadOptions::default()
        };
        let error = load(&format!("Run,{XYZ}\n1,0,0,1\n"), &options).unwrap_err();
        assert!(error.message().contains("filter"), "{error}");
    }
}
