//! A calibration applied to any recording.
//!
//! ```
//! use wimu_host::apply::Correction;
//! use wimu_host::calibration::{CalibrationFile, read_model};
//! use wimu_host::recording::{Quantity, Recording, Sink, TrackInfo, Unit};
//! use wimu_model::{ErrorModel, ErrorTerms, ParameterSet, Sensitivity};
//!
//! let folder = tempfile::tempdir().unwrap();
//! let path = folder.path().join("CAL.json");
//! let model = ErrorModel::new(ErrorTerms { bias_mps2: [0.1, 0.0, 0.0], ..ErrorTerms::default() }).unwrap();
//! let sensitivity = Sensitivity::from_lsb_per_g(1000.0).unwrap();
//! let set = ParameterSet { model, ..ParameterSet::uncalibrated(2, sensitivity) };
//! CalibrationFile::new(&set, &[], "poses.csv").write(&path)?;
//!
//! let mut recording = Recording::new("example");
//! let counts = Unit::Counts { si_per_lsb: None };
//! let track = recording.track(TrackInfo::new("acc", Quantity::SpecificForce, counts));
//! recording.row(track, 0, &[0.0, 0.0, 1000.0]);
//! let calibration = read_model(&path)?;
//! let correction = Correction::new(&calibration, &recording)?;
//! let first = correction.rows().next().expect("a row");
//! assert!((first.force_mps2[0] + 0.1).abs() < 1e-12 && (first.force_mps2[2] - 9.80665).abs() < 1e-12);
//! # Ok::<(), wimu_host::Problem>(())
//! ```

use std::io::BufWriter;
use std::path::Path;

use wimu_model::{
    CentiCelsius, MagneticFieldNt, MagnetometerModel, STANDARD_GRAVITY_MPS2, SpecificForceMps2,
};

use crate::calibration::StoredModel;
use crate::csv::{self, CsvWriter};
use crate::mcap_file::RosFile;
use crate::motion::FIELD_CALIBRATED;
use crate::recording::{Origin, Quantity, Recording, Track, Unit};
use crate::ros::message::Message;
use crate::ros::rate_covariance;
use crate::stats::{median, norm};
use crate::{Code, OutputFile, Problem, Result};

/// Largest departure of the median magnitude from gravity, relative: strong motion stays below. Chosen.
const NOT_GRAVITY: f64 = 0.3;
/// Relative difference of two sensitivities above which they are of two ranges.
const OTHER_RANGE: f64 = 0.3;

/// A corrected sample, body axes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Corrected {
    /// ns on the clock of the recording.
    pub time_ns: i64,
    /// Specific force, m/s².
    pub force_mps2: [f64; 3],
    /// Angular rate, rad/s.
    pub rate_rad_s: Option<[f64; 3]>,
    /// Magnetic flux density, µT: corrected, or as measured where the magnetometer is not calibrated.
    pub field_ut: Option<[f64; 3]>,
    /// °C.
    pub temperature_c: Option<f64>,
}

/// A calibration and the tracks of a recording that it corrects.
#[derive(Debug)]
pub struct Correction<'a> {
    calibration: &'a StoredModel,
    corrector: Corrector<'a>,
    force: &'a Track,
    /// With rad/s per unit.
    rate: Option<(&'a Track, f64)>,
    field: Option<&'a Track>,
    temperature: Option<&'a Track>,
    /// What was noticed, without the findings of the recording.
    pub findings: Vec<Problem>,
}

impl<'a> Correction<'a> {
    /// Chooses the tracks of the sensor with the lowest index, those that the device did not correct first.
    ///
    /// # Errors
    /// `data_refused` without a specific force or valid rows; `unknown_format` where the units of recording and
    /// calibration do not fit.
    pub fn new(calibration: &'a StoredModel, recording: &'a Recording) -> Result<Self> {
        let at = |error: Problem| error.at(&recording.name);
        let force = chosen(recording, Quantity::SpecificForce);
        let force = force.ok_or_else(|| at(no_force(recording)))?;
        let mut findings = Vec::new();
        if force.info.corrected {
            findings.push(
                Code::TrackChosen
                    .warning(format!("`{}` was corrected by the device before", force.info.name))
                    .remedy("use its uncorrected output, or the calibration of this output"),
            );
        }
        let mut correction = Self {
            calibration,
            corrector: Corrector::new(Some(calibration), force, None).map_err(at)?,
            force,
            rate: None,
            field: recording
                .first(Quantity::MagneticField)
                .filter(|track| track.info.unit == Unit::Si),
            temperature: recording.first(Quantity::Temperature),
            findings,
        };
        correction.choose_rate(recording);
        correction.findings.extend(correction.not_gravity());
        match force.valid().next() {
            Some(_) => Ok(correction),
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
            let text = format!("the median magnitude after correction is {median:.2} m/s², and gravity 9.81");
            let finding = Code::UnitInferred.warning(text);
            finding.remedy("check the unit, the count at zero (--units LSB@N), and that the calibration is of this sensor at this range")
        })
    }

    fn choose_rate(&mut self, recording: &'a Recording) {
        let Some(track) = chosen(recording, Quantity::AngularRate) else {
            return;
        };
        let scale = match (track.info.unit, &self.calibration.gyroscope) {
            (Unit::Si, _) => Some(1.0),
            (Unit::Counts { .. }, Some(gyroscope)) => Some(gyroscope.rad_s_per_lsb),
            (Unit::Counts { si_per_lsb }, None) => si_per_lsb,
            (Unit::Unknown, _) => None,
        };
        let name = &track.info.name;
        let finding = match (scale, &self.calibration.gyroscope) {
            (Some(_), Some(_)) => None,
            (Some(_), None) => Some(Code::Uncalibrated.note(format!(
                "`{name}` is only rotated to body axes: the calibration has no gyroscope"
            ))),
            (None, _) => Some(
                Code::Uncalibrated.warning(format!("`{name}` is left out: its unit is not known")),
            ),
        };
        self.rate = scale.map(|scale| (track, scale));
        self.findings.extend(finding);
    }

    /// The corrected samples, in the order of the recording.
    pub fn rows(&self) -> impl Iterator<Item = Corrected> {
        let mut rate = self.rate.map(|(track, _)| track.beside(self.force));
        let mut field = self.field.map(|track| track.beside(self.force));
        let mut temperature = self.temperature.map(|track| track.beside(self.force));
        let mut corrector = self.corrector.clone();
        let mut celsius = None;
        let times = self.force.times_ns().iter().enumerate();
        times.filter_map(move |(row, time_ns)| {
            let rate = rate.as_mut().and_then(|track| track.at(row, *time_ns));
            let field = field.as_mut().and_then(|track| track.latest(row, *time_ns));
            let now = temperature.as_mut().and_then(|track| track.latest(row, *time_ns));
            celsius = now.map(|row| row[0]).or(celsius);
            let output = self.force.row(row).filter(|_| self.force.mask()[row])?;
            let field: Option<[f64; 3]> = field.and_then(|row| row.try_into().ok());
            let force = corrector.force(output.try_into().ok()?, celsius);
            let scale = self.rate.map_or(1.0, |(_, scale)| scale);
            let rate = rate.map(|rate| corrector.to_body(corrector.rate(rate, scale, force)));
            Some(Corrected {
                time_ns: *time_ns,
                force_mps2: corrector.to_body(force),
                rate_rad_s: rate,
                field_ut: field.and_then(|tesla| match self.magnetometer() {
                    Some(_) => corrector.field(tesla, None),
                    None => Some(tesla.map(|axis| axis * 1e6)),
                }),
                temperature_c: celsius,
            })
        })
    }

    /// The model of the magnetometer, if its axes are known.
    fn magnetometer(&self) -> Option<MagnetometerModel> {
        let model = self.calibration.magnetometer;
        model.filter(|model| model.terms().to_accelerometer.is_some())
    }

    /// Writes the samples to `path`: ROS 2 messages where its name ends in `.mcap`, else CSV. Returns their number.
    ///
    /// # Errors
    /// `file_unreadable`, `file_failed`.
    pub fn write(&self, path: &Path) -> Result<usize> {
        let extension = path.extension();
        match extension.is_some_and(|e| e.eq_ignore_ascii_case("mcap")) {
            true => self.write_mcap(path),
            false => self.write_csv(path),
        }
    }

    fn write_csv(&self, path: &Path) -> Result<usize> {
        let (output, sink) = OutputFile::create(path)?;
        let calibrated = self.magnetometer().is_some();
        let mut columns = vec![csv::TIME.to_owned()];
        columns.extend(csv::axes("Accelerometer", "m/s²"));
        if self.field.is_some() {
            columns.extend(csv::axes("Magnetometer", "µT"));
        }
        if self.temperature.is_some() {
            columns.push(csv::TEMPERATURE.to_owned());
        }
        if self.field.is_some() {
            columns.push(FIELD_CALIBRATED.to_owned());
        }
        if self.rate.is_some() {
            columns.extend(csv::axes("Gyroscope", "rad/s"));
        }
        let mut writer = CsvWriter::new(BufWriter::new(sink), output.name(), &columns)?;
        let mut count = 0;
        for row in self.rows() {
            (writer.time(Some(row.time_ns))).vector(Some(row.force_mps2));
            if self.field.is_some() {
                writer.vector(row.field_ut);
            }
            if self.temperature.is_some() {
                writer.number(row.temperature_c);
            }
            if self.field.is_some() {
                writer.field(u8::from(calibrated));
            }
            writer.vector(row.rate_rad_s.filter(|_| self.rate.is_some()));
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
        let gyroscope = self.calibration.gyroscope.and_then(|gyroscope| gyroscope.sd);
        let gyroscope = gyroscope.map(|sd| sd.map(f64::from));
        let rotation = self.calibration.alignment.matrix();
        let variance = self.calibration.bias_sd_mps2().powi(2);
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
            if let Some([x, y, z]) = row.field_ut {
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

/// A calibration, if there is one, for outputs of one unit.
#[derive(Clone, Debug)]
pub(crate) struct Corrector<'a> {
    stored: Option<&'a StoredModel>,
    mps2_per_unit: f64,
    /// The last temperature that was read.
    temperature: Option<CentiCelsius>,
}

impl<'a> Corrector<'a> {
    /// That of a track of accelerations; `given` is the sensitivity of its counts, LSB/g, instead of that of the file, where
    /// the command has such an option.
    ///
    /// # Errors
    /// `unknown_format` where the units do not fit, or are not known.
    pub(crate) fn new(
        stored: Option<&'a StoredModel>,
        force: &Track,
        given: Option<Option<f64>>,
    ) -> Result<Self> {
        let wrong = |message: &str, remedy: &str| Err(Code::UnknownFormat.error(message, remedy));
        let si_per_lsb = match force.info.unit {
            Unit::Counts { si_per_lsb } => si_per_lsb,
            Unit::Si if stored.is_some_and(|stored| stored.of_counts) => {
                return wrong(
                    "its accelerations are in m/s² or g, and the calibration is one of raw counts",
                    "give the raw counts, in columns `Accelerometer X (LSB)`, …, or calibrate with a recording in m/s² or \
                     g: `wimu calibrate FILE -o CAL.json`",
                );
            }
            Unit::Si => return Ok(Self::scaled(stored, 1.0)),
            Unit::Unknown => {
                return wrong(
                    "the unit of its accelerations is not known",
                    "name it: --units m/s2, g, mg or LSB",
                );
            }
        };
        let stated = given.flatten().or(si_per_lsb.map(|scale| STANDARD_GRAVITY_MPS2 / scale));
        let own = stored.and_then(|stored| stored.sensitivity_lsb_per_g);
        match (own, stated) {
            (Some(own), Some(stated)) if (stated / own - 1.0).abs() > OTHER_RANGE => wrong(
                &format!("1 g is {stated:.0} LSB in it, and {own:.0} LSB in the calibration"),
                match given {
                    Some(_) => "give the calibration of this range, or leave --sensitivity out",
                    None => "give the calibration of this range",
                },
            ),
            (Some(lsb_per_g), _) | (None, Some(lsb_per_g)) => {
                Ok(Self::scaled(stored, STANDARD_GRAVITY_MPS2 / lsb_per_g))
            }
            (None, None) if stored.is_some() => wrong(
                "its accelerations are raw counts, and the calibration is one of m/s² or g",
                match given {
                    Some(_) => {
                        "calibrate with a recording of raw counts: `wimu calibrate FILE -o CAL.json`; or say what the counts \
                         are, --sensitivity LSB_PER_G"
                    }
                    None => {
                        "calibrate with a recording of raw counts: `wimu calibrate FILE -o CAL.json`"
                    }
                },
            ),
            (None, None) => wrong(
                "its accelerations are raw counts, of which nothing says what they are",
                "calibrate the sensor, `wimu calibrate FILE -o CAL.json`, and give --with CAL.json; or say what the \
                 counts are, --sensitivity LSB_PER_G",
            ),
        }
    }

    fn scaled(stored: Option<&'a StoredModel>, mps2_per_unit: f64) -> Self {
        Self { stored, mps2_per_unit, temperature: None }
    }

    /// Specific force, m/s², sensor axes, from an output in the file's unit and the latest temperature, °C.
    pub(crate) fn force(&mut self, output: [f64; 3], celsius: Option<f64>) -> [f64; 3] {
        let output = output.map(|axis| axis * self.mps2_per_unit);
        self.temperature = celsius.map(CentiCelsius::from_celsius).or(self.temperature);
        let Some(stored) = self.stored else {
            return output;
        };
        let force = SpecificForceMps2(output);
        stored.model.correct(force, self.temperature).0
    }

    /// Angular rate, rad/s, sensor axes, from an output in units of `scale` rad/s, at a specific force, m/s².
    pub(crate) fn rate(&self, output: [f64; 3], scale: f64, force: [f64; 3]) -> [f64; 3] {
        let rate = output.map(|axis| axis * scale);
        match self.stored.and_then(|stored| stored.gyroscope) {
            Some(gyroscope) => gyroscope.model.correct(rate, force, self.temperature),
            None => rate,
        }
    }

    /// Magnetic field, µT, body axes, from an output, T: as a magnetometer put it out that is not calibrated, it says
    /// nothing of directions.
    pub(crate) fn field(&self, tesla: [f64; 3], is_calibrated: Option<bool>) -> Option<[f64; 3]> {
        match self.stored.and_then(|stored| stored.magnetometer) {
            Some(model) if is_calibrated != Some(true) => {
                let output = MagneticFieldNt(tesla.map(|axis| (axis * 1e9).round() as i32));
                let field_nt = model.correct_to_accelerometer(output)?;
                Some(self.to_body(field_nt.map(|nt| nt * 1e-3)))
            }
            _ if is_calibrated == Some(false) => None,
            _ => Some(self.to_body(tesla.map(|axis| axis * 1e6))),
        }
    }

    /// From the sensor's axes to the body's.
    pub(crate) fn to_body(&self, vector: [f64; 3]) -> [f64; 3] {
        self.stored.map_or(vector, |stored| stored.alignment.rotate(vector))
    }
}
