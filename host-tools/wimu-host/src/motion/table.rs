//! One unit's recording from a CSV file, corrected where it is not yet.

use std::path::Path;

use wimu_model::{CentiCelsius, MagneticFieldNt, STANDARD_GRAVITY_MPS2, SpecificForceMps2};
use wimu_nav::unit::UnitSample;

use super::{FIELD_CALIBRATED, MotionRecording, Truth};
use crate::calibration::StoredModel;
use crate::csv::{CsvReader, Header, Row, SENSITIVITY};
use crate::dataset::{LoadOptions, one_sensor};
use crate::export::GYROSCOPE_SCALE;
use crate::{ErrorCode, HostError, Result};

/// Two sensitivities that differ by more than this share are of two ranges.
pub(crate) const OTHER_RANGE: f64 = 0.3;

/// What a CSV file does not say itself.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct TableOptions {
    /// What corrects its samples; without it, they are corrected.
    pub calibration: Option<StoredModel>,
    /// Sensitivity of counts, where neither the calibration nor a column [`SENSITIVITY`] says it, LSB/g.
    pub sensitivity_lsb_per_g: Option<f64>,
}

const RATE_UNITS: [(&str, f64); 3] = [
    ("rad/s", 1.0),
    ("deg/s", std::f64::consts::PI / 180.0),
    ("dps", std::f64::consts::PI / 180.0),
];

/// The unit of a gyroscope's counts in a table with a column [`GYROSCOPE_SCALE`].
const COUNTS: [(&str, f64); 1] = [("LSB", 1.0)];

/// The column called `name` and the factor of its unit; `None` where there is none.
fn unit_of(names: &[String], name: &str, units: &[(&str, f64)]) -> Result<Option<(usize, f64)>> {
    let parts = |column: &str| {
        let (start, unit) = column.split_once('(').unwrap_or((column, ")"));
        (start.trim() == name).then(|| unit.trim_end_matches(')').trim().to_owned())
    };
    let Some((k, unit)) = names
        .iter()
        .enumerate()
        .find_map(|(k, n)| Some((k, parts(n)?)))
    else {
        return Ok(None);
    };
    match units.iter().find(|(known, _)| *known == unit) {
        Some((_, factor)) => Ok(Some((k, *factor))),
        None => {
            let known: Vec<String> = units
                .iter()
                .map(|(u, _)| format!("`{name} ({u})`"))
                .collect();
            Err(HostError::new(
                ErrorCode::UnknownFormat,
                format!("the unit of `{}` is not known", names[k]),
                format!("give it as {}", known.join(" or ")),
            ))
        }
    }
}

/// Three axes or none.
fn complete(
    name: &str,
    axes: [Result<Option<(usize, f64)>>; 3],
) -> Result<Option<[(usize, f64); 3]>> {
    let [x, y, z] = axes;
    match [x?, y?, z?] {
        [Some(x), Some(y), Some(z)] => Ok(Some([x, y, z])),
        [None, None, None] => Ok(None),
        _ => Err(HostError::new(
            ErrorCode::CsvMissingColumn,
            format!("`{name}` has not all its axes"),
            "give all three, or none",
        )),
    }
}

impl MotionRecording {
    /// Reads a CSV file of corrected samples: [`from_csv_with`](Self::from_csv_with) without options.
    ///
    /// # Errors
    /// Those of [`from_csv_with`](Self::from_csv_with).
    pub fn from_csv(path: &Path) -> Result<Self> {
        Self::from_csv_with(path, &TableOptions::default())
    }

    /// Reads a CSV file with times and one accelerometer, whose empty fields are not a number; `Gyroscope X (rad/s)` or `(deg/s)`, or
    /// counts with the nominal scale as exported, the magnetometer and
    /// `Truth Position E (m)`, `Truth Quaternion W`, … if there are. A magnetic field whose `Field Calibrated` is 0 is
    /// left out, unless the calibration has a model of the magnetometer. A calibration is of the unit in which the
    /// accelerations are: of counts, or of m/s² and g.
    ///
    /// # Errors
    /// Those of [`CsvReader`]; `csv_missing_column` without times, with other than one accelerometer or
    /// with an axis whose neighbours are there; `unknown_format` for counts of unknown sensitivity, a calibration of the
    /// other unit, and units that are not known.
    pub fn from_csv_with(path: &Path, options: &TableOptions) -> Result<Self> {
        one_sensor(path, &LoadOptions::default())?;
        let mut reader = CsvReader::open(path)?.with_holes();
        let header = reader.header().clone();
        let name = reader.name().to_owned();
        let in_header = |error: HostError| error.at(format!("{name} line 1"));
        if !header.time || header.accelerometers.len() != 1 {
            return Err(in_header(HostError::new(
                ErrorCode::CsvMissingColumn,
                "navigation needs times and one accelerometer",
                "name the columns `Time (s)`, `Accelerometer X (m/s²)`, …; for several accelerometers \
                 on one body give --geometry",
            )));
        }
        let first = reader.next_row()?;
        let mut correction = Correction::of(&header, first.as_ref(), options).map_err(in_header)?;
        let mut recording = Self {
            name: name.clone(),
            bias_sd_mps2: options.calibration.map_or(0.0, |c| c.bias_sd_mps2),
            other: header
                .other
                .iter()
                .map(|n| (n.clone(), Vec::new()))
                .collect(),
            ..Self::default()
        };
        recording.remarks.extend(correction.remark());
        let column = |name: String, units: &[(&str, f64)]| {
            unit_of(&header.other, &name, units).map_err(in_header)
        };
        let find = |name: &str| header.other.iter().position(|n| n == name);
        let scale = find(GYROSCOPE_SCALE).filter(|_| find("Gyroscope X (LSB)").is_some());
        let units = if scale.is_some() {
            &COUNTS[..]
        } else {
            &RATE_UNITS
        };
        let rate = complete(
            "Gyroscope",
            ["X", "Y", "Z"].map(|axis| column(format!("Gyroscope {axis}"), units)),
        )
        .map_err(in_header)?;
        let strange = |n: &&String| {
            let name = n.to_lowercase();
            rate.is_none() && (name.starts_with("gyr") || name.starts_with("angular"))
        };
        if let Some(column) = header.other.iter().find(strange) {
            recording.remarks.push(format!(
                "`{column}` is not read: an angular rate is called `Gyroscope X (rad/s)` or `(deg/s)`"
            ));
        }
        let metres = |axis| column(format!("Truth Position {axis}"), &[("m", 1.0)]);
        let position =
            complete("Truth Position", ["E", "N", "U"].map(metres)).map_err(in_header)?;
        let quaternion = ["W", "X", "Y", "Z"].map(|a| find(&format!("Truth Quaternion {a}")));
        let calibrated = find(FIELD_CALIBRATED);
        let mut last = None;
        for row in first.map(Ok).into_iter().chain(reader) {
            let row = row?;
            for ((_, values), text) in recording.other.iter_mut().zip(&row.other) {
                values.push(text.parse().unwrap_or(f64::NAN));
            }
            let other = &recording.other;
            let value = |at: Option<usize>| {
                let (_, values) = other.get(at?)?;
                values.last().copied().filter(|v| v.is_finite())
            };
            let all = |at: Option<[(usize, f64); 3]>| {
                let [x, y, z] = at?.map(|(k, by)| value(Some(k)).map(|v| v * by));
                Some([x?, y?, z?])
            };
            let is_calibrated = calibrated
                .and_then(|k| value(Some(k)))
                .map(|flag| flag != 0.0);
            let time = row.time_ns.unwrap_or_default() as f64 * 1e-9;
            let field_ut = correction.field(&row, is_calibrated);
            let force = correction.force(&row);
            let rate_rad_s = match scale {
                None => all(rate),
                Some(scale) => all(rate)
                    .zip(value(Some(scale)))
                    .map(|(counts, nominal)| correction.rate(counts, nominal, force)),
            };
            recording.samples.push(UnitSample {
                step_s: time - last.unwrap_or(time),
                force_mps2: correction.turned(force),
                field_ut,
                rate_rad_s: rate_rad_s.map(|rate| correction.turned(rate)),
            });
            recording.field_uncalibrated |= row.magnetic_field_ut.is_some() && field_ut.is_none();
            recording.times_s.push(time);
            recording.lines.push(row.line);
            last = Some(time);
            recording.truth.push(all(position).map(|position_m| Truth {
                position_m,
                quaternion: quaternion.map(|q| value(q).unwrap_or(f64::NAN)),
            }));
        }
        if recording.samples.len() < 2 {
            return Err(HostError::new(
                ErrorCode::NoRows,
                "there are fewer than two samples",
                "check the file",
            )
            .at(&recording.name));
        }
        Ok(recording)
    }
}

/// What becomes of a row's values.
struct Correction {
    mps2_per_unit: f64,
    stored: Option<StoredModel>,
    /// The last temperature that was read.
    temperature: Option<CentiCelsius>,
}

impl Correction {
    /// The one for a file, of which `first` is the first row.
    fn of(header: &Header, first: Option<&Row>, options: &TableOptions) -> Result<Self> {
        let stored = options.calibration;
        let wrong =
            |message: &str, remedy: &str| HostError::new(ErrorCode::UnknownFormat, message, remedy);
        let correction = |mps2_per_unit| Self {
            mps2_per_unit,
            stored,
            temperature: None,
        };
        if let Some(mps2_per_unit) = header.acceleration_unit.mps2() {
            return match stored {
                Some(stored) if stored.of_counts => Err(wrong(
                    "its accelerations are in m/s² or g, and the calibration is one of raw counts",
                    "give the raw counts, in columns `Accelerometer X (LSB)`, …, or calibrate with a recording in m/s² or \
                     g: `wimu calibrate FILE -o CAL.json`",
                )),
                _ => Ok(correction(mps2_per_unit)),
            };
        }
        let in_file = header
            .other
            .iter()
            .position(|n| n == SENSITIVITY)
            .and_then(|k| first?.other.get(k)?.parse::<f64>().ok());
        let said = options.sensitivity_lsb_per_g.or(in_file);
        let own = stored.and_then(|stored| stored.sensitivity_lsb_per_g);
        if let (Some(own), Some(said)) = (own, said)
            && (said / own - 1.0).abs() > OTHER_RANGE
        {
            return Err(wrong(
                &format!("1 g is {said:.0} LSB in it, and {own:.0} LSB in the calibration"),
                "give the calibration of this range, or leave --sensitivity out",
            ));
        }
        let lsb_per_g = match (stored, own, said) {
            (_, Some(own), _) => own,
            (Some(_), None, None) => {
                return Err(wrong(
                    "its accelerations are raw counts, and the calibration is one of m/s² or g",
                    "calibrate with a recording of raw counts: `wimu calibrate FILE -o CAL.json`; or say what the counts \
                     are, --sensitivity LSB_PER_G",
                ));
            }
            (_, None, Some(said)) => said,
            (None, None, None) => {
                return Err(wrong(
                    "its accelerations are raw counts, of which nothing says what they are",
                    "calibrate the sensor, `wimu calibrate FILE -o CAL.json`, and give --calibration CAL.json; or say what \
                     the counts are, --sensitivity LSB_PER_G",
                ));
            }
        };
        Ok(correction(STANDARD_GRAVITY_MPS2 / lsb_per_g))
    }

    fn remark(&self) -> Option<String> {
        let stored = self.stored?;
        let [x, y, z] = stored.model.terms().bias_mps2;
        let known = if stored.bias_sd_mps2 > 0.0 {
            format!(
                ", which with scale and axes it knows to ± {:.4} m/s²",
                stored.bias_sd_mps2
            )
        } else {
            String::new()
        };
        let field = match stored.magnetometer {
            Some(_) => ", and the magnetic field too",
            None => "",
        };
        Some(format!(
            "the calibration is applied{field}: a bias of {x:+.4} {y:+.4} {z:+.4} m/s² is taken off{known}"
        ))
    }

    /// Specific force, m/s², sensor axes.
    fn force(&mut self, row: &Row) -> [f64; 3] {
        let output = row.accelerations.first().copied().unwrap_or_default();
        let output = output.map(|axis| axis * self.mps2_per_unit);
        let Some(stored) = &self.stored else {
            return output;
        };
        let now = row.temperature_c.map(CentiCelsius::from_celsius);
        self.temperature = now.or(self.temperature);
        let force = stored
            .model
            .correct(SpecificForceMps2(output), self.temperature);
        force.0
    }

    /// Angular rate, rad/s, sensor axes, from counts of a nominal scale, rad/s per LSB, at a specific force.
    fn rate(&self, counts: [f64; 3], nominal: f64, force: [f64; 3]) -> [f64; 3] {
        match self.stored.and_then(|stored| stored.gyroscope) {
            Some(gyroscope) => {
                let output = counts.map(|axis| axis * gyroscope.rad_s_per_lsb);
                gyroscope.model.correct(output, force, self.temperature)
            }
            None => counts.map(|axis| axis * nominal),
        }
    }

    /// Magnetic field, µT, body axes: as a magnetometer put it out that is not calibrated, it says nothing of
    /// directions.
    fn field(&self, row: &Row, is_calibrated: Option<bool>) -> Option<[f64; 3]> {
        let field_ut = row.magnetic_field_ut?;
        match self.stored.and_then(|stored| stored.magnetometer) {
            Some(model) if is_calibrated != Some(true) => {
                let output = MagneticFieldNt(field_ut.map(|b| (b * 1e3).round() as i32));
                let field_nt = model.correct_to_accelerometer(output)?;
                Some(self.turned(field_nt.map(|b| b * 1e-3)))
            }
            _ if is_calibrated == Some(false) => None,
            _ => Some(self.turned(field_ut)),
        }
    }

    /// From the sensor's axes to the body's.
    fn turned(&self, vector: [f64; 3]) -> [f64; 3] {
        match &self.stored {
            Some(stored) => stored.alignment.rotate(vector),
            None => vector,
        }
    }
}
