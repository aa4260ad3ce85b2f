//! Calibration files.

use std::path::Path;

use crate::calibration::parameter_id;
use serde::{Deserialize, Serialize};
use wimu_model::{
    Alignment, CalibratedTemperature, CalibrationMethod, CalibrationQuality, ErrorModel,
    ErrorTerms, GyroscopeParameters, MagnetometerModel, ModelCovariance, ParameterSet,
    QualityTerms, STANDARD_GRAVITY_MPS2, Sensitivity, SensorId, TermDeviations,
};

use super::Source;
use super::covariance::{Covariance, model_order, rotation_order};
use super::range::Range;
use crate::OutputFile;
use crate::csv::AccelerationUnit;
use crate::{Code, Problem, Result};

/// How to make a file that can be read.
const REMEDY: &str = "make it with `wimu calibrate … -o CAL.json`";

/// A calibration that has no sensitivity of a board.
pub(super) const NOT_FOR_A_BOARD: &str = "it has no parameters for a board";
pub(super) const SENSITIVITY_REMEDY: &str =
    "calibrate again with --sensitivity, the nominal LSB/g of the board's range";

/// A calibration file: every value once.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct CalibrationFile {
    /// [`CalibrationFile::SCHEMA`].
    schema: String,
    /// Id of the device that it was made on, 16 hexadecimal digits; absent where the data do not name it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    device: Option<String>,
    /// The sensors of a board.
    pub sensors: Vec<StoredSensor>,
}

/// A sensor in a calibration file.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct StoredSensor {
    /// Its index on its board, from 0.
    pub index: u8,
    /// Its type, as numbered in the protocol; null if unknown.
    pub sensor: Option<SensorId>,
    /// Sensor axes to body axes, quaternion W, X, Y, Z.
    pub alignment_wxyz: Alignment,
    /// Covariance of the alignment's error about body axes, rad²; null if not measured.
    pub alignment_covariance: Option<Covariance>,
    /// Its accelerometer.
    pub accelerometer: StoredAccelerometer,
    /// Its gyroscope; null if it has none, or one that is uncalibrated.
    pub gyroscope: Option<GyroscopeParameters>,
    /// The magnetometer beside it; null if uncalibrated.
    pub magnetometer: Option<MagnetometerModel>,
    /// Id of its parameter set; null without parameters for a board. A file with another one was edited.
    parameter_id: Option<String>,
}

/// An accelerometer in a calibration file.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct StoredAccelerometer {
    /// Unit of the output that was calibrated: `LSB`, or `m/s²` for g too.
    pub unit: String,
    /// Full-scale range, ± *g*; null if unknown.
    pub range_g: Option<u8>,
    /// Source of the range.
    pub range_source: Option<Source>,
    /// Nominal sensitivity, LSB/*g*; null for data in m/s² where none was given.
    pub sensitivity_lsb_per_g: Option<f64>,
    /// Output at zero that was subtracted from the counts, LSB; absent where none was.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub zero_count: Option<f64>,
    /// The error model, sensor axes.
    pub model: ErrorTerms,
    /// Its uncertainty; null if it was not estimated.
    pub quality: Option<StoredQuality>,
    /// Where the data come from, in order.
    pub sessions: Vec<Session>,
}

/// Uncertainty of an error model in a calibration file, as in [`QualityTerms`].
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct StoredQuality {
    method: CalibrationMethod,
    /// Temperatures of the data, between which the model is valid.
    temperature: Option<CalibratedTemperature>,
    dof: u32,
    rms_mps2: f32,
    loo_rms_mps2: Option<f32>,
    condition: Option<f32>,
    covariance: Covariance,
    other_sd: TermDeviations,
}

/// Data of a calibration.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Session {
    /// When it was made, s since 1970 UTC.
    pub utc_s: Option<u64>,
    /// The file or link.
    pub file: Option<String>,
    /// Number of poses.
    pub poses: u32,
}

/// Poses of all sessions.
fn total(sessions: &[Session]) -> u32 {
    let poses = sessions.iter().map(|session| session.poses);
    poses.fold(0, u32::saturating_add)
}

impl CalibrationFile {
    /// Name of the JSON object.
    pub const SCHEMA: &'static str = "wimu.calibration/2";

    /// The file of `set`, whose accelerometer was calibrated with the data of the sessions `before` and, if it has
    /// more poses, with those of `source`.
    pub fn new(set: &ParameterSet, before: &[Session], source: &str) -> Self {
        let quality = set.quality.as_ref().map(CalibrationQuality::terms);
        let poses = quality.map_or(0, |terms| terms.poses);
        let known = total(before);
        let mut sessions = before.to_vec();
        if poses > known {
            sessions.push(Session {
                utc_s: quality.and_then(|terms| terms.utc_s),
                file: Some(source.to_owned()),
                poses: poses - known,
            });
        }
        let mut sensor = StoredSensor {
            index: set.sensor_index,
            sensor: set.sensor,
            alignment_wxyz: set.alignment,
            alignment_covariance: set.alignment_covariance.map(|covariance| {
                Covariance::new(rotation_order(), covariance.factor().as_flattened())
            }),
            accelerometer: StoredAccelerometer {
                unit: AccelerationUnit::Lsb.as_str().to_owned(),
                range_g: Some(set.range_g),
                range_source: None,
                sensitivity_lsb_per_g: Some(set.sensitivity.lsb_per_g()),
                zero_count: None,
                model: *set.model.terms(),
                quality: quality.map(StoredQuality::new),
                sessions,
            },
            gyroscope: set.gyroscope,
            magnetometer: set.magnetometer,
            parameter_id: None,
        };
        sensor.seal();
        Self { schema: Self::SCHEMA.to_owned(), device: None, sensors: vec![sensor] }
    }

    /// The file of `set`, which later data made of the calibration `before`: that of the file `path`, if there is one.
    pub fn after(
        path: Option<&Path>,
        before: &ParameterSet,
        set: &ParameterSet,
        source: &str,
    ) -> Self {
        let mut file = Self::new(set, &sessions(path, before), source);
        file.device = path.and_then(|path| read(path).ok()?.device);
        file.with_zero_count(path.and_then(zero_count))
    }

    /// The same of this device, if it does not name one.
    #[must_use]
    pub fn of_device(mut self, id: Option<u64>) -> Self {
        self.device = self.device.or(id.map(|id| format!("{id:016x}")));
        self
    }

    /// The file of an accelerometer that may have no parameters for a board.
    pub(super) fn of_model(
        model: ErrorModel,
        quality: Option<CalibrationQuality>,
        sensor: Option<SensorId>,
        unit: AccelerationUnit,
        lsb_per_g: Option<f64>,
        range: Option<Range>,
        source: &str,
    ) -> Option<Self> {
        // Any in bounds: replaced below.
        let sensitivity = Sensitivity::from_lsb_per_g(16384.0).ok()?;
        let set =
            ParameterSet { model, quality, sensor, ..ParameterSet::uncalibrated(1, sensitivity) };
        let mut file = Self::new(&set, &[], source);
        let entry = file.sensors.first_mut()?;
        let stored = &mut entry.accelerometer;
        stored.unit = unit.as_str().to_owned();
        stored.sensitivity_lsb_per_g = lsb_per_g;
        stored.range_g = range.map(|range| range.g);
        stored.range_source = range.map(|range| range.source);
        entry.seal();
        Some(file)
    }

    /// The same with the output at zero that was subtracted from the counts, LSB.
    #[must_use]
    pub(super) fn with_zero_count(mut self, zero_count: Option<f64>) -> Self {
        for sensor in &mut self.sensors {
            sensor.accelerometer.zero_count = zero_count;
        }
        self
    }

    /// The same with the gyroscope of its sensors.
    #[must_use]
    pub(super) fn with_gyroscope(mut self, gyroscope: Option<GyroscopeParameters>) -> Self {
        for sensor in &mut self.sensors {
            sensor.gyroscope = gyroscope;
            sensor.seal();
        }
        self
    }

    /// The same with the model of several sessions.
    #[must_use]
    pub(super) fn with_sessions(
        mut self,
        model: &ErrorModel,
        quality: Option<&CalibrationQuality>,
        sessions: Vec<Session>,
    ) -> Self {
        for sensor in &mut self.sensors {
            let stored = &mut sensor.accelerometer;
            stored.model = *model.terms();
            stored.quality = quality.map(|quality| StoredQuality::new(quality.terms()));
            stored.sessions.clone_from(&sessions);
            sensor.seal();
        }
        self
    }

    /// Writes it.
    ///
    /// # Errors
    /// `file_failed`, `file_unreadable`.
    pub fn write(&self, path: &Path) -> Result<()> {
        let json = serde_json::to_string_pretty(self).map_err(|error| {
            Code::FileFailed.error(
                format!("the calibration cannot be written as JSON: {error}"),
                "report this as a fault of wimu",
            )
        })?;
        OutputFile::write(path, json + "\n")
    }

    /// The error model of its sensor with index 0, else of the first. `path` is the file in errors.
    ///
    /// # Errors
    /// `bad_calibration` without a sensor, or with numbers that are out of bounds.
    pub fn model(&self, path: &Path) -> Result<StoredModel> {
        let stored = self.sensor().and_then(StoredSensor::stored);
        stored.map_err(invalid(path))
    }

    /// The sensor that a device corrects: that with index 0, else the first.
    fn sensor(&self) -> std::result::Result<&StoredSensor, String> {
        let mut sensors = self.sensors.iter();
        let first = sensors.clone().find(|sensor| sensor.index == 0);
        let first = first.or_else(|| sensors.next());
        first.ok_or_else(|| "it has no sensor".to_owned())
    }
}

impl StoredQuality {
    fn new(terms: &QualityTerms) -> Self {
        Self {
            method: terms.method,
            temperature: terms.temperature,
            dof: terms.dof,
            rms_mps2: terms.rms_mps2,
            loo_rms_mps2: terms.loo_rms_mps2,
            condition: terms.condition,
            covariance: Covariance::new(model_order(), terms.covariance.factor().as_flattened()),
            other_sd: terms.other_sd,
        }
    }

    fn read(&self, sessions: &[Session]) -> std::result::Result<CalibrationQuality, String> {
        CalibrationQuality::new(QualityTerms {
            method: self.method,
            utc_s: sessions.last().and_then(|session| session.utc_s),
            temperature: self.temperature,
            poses: total(sessions),
            dof: self.dof,
            rms_mps2: self.rms_mps2,
            loo_rms_mps2: self.loo_rms_mps2,
            condition: self.condition,
            covariance: self.covariance.of_model()?,
            other_sd: self.other_sd,
        })
        .map_err(|error| error.to_string())
    }
}

impl StoredSensor {
    fn model(&self) -> std::result::Result<ErrorModel, String> {
        ErrorModel::new(self.accelerometer.model).map_err(|error| error.to_string())
    }

    fn stored(&self) -> std::result::Result<StoredModel, String> {
        let accelerometer = &self.accelerometer;
        let quality = accelerometer.quality.as_ref();
        let covariance = quality.map(|quality| quality.covariance.of_model());
        let covariance = covariance.transpose()?;
        Ok(StoredModel {
            model: self.model()?,
            sensitivity_lsb_per_g: accelerometer.sensitivity_lsb_per_g,
            of_counts: accelerometer.unit == AccelerationUnit::Lsb.as_str(),
            covariance,
            of_sessions: accelerometer.sessions.len() > 1
                && quality.is_some_and(|quality| quality.method != CalibrationMethod::Updated),
            alignment: self.alignment_wxyz,
            magnetometer: self.magnetometer,
            gyroscope: self.gyroscope()?,
        })
    }

    /// Names the set that it holds.
    fn seal(&mut self) {
        let id = self.values().map(|set| parameter_id(&set).to_string());
        self.parameter_id = id.ok();
    }

    /// The set for a board.
    fn set(&self) -> std::result::Result<ParameterSet, String> {
        let set = self.values()?;
        match &self.parameter_id {
            Some(id) if *id == parameter_id(&set).to_string() => Ok(set),
            _ => Err("the file was edited: its values and parameter_id differ".to_owned()),
        }
    }

    /// The gyroscope, whose range and sensitivity have not been checked at reading.
    fn gyroscope(&self) -> std::result::Result<Option<GyroscopeParameters>, String> {
        let gyroscope = self.gyroscope.map(|gyroscope| {
            let GyroscopeParameters { range_dps, rad_s_per_lsb, model, sd, .. } = gyroscope;
            GyroscopeParameters::new(range_dps, rad_s_per_lsb, model, sd)
        });
        gyroscope.transpose().map_err(|error| error.to_string())
    }

    fn values(&self) -> std::result::Result<ParameterSet, String> {
        let accelerometer = &self.accelerometer;
        let (Some(range_g), Some(lsb_per_g)) =
            (accelerometer.range_g, accelerometer.sensitivity_lsb_per_g)
        else {
            let why = match accelerometer.sensitivity_lsb_per_g {
                Some(own) => format!("{own:.1} LSB/g is outside the range of boards"),
                None => "its data were in m/s² or g".to_owned(),
            };
            return Err(format!("{NOT_FOR_A_BOARD}: {why}"));
        };
        let sensitivity = Sensitivity::from_lsb_per_g(lsb_per_g);
        let quality = accelerometer.quality.as_ref();
        let covariance = self.alignment_covariance.as_ref();
        Ok(ParameterSet {
            model: self.model()?,
            quality: quality.map(|quality| quality.read(&accelerometer.sessions)).transpose()?,
            alignment: self.alignment_wxyz,
            alignment_covariance: covariance.map(Covariance::of_rotation).transpose()?,
            magnetometer: self.magnetometer,
            sensor: self.sensor,
            sensor_index: self.index,
            gyroscope: self.gyroscope()?,
            ..ParameterSet::uncalibrated(range_g, sensitivity.map_err(|e| e.to_string())?)
        })
    }
}

fn read(path: &Path) -> Result<CalibrationFile> {
    #[derive(Deserialize)]
    struct Head {
        schema: Option<String>,
    }
    let name = path.display().to_string();
    let text = std::fs::read_to_string(path).map_err(|e| Problem::file(&name, "read", &e))?;
    let head: Head = parse(&name, &text)?;
    let schema = head.schema.as_deref();
    if schema == Some(CalibrationFile::SCHEMA) {
        return parse(&name, &text);
    }
    let schema = schema.unwrap_or("missing");
    let remedy = match schema.starts_with("wimu.calibration/") {
        true => "update wimu on this computer",
        false => REMEDY,
    };
    let message = format!("its schema is {schema}, not {}", CalibrationFile::SCHEMA);
    Err(Code::BadCalibration.error(message, remedy).at(name))
}

fn parse<'a, T: Deserialize<'a>>(name: &str, text: &'a str) -> Result<T> {
    serde_json::from_str(text).map_err(|error| {
        let at = format!("{name} line {}, column {}", error.line(), error.column());
        let message = format!("this is not a calibration file: {error}");
        Code::BadCalibration.error(message, REMEDY).at(at)
    })
}

/// The error of a file whose values are not a calibration.
fn invalid(path: &Path) -> impl Fn(String) -> Problem {
    move |message| {
        let remedy = match message.starts_with(NOT_FOR_A_BOARD) {
            true => SENSITIVITY_REMEDY,
            false => "undo the change, or calibrate again",
        };
        Code::BadCalibration.error(message, remedy).at(path.display().to_string())
    }
}

/// Reads the parameters of a calibration file, for a board: those of the sensor with index 0, else of the first.
///
/// # Errors
/// `file_unreadable`; `bad_calibration` when it is not a calibration, has no sensitivity or contains numbers that are out
/// of bounds.
pub fn read_parameters(path: &Path) -> Result<ParameterSet> {
    read(path)?.sensor().and_then(StoredSensor::set).map_err(invalid(path))
}

/// The parameters in the text of a calibration file.
pub fn parameters_in(text: &str) -> Option<ParameterSet> {
    let file: CalibrationFile = serde_json::from_str(text).ok()?;
    file.sensor().ok()?.set().ok()
}

/// Indices of the sensors in a calibration file that [`read_parameters`] leaves out; none of an unreadable file.
pub fn further_sensors(path: &Path) -> Vec<u8> {
    let Ok(file) = read(path) else {
        return Vec::new();
    };
    let taken = file.sensor().map_or(0, |sensor| sensor.index);
    let indices = file.sensors.iter().map(|sensor| sensor.index);
    indices.filter(|index| *index != taken).collect()
}

/// Output at zero that was subtracted from the counts of a calibration, LSB; `None` of an unreadable file.
pub fn zero_count(path: &Path) -> Option<f64> {
    read(path).ok()?.sensor().ok()?.accelerometer.zero_count
}

/// Checks that a calibration file is of this device, or names none.
///
/// # Errors
/// `other_device`.
pub fn check_device(path: &Path, id: u64) -> Result<()> {
    let id = format!("{id:016x}");
    match read(path)?.device {
        Some(device) if device != id => Err(Code::OtherDevice
            .error(
                format!("this is the calibration of device {device}, the board is device {id}"),
                "push that of this device; `device params push` and `fleet push` also take another one with --force",
            )
            .at(path.display().to_string())),
        _ => Ok(()),
    }
}

/// The sessions of the calibration `set`: those in the file `path` that it was read from, if there is one.
pub fn sessions(path: Option<&Path>, set: &ParameterSet) -> Vec<Session> {
    if let Some(Ok(file)) = path.map(read)
        && let Ok(sensor) = file.sensor()
    {
        return sensor.accelerometer.sessions.clone();
    }
    let quality = set.quality.iter().map(CalibrationQuality::terms);
    let session =
        |terms: &QualityTerms| Session { utc_s: terms.utc_s, file: None, poses: terms.poses };
    quality.map(session).collect()
}

/// The error model in a calibration file.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StoredModel {
    /// The error model, sensor axes.
    pub model: ErrorModel,
    /// Sensitivity that converts counts into its output; `None` where its data were in m/s² or g and none was given.
    pub sensitivity_lsb_per_g: Option<f64>,
    /// Whether it was estimated from counts: then it does not apply to output in m/s², which was scaled elsewhere.
    pub of_counts: bool,
    /// Covariance of bias and matrix, sensor axes; `None` where the file does not contain it.
    pub covariance: Option<ModelCovariance>,
    /// Whether it combines sessions: its covariance is that of a new session, with the change between sessions.
    pub of_sessions: bool,
    /// Sensor axes to body axes.
    pub alignment: Alignment,
    /// Model of the magnetometer beside it.
    pub magnetometer: Option<MagnetometerModel>,
    /// Model of the gyroscope, for counts and for output in rad/s.
    pub gyroscope: Option<GyroscopeParameters>,
}

impl StoredModel {
    /// Standard deviation of the specific force at 1 *g* on the worst axis, m/s², of bias, scale factor and misalignment
    /// together; 0 where it is not known.
    pub fn bias_sd_mps2(&self) -> f64 {
        self.covariance.map_or(0.0, |known| worst_sd(|place| known.sd(place)))
    }

    /// m/s² of one unit of the output that it corrects: of one LSB where a sensitivity is known, else 1.
    pub fn mps2_per_unit(&self) -> f64 {
        let lsb_per_g = self.sensitivity_lsb_per_g;
        lsb_per_g.map_or(1.0, |lsb_per_g| STANDARD_GRAVITY_MPS2 / lsb_per_g)
    }
}

/// Reads the error model of a calibration file, of any sensor.
///
/// # Errors
/// `file_unreadable`; `bad_calibration` when it is not a calibration, or contains numbers that are out of bounds.
pub fn read_model(path: &Path) -> Result<StoredModel> {
    read(path)?.model(path)
}

/// Standard deviation of the specific force corrected by a parameter set at 1 *g* on the worst axis, m/s²; `None` if
/// the set holds none.
pub fn force_sd_mps2(set: &ParameterSet) -> Option<f64> {
    let covariance = set.quality?.terms().covariance;
    Some(worst_sd(|place| covariance.sd(place)))
}

/// Standard deviation of the specific force at 1 *g* on the worst axis, m/s², from those of the parameters.
pub(crate) fn worst_sd(sd: impl Fn(usize) -> f64) -> f64 {
    let of_axis = |axis: usize| {
        let row = (3 + 3 * axis..6 + 3 * axis).map(|place| sd(place) * STANDARD_GRAVITY_MPS2);
        row.fold(sd(axis), f64::hypot)
    };
    (0..3).map(of_axis).fold(0.0, f64::max)
}

/// An assumed range of a calibration file.
pub(super) fn range_finding(path: &Path, set: &ParameterSet) -> Option<Problem> {
    let source = read(path).ok()?.sensor().ok()?.accelerometer.range_source;
    let likely = Range { g: set.range_g, source: Source::SixteenBits };
    (source == Some(Source::SixteenBits)).then(|| likely.finding(set.sensitivity))?
}
