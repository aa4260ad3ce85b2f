//! A recording with what corrects it as samples of one unit.

use std::path::Path;

use wimu_model::STANDARD_GRAVITY_MPS2;

use super::{FIELD_CALIBRATED, MOVING, MotionRecording, Truth, UnitSample, in_body_axes};
use crate::calibration::{Correction, SensorCalibration};
use crate::formats::{self, ReadOptions};
use crate::multi_range::{FullScales, Merge};
use crate::recording::{Origin, Quantity, Recording, Track, TrackInfo, Unit};
use crate::{Code, Problem, Result};

/// What a file does not say itself.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct TableOptions {
    /// What corrects its samples; without it, they are corrected.
    pub calibration: Option<SensorCalibration>,
    /// Sensitivity of counts, where neither the calibration nor the file gives it, LSB/g.
    pub sensitivity_lsb_per_g: Option<f64>,
}

impl TableOptions {
    /// What corrects the output of an accelerometer. Its full scale does not count: merged accelerometers have that of the
    /// widest, and the calibration is that of the finest.
    fn correction(&self, force: &TrackInfo) -> Result<Correction> {
        let mut info = TrackInfo { full_scale: None, ..force.clone() };
        if let (Unit::Counts { .. }, Some(lsb_per_g)) = (info.unit, self.sensitivity_lsb_per_g) {
            info.unit = Unit::Counts { si_per_lsb: Some(STANDARD_GRAVITY_MPS2 / lsb_per_g) };
        }
        match &self.calibration {
            Some(calibration) => calibration.compile(&info),
            None => Correction::ideal(&info),
        }
    }
}

impl MotionRecording {
    /// Reads a file of corrected samples.
    ///
    /// # Errors
    /// Those of [`formats::load`] and [`of`](Self::of).
    pub fn from_csv(path: &Path) -> Result<Self> {
        Self::from_csv_with(path, &TableOptions::default())
    }

    /// Reads a file: [`of`](Self::of) its recording.
    ///
    /// # Errors
    /// Those of [`formats::load`] and [`of`](Self::of).
    pub fn from_csv_with(path: &Path, options: &TableOptions) -> Result<Self> {
        Self::of(&formats::load(path, &ReadOptions::default())?, options)
    }

    /// The samples of a recording with times and one accelerometer; with angular rates, the magnetic field and truth if
    /// there are. A magnetic field whose `Field Calibrated` is 0 is left out, unless the calibration has a model of the
    /// magnetometer. A calibration is of the unit in which the accelerations are: of counts, or of m/s² and g. Two or three
    /// accelerometers whose full scales are known and differ are [merged](Merge) first; the calibration is that of the finest.
    ///
    /// # Errors
    /// `csv_missing_column` without times, or with other than one accelerometer; `unknown_format` for counts of unknown
    /// sensitivity and a calibration of the other unit; `no_rows` with fewer than two samples.
    pub fn of(recording: &Recording, options: &TableOptions) -> Result<Self> {
        if let Some(merge) = Merge::of(recording, &FullScales::default())? {
            let mut motion = Self::of(&merge.recording, options)?;
            motion.findings.splice(0..0, merge.findings);
            return Ok(motion);
        }
        let name = recording.name.as_str();
        let sensor = |track: &&Track| track.info.origin == Origin::Sensor;
        let mut forces = recording.of(Quantity::SpecificForce).filter(sensor);
        let (Some(force), None) = (forces.next(), forces.next()) else {
            return Err(without_unit(recording));
        };
        if force.info.timeless {
            return Err(without_unit(recording));
        }
        let stored = options.calibration.as_ref();
        let correction = options.correction(&force.info).map_err(|error| error.at(name))?;
        let beside = |quantity| recording.of(quantity).find(sensor);
        let mut rates = recording.of(Quantity::AngularRate);
        let is_unknown = |track: &&Track| correction.rad_s_per_unit(&track.info).is_none();
        if let Some(track) = rates.find(is_unknown) {
            return Err(Code::UnknownFormat
                .error(
                    format!("the unit of `{}` is not known: counts", track.info.name),
                    "give it as `Gyroscope X (rad/s)` or `Gyroscope X (deg/s)`",
                )
                .at(name));
        }
        let [rate, field, temperature] =
            [Quantity::AngularRate, Quantity::MagneticField, Quantity::Temperature].map(beside);
        let truth = |quantity| {
            let mut tracks = recording.of(quantity);
            tracks.find(|track| track.info.origin == Origin::Truth)
        };
        let (position, attitude) = (truth(Quantity::Position), truth(Quantity::Attitude));
        let scalar = |name| recording.of(Quantity::Scalar).find(|track| track.info.name == name);
        let (calibrated, moving) = (scalar(FIELD_CALIBRATED), scalar(MOVING));
        let mut motion = Self {
            name: name.to_owned(),
            findings: recording.relevant(&[Code::RowsMasked, Code::Frozen]),
            covariance: stored.and_then(|stored| {
                let known = stored.accelerometer.covariance()?;
                Some(in_body_axes(&known, &stored.alignment))
            }),
            of_sessions: stored.is_some_and(|stored| stored.accelerometer.of_sessions()),
            full_scale_mps2: force.info.full_scale,
            moving: moving.map(|_| Vec::new()),
            ..Self::default()
        };
        motion.findings.extend(stored.map(finding));
        let mut rates = rate.map(|track| track.beside(force));
        let mut fields = field.map(|track| track.beside(force));
        let mut temperatures = temperature.map(|track| track.beside(force));
        let mut flags = calibrated.map(|track| track.beside(force));
        let mut positions = position.map(|track| track.beside(force));
        let mut attitudes = attitude.map(|track| track.beside(force));
        let mut moves = moving.map(|track| track.beside(force));
        let (mut last_s, mut temperature_c) = (None, None);
        let rad_s = rate.and_then(|track| correction.rad_s_per_unit(&track.info)).unwrap_or(1.0);
        let [_, has_magnetometer] = correction.has();
        for (row, time_ns) in force.times_ns().iter().copied().enumerate() {
            let time_s = time_ns as f64 * 1e-9;
            // A masked row of numbers is out of order, and has no place in the sequence.
            let is_finite = force.row(row).is_some_and(|v| v.iter().all(|c| c.is_finite()));
            if is_finite && !force.mask()[row] {
                continue;
            }
            let output = vector(force.row(row)).unwrap_or([f64::NAN; 3]);
            let celsius = temperatures.as_mut().and_then(|t| t.latest(row, time_ns));
            temperature_c = celsius.map(|row| row[0]).or(temperature_c);
            let rate_rad_s = rates.as_mut().and_then(|t| t.at(row, time_ns));
            let rate_rad_s = rate_rad_s.zip(rate).map(|(value, track): ([f64; 3], _)| {
                if track.info.corrected {
                    return value;
                }
                correction.rate(value.map(|axis| axis * rad_s), output, temperature_c)
            });
            let tesla = vector(fields.as_mut().and_then(|t| t.latest(row, time_ns)));
            let flag = flags.as_mut().and_then(|t| t.latest(row, time_ns)).map(|row| row[0] != 0.0);
            // As a magnetometer put it out that is not calibrated, it says nothing of directions.
            let field_ut = tesla.and_then(|tesla| match flag {
                None | Some(false) if has_magnetometer => correction.field_ut(tesla),
                Some(false) => None,
                _ => Some(correction.to_body(tesla.map(|axis| axis * 1e6))),
            });
            motion.field_uncalibrated |= tesla.is_some() && field_ut.is_none();
            motion.samples.push(UnitSample {
                step_s: time_s - last_s.unwrap_or(time_s),
                force_mps2: correction.sample(output, temperature_c),
                field_ut,
                rate_rad_s,
            });
            motion.times_s.push(time_s);
            let quaternion = attitudes.as_mut().and_then(|t| t.at(row, time_ns));
            let position_m = positions.as_mut().and_then(|t| t.at(row, time_ns));
            motion.truth.push(position_m.map(|position_m| Truth {
                position_m,
                quaternion: quaternion.unwrap_or([f64::NAN; 4]),
            }));
            if let (Some(column), Some(moves)) = (&mut motion.moving, &mut moves) {
                let value: Option<[f64; 1]> = moves.at(row, time_ns);
                column.push(value.map_or(f64::NAN, |[value]| value));
            }
            last_s = Some(time_s);
        }
        if motion.samples.len() < 2 {
            return Err(Code::NoRows
                .error("there are fewer than two samples", "check the file")
                .at(name));
        }
        Ok(motion)
    }
}

fn without_unit(recording: &Recording) -> Problem {
    let of_gravity = |finding: &&Problem| finding.code == Code::GravityMissing;
    let names: Vec<&str> =
        recording.of(Quantity::SpecificForce).map(|track| track.info.name.as_str()).collect();
    let error = match (recording.findings.iter().find(of_gravity), names.len()) {
        (Some(missing), 0) => {
            Code::DataRefused.error(missing.text.clone(), missing.remedy.clone())
        }
        (_, count @ 2..) => Code::CsvMissingColumn.error(
            format!("it has {count} accelerometers: {}", names.join(", ")),
            "choose one with --topic; for several on one body give --setup geometry=FILE, or --setup full_scales_g=[G,G] where their ranges differ",
        ),
        _ => Code::CsvMissingColumn.error(
            "navigation needs times and one accelerometer",
            "name the columns `Time (s)`, `Accelerometer X (m/s²)`, …, or give --rate HZ; for several accelerometers on one body give --setup geometry=FILE",
        ),
    };
    error.at(&recording.name)
}

fn vector(row: Option<&[f64]>) -> Option<[f64; 3]> {
    row?.try_into().ok()
}

/// The finding on a calibration that is applied.
fn finding(stored: &SensorCalibration) -> Problem {
    let [x, y, z] = stored.accelerometer.model.terms().bias_mps2;
    let sd_mps2 = stored.accelerometer.bias_sd_mps2();
    let known = if sd_mps2 > 0.0 {
        format!(", which with scale and axes it knows to ± {:.4} m/s²", sd_mps2)
    } else {
        String::new()
    };
    let field = match stored.magnetometer {
        Some(_) => ", and the magnetic field too",
        None => "",
    };
    Code::Navigation.note(format!(
        "the calibration is applied{field}: a bias of {x:+.4} {y:+.4} {z:+.4} m/s² is subtracted{known}"
    ))
}
