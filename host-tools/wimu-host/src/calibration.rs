//! Calibration: from recorded data to an error model, its report, and the file for a board.

mod checks;
mod correction;
mod covariance;
mod datasheet;
mod describe;
mod export;
mod file;
mod gyroscope;
mod identity;
mod magnetometer;
mod nested;
mod paired;
mod poses;
mod reference;
mod report;
mod several;
mod solution;
pub mod source;
mod update;

pub use correction::Correction;
use datasheet::DatasheetReport;
pub use datasheet::{Datasheet, datasheet};
pub use describe::{Difference, describe, parameter_figures, values_text};
pub use export::{CalibrationExport, ExportTarget, KalibrNoise};
pub(crate) use file::worst_sd;
pub use file::{
    AccelerometerCalibration, Calibration, Quality, SensorCalibration, Session, force_sd_mps2,
    read_parameters,
};
pub use identity::parameter_id;
pub use magnetometer::calibrate_magnetometer;
pub use paired::Paired;
pub(crate) use poses::Fitting;
pub use poses::calibrate;
pub use reference::compare_with_reference;
pub use report::{CalibrationReport, Criterion, Grade, Source};
pub use several::calibrate_several;
pub use source::compiled_for;
pub use update::update;

use wimu_calib::{Face, Gravity, MultiPosition, Placement, Pose, Term, Terms};
use wimu_model::CalibrationMethod;

use crate::plural::counted;
use crate::recording::Samples;
use crate::stats::{median, norm as magnitude};
use crate::{Code, Result};

/// Range of sensitivities that a sensor can have, LSB/*g*: from 8 bits at ±100 *g* to 27 bits at ±1 *g*. The range
/// that a board accepts is narrower: [`Sensitivity::from_lsb_per_g`].
const SENSOR_LSB_PER_G: std::ops::RangeInclusive<f64> = 1.0..=67_108_864.0;

/// The methods with static poses.
pub const METHODS: [CalibrationMethod; 4] = [
    CalibrationMethod::MultiPosition,
    CalibrationMethod::SixPosition,
    CalibrationMethod::FourAngle,
    CalibrationMethod::ThreeAngle,
];

/// Steps of a rotation, where a method has rotations.
pub(crate) fn steps(method: CalibrationMethod) -> Option<usize> {
    match method {
        CalibrationMethod::FourAngle => Some(4),
        CalibrationMethod::ThreeAngle => Some(3),
        _ => None,
    }
}

/// The model and terms that a text such as `6`, `auto` or `9+drift` names; those of the method where it names none.
///
/// # Errors
/// `usage` for an unknown name, or one that does not go with the method.
pub fn parse_model(text: &str, method: CalibrationMethod) -> Result<MultiPosition> {
    let (base, names) =
        text.split_once('+').map_or((text, None), |(base, names)| (base, Some(names)));
    let mut terms = Terms::NONE;
    for name in names.into_iter().flat_map(|names| names.split('+')) {
        terms = match name {
            "drift" => terms.with(Term::Drift),
            "temperature" => terms.with(Term::BiasTemperature).with(Term::ScaleTemperature),
            "quadratic" => terms.with(Term::Quadratic),
            other => {
                return Err(Code::Usage.error(
                    format!("--model {text}: unknown term {other:?}"),
                    "the terms are drift, temperature and quadratic, as in 9+drift",
                ));
            }
        };
    }
    let priors = match (base, method) {
        ("", _)
        | ("12", CalibrationMethod::SixPosition)
        | ("6", CalibrationMethod::FourAngle | CalibrationMethod::ThreeAngle)
        | ("9", CalibrationMethod::MultiPosition) => false,
        ("auto", CalibrationMethod::MultiPosition) => true,
        _ => {
            return Err(Code::Usage.error(
                format!("--model {text} does not go with --method {method}"),
                "multi-position has 9 or auto, six-position 12, four-angle and three-angle 6",
            ));
        }
    };
    if terms != Terms::NONE && method != CalibrationMethod::MultiPosition {
        return Err(Code::Usage.error(
            format!("--model {text}: only multi-position has terms"),
            "leave the term out, or use --method multi-position",
        ));
    }
    Ok(MultiPosition { terms, priors, ..MultiPosition::default() })
}

/// Options of a calibration.
#[derive(Clone, Debug, Default)]
pub struct CalibrateOptions {
    /// One of [`METHODS`].
    pub method: CalibrationMethod,
    /// What is fitted with [`CalibrationMethod::MultiPosition`]; outliers are rejected in any case.
    pub model: MultiPosition,
    /// Which side was up in each pose, in order, with [`CalibrationMethod::SixPosition`]; `None` detects the sides from the
    /// readings.
    pub sides: Option<Vec<Face>>,
    /// Local gravity, m/s², taken as exact; `None`: 9.80665 ± 0.015.
    pub gravity_mps2: Option<f64>,
    /// Geodetic latitude, degrees, and height, m, instead of gravity: see [`wimu_calib::Gravity::at`].
    pub place: Option<[f64; 2]>,
    /// Nominal sensitivity, LSB/g; `None`: the board's, else the mean of the fit.
    pub sensitivity_lsb_per_g: Option<f64>,
    /// Full-scale range at which the data were taken, ± *g*, where the data do not contain it.
    pub range_g: Option<u8>,
    /// Placement error of known orientations, degrees, 1 σ; `None`: 1.
    pub placement_sd_deg: Option<f64>,
    /// Datasheet to compare with; `None`: that of the device's sensor, where it is known.
    pub datasheet: Option<&'static Datasheet>,
    /// Largest error at 1 *g* in the worst orientation that the calibration is to have, m/s².
    pub target_mps2: Option<f64>,
    /// Time of the calibration, s since 1970 UTC, stored in the parameter set.
    pub utc_s: Option<u64>,
}

impl CalibrateOptions {
    /// Local gravity, and where it comes from.
    ///
    /// # Errors
    /// `usage` when it is out of bounds, or given twice.
    pub fn gravity(&self) -> Result<(Gravity, Source)> {
        let (gravity, source, flag) = match (self.gravity_mps2, self.place) {
            (Some(_), Some(_)) => {
                return Err(Code::Usage.error(
                    "gravity is given twice, by its value and by a latitude",
                    "give --gravity or --latitude",
                ));
            }
            (Some(mps2), None) => (Gravity::new(mps2, 0.0), Source::Given, "--gravity"),
            (None, Some([latitude, height])) => {
                (Gravity::at(latitude, height), Source::Latitude, "--latitude")
            }
            (None, None) => return Ok((Gravity::UNKNOWN_PLACE, Source::Default)),
        };
        let Some(gravity) = gravity else {
            let text = "local gravity on Earth is 9.764 to 9.834 m/s², at latitudes of -90 to 90° and heights of -500 to 9000 m";
            return Err(Code::Usage.error(text, format!("check {flag}")));
        };
        Ok((gravity, source))
    }

    fn placement(&self) -> Result<Placement> {
        let Some(degrees) = self.placement_sd_deg else { return Ok(Placement::BY_HAND) };
        let outside = || {
            let text = format!("a placement error of {degrees}° is outside 0 to 5°");
            Code::Usage.error(text, "check --placement-sd, or use multi-position")
        };
        Placement::new(degrees.to_radians()).ok_or_else(outside)
    }

    /// Whether there is a side for each pose.
    fn check_sides(&self, data: &Samples<'_>, poses: &[Pose]) -> Result<()> {
        let Some(sides) = self.sides.as_ref().filter(|sides| sides.len() != poses.len()) else {
            return Ok(());
        };
        let named = counted(sides.len(), "pose");
        let (has, starts) = (poses.len(), checks::start_times(data, poses));
        Err(Code::Usage.error(
            format!("--sides names {named}, the data have {has}{starts}"),
            "check --sides: one for each static pose, in order",
        ))
    }

    pub(crate) fn multi_position(&self) -> MultiPosition {
        MultiPosition { reject: true, ..self.model }
    }
}
