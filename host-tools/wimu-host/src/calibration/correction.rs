//! The only way in f64 from the output of sensors to SI and body axes. A device computes the same in integers
//! ([`wimu_model::Corrector`]), and [`crate::replay`] repeats that.

use wimu_model::{
    Alignment, CentiCelsius, ErrorModel, GyroscopeModel, MagneticFieldNt, MagnetometerModel,
    Matrix3, ParameterSet, STANDARD_GRAVITY_MPS2, SpecificForceMps2,
};

use super::{Calibration, SensorCalibration, Source};
use crate::csv::AccelerationUnit;
use crate::recording::{TrackInfo, Unit};
use crate::{Code, Result};

/// Relative difference of two sensitivities above which they are of two ranges.
const OTHER_RANGE: f64 = 0.3;
/// Largest difference of two outputs at zero that are the same, LSB.
const SAME_ZERO: f64 = 0.5;

/// Corrects the outputs of one sensor.
#[derive(Clone, Copy, Debug)]
pub struct Correction {
    /// m/s² of one unit of the accelerometer's output.
    mps2_per_unit: f64,
    model: ErrorModel,
    /// From sensor axes to body axes.
    rotation: Matrix3,
    /// With rad/s of one of its counts.
    gyroscope: Option<(GyroscopeModel, f64)>,
    magnetometer: Option<MagnetometerModel>,
}

impl SensorCalibration {
    /// Its correction of the output of `track`, an accelerometer.
    ///
    /// # Errors
    /// `already_corrected`; `unknown_format` where the units, the ranges or the outputs at zero do not fit.
    pub fn compile(&self, track: &TrackInfo) -> Result<Correction> {
        let own = &self.accelerometer;
        // A calibration in m/s² may be one of corrected output.
        if track.corrected && own.unit == AccelerationUnit::Lsb {
            return Err(Code::AlreadyCorrected.error(
                format!("`{}` was corrected by the device before", track.name),
                "use its uncorrected output, or leave the calibration out",
            ));
        }
        let counts = match track.unit {
            Unit::Counts { si_per_lsb } => si_per_lsb,
            Unit::Si if own.unit == AccelerationUnit::Lsb => {
                return Err(Code::UnknownFormat.error(
                    "its accelerations are in m/s² or g, and the calibration is one of raw counts",
                    "give the raw counts, in columns `Accelerometer X (LSB)`, …, or calibrate with a recording in m/s² or g: \
                     `wimu calibrate FILE -o CAL.json`",
                ));
            }
            Unit::Si => return Ok(self.correction(1.0)),
            Unit::Unknown => return Err(unknown_unit()),
        };
        let stated = counts.map(|scale| STANDARD_GRAVITY_MPS2 / scale);
        let Some(lsb_per_g) = own.sensitivity_lsb_per_g.or(stated) else {
            return Err(Code::UnknownFormat.error(
                "its accelerations are raw counts, and the calibration is one of m/s² or g",
                "calibrate with a recording of raw counts: `wimu calibrate FILE -o CAL.json`",
            ));
        };
        self.fits(track, lsb_per_g, stated)?;
        Ok(self.correction(STANDARD_GRAVITY_MPS2 / lsb_per_g))
    }

    /// Whether counts of `track`, of the sensitivity `stated`, are those that were calibrated.
    fn fits(&self, track: &TrackInfo, lsb_per_g: f64, stated: Option<f64>) -> Result<()> {
        let own = &self.accelerometer;
        let other = |text: String, remedy: &str| Err(Code::UnknownFormat.error(text, remedy));
        let this_range = "give the calibration of this range";
        if let Some(stated) = stated.filter(|stated| (stated / lsb_per_g - 1.0).abs() > OTHER_RANGE)
        {
            let text =
                format!("1 g is {stated:.0} LSB in it, and {lsb_per_g:.0} LSB in the calibration");
            return other(text, this_range);
        }
        let range_g = track.full_scale.map(|mps2| (mps2 / STANDARD_GRAVITY_MPS2).round());
        let known = own.range_g.filter(|_| own.range_source != Some(Source::SixteenBits));
        if let (Some(range), Some(known)) = (range_g, known)
            && range != f64::from(known)
        {
            return other(
                format!("its range is ±{range} g, the calibration's ±{known} g"),
                this_range,
            );
        }
        let [zero, known] = [track.zero_count, own.zero_count].map(Option::unwrap_or_default);
        if (zero - known).abs() > SAME_ZERO {
            return other(
                format!("{zero} LSB is taken as zero in it, and {known} LSB in the calibration"),
                "leave --zero-count out, or calibrate counts with the same one",
            );
        }
        Ok(())
    }

    fn correction(&self, mps2_per_unit: f64) -> Correction {
        Correction {
            mps2_per_unit,
            model: self.accelerometer.model,
            rotation: self.alignment.matrix(),
            gyroscope: self.gyroscope.map(|own| (own.model, own.rad_s_per_lsb)),
            magnetometer: self.magnetometer,
        }
    }
}

impl From<&ParameterSet> for Correction {
    /// Of the counts of a board.
    fn from(set: &ParameterSet) -> Self {
        Calibration::held(set).sensor().correction(set.sensitivity.mps2_per_lsb())
    }
}

impl Correction {
    /// That of an ideal sensor in body axes.
    ///
    /// # Errors
    /// `unknown_format` for counts whose sensitivity is not known.
    pub fn ideal(track: &TrackInfo) -> Result<Self> {
        let mps2_per_unit = match track.unit {
            Unit::Si => 1.0,
            Unit::Counts { si_per_lsb: Some(mps2) } => mps2,
            Unit::Counts { si_per_lsb: None } => {
                return Err(Code::UnknownFormat.error(
                    "its accelerations are raw counts, of which nothing says what they are",
                    "calibrate the sensor, `wimu calibrate FILE -o CAL.json`, and give --with CAL.json; `wimu navigate` \
                     also takes --sensitivity LSB_PER_G",
                ));
            }
            Unit::Unknown => return Err(unknown_unit()),
        };
        Ok(Self::of_model(ErrorModel::default(), mps2_per_unit, Alignment::IDENTITY.matrix()))
    }

    /// Of an error model of an output of `mps2_per_unit`, and a rotation to body axes.
    pub fn of_model(model: ErrorModel, mps2_per_unit: f64, rotation: Matrix3) -> Self {
        Self { mps2_per_unit, model, rotation, gyroscope: None, magnetometer: None }
    }

    /// The same with sensor axes for body axes.
    #[must_use]
    pub fn in_sensor_axes(self) -> Self {
        Self { rotation: Alignment::IDENTITY.matrix(), ..self }
    }

    /// m/s² of one unit of the accelerometer's output at its nominal sensitivity.
    pub fn mps2_per_unit(&self) -> f64 {
        self.mps2_per_unit
    }

    /// Specific force, m/s², body axes, from an output in the unit of the track and its temperature, °C.
    pub fn sample(&self, raw: [f64; 3], temperature_c: Option<f64>) -> [f64; 3] {
        self.to_body(self.force(raw, temperature_c))
    }

    /// rad/s of one unit of `track`, a gyroscope; `None` where nothing says it.
    pub fn rad_s_per_unit(&self, track: &TrackInfo) -> Option<f64> {
        match (track.unit, &self.gyroscope) {
            (Unit::Si, _) => Some(1.0),
            (Unit::Counts { .. }, Some((_, rad_s))) => Some(*rad_s),
            (Unit::Counts { si_per_lsb }, None) => si_per_lsb,
            (Unit::Unknown, _) => None,
        }
    }

    /// Whether it has a model of the gyroscope, and of the magnetometer.
    pub fn has(&self) -> [bool; 2] {
        [self.gyroscope.is_some(), self.magnetometer.is_some()]
    }

    /// Angular rate, rad/s, body axes, from an output at its nominal sensitivity, rad/s, and the output of the accelerometer.
    pub fn rate(&self, rad_s: [f64; 3], raw: [f64; 3], temperature_c: Option<f64>) -> [f64; 3] {
        let Some((model, _)) = &self.gyroscope else { return self.to_body(rad_s) };
        let force = self.force(raw, temperature_c);
        self.to_body(model.correct(rad_s, force, temperature_c.map(CentiCelsius::from_celsius)))
    }

    /// Magnetic field, µT, body axes, from an output, T; `None` without a magnetometer whose axes are known.
    pub fn field_ut(&self, tesla: [f64; 3]) -> Option<[f64; 3]> {
        let output = MagneticFieldNt(tesla.map(|axis| (axis * 1e9).round() as i32));
        let field_nt = self.magnetometer?.correct_to_accelerometer(output)?;
        Some(self.to_body(field_nt.map(|nt| nt * 1e-3)))
    }

    /// A vector in sensor axes, in body axes.
    pub fn to_body(&self, v: [f64; 3]) -> [f64; 3] {
        self.rotation.map(|row| row[0] * v[0] + row[1] * v[1] + row[2] * v[2])
    }

    fn force(&self, raw: [f64; 3], temperature_c: Option<f64>) -> [f64; 3] {
        let output = SpecificForceMps2(raw.map(|axis| axis * self.mps2_per_unit));
        self.model.correct(output, temperature_c.map(CentiCelsius::from_celsius)).0
    }
}

fn unknown_unit() -> crate::Problem {
    let remedy = "name it: --units m/s2, g, mg or LSB";
    Code::UnknownFormat.error("the unit of its accelerations is not known", remedy)
}
