//! A calibration applied to any recording.
//!
//! ```
//! use wimu_host::apply::CorrectedRecording;
//! use wimu_host::calibration::Calibration;
//! use wimu_host::recording::{Quantity, Recording, Sink, TrackInfo, Unit};
//! use wimu_model::{ErrorModel, ErrorTerms, ParameterSet, Sensitivity};
//!
//! let model = ErrorModel::new(ErrorTerms { bias_mps2: [0.1, 0.0, 0.0], ..ErrorTerms::default() }).unwrap();
//! let sensitivity = Sensitivity::from_lsb_per_g(1000.0).unwrap();
//! let set = ParameterSet { model, ..ParameterSet::uncalibrated(2, sensitivity) };
//! let calibration = Calibration::held(&set);
//!
//! let mut recording = Recording::new("example");
//! let counts = Unit::Counts { si_per_lsb: None };
//! let track = recording.track(TrackInfo::new("acc", Quantity::SpecificForce, counts));
//! recording.row(track, 0, &[0.0, 0.0, 1000.0]);
//! let corrected = CorrectedRecording::new(calibration.sensor(), &recording)?;
//! let first = corrected.rows().next().expect("a row");
//! assert!((first.force_mps2[0] + 0.1).abs() < 1e-12 && (first.force_mps2[2] - 9.80665).abs() < 1e-12);
//! # Ok::<(), wimu_host::Problem>(())
//! ```

use std::io::BufWriter;
use std::path::Path;

use wimu_model::{Alignment, STANDARD_GRAVITY_MPS2};

use crate::calibration::{Correction, SensorCalibration};
use crate::csv::{self, CsvWriter};
use crate::imu::FIELD_CALIBRATED;
use crate::mcap_file::RosFile;
use crate::recording::{Origin, Quantity, Recording, Track, Unit};
use crate::ros::message::Message;
use crate::ros::rate_covariance;
use crate::stats::{median, norm};
use crate::{Code, OutputFile, Problem, Result};

/// Largest departure of the median magnitude from gravity, relative: strong motion stays below. Chosen.
const NOT_GRAVITY: f64 = 0.3;

/// The tracks of one unit, and what corrects them: the one way from the output of sensors to SI and body axes.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Tracks<'a> {
    pub correction: Correction,
    pub force: &'a Track,
    pub rate: Option<&'a Track>,
    pub field: Option<&'a Track>,
    pub temperature: Option<&'a Track>,
}

/// A sample of an accelerometer, corrected, with what was measured beside it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Corrected {
    /// Its row in the track of the accelerometer.
    pub row: usize,
    /// ns on the clock of the recording.
    pub time_ns: i64,
    /// Specific force, m/s², body axes; not a number where the sensor gave none.
    pub force_mps2: [f64; 3],
    /// Angular rate, rad/s, body axes.
    pub rate_rad_s: Option<[f64; 3]>,
    /// Magnetic flux density as measured, T, sensor axes.
    pub field_t: Option<[f64; 3]>,
    /// The latest temperature, °C.
    pub temperature_c: Option<f64>,
}

impl<'a> Tracks<'a> {
    /// The rows in the order of time. A masked row of numbers is out of order, and has no place in the sequence.
    pub fn rows(self) -> impl Iterator<Item = Corrected> + use<'a> {
        let Self { correction, force, .. } = self;
        let rate = self.rate.map(|track| {
            // What the device has corrected is in body axes.
            let rad_s = correction.rad_s_per_unit(&track.info).filter(|_| !track.info.corrected);
            (track.beside::<3>(force), rad_s)
        });
        let mut field = self.field.map(|track| track.beside::<3>(force));
        let mut temperature = self.temperature.map(|track| track.beside::<1>(force));
        let mut celsius = None;
        force.times_ns().iter().copied().enumerate().filter_map(move |(row, time_ns)| {
            let output: [f64; 3] = force.row(row)?.try_into().ok()?;
            if !force.mask()[row] && output.iter().all(|axis| axis.is_finite()) {
                return None;
            }
            let now = temperature.as_mut().and_then(|track| track.latest(row, time_ns));
            celsius = now.map(|[celsius]| celsius).or(celsius);
            let rate_rad_s = rate.as_ref().and_then(|(track, rad_s)| {
                let value = track.at(row, time_ns)?;
                Some(rad_s.map_or(value, |rad_s| {
                    correction.rate(value.map(|axis| axis * rad_s), output, celsius)
                }))
            });
            Some(Corrected {
                row,
                time_ns,
                force_mps2: correction.sample(output, celsius),
                rate_rad_s,
                field_t: field.as_mut().and_then(|track| track.latest(row, time_ns)),
                temperature_c: celsius,
            })
        })
    }
}

/// The tracks of a recording that a calibration corrects.
#[derive(Debug)]
pub struct CorrectedRecording<'a> {
    /// `None`: its output is only brought to SI units.
    calibration: Option<&'a SensorCalibration>,
    tracks: Tracks<'a>,
    /// What was noticed, without the findings of the recording.
    pub findings: Vec<Problem>,
}

impl<'a> CorrectedRecording<'a> {
    /// Chooses the tracks of the sensor with the lowest index, those that the device did not correct first. Without a
    /// calibration their output is brought to SI units.
    ///
    /// # Errors
    /// `data_refused` without a specific force or valid rows; those of [`SensorCalibration::compile`] or [`Correction::ideal`].
    pub fn new(
        calibration: impl Into<Option<&'a SensorCalibration>>,
        recording: &'a Recording,
    ) -> Result<Self> {
        let calibration = calibration.into();
        let at = |error: Problem| error.at(&recording.name);
        let force = chosen(recording, Quantity::SpecificForce);
        let force = force.ok_or_else(|| at(no_force(recording)))?;
        if force.info.timeless && calibration.is_none() {
            let text = "there are no times, and a recording has some";
            return Err(at(Code::NoRows.error(text, "give --rate HZ")));
        }
        if force.info.origin == Origin::Sensor {
            // Refuses several sensors of one number.
            recording.accelerometer(Some(force.info.sensor))?;
        }
        let correction = match calibration {
            Some(calibration) => calibration.compile(&force.info),
            None => Correction::ideal(&force.info),
        };
        let mut corrected = Self {
            calibration,
            tracks: Tracks {
                correction: correction.map_err(at)?,
                force,
                rate: None,
                field: recording
                    .first(Quantity::MagneticField)
                    .filter(|track| track.info.unit == Unit::Si),
                temperature: recording.first(Quantity::Temperature),
            },
            findings: Vec::new(),
        };
        if force.info.corrected && calibration.is_some() {
            let text = format!("`{}` was corrected by the device before", force.info.name);
            let remedy = "use its uncorrected output, or the calibration of this output";
            corrected.findings.push(Code::TrackChosen.warning(text).remedy(remedy));
        }
        corrected.choose_rate(recording);
        corrected.findings.extend(corrected.not_gravity());
        match force.valid().next() {
            Some(_) => Ok(corrected),
            None => Err(at(Code::DataRefused.error(
                format!("`{}` has no valid row", force.info.name),
                "check the file with `wimu info`",
            ))),
        }
    }

    /// A warning where the median of the corrected magnitudes cannot be gravity: another unit, range or sensor.
    fn not_gravity(&self) -> Option<Problem> {
        let median = median(self.rows().map(|row| norm(row.force_mps2)))?;
        ((median / STANDARD_GRAVITY_MPS2 - 1.0).abs() > NOT_GRAVITY).then(|| {
            let text = format!("the median magnitude written is {median:.2} m/s², and gravity 9.81");
            let remedy = if self.calibration.is_some() {
                "check the unit, the count at zero (--units LSB@N), and that the calibration is of this sensor at this range"
            } else {
                "check the unit: --units g, mg or m/s2"
            };
            Code::UnitInferred.warning(text).remedy(remedy)
        })
    }

    fn choose_rate(&mut self, recording: &'a Recording) {
        let Some(track) = chosen(recording, Quantity::AngularRate) else { return };
        let name = &track.info.name;
        let scale = self.tracks.correction.rad_s_per_unit(&track.info);
        let [is_calibrated, _] = self.tracks.correction.has();
        self.tracks.rate = scale.map(|_| track);
        if scale.is_none() {
            let text = format!("`{name}` is left out: its unit is not known");
            self.findings.push(Code::Uncalibrated.warning(text));
        } else if !is_calibrated && self.calibration.is_some() {
            self.findings.push(Code::Uncalibrated.note(format!(
                "`{name}` is only rotated to body axes: the calibration has no gyroscope"
            )));
        }
    }

    /// The corrected samples, in the order of the recording.
    pub fn rows(&self) -> impl Iterator<Item = Corrected> {
        let is_number = |row: &Corrected| row.force_mps2.iter().all(|axis| axis.is_finite());
        self.tracks.rows().filter(is_number)
    }

    /// Magnetic flux density of a sample, µT: corrected, or as measured where the magnetometer is not calibrated.
    pub fn field_ut(&self, sample: &Corrected) -> Option<[f64; 3]> {
        let tesla = sample.field_t?;
        let corrected = self.tracks.correction.field_ut(tesla);
        Some(corrected.unwrap_or(tesla.map(|axis| axis * 1e6)))
    }

    /// Whether the magnetic field is corrected: there is a model of the magnetometer, and its axes are known.
    fn is_field_calibrated(&self) -> bool {
        let model = self.calibration.and_then(|own| own.magnetometer);
        model.is_some_and(|model| model.terms().to_accelerometer.is_some())
    }

    /// Writes the samples to `path`: ROS 2 messages where its name ends in `.mcap`, else CSV. Returns their number.
    ///
    /// # Errors
    /// `file_unreadable`, `file_failed`.
    pub fn write(&self, path: &Path) -> Result<usize> {
        if path.extension().is_some_and(|e| e.eq_ignore_ascii_case("mcap")) {
            return self.write_mcap(path);
        }
        self.write_csv(path)
    }

    fn write_csv(&self, path: &Path) -> Result<usize> {
        let (output, sink) = OutputFile::create(path)?;
        let calibrated = self.is_field_calibrated();
        let mut columns = vec![csv::TIME.to_owned()];
        columns.extend(csv::axes("Accelerometer", "m/s²"));
        if self.tracks.field.is_some() {
            columns.extend(csv::axes("Magnetometer", "µT"));
        }
        if self.tracks.temperature.is_some() {
            columns.push(csv::TEMPERATURE.to_owned());
        }
        if self.tracks.field.is_some() {
            columns.push(FIELD_CALIBRATED.to_owned());
        }
        if self.tracks.rate.is_some() {
            columns.extend(csv::axes("Gyroscope", "rad/s"));
        }
        let mut writer = CsvWriter::new(BufWriter::new(sink), output.name(), &columns)?;
        let mut count = 0;
        for row in self.rows() {
            (writer.time(Some(row.time_ns))).vector(Some(row.force_mps2));
            if self.tracks.field.is_some() {
                writer.vector(self.field_ut(&row));
            }
            if self.tracks.temperature.is_some() {
                writer.number(row.temperature_c);
            }
            if self.tracks.field.is_some() {
                writer.field(u8::from(calibrated));
            }
            writer.vector(row.rate_rad_s.filter(|_| self.tracks.rate.is_some()));
            writer.end_row()?;
            count += 1;
        }
        writer.finish()?;
        output.finish()?;
        Ok(count)
    }

    /// `/imu/data`, `/imu/mag` and `/imu/temperature`, stamped with the times of the recording. The covariance of the
    /// acceleration is that of the calibration at 1 *g*.
    fn write_mcap(&self, path: &Path) -> Result<usize> {
        let (output, sink) = OutputFile::create(path)?;
        let mut out = RosFile::new(sink, output.name())?;
        let gyroscope = self.calibration.and_then(|own| own.gyroscope?.sd);
        let gyroscope = gyroscope.map(|sd| sd.map(f64::from));
        let rotation = self.calibration.map_or(Alignment::IDENTITY, |own| own.alignment).matrix();
        let variance = self.calibration.map_or(0.0, |own| own.accelerometer.bias_sd_mps2().powi(2));
        let mut count = 0;
        for row in self.rows() {
            let stamp_ns = u64::try_from(row.time_ns).unwrap_or_default();
            let mut fields = crate::ros::imu(row.force_mps2, row.rate_rad_s, None);
            for axis in 0..3 {
                fields[28 + 4 * axis] = variance;
            }
            if let (Some(rate), Some(sd)) = (row.rate_rad_s, &gyroscope) {
                let covariance = rate_covariance(rate, sd, &rotation);
                fields[16..25].copy_from_slice(covariance.as_flattened());
            }
            let mut publish = |topic: &str, type_name: &str, fields: &[f64]| {
                let message = Message::new().header(stamp_ns, "imu_link").numbers(fields);
                out.publish(topic, type_name, stamp_ns, stamp_ns, &message)
            };
            publish("/imu/data", "sensor_msgs/Imu", &fields)?;
            if let Some([x, y, z]) = self.field_ut(&row) {
                let mut fields = [0.0; 12];
                fields[..3].copy_from_slice(&[x * 1e-6, y * 1e-6, z * 1e-6]);
                publish("/imu/mag", "sensor_msgs/MagneticField", &fields)?;
            }
            if let Some(celsius) = row.temperature_c {
                publish("/imu/temperature", "sensor_msgs/Temperature", &[celsius, 0.0])?;
            }
            count += 1;
        }
        out.finish()?;
        output.finish()?;
        Ok(count)
    }
}

/// The track of a quantity that the device did not correct, else any.
fn chosen(recording: &Recording, quantity: Quantity) -> Option<&Track> {
    let raw = |track: &&Track| track.info.origin == Origin::Sensor && !track.info.corrected;
    let raw = recording.of(quantity).filter(raw);
    raw.min_by_key(|track| track.info.sensor).or_else(|| recording.first(quantity))
}

fn no_force(recording: &Recording) -> Problem {
    match recording.first(Quantity::LinearAcceleration) {
        Some(track) => Code::DataRefused.error(
            format!(
                "`{}` is linear acceleration (gravity removed) and cannot be corrected",
                track.info.name
            ),
            "export the acceleration with gravity",
        ),
        None => {
            let tracks = recording.tracks().iter();
            let names: Vec<&str> = tracks.map(|track| track.info.name.as_str()).collect();
            Code::DataRefused.error(
                format!("it has no accelerometer, but: {}", names.join(", ")),
                "name its topic or columns",
            )
        }
    }
}
