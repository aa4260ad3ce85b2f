//! A recording with what corrects it as samples of one unit.

use wimu_model::STANDARD_GRAVITY_MPS2;

use super::{BEYOND_RANGE, FIELD_CALIBRATED, Imu, Reference, Sample, in_body_axes};
use crate::apply::Tracks;
use crate::calibration::{Correction, SensorCalibration};
use crate::multi_range::{FullScales, Merge};
use crate::recording::{Origin, Quantity, Recording, Track, TrackInfo, Unit};
use crate::series::Ns;
use crate::{Code, Problem, Result};

/// What a file does not say itself.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ImuOptions {
    /// What corrects its samples; without it, they are corrected.
    pub calibration: Option<SensorCalibration>,
    /// Sensitivity of counts, where neither the calibration nor the file gives it, LSB/g.
    pub sensitivity_lsb_per_g: Option<f64>,
}

impl ImuOptions {
    /// A calibration.
    pub(crate) fn of(calibration: &SensorCalibration) -> Self {
        Self { calibration: Some(calibration.clone()), sensitivity_lsb_per_g: None }
    }

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

impl Imu {
    /// The samples of a recording with times and one accelerometer; with angular rates, the magnetic field and truth if
    /// there are. A magnetic field whose `Field Calibrated` is 0 is left out, unless the calibration has a model of the
    /// magnetometer. A calibration is of the unit in which the accelerations are: of counts, or of m/s² and g. Two or three
    /// accelerometers whose full scales are known and differ are [merged](Merge) first; the calibration is that of the finest.
    ///
    /// # Errors
    /// `csv_missing_column` without times, or with other than one accelerometer; `unknown_format` for counts of unknown
    /// sensitivity and a calibration of the other unit; `no_rows` with fewer than two samples.
    pub fn of(recording: &Recording, options: &ImuOptions) -> Result<Self> {
        if let Some(merge) = Merge::of(recording, &FullScales::default())? {
            let mut imu = Self::of(&merge.recording, options)?;
            imu.findings.splice(0..0, merge.findings);
            return Ok(imu);
        }
        let name = recording.name.as_str();
        let force = accelerometer(recording).map_err(|error| error.at(name))?;
        let stored = options.calibration.as_ref();
        let correction = options.correction(&force.info).map_err(|error| error.at(name))?;
        let is_unknown = |track: &&Track| correction.rad_s_per_unit(&track.info).is_none();
        if let Some(track) = recording.of(Quantity::AngularRate).find(is_unknown) {
            return Err(Code::UnknownFormat
                .error(
                    format!("the unit of `{}` is not known: counts", track.info.name),
                    "give it as `Gyroscope X (rad/s)` or `Gyroscope X (deg/s)`",
                )
                .at(name));
        }
        let sensed = |quantity| recording.of(quantity).find(is_sensed);
        let tracks = Tracks {
            correction,
            force,
            rate: sensed(Quantity::AngularRate),
            field: sensed(Quantity::MagneticField),
            temperature: sensed(Quantity::Temperature),
        };
        let mut imu = Self {
            name: name.to_owned(),
            reference: Reference::of(recording),
            findings: recording.relevant(&[Code::RowsMasked, Code::Frozen]),
            covariance: stored.and_then(|stored| {
                let known = stored.accelerometer.covariance()?;
                Some(in_body_axes(&known, &stored.alignment))
            }),
            of_sessions: stored.is_some_and(|stored| stored.accelerometer.of_sessions()),
            full_scale_mps2: force.info.full_scale.map(|mps2| mps2 * BEYOND_RANGE),
            ..Self::default()
        };
        imu.findings.extend(stored.map(finding));
        let mut scalars = recording.of(Quantity::Scalar);
        let calibrated = scalars.find(|track| track.info.name == FIELD_CALIBRATED);
        let mut flags = calibrated.map(|track| track.beside::<1>(force));
        let [_, has_magnetometer] = correction.has();
        for row in tracks.rows() {
            let flag = flags.as_mut().and_then(|flags| flags.latest(row.row, row.time_ns));
            // As a magnetometer put it out that is not calibrated, it says nothing of directions.
            let field_ut = row.field_t.and_then(|tesla| match flag.map(|[flag]| flag != 0.0) {
                None | Some(false) if has_magnetometer => correction.field_ut(tesla),
                Some(false) => None,
                _ => Some(correction.to_body(tesla.map(|axis| axis * 1e6))),
            });
            imu.field_uncalibrated |= row.field_t.is_some() && field_ut.is_none();
            let sample = Sample {
                step_s: 0.0,
                force_mps2: row.force_mps2.into(),
                rate_rad_s: row.rate_rad_s.map(Into::into),
                field_ut: field_ut.map(Into::into),
            };
            imu.push(Ns(row.time_ns), sample);
        }
        if imu.samples.len() < 2 {
            return Err(Code::NoRows
                .error("there are fewer than two samples", "check the file")
                .at(name));
        }
        Ok(imu)
    }
}

/// Whether a sensor made a track.
fn is_sensed(track: &&Track) -> bool {
    track.info.origin == Origin::Sensor
}

/// The only accelerometer of a recording, with times.
fn accelerometer(recording: &Recording) -> Result<&Track> {
    let mut forces = recording.of(Quantity::SpecificForce).filter(is_sensed);
    match (forces.next(), forces.next()) {
        (Some(force), None) if !force.info.timeless => Ok(force),
        _ => Err(without_unit(recording)),
    }
}

fn without_unit(recording: &Recording) -> Problem {
    let of_gravity = |finding: &&Problem| finding.code == Code::GravityMissing;
    let mut names: Vec<&str> =
        recording.of(Quantity::SpecificForce).map(|track| track.info.name.as_str()).collect();
    let count = names.len();
    names.dedup();
    match (recording.findings.iter().find(of_gravity), names.as_slice()) {
        (Some(missing), []) => {
            Code::DataRefused.error(missing.text.clone(), missing.remedy.clone())
        }
        (_, [name]) if count > 1 => Code::Usage.error(
            format!("it has {count} accelerometers of the same name: {name}"),
            "give one file of the folder or archive",
        ),
        (_, [_, _, ..]) => Code::CsvMissingColumn.error(
            format!("it has {count} accelerometers: {}", names.join(", ")),
            "choose one with --topic, or leave out the columns of the others; for several on one body give --setup geometry=FILE, or --setup full_scales_g=[G,G] where their ranges differ",
        ),
        _ => Code::CsvMissingColumn.error(
            "navigation needs times and one accelerometer",
            "name the columns `Time (s)`, `Accelerometer X (m/s²)`, …, or give --rate HZ; for several accelerometers on one body give --setup geometry=FILE",
        ),
    }
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
