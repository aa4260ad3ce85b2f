//! Calibrations: the content of a CAL.json.

use std::path::{Path, PathBuf};

use serde::de::Error;
use serde::{Deserialize, Deserializer, Serialize};
use wimu_model::{
    Alignment, CalibratedTemperature, CalibrationMethod, CalibrationQuality, ErrorModel,
    GyroscopeParameters, MagnetometerModel, ModelCovariance, ParameterSet, QualityTerms,
    RotationCovariance, STANDARD_GRAVITY_MPS2, Sensitivity, SensorId, TermDeviations,
};

use super::{Source, covariance, parameter_id};
use crate::csv::AccelerationUnit;
use crate::{Code, OutputFile, Problem, Result};

/// How to make a file that can be read.
const REMEDY: &str =
    "give the file that `wimu calibrate … -o CAL.json` wrote; if it was edited, undo the change";

/// A calibration, as CAL.json holds it: every value once, and within its bounds.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Calibration {
    /// [`Calibration::SCHEMA`].
    schema: String,
    /// Id of the device that it was made on, 16 hexadecimal digits; absent where the data do not name it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    device: Option<String>,
    /// The sensors of a board, at least one.
    #[serde(deserialize_with = "checked")]
    sensors: Vec<SensorCalibration>,
    /// The file that it was read from.
    #[serde(skip)]
    path: Option<PathBuf>,
}

/// The calibration of a sensor.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SensorCalibration {
    /// Its index on its board, from 0.
    pub index: u8,
    /// Its type, as numbered in the protocol; null if unknown.
    pub sensor: Option<SensorId>,
    /// Sensor axes to body axes, quaternion W, X, Y, Z.
    #[serde(rename = "alignment_wxyz")]
    pub alignment: Alignment,
    /// Covariance of the alignment's error about body axes, rad²; null if not measured.
    #[serde(default, with = "covariance::of_rotation")]
    pub alignment_covariance: Option<RotationCovariance>,
    /// Its accelerometer.
    pub accelerometer: AccelerometerCalibration,
    /// Its gyroscope; null if it has none, or one that is uncalibrated.
    pub gyroscope: Option<GyroscopeParameters>,
    /// The magnetometer beside it; null if uncalibrated.
    pub magnetometer: Option<MagnetometerModel>,
    /// Id of its parameter set; null without parameters for a board. A file with another one was edited.
    parameter_id: Option<String>,
}

/// The calibration of an accelerometer.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct AccelerometerCalibration {
    /// Unit of the output that was calibrated: `LSB`, or `m/s²` for g too. A model of counts does not apply to output in
    /// m/s², which was scaled elsewhere.
    pub unit: AccelerationUnit,
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
    pub model: ErrorModel,
    /// Its uncertainty; null if it was not estimated.
    pub quality: Option<Quality>,
    /// Where the data come from, in order.
    pub sessions: Vec<Session>,
}

/// Uncertainty of an error model: [`QualityTerms`] without the poses and the time, which are those of the sessions.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Quality {
    method: CalibrationMethod,
    /// Temperatures of the data, between which the model is valid.
    temperature: Option<CalibratedTemperature>,
    dof: u32,
    rms_mps2: f32,
    loo_rms_mps2: Option<f32>,
    condition: Option<f32>,
    #[serde(with = "covariance::of_model")]
    covariance: ModelCovariance,
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

fn checked<'de, D: Deserializer<'de>>(input: D) -> Result<Vec<SensorCalibration>, D::Error> {
    let sensors = Vec::<SensorCalibration>::deserialize(input)?;
    if sensors.is_empty() {
        return Err(D::Error::custom("it has no sensor"));
    }
    sensors.iter().try_for_each(SensorCalibration::check).map_err(D::Error::custom)?;
    Ok(sensors)
}

impl Calibration {
    /// Name of the JSON object.
    pub const SCHEMA: &'static str = "wimu.calibration/2";
    /// Begin of the names of all versions.
    pub(crate) const FAMILY: &'static str = "\"wimu.calibration/";

    /// Of one sensor.
    pub fn of(sensor: SensorCalibration) -> Self {
        Self { schema: Self::SCHEMA.to_owned(), device: None, sensors: vec![sensor], path: None }
    }

    /// Of a set that a board or a recording holds.
    pub fn held(set: &ParameterSet) -> Self {
        let quality = set.quality.iter().map(CalibrationQuality::terms);
        let session =
            |terms: &QualityTerms| Session { utc_s: terms.utc_s, file: None, poses: terms.poses };
        let accelerometer = AccelerometerCalibration {
            unit: AccelerationUnit::Lsb,
            range_g: Some(set.range_g),
            range_source: None,
            sensitivity_lsb_per_g: Some(set.sensitivity.lsb_per_g()),
            zero_count: None,
            model: set.model,
            quality: set.quality.as_ref().map(Quality::from),
            sessions: quality.map(session).collect(),
        };
        Self::of(SensorCalibration {
            index: set.sensor_index,
            alignment: set.alignment,
            alignment_covariance: set.alignment_covariance,
            gyroscope: set.gyroscope,
            magnetometer: set.magnetometer,
            ..SensorCalibration::new(set.sensor, accelerometer)
        })
    }

    /// The same of this device, if it does not name one.
    #[must_use]
    pub fn of_device(mut self, id: Option<u64>) -> Self {
        self.device = self.device.or(id.map(|id| format!("{id:016x}")));
        self
    }

    /// The same with the sensors of another one.
    #[must_use]
    pub fn and(mut self, other: Self) -> Self {
        self.sensors.extend(other.sensors);
        self
    }

    /// Reads a file.
    ///
    /// # Errors
    /// `file_unreadable`; `bad_calibration` when it is not a calibration, was edited, or holds numbers that are out of bounds.
    pub fn read(path: &Path) -> Result<Self> {
        let name = path.display().to_string();
        let text = std::fs::read_to_string(path).map_err(|e| Problem::file(&name, "read", &e))?;
        let calibration = Self::parse(&text).map_err(|problem| match &problem.place.at {
            Some(at) => problem.clone().at(format!("{name} {at}")),
            None => problem.at(name),
        })?;
        Ok(Self { path: Some(path.to_owned()), ..calibration })
    }

    /// Reads the text of a file.
    ///
    /// # Errors
    /// `bad_calibration`.
    pub fn parse(text: &str) -> Result<Self> {
        #[derive(Deserialize)]
        struct Head {
            schema: Option<String>,
        }
        let bad = |error: serde_json::Error| {
            let problem =
                Code::BadCalibration.error(format!("this is not a calibration: {error}"), REMEDY);
            problem.at(format!("line {}, column {}", error.line(), error.column()))
        };
        let head: Head = serde_json::from_str(text).map_err(bad)?;
        let schema = head.schema.as_deref().unwrap_or("missing");
        if schema == Self::SCHEMA {
            return serde_json::from_str(text).map_err(bad);
        }
        let remedy = if schema.starts_with(Self::FAMILY.trim_start_matches('"')) {
            "update wimu on this computer"
        } else {
            REMEDY
        };
        let text = format!("its schema is {schema}, not {}", Self::SCHEMA);
        Err(Code::BadCalibration.error(text, remedy))
    }

    /// The same with the ids of its parameter sets, without which a file is not read.
    fn sealed(&self) -> Self {
        let mut sealed = self.clone();
        for sensor in &mut sealed.sensors {
            let set = sensor.values();
            sensor.parameter_id = set.ok().map(|set| parameter_id(&set).to_string());
        }
        sealed
    }

    /// Its text in one line, as a recording keeps it.
    pub fn text(&self) -> String {
        // Numbers, texts and lists always are JSON.
        serde_json::to_string(&self.sealed()).unwrap_or_default()
    }

    /// Writes it.
    ///
    /// # Errors
    /// `file_failed`, `file_unreadable`.
    pub fn write(&self, path: &Path) -> Result<()> {
        let text = serde_json::to_string_pretty(&self.sealed()).unwrap_or_default();
        OutputFile::write(path, text + "\n")
    }

    /// The sensor that a device corrects: that with index 0, else the first.
    pub fn sensor(&self) -> &SensorCalibration {
        self.sensors.iter().find(|sensor| sensor.index == 0).unwrap_or(&self.sensors[0])
    }

    /// The same, to change it.
    pub fn sensor_mut(&mut self) -> &mut SensorCalibration {
        let first = self.sensors.iter().position(|sensor| sensor.index == 0);
        &mut self.sensors[first.unwrap_or(0)]
    }

    /// Indices of the other sensors.
    pub fn further(&self) -> Vec<u8> {
        let indices = self.sensors.iter().map(|sensor| sensor.index);
        indices.filter(|index| *index != self.sensor().index).collect()
    }

    /// The parameters of [`sensor`](Self::sensor) for a board.
    ///
    /// # Errors
    /// `bad_calibration` without a sensitivity, or with one outside the range of boards.
    pub fn parameters(&self) -> Result<ParameterSet> {
        self.sensor().values().map_err(|text| self.without_board(text))
    }

    /// The models of [`sensor`](Self::sensor), for use on the host: of a calibration in m/s² too.
    ///
    /// # Errors
    /// `bad_calibration` of raw counts with a sensitivity outside the range of boards.
    pub fn models(&self) -> Result<ParameterSet> {
        self.sensor().models().map_err(|text| self.without_board(text))
    }

    fn without_board(&self, text: String) -> Problem {
        let remedy = "calibrate again with --sensitivity, the nominal LSB/g of the board's range";
        self.located(Code::BadCalibration.error(text, remedy))
    }

    /// Checks that it is of this device, or names none.
    ///
    /// # Errors
    /// `other_device`.
    pub fn check_device(&self, id: u64) -> Result<()> {
        let id = format!("{id:016x}");
        let Some(device) = self.device.as_ref().filter(|device| **device != id) else {
            return Ok(());
        };
        Err(self.located(Code::OtherDevice.error(
            format!("this is the calibration of device {device}, the board is device {id}"),
            "push that of this device; `device params push` and `fleet push` also take another one with --force",
        )))
    }

    fn located(&self, problem: Problem) -> Problem {
        match &self.path {
            Some(path) => problem.at(path.display().to_string()),
            None => problem,
        }
    }
}

/// Range and sensitivity of models that are applied to an output in m/s²: 16 bits at ± 2 g.
const ANY_RANGE_G: u8 = 2;
const ANY_LSB_PER_G: f64 = 16384.0;

/// Reads the parameters of a calibration file, for a board: those of the sensor with index 0, else of the first.
///
/// # Errors
/// Those of [`Calibration::read`] and [`Calibration::parameters`].
pub fn read_parameters(path: &Path) -> Result<ParameterSet> {
    Calibration::read(path)?.parameters()
}

impl SensorCalibration {
    /// Of an accelerometer.
    pub fn new(sensor: Option<SensorId>, accelerometer: AccelerometerCalibration) -> Self {
        Self {
            index: 0,
            sensor,
            alignment: Alignment::IDENTITY,
            alignment_covariance: None,
            accelerometer,
            gyroscope: None,
            magnetometer: None,
            parameter_id: None,
        }
    }

    /// What the types of its fields do not check.
    fn check(&self) -> std::result::Result<(), String> {
        if let Some(GyroscopeParameters { range_dps, rad_s_per_lsb, model, sd, .. }) =
            self.gyroscope
        {
            GyroscopeParameters::new(range_dps, rad_s_per_lsb, model, sd)
                .map_err(|error| error.to_string())?;
        }
        self.accelerometer.quality()?;
        match (self.values(), &self.parameter_id) {
            (Ok(set), id) if *id != Some(parameter_id(&set).to_string()) => {
                Err("the file was edited: its values and parameter_id differ".to_owned())
            }
            _ => Ok(()),
        }
    }

    fn values(&self) -> std::result::Result<ParameterSet, String> {
        let accelerometer = &self.accelerometer;
        let (Some(range_g), Some(lsb_per_g)) =
            (accelerometer.range_g, accelerometer.sensitivity_lsb_per_g)
        else {
            return Err(match accelerometer.sensitivity_lsb_per_g {
                Some(own) => format!(
                    "it has no parameters for a board: {own:.1} LSB/g is outside the range of boards"
                ),
                None => "it has no parameters for a board: its data were in m/s² or g".to_owned(),
            });
        };
        let sensitivity = Sensitivity::from_lsb_per_g(lsb_per_g).map_err(|e| e.to_string())?;
        self.with(range_g, sensitivity)
    }

    /// What corrects an output in m/s²: range and sensitivity of a calibration without them are those of any board.
    fn models(&self) -> std::result::Result<ParameterSet, String> {
        if self.accelerometer.unit == AccelerationUnit::Lsb {
            return self.values();
        }
        let sensitivity = Sensitivity::from_lsb_per_g(ANY_LSB_PER_G).map_err(|e| e.to_string())?;
        self.with(ANY_RANGE_G, sensitivity)
    }

    fn with(
        &self,
        range_g: u8,
        sensitivity: Sensitivity,
    ) -> std::result::Result<ParameterSet, String> {
        let accelerometer = &self.accelerometer;
        Ok(ParameterSet {
            model: accelerometer.model,
            quality: accelerometer.quality()?,
            alignment: self.alignment,
            alignment_covariance: self.alignment_covariance,
            magnetometer: self.magnetometer,
            sensor: self.sensor,
            sensor_index: self.index,
            gyroscope: self.gyroscope,
            ..ParameterSet::uncalibrated(range_g, sensitivity)
        })
    }
}

impl AccelerometerCalibration {
    fn quality(&self) -> std::result::Result<Option<CalibrationQuality>, String> {
        let Some(quality) = &self.quality else { return Ok(None) };
        let terms = QualityTerms {
            method: quality.method,
            utc_s: self.sessions.last().and_then(|session| session.utc_s),
            temperature: quality.temperature,
            poses: total(&self.sessions),
            dof: quality.dof,
            rms_mps2: quality.rms_mps2,
            loo_rms_mps2: quality.loo_rms_mps2,
            condition: quality.condition,
            covariance: quality.covariance,
            other_sd: quality.other_sd,
        };
        CalibrationQuality::new(terms).map(Some).map_err(|error| error.to_string())
    }

    /// Covariance of bias and matrix, sensor axes; `None` where it was not estimated.
    pub fn covariance(&self) -> Option<ModelCovariance> {
        self.quality.map(|quality| quality.covariance)
    }

    /// Whether it combines sessions: its covariance is that of a new session, with the change between sessions.
    pub fn of_sessions(&self) -> bool {
        let updated = |quality: &Quality| quality.method == CalibrationMethod::Updated;
        self.sessions.len() > 1 && self.quality.is_some_and(|quality| !updated(&quality))
    }

    /// Standard deviation of the specific force at 1 *g* on the worst axis, m/s², of bias, scale factor and misalignment
    /// together; 0 where it is not known.
    pub fn bias_sd_mps2(&self) -> f64 {
        self.covariance().map_or(0.0, |known| worst_sd(|place| known.sd(place)))
    }

    /// m/s² of one unit of the output that it corrects: of one LSB where a sensitivity is known, else 1.
    pub fn mps2_per_unit(&self) -> f64 {
        let lsb_per_g = self.sensitivity_lsb_per_g;
        lsb_per_g.map_or(1.0, |lsb_per_g| STANDARD_GRAVITY_MPS2 / lsb_per_g)
    }
}

impl From<&CalibrationQuality> for Quality {
    fn from(quality: &CalibrationQuality) -> Self {
        let terms = quality.terms();
        Self {
            method: terms.method,
            temperature: terms.temperature,
            dof: terms.dof,
            rms_mps2: terms.rms_mps2,
            loo_rms_mps2: terms.loo_rms_mps2,
            condition: terms.condition,
            covariance: terms.covariance,
            other_sd: terms.other_sd,
        }
    }
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
