//! Output of one accelerometer over time, or static-pose means, from a CSV file or a recording: the input of a
//! calibration.

mod link;
mod selection;
mod times;

use std::path::Path;

use wimu_calib::{Datasheet, Pose, find_poses};
use wimu_model::{
    CentiCelsius, Counts, ParameterSet, Sensitivity, SensorId, SpecificForceMps2, TemperatureTerms,
};

use crate::csv::{AccelerationUnit, CsvReader};
use crate::error::{ErrorCode, Result};
use crate::plural::counted;
pub use selection::LoadOptions;
pub(crate) use selection::one_sensor;
use selection::{choose, samples_of};
use times::RowTimes;

/// Assumed sample rate of a file without times, Hz.
const ASSUMED_RATE_HZ: f64 = 100.0;
/// Extrapolation beyond the temperatures of a calibration without a remark, K. Chosen.
const BEYOND_K: f64 = 5.0;
/// Rests for which memory is reserved at first.
const USUAL_RESTS: usize = 1000;
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
    /// Temperature, °C.
    pub temperature_c: Option<f64>,
    /// Number of samples in a mean; 1 for a sample.
    pub samples: u32,
    /// Whether samples are missing before this one.
    pub after_gap: bool,
    /// Time, s; `None` if unknown. In a CSV file as in its rows; in a recording device time from the first sample
    /// on, continued where the device restarted.
    pub time_s: Option<f64>,
    /// Output of the magnetometer, nT: in a recording with the first sample after it was read, in
    /// a CSV file as in its rows.
    pub magnetic_field_nt: Option<[f64; 3]>,
}

/// Output of one accelerometer.
#[derive(Clone, Debug)]
pub struct Dataset {
    /// Name of the data in errors.
    pub name: String,
    /// Unit of the values.
    pub unit: OutputUnit,
    /// Whether the rows are static-pose means.
    pub poses: bool,
    /// Nominal sample rate, Hz.
    pub rate_hz: f64,
    /// Source of the rate.
    pub rate_source: RateSource,
    /// Datasheet of the sensor, where the device identifies it and it is known.
    pub datasheet: Option<&'static Datasheet>,
    /// The rows, in order; at least one.
    pub outputs: Vec<Output>,
    /// The accelerometer, where a device identified it.
    pub sensor: Option<SensorId>,
    /// Whether the data have a gyroscope, too.
    pub has_gyroscope: bool,
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
            return Err(ErrorCode::NoRows
                .error(
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
                // Pose means are not a time series: no samples are missing between them.
                for row in gaps.into_iter().filter(|_| !options.poses) {
                    outputs[row].after_gap = true;
                }
                (rate, RateSource::Times)
            }
            None => (ASSUMED_RATE_HZ, RateSource::Assumed),
        };
        let sampled = rate_source == RateSource::Times
            && rate_hz > MAX_POSE_RATE_HZ
            && outputs.len() > MAX_POSES;
        if options.poses && sampled {
            return Err(ErrorCode::Usage
                .error(
                    format!(
                        "its {} rows look like a continuous recording, not means over static poses",
                        outputs.len()
                    ),
                    "leave out --poses: the rests are found in the recording",
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
            has_gyroscope: header
                .other
                .iter()
                .any(|name| name.starts_with("Gyroscope ")),
        })
    }

    /// Time of an output, s since the first one, by the data's times, else by the rate.
    pub fn since_start_s(&self, index: usize) -> f64 {
        let time = |index: usize| self.outputs.get(index)?.time_s;
        match (time(0), time(index)) {
            (Some(first), Some(time)) => time - first,
            _ => index as f64 / self.rate_hz,
        }
    }

    /// Number of gaps, and their total length, s.
    pub fn gaps(&self) -> (usize, f64) {
        let gaps = (1..self.outputs.len()).filter(|index| self.outputs[*index].after_gap);
        gaps.fold((0, 0.0), |(count, total_s), index| {
            let step_s = self.since_start_s(index) - self.since_start_s(index - 1);
            (count + 1, total_s + (step_s - 1.0 / self.rate_hz).max(0.0))
        })
    }

    /// Remark on gaps; `None` without gaps.
    pub(crate) fn gaps_remark(&self) -> Option<String> {
        let (count, total_s) = self.gaps();
        (count > 0).then(|| {
            format!(
                "samples are missing: {}, {total_s:.1} s in total; no mean includes a gap",
                counted(count, "gap")
            )
        })
    }

    /// The outputs corrected by `set`, each at its temperature, m/s², sensor axes. A row without a temperature has that of
    /// the last one before it.
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

    /// Remark on temperatures that are missing or outside the range of the calibration `set`.
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
                        "the calibration depends on temperature and the data have none: {:.1} °C assumed",
                    terms.reference_c
                )
            });
        }
        let made = set.quality?.terms().temperature?;
        let (from, to) = (f64::from(made.lowest_c), f64::from(made.highest_c));
        (lowest < from - BEYOND_K || highest > to + BEYOND_K).then(|| {
            format!(
                    "the data are from {lowest:.1} to {highest:.1} °C, the calibration from {from:.1} to {to:.1} °C: ± does not \
                     include the error of this extrapolation"
            )
        })
    }

    /// The rests among `forces`, m/s², one for each output. A gap ends a rest.
    ///
    /// [`Pose::first_sample`] is an index into [`outputs`](Self::outputs), [`Pose::time_s`] is relative to the
    /// first output.
    pub(crate) fn rests(&self, forces: &[[f64; 3]]) -> Vec<Pose> {
        // A NaN ends a rest.
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
        // Indices of the NaNs in the sequence given to the detector.
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

    /// The outputs as counts of a sensor's registers.
    ///
    /// # Errors
    /// `unknown_format` when they are not counts; `csv_bad_number` when one does not fit 16 bits.
    pub fn counts(&self) -> Result<Vec<Counts>> {
        if self.unit == OutputUnit::Mps2 {
            return Err(ErrorCode::UnknownFormat
                .error(
                    "its accelerations are not raw counts",
                    "give a file whose accelerometer columns are in LSB",
                )
                .at(&self.name));
        }
        let count = |value: f64| {
            let exact = value.trunc() == value && (-32768.0..=32767.0).contains(&value);
            exact.then_some(value as i16).ok_or_else(|| {
                ErrorCode::CsvBadNumber
                    .error(
                        format!("{value} is not a count of a 16-bit sensor"),
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
