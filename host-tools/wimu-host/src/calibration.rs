//! Calibration: from recorded data to an error model, its report, and the file for a board.

mod advice;
mod change;
mod covariance;
mod datasheet;
mod difference;
mod export;
mod file;
mod gravity;
mod gyroscope;
mod identity;
mod input;
mod magnetometer;
mod numbers;
mod page;
mod pages;
mod paired;
mod range;
mod reference;
mod report;
mod saturation;
mod sensitivity;
mod several;
pub mod source;
mod text;
mod update;
mod weights;
mod words;

pub use datasheet::{DatasheetReport, LimitReport, datasheet};
pub use difference::{Change, Difference, parameter_figures, values_text};
pub use export::{CalibrationExport, ExportTarget, KalibrNoise, KalibrTerms};
pub(crate) use file::worst_sd;
pub use file::{
    CalibrationFile, Session, StoredModel, check_device, force_sd_mps2, further_sensors,
    read_model, read_parameters, sessions, zero_count,
};
pub use gyroscope::GyroscopeReport;
pub use identity::parameter_id;
pub use magnetometer::{FieldPose, MagneticHalfWidths, MagnetometerReport, calibrate_magnetometer};
pub use paired::Paired;
pub use reference::{AxisReport, NoiseSource, ReferenceReport, compare_with_reference};
pub use report::{
    CalibrationReport, DriftReport, Fit, NextPose, OtherUnits, Source, StaticPose, describe,
    not_observed,
};
pub use several::{
    DepartureReport, Repeatability, SessionReport, SeveralFit, SeveralReport, calibrate_several,
};
pub use source::compiled_for;
pub use update::{RestReport, UpdateReport, update};

use wimu_calib::{
    Datasheet, Estimate, Face, Gravity, Guide, Method, Model, MultiPosition, Placement, Pose,
    Refusal, Term, Terms, best_model, four_angle, multi_position_with, six_position,
    six_position_labelled, three_angle,
};
use wimu_model::{ParameterSet, STANDARD_GRAVITY_MPS2, Sensitivity};

use crate::csv::AccelerationUnit;
use crate::plural::counted;
use crate::problem::Outcome;
use crate::recording::{OutputUnit, Samples};
use crate::{Code, Result};
use advice::{advice, next_poses};
use input::{magnitude, median_magnitude, poses, rms, wrong_unit};
use numbers::{numbers, static_poses};
use range::Range;
use words::{findings, left_out, reason, start_times};

/// Range of sensitivities that a sensor can have, LSB/*g*: from 8 bits at ±100 *g* to 27 bits at ±1 *g*. The range
/// that a board accepts is narrower: [`Sensitivity::from_lsb_per_g`].
const SENSOR_LSB_PER_G: std::ops::RangeInclusive<f64> = 1.0..=67_108_864.0;

/// How to estimate.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub enum MethodChoice {
    /// From the magnitude of gravity, any orientations.
    #[default]
    MultiPosition,
    /// From six known orientations.
    SixPosition,
    /// From full rotations of four steps about level axes.
    FourAngle,
    /// From full rotations of three steps about level axes.
    ThreeAngle,
}

impl MethodChoice {
    /// All methods.
    pub const ALL: [Self; 4] =
        [Self::MultiPosition, Self::SixPosition, Self::FourAngle, Self::ThreeAngle];

    /// Its name on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::MultiPosition => "multi-position",
            Self::SixPosition => "six-position",
            Self::FourAngle => "four-angle",
            Self::ThreeAngle => "three-angle",
        }
    }
}

/// Which parameters to fit with [`MethodChoice::MultiPosition`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ModelChoice {
    /// This model.
    Fixed(Model),
    /// The model with the least leave-one-out error.
    Auto,
}

impl Default for ModelChoice {
    fn default() -> Self {
        Self::Fixed(Model::Full9)
    }
}

/// The model and terms that a text such as `6`, `auto` or `9+drift` names; those of the method where it names none.
///
/// # Errors
/// `usage` for an unknown name, or one that does not go with the method.
pub fn parse_model(text: &str, method: MethodChoice) -> Result<(ModelChoice, Terms)> {
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
    let model = match (base, method) {
        ("", _)
        | ("12", MethodChoice::SixPosition)
        | ("6", MethodChoice::FourAngle | MethodChoice::ThreeAngle) => ModelChoice::default(),
        ("9", MethodChoice::MultiPosition) => ModelChoice::Fixed(Model::Full9),
        ("6", MethodChoice::MultiPosition) => ModelChoice::Fixed(Model::BiasScale6),
        ("3", MethodChoice::MultiPosition) => ModelChoice::Fixed(Model::Bias3),
        ("auto", MethodChoice::MultiPosition) => ModelChoice::Auto,
        _ => {
            return Err(Code::Usage.error(
                format!("--model {text} does not go with --method {}", method.name()),
                "multi-position has 3, 6, 9 or auto, six-position 12, four-angle and three-angle 6",
            ));
        }
    };
    if terms != Terms::NONE && method != MethodChoice::MultiPosition {
        return Err(Code::Usage.error(
            format!("--model {text}: only multi-position has terms"),
            "leave the term out, or use --method multi-position",
        ));
    }
    Ok((model, terms))
}

/// Options of a calibration.
#[derive(Clone, Debug, Default)]
pub struct CalibrateOptions {
    /// Method.
    pub method: MethodChoice,
    /// Model to fit.
    pub model: ModelChoice,
    /// Terms to fit in addition to the model, with [`MethodChoice::MultiPosition`].
    pub terms: Terms,
    /// Which side was up in each pose, in order, with [`MethodChoice::SixPosition`]; `None` detects the sides from the
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
    /// Time of the calibration, s since 1970 UTC, stored in the parameter set.
    pub utc_s: Option<u64>,
}

/// Local gravity by the options.
///
/// # Errors
/// `usage` when it is out of bounds, or given twice.
pub fn local_gravity(options: &CalibrateOptions) -> Result<Gravity> {
    gravity::gravity(options).map(|(gravity, _)| gravity)
}

/// Estimates the error model from a dataset.
///
/// Data that do not support an answer give a report with status `refused`, not an error.
///
/// # Errors
/// `usage` when an option is out of bounds.
pub fn calibrate(data: &Samples<'_>, options: &CalibrateOptions) -> Result<CalibrationReport> {
    let usage = |message: String, flag: &str| Code::Usage.error(message, format!("check {flag}"));
    let (gravity, gravity_source) = gravity::gravity(options)?;
    let placement = match options.placement_sd_deg {
        Some(degrees) => Placement::new(degrees.to_radians())
            .map_err(|e| usage(e.to_string(), "--placement-sd"))?,
        None => Placement::BY_HAND,
    };
    if let Some(lsb_per_g) = options.sensitivity_lsb_per_g
        && !SENSOR_LSB_PER_G.contains(&lsb_per_g)
    {
        let message = format!("{lsb_per_g} LSB/g is outside the range of sensors (1 to 67108864)");
        return Err(usage(message, "--sensitivity"));
    }
    // A sensor outside the range of boards can still be calibrated.
    let given = options
        .sensitivity_lsb_per_g
        .and_then(|lsb_per_g| Sensitivity::from_lsb_per_g(lsb_per_g).ok());
    let given_beyond_board = (options.sensitivity_lsb_per_g).filter(|_| given.is_none());

    let (known, source) = match (given, data.unit) {
        (None, _) if given_beyond_board.is_some() => (None, Some(Source::Given)),
        (Some(given), _) => (Some(given), Some(Source::Given)),
        (None, OutputUnit::Counts { nominal, .. }) => match nominal {
            Some(nominal) => (Some(nominal), Some(Source::Board)),
            None => (None, Some(Source::Fit)),
        },
        (None, OutputUnit::Mps2) => (None, None),
    };
    // Counts of unknown sensitivity: the median magnitude, mostly at rest, is taken as g at first.
    let scale = match (data.unit, known) {
        (OutputUnit::Mps2, _) => 1.0,
        (OutputUnit::Counts { .. }, Some(known)) => known.mps2_per_lsb(),
        (OutputUnit::Counts { .. }, None) => match given_beyond_board {
            Some(lsb_per_g) => STANDARD_GRAVITY_MPS2 / lsb_per_g,
            None => gravity.mps2() / median_magnitude(data),
        },
    };
    let mut found = poses(data, scale, gravity.mps2());
    let returned = "the rotation had returned to its first step";
    let repeated = match options.method {
        MethodChoice::MultiPosition => {
            left_out(found.remove_repeated(), "exactly equal to an earlier pose")
        }
        MethodChoice::SixPosition => None,
        MethodChoice::FourAngle => left_out(found.remove_closing(4), returned),
        MethodChoice::ThreeAngle => left_out(found.remove_closing(3), returned),
    };
    if let Some(sides) = &options.sides
        && sides.len() != found.poses.len()
    {
        return Err(usage(
            format!(
                "--sides names {}, the data have {}{}",
                counted(sides.len(), "pose"),
                found.poses.len(),
                start_times(data, &found.poses)
            ),
            "--sides: one for each static pose, in order",
        ));
    }
    let fit = |poses: &[Pose]| match (options.method, options.model) {
        (MethodChoice::SixPosition, _) => match &options.sides {
            Some(sides) => {
                let labelled: Vec<(Face, Pose)> =
                    sides.iter().copied().zip(poses.iter().copied()).collect();
                six_position_labelled(&labelled, gravity, placement)
            }
            None => six_position(poses, gravity, placement),
        },
        (MethodChoice::FourAngle, _) => four_angle(poses, gravity, placement),
        (MethodChoice::ThreeAngle, _) => three_angle(poses, gravity, placement),
        (MethodChoice::MultiPosition, ModelChoice::Fixed(model)) => {
            let what = MultiPosition { model, terms: options.terms, reject: true };
            multi_position_with(poses, gravity, what)
        }
        (MethodChoice::MultiPosition, ModelChoice::Auto) => {
            best_model(poses, gravity, options.terms, true)
        }
    };
    let mut fitted = found.poses.clone();
    let saturated = found.saturated.map(Refusal::saturated);
    let implausible = wrong_unit(data, &found, gravity).or(saturated);
    let mut outcome = match implausible.or_else(|| sensitivity::refusal(&found, gravity, scale)) {
        Some(refusal) => Err(refusal),
        None => fit(&fitted),
    };
    let mut sensitivity = known;
    // The sensitivity of the fit, whether or not a board accepts it.
    let mut fitted_lsb_per_g = given_beyond_board;
    if source == Some(Source::Fit)
        && let Ok(estimate) = &outcome
    {
        // Scaling the counts scales A: with the mean scale factor taken out, it becomes 1.
        let matrix = estimate.model.terms().matrix;
        let mean = (matrix[0][0] + matrix[1][1] + matrix[2][2]) / 3.0;
        let lsb_per_g = STANDARD_GRAVITY_MPS2 / scale * mean;
        sensitivity = Sensitivity::from_lsb_per_g(lsb_per_g).ok();
        fitted_lsb_per_g = Some(lsb_per_g);
        fitted = found.scaled(STANDARD_GRAVITY_MPS2 / lsb_per_g);
        outcome = fit(&fitted);
    }
    let mut noise_seen_mps2 = None;
    if data.poses && options.method == MethodChoice::MultiPosition {
        let bare = fitted.clone();
        let what = MultiPosition { model: wanted(options), terms: options.terms, reject: false };
        // First from all poses: without weights, the noisier ones would be rejected. Then again, because the noise is
        // estimated from residuals of a fit that depends on it.
        let mut of_all = multi_position_with(&bare, gravity, what).ok();
        for _ in 0..2 {
            let of_all = of_all.take();
            let with_noise = |estimate| weights::with_noise(estimate, &bare);
            let poses = (of_all.as_ref().and_then(with_noise))
                .or_else(|| outcome.as_ref().ok().and_then(with_noise));
            let Some(poses) = poses else { break };
            let Ok(better) = fit(&poses) else { break };
            noise_seen_mps2 = poses.first().map(|pose| pose.sd_mps2[0]);
            (outcome, fitted) = (Ok(better), poses);
        }
    }
    let lsb_per_g = sensitivity.map(Sensitivity::lsb_per_g).or(fitted_lsb_per_g);
    let range = Range::of(data.unit, options.range_g, sensitivity);

    let (estimate, refusal) = match outcome {
        Ok(estimate) => (Some(estimate), None),
        Err(refusal) => (None, Some(refusal)),
    };
    let mut gyroscope_findings = Vec::new();
    let gyroscope = estimate.as_ref().filter(|_| options.method == MethodChoice::MultiPosition);
    let gyroscope = gyroscope.and_then(|estimate| {
        let scale = lsb_per_g.filter(|_| data.unit != OutputUnit::Mps2);
        let scale = scale.map_or(1.0, |lsb_per_g| STANDARD_GRAVITY_MPS2 / lsb_per_g);
        gyroscope::calibrate(data, scale, &fitted, estimate, &mut gyroscope_findings)
    });
    let gyroscope_parameters = gyroscope.as_ref().and_then(|found| found.parameters);
    let parameters =
        estimate.as_ref().zip(sensitivity.zip(range)).map(|(estimate, (sensitivity, range))| {
            ParameterSet {
                model: estimate.model,
                quality: estimate.quality(options.utc_s, &fitted),
                sensor: data.sensor,
                gyroscope: gyroscope_parameters,
                ..ParameterSet::uncalibrated(range.g, sensitivity)
            }
        });
    let board = sensitivity.zip(range);
    let mut outcome = Outcome::default();
    let refit = |poses: &[Pose]| fit(poses).ok();
    let time_s = |pose: &Pose| data.since_start_s(pose.first_sample as usize);
    let changed = (estimate.as_ref()).and_then(|e| change::finding(&fitted, e, refit, time_s));
    let found = findings(data, options, &fitted, estimate.as_ref(), changed, board, lsb_per_g);
    outcome.findings.extend(found.into_iter().chain(repeated));
    outcome.findings.extend(gyroscope_findings);
    outcome.findings.extend(noise_seen_mps2.map(|sd| {
        Code::Residuals.note(format!(
            "poses of fewer samples have larger residuals: a noise of {:.0} mm/s² per sample was estimated, and the poses \
             are weighted by it",
            sd * 1e3
        ))
    }));
    let datasheet = options.datasheet.or(data.datasheet()).zip(estimate.as_ref()).map(
        |(datasheet, estimate)| {
            let (used, range) = match data.unit {
                OutputUnit::Counts { .. } => (lsb_per_g, range.map(|range| range.g)),
                OutputUnit::Mps2 => (None, None),
            };
            DatasheetReport::new(datasheet, estimate, used, range)
        },
    );
    (outcome.findings).extend(datasheet.iter().flat_map(DatasheetReport::findings));
    let of_gravity = (estimate.as_ref()).and_then(|e| gravity::finding_of(e, gravity_source));
    outcome.findings.extend(of_gravity);
    let rejected = estimate.as_ref().map_or(0, |e| e.rejected.len());
    let rejected_poses: Vec<usize> = match options.method {
        MethodChoice::SixPosition => {
            (0..fitted.len()).filter(|index| Face::of(&fitted[*index]).is_none()).collect()
        }
        _ => (estimate.iter()).flat_map(|e| e.rejected.clone()).collect(),
    };
    if estimate.is_some() && !rejected_poses.is_empty() {
        let count = counted(rejected.max(rejected_poses.len()), "pose");
        let text = format!(
            "{count} left out because the others contradict them: {rejected_poses:?} (from 0)"
        );
        (outcome.findings).push(Code::PosesLeftOut.warning(text));
    }
    if let Some(refusal) = &refusal {
        let counts = matches!(data.unit, OutputUnit::Counts { .. });
        let used = lsb_per_g.filter(|_| counts);
        outcome.refuse(reason(refusal, &fitted, data, options, used));
    }
    let unit = match data.unit {
        OutputUnit::Counts { .. } => AccelerationUnit::Lsb,
        OutputUnit::Mps2 => AccelerationUnit::Mps2,
    };
    Ok(CalibrationReport {
        outcome,
        source: data.name.to_owned(),
        method: options.method.name(),
        terms: terms(estimate.as_ref(), options),
        poses: fitted.len(),
        rate_hz: (!data.poses).then_some(data.rate_hz),
        rate_source: (!data.poses).then_some(data.rate_source),
        gravity_m_s2: gravity.mps2(),
        gravity_sd_m_s2: gravity.sd_mps2(),
        gravity_source,
        unit: unit.as_str(),
        sensitivity_lsb_per_g: lsb_per_g,
        sensitivity_source: source.filter(|_| lsb_per_g.is_some()),
        range_g: range.map(|range| range.g),
        range_source: range.map(|range| range.source),
        uncalibrated_rms_mm_s2: rms(fitted
            .iter()
            .map(|pose| magnitude(pose.mean_mps2) - gravity.mps2()))
        .map(|rms| rms * 1e3),
        rejected,
        rejected_poses,
        next_poses: match &refusal {
            Some(refusal) => next_poses(refusal, &fitted, options),
            None => advice(&fitted, options, 0),
        },
        poses_worth_adding: match options.method {
            MethodChoice::MultiPosition => Guide::after(wanted(options), &fitted).worth(|_| true),
            _ => 0,
        },
        static_poses: static_poses(&fitted, estimate.as_ref()),
        datasheet,
        gyroscope,
        file: estimate.as_ref().and_then(|estimate| {
            let quality = estimate.quality(options.utc_s, &fitted);
            CalibrationFile::of_model(
                estimate.model,
                quality,
                data.sensor,
                unit,
                lsb_per_g,
                range,
                data.name,
            )
            .map(|file| file.with_zero_count(data.info().zero_count))
            .map(|file| file.of_device(data.info().device_id))
            .map(|file| file.with_gyroscope(gyroscope_parameters))
        }),
        fit: estimate.as_ref().map(|e| numbers(e, range)),
        estimate,
        parameter_id: parameters.as_ref().map(|set| parameter_id(set).to_string()),
        parameters,
    })
}

/// The terms that were fitted, or were requested.
fn terms(estimate: Option<&Estimate>, options: &CalibrateOptions) -> Vec<&'static str> {
    let model = match (estimate.map(|e| e.method), options.method) {
        (Some(Method::MultiPosition(model)), _) => model,
        (_, MethodChoice::SixPosition) => return vec!["bias", "scale", "misalignment_6"],
        (_, MethodChoice::FourAngle | MethodChoice::ThreeAngle) => Model::BiasScale6,
        (_, MethodChoice::MultiPosition) => wanted(options),
    };
    let basic: &[_] = match model {
        Model::Bias3 => &["bias"],
        Model::BiasScale6 => &["bias", "scale"],
        Model::Full9 => &["bias", "scale", "misalignment_3"],
    };
    let terms = estimate.map_or(options.terms, |estimate| estimate.terms);
    let more = terms.iter().map(|term| match term {
        Term::Drift => "drift",
        Term::BiasTemperature => "bias_temperature",
        Term::ScaleTemperature => "scale_temperature",
        Term::Quadratic => "quadratic",
    });
    basic.iter().copied().chain(more).collect()
}

fn wanted(options: &CalibrateOptions) -> Model {
    match options.model {
        ModelChoice::Fixed(model) => model,
        ModelChoice::Auto => Model::Full9,
    }
}
