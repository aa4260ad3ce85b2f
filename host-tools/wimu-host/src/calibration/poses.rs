//! Calibration with static poses, by the magnitude or the direction of gravity: from the samples to the report.

use std::collections::HashSet;

use wimu_calib::{
    Estimate, Face, Gravity, Guide, Orientation, Placement, Pose, Reason, Refusal, Term,
    four_angle, multi_position, six_position, six_position_labelled, three_angle,
};
use wimu_model::{GyroscopeParameters, ParameterSet, STANDARD_GRAVITY_MPS2, Sensitivity};

use super::file::Quality;
use super::report::{Fit, Grade, MAX_POSES, StaticPose};
use super::{
    AccelerometerCalibration, CalibrateOptions, Calibration, CalibrationReport, DatasheetReport,
    MethodChoice, NextPose, SENSOR_LSB_PER_G, SensorCalibration, Session, Source, checks,
    gyroscope, magnitude, median, nested, parameter_id,
};
use crate::csv::AccelerationUnit;
use crate::plural::counted;
use crate::problem::Outcome;
use crate::recording::{Output, OutputUnit, Samples};
use crate::{Code, Problem, Result};

/// Largest number of orientations recommended at once.
const MAX_ADVISED: usize = 6;
/// Up to this many poses, three more than parameters, are planned together: chosen one by one they would not be the best set.
const PLANNED: usize = 12;

/// Estimates the error model from a dataset.
///
/// Data that do not support an answer give a report with status `refused`, not an error.
///
/// # Errors
/// `usage` when an option is out of bounds.
pub fn calibrate(data: &Samples<'_>, options: &CalibrateOptions) -> Result<CalibrationReport> {
    let fitting = Fitting::new(options)?;
    let gravity = fitting.gravity;
    let mut scale = Scale::of(data, options, gravity)?;
    let mut found = Poses::find(data, scale.mps2);
    let repeated = found.without_repetitions(options.method);
    options.check_sides(data, &found.poses)?;
    let mut outcome = match checks::refusal(data, &found, gravity) {
        Some(refusal) => Err(refusal),
        None => fitting.of(&found.poses),
    };
    if let (Some(Source::Fit), Ok(estimate)) = (scale.source, &outcome) {
        scale = scale.of_fit(estimate);
        found.rescale(scale.mps2);
        outcome = fitting.of(&found.poses);
    }
    let session = Fitted {
        data,
        options,
        gravity,
        scale,
        poses: found.poses,
        outcome,
        problems: Vec::from_iter(repeated),
    };
    session.report(&fitting)
}

/// What converts the data to m/s².
#[derive(Clone, Copy)]
struct Scale {
    /// LSB/*g*; `None` for data in m/s² without a given one, and before the fit.
    lsb_per_g: Option<f64>,
    source: Option<Source>,
    /// m/s² of one unit.
    mps2: f64,
}

impl Scale {
    /// As given, else as the board says. Counts of unknown sensitivity: the median magnitude, mostly at rest, is taken as
    /// gravity at first.
    fn of(data: &Samples<'_>, options: &CalibrateOptions, gravity: Gravity) -> Result<Self> {
        let given = options.sensitivity_lsb_per_g;
        if let Some(given) = given.filter(|given| !SENSOR_LSB_PER_G.contains(given)) {
            let text = format!("{given} LSB/g is outside the range of sensors (1 to 67108864)");
            return Err(Code::Usage.error(text, "check --sensitivity"));
        }
        let (lsb_per_g, source) = match (given, data.unit) {
            (Some(_), _) => (given, Some(Source::Given)),
            (None, OutputUnit::Counts { nominal: Some(nominal), .. }) => {
                (Some(nominal.lsb_per_g()), Some(Source::Board))
            }
            (None, OutputUnit::Counts { .. }) => (None, Some(Source::Fit)),
            (None, OutputUnit::Mps2) => (None, None),
        };
        let mps2 = match (data.unit, lsb_per_g) {
            (OutputUnit::Mps2, _) => 1.0,
            (OutputUnit::Counts { .. }, Some(lsb_per_g)) => STANDARD_GRAVITY_MPS2 / lsb_per_g,
            (OutputUnit::Counts { .. }, None) => gravity.mps2() / median_magnitude(data),
        };
        Ok(Self { lsb_per_g, source, mps2 })
    }

    /// That at which the mean scale factor of an estimate is 1: scaling the counts scales A.
    fn of_fit(self, estimate: &Estimate) -> Self {
        let matrix = estimate.model.terms().matrix;
        let mean = (matrix[0][0] + matrix[1][1] + matrix[2][2]) / 3.0;
        let mps2 = self.mps2 / mean;
        Self { lsb_per_g: Some(STANDARD_GRAVITY_MPS2 / mps2), mps2, ..self }
    }

    /// As a board takes it.
    fn of_board(&self) -> Option<Sensitivity> {
        Sensitivity::from_lsb_per_g(self.lsb_per_g?).ok()
    }
}

/// A full-scale range, ± *g*, and its source: that of the data, else as given, else that of 16 bits at this sensitivity.
pub(super) fn range(
    unit: OutputUnit,
    given: Option<u8>,
    sensitivity: Option<Sensitivity>,
) -> Option<(u8, Source)> {
    let of_board = match unit {
        OutputUnit::Counts { range_g, .. } => range_g,
        OutputUnit::Mps2 => None,
    };
    let stated = of_board.map(|g| (g, Source::Board)).or(given.map(|g| (g, Source::Given)));
    stated.or_else(|| {
        // The power of two below it, with 10 % for the scale error of the sensor.
        let full_scale_g = 1.1 * 32768.0 / sensitivity?.lsb_per_g();
        Some((2_u8.pow((full_scale_g.log2().floor() as u32).min(7)), Source::SixteenBits))
    })
}

/// That a range was assumed.
pub(super) fn range_note(
    (range_g, source): (u8, Source),
    sensitivity: Sensitivity,
) -> Option<Problem> {
    if source != Source::SixteenBits {
        return None;
    }
    let text = format!(
        "the range is unknown: ±{range_g} g assumed (16 bits at {:.0} LSB/g); a board accepts the calibration at this range \
         only",
        sensitivity.lsb_per_g()
    );
    Some(Code::RangeAssumed.note(text).remedy("give the range with --range"))
}

/// Static poses at an assumed scale.
pub(super) struct Poses {
    pub poses: Vec<Pose>,
    /// m/s² per unit at which they were searched.
    pub scale: f64,
}

impl Poses {
    pub fn find(data: &Samples<'_>, scale: f64) -> Self {
        let si = |value: [f64; 3]| value.map(|axis| axis * scale);
        if !data.poses {
            let forces: Vec<[f64; 3]> = data.values().map(si).collect();
            return Self { poses: data.rests(&forces), scale };
        }
        let pose = |(index, output): (usize, Output)| Pose {
            samples: output.samples,
            temperature_c: output.temperature_c,
            first_sample: index as u64,
            // Without times no drift can be fitted.
            time_s: data.time_s(index).unwrap_or(0.0),
            ..Pose::from_mean(si(output.value))
        };
        Self { poses: data.iter().enumerate().map(pose).collect(), scale }
    }

    /// Removes poses that add nothing: exactly equal to an earlier one (a file joined to itself, or a logger that repeats),
    /// or the first step of a rotation again.
    fn without_repetitions(&mut self, method: MethodChoice) -> Option<Problem> {
        let all = self.poses.len();
        let returned = "the rotation had returned to its first step";
        let why = match method {
            MethodChoice::MultiPosition => {
                let mut seen = HashSet::with_capacity(all);
                self.poses.retain(|pose| seen.insert(pose.mean_mps2.map(f64::to_bits)));
                "exactly equal to an earlier pose"
            }
            MethodChoice::SixPosition => return None,
            MethodChoice::FourAngle => self.remove_closing(4, returned),
            MethodChoice::ThreeAngle => self.remove_closing(3, returned),
        };
        let removed = all - self.poses.len();
        (removed > 0).then(|| {
            let count = counted(removed, "pose");
            let text = format!("{count} left out: {why}; pose numbers count only the others");
            Code::PosesLeftOut.note(text)
        })
    }

    /// Removes the pose after a rotation of `steps` that repeats the rotation's first step, if whole rotations remain.
    fn remove_closing<'t>(&mut self, steps: usize, why: &'t str) -> &'t str {
        let mut kept = Vec::with_capacity(self.poses.len());
        let mut rest = self.poses.as_slice();
        while let Some((turn, after)) = rest.split_at_checked(steps) {
            kept.extend_from_slice(turn);
            let comes_back = after.first().is_some_and(|pose| turn[0].is_like(pose));
            let is_over = !after.len().is_multiple_of(steps);
            rest = after.get(usize::from(is_over && comes_back)..).unwrap_or(&[]);
        }
        if rest.is_empty() {
            self.poses = kept;
        }
        why
    }

    fn rescale(&mut self, scale: f64) {
        let change = scale / self.scale;
        self.scale = scale;
        for pose in &mut self.poses {
            pose.mean_mps2 = pose.mean_mps2.map(|axis| axis * change);
            pose.sd_mps2 = pose.sd_mps2.map(|axis| axis * change);
            pose.rounding_sd_mps2 = pose.rounding_sd_mps2.map(|axis| axis * change);
        }
    }
}

/// Median magnitude of the data, 1 where that is 0.
pub(super) fn median_magnitude(data: &Samples<'_>) -> f64 {
    median(data.values().map(magnitude)).filter(|median| *median > 0.0).unwrap_or(1.0)
}

pub(super) fn rms(values: impl Iterator<Item = f64>) -> Option<f64> {
    let (sum, count) =
        values.fold((0.0, 0.0), |(sum, count), value| (sum + value * value, count + 1.0));
    (count > 0.0).then(|| (sum / count).sqrt())
}

/// How the model is fitted to poses.
pub(crate) struct Fitting<'a> {
    options: &'a CalibrateOptions,
    gravity: Gravity,
    placement: Placement,
}

impl<'a> Fitting<'a> {
    /// As the options say.
    pub fn new(options: &'a CalibrateOptions) -> Result<Self> {
        let (gravity, _) = options.gravity()?;
        Ok(Self { options, gravity, placement: options.placement()? })
    }

    /// The estimate from poses at the nominal sensitivity.
    pub fn of(&self, poses: &[Pose]) -> Result<Estimate, Refusal> {
        let (gravity, options) = (self.gravity, self.options);
        match options.method {
            MethodChoice::SixPosition => match &options.sides {
                Some(sides) => {
                    let labelled: Vec<(Face, Pose)> =
                        sides.iter().copied().zip(poses.iter().copied()).collect();
                    six_position_labelled(&labelled, gravity, self.placement)
                }
                None => six_position(poses, gravity, self.placement),
            },
            MethodChoice::FourAngle => four_angle(poses, gravity, self.placement),
            MethodChoice::ThreeAngle => three_angle(poses, gravity, self.placement),
            MethodChoice::MultiPosition => multi_position(poses, gravity, options.multi_position()),
        }
    }
}

/// A fit, and all that its report says.
struct Fitted<'a> {
    data: &'a Samples<'a>,
    options: &'a CalibrateOptions,
    gravity: Gravity,
    scale: Scale,
    poses: Vec<Pose>,
    outcome: Result<Estimate, Refusal>,
    problems: Vec<Problem>,
}

impl Fitted<'_> {
    fn report(mut self, fitting: &Fitting<'_>) -> Result<CalibrationReport> {
        let (data, options, scale) = (self.data, self.options, self.scale);
        let range = range(data.unit, options.range_g, scale.of_board());
        let mut of_gyroscope = Vec::new();
        let gyroscope = match &self.outcome {
            Ok(estimate) if options.method == MethodChoice::MultiPosition => {
                gyroscope::calibrate(data, scale.mps2, &self.poses, estimate, &mut of_gyroscope)
            }
            _ => None,
        };
        self.problems.append(&mut of_gyroscope);
        let datasheet = self.limits();
        let (rejected, rejected_poses) = self.rejected();
        let shows_axes =
            gyroscope.is_some() || self.problems.iter().any(|problem| problem.code == Code::Axes);
        let mut outcome = self.problems(fitting, range, &rejected_poses, shows_axes);
        outcome.findings.extend(datasheet.iter().map(DatasheetReport::finding));
        let estimate = self.outcome.as_ref().ok();
        let parameters = gyroscope.as_ref().and_then(|found| found.parameters);
        let file = estimate.map(|estimate| self.file(estimate, range, parameters));
        let set = file.as_ref().and_then(|file| file.parameters().ok());
        let grade = |estimate| Grade::new(estimate, &self.poses, options.target_mps2);
        let fit = estimate.map(|estimate| Fit::new(estimate, grade(estimate)));
        outcome.findings.extend(fit.as_ref().and_then(|fit| checks::target(&fit.grade)));
        let (next_poses, poses_worth_adding) = self.advice();
        let gravity_mps2 = self.gravity.mps2();
        let residuals = self.poses.iter().map(|pose| magnitude(pose.mean_mps2) - gravity_mps2);
        let listed = if self.poses.len() > MAX_POSES { &[] } else { &self.poses[..] };
        Ok(CalibrationReport {
            outcome,
            source: data.name.to_owned(),
            method: options.method.name(),
            terms: terms(estimate, options),
            poses: self.poses.len(),
            rate_hz: (!data.poses).then_some(data.rate_hz),
            rate_source: (!data.poses).then_some(data.rate_source),
            gravity_m_s2: gravity_mps2,
            gravity_sd_m_s2: self.gravity.sd_mps2(),
            gravity_source: options.gravity()?.1,
            unit: self.unit().as_str(),
            sensitivity_lsb_per_g: scale.lsb_per_g,
            sensitivity_source: scale.source.filter(|_| scale.lsb_per_g.is_some()),
            range_g: range.map(|(g, _)| g),
            range_source: range.map(|(_, source)| source),
            uncalibrated_rms_mm_s2: rms(residuals).map(|rms| rms * 1e3),
            fit,
            rejected,
            next_poses,
            poses_worth_adding,
            static_poses: listed.iter().map(|pose| StaticPose::new(pose, estimate)).collect(),
            gyroscope,
            datasheet,
            parameter_id: set.as_ref().map(|set: &ParameterSet| parameter_id(set).to_string()),
            parameters: set,
            file,
            rejected_poses,
            estimate: self.outcome.ok(),
        })
    }

    /// The estimate against the limits of the sensor's datasheet.
    fn limits(&self) -> Option<DatasheetReport> {
        let (datasheet, estimate) =
            self.options.datasheet.or(self.data.datasheet()).zip(self.outcome.as_ref().ok())?;
        let counts = self.unit() == AccelerationUnit::Lsb;
        let used = self.scale.lsb_per_g.filter(|_| counts);
        Some(DatasheetReport::new(datasheet, estimate, used))
    }

    /// What the session and the estimate show, and why there is no estimate.
    fn problems(
        &self,
        fitting: &Fitting<'_>,
        range: Option<(u8, Source)>,
        rejected: &[usize],
        has_gyroscope: bool,
    ) -> Outcome {
        let data = self.data;
        let estimate = self.outcome.as_ref().ok();
        let refit = |poses: &[Pose]| fitting.of(poses).ok();
        let time_s = |pose: &Pose| data.since_start_s(pose.first_sample as usize);
        let changed = estimate.and_then(|e| nested::finding(&self.poses, e, refit, time_s));
        let context = checks::Context {
            data,
            options: self.options,
            poses: &self.poses,
            rejected,
            lsb_per_g: self.scale.lsb_per_g,
            board: self.scale.of_board().zip(range),
            has_gyroscope,
        };
        let findings = context.problems(estimate, changed);
        let mut outcome = Outcome { findings, ..Outcome::default() };
        outcome.findings.extend(self.problems.iter().cloned());
        if let Err(refusal) = &self.outcome {
            let counts = self.unit() == AccelerationUnit::Lsb;
            let used = self.scale.lsb_per_g.filter(|_| counts);
            outcome.refuse(context.reason(refusal, used));
        }
        outcome
    }

    /// The calibration as a file.
    fn file(
        &self,
        estimate: &Estimate,
        range: Option<(u8, Source)>,
        gyroscope: Option<GyroscopeParameters>,
    ) -> Calibration {
        let accelerometer = self.accelerometer(estimate, range);
        let mut sensor = SensorCalibration::new(self.data.sensor, accelerometer);
        sensor.gyroscope = gyroscope;
        Calibration::of(sensor).of_device(self.data.info().device_id)
    }

    fn unit(&self) -> AccelerationUnit {
        match self.data.unit {
            OutputUnit::Counts { .. } => AccelerationUnit::Lsb,
            OutputUnit::Mps2 => AccelerationUnit::Mps2,
        }
    }

    /// What the calibration file holds of the accelerometer.
    fn accelerometer(
        &self,
        estimate: &Estimate,
        range: Option<(u8, Source)>,
    ) -> AccelerometerCalibration {
        let utc_s = self.options.utc_s;
        let quality = estimate.quality(utc_s, &self.poses);
        let poses = quality.map_or(0, |quality| quality.terms().poses);
        AccelerometerCalibration {
            unit: self.unit(),
            range_g: range.map(|(g, _)| g),
            range_source: range.map(|(_, source)| source),
            sensitivity_lsb_per_g: self.scale.lsb_per_g,
            zero_count: self.data.info().zero_count,
            model: estimate.model,
            quality: quality.as_ref().map(Quality::from),
            sessions: vec![Session { utc_s, file: Some(self.data.name.to_owned()), poses }],
        }
    }

    /// Number of poses left out of the fit, and their indices: of very many, not all are listed.
    fn rejected(&self) -> (usize, Vec<usize>) {
        let Ok(estimate) = &self.outcome else { return (0, Vec::new()) };
        let listed = match self.options.method {
            MethodChoice::SixPosition => {
                let all = self.poses.iter().enumerate();
                all.filter(|(_, pose)| Face::of(pose).is_none()).map(|(k, _)| k).collect()
            }
            _ => estimate.rejected.clone(),
        };
        (estimate.rejected.len().max(listed.len()), listed)
    }

    /// The poses that would resolve a refusal or improve the fit, and the number of worthwhile ones.
    fn advice(&self) -> (Vec<NextPose>, usize) {
        let worthwhile = match self.options.method {
            MethodChoice::MultiPosition => Guide::after(&self.poses).worth(|_| true),
            _ => 0,
        };
        let least = match &self.outcome {
            Ok(_) => 0,
            // A repeated orientation adds little: its error may be the same.
            Err(Refusal {
                reason: Reason::NotObservable | Reason::PoorPrediction { .. }, ..
            }) => 1,
            // One that replaces the disturbed pose, and one that identifies it.
            Err(Refusal { reason: Reason::Contradicted { .. }, .. }) => 2,
            Err(Refusal { reason: Reason::TooFew { .. }, .. })
                if self.options.method == MethodChoice::SixPosition =>
            {
                let is_missing =
                    |face: &Face| self.poses.iter().all(|pose| Face::of(pose) != Some(*face));
                let missing = Face::ALL.into_iter().filter(is_missing);
                return (missing.map(|face| Orientation::from(face).into()).collect(), worthwhile);
            }
            Err(Refusal { reason: Reason::TooFew { have, need }, .. }) => {
                need.saturating_sub(*have)
            }
            Err(_) => return (Vec::new(), worthwhile),
        };
        (self.worthwhile(least), worthwhile)
    }

    /// The orientations that improve the fit of these poses most: all worthwhile ones, at least `least`.
    fn worthwhile(&self, least: usize) -> Vec<NextPose> {
        if self.options.method != MethodChoice::MultiPosition {
            return Vec::new();
        }
        let mut guide = Guide::after(&self.poses);
        let count = guide.worth(|_| true).min(MAX_ADVISED).max(least);
        let planned = count.max(PLANNED.saturating_sub(self.poses.len()));
        let next = |remaining| {
            let next = guide.next_of(remaining, |_| true)?;
            guide.take(next.up());
            Some(next.into())
        };
        ((planned - count + 1)..=planned).rev().map_while(next).collect()
    }
}

/// The terms that were fitted, or were requested.
fn terms(estimate: Option<&Estimate>, options: &CalibrateOptions) -> Vec<&'static str> {
    let mut terms = match options.method {
        MethodChoice::SixPosition => vec!["bias", "scale", "misalignment_6"],
        MethodChoice::FourAngle | MethodChoice::ThreeAngle => vec!["bias", "scale"],
        MethodChoice::MultiPosition => vec!["bias", "scale", "misalignment_3"],
    };
    let more = estimate.map_or(options.terms, |estimate| estimate.terms);
    terms.extend(more.iter().map(|term| match term {
        Term::Drift => "drift",
        Term::BiasTemperature => "bias_temperature",
        Term::ScaleTemperature => "scale_temperature",
        Term::Quadratic => "quadratic",
    }));
    terms
}
