//! Checks of a session and its estimate: why there is no answer, and what a user should know beside the numbers.

use statrs::distribution::{ChiSquared, ContinuousCDF};
use wimu_calib::{
    Covariance, Estimate, Face, Gravity, MultiPosition, Parameter, Parameters, Pose, Reason,
    Refusal, Sides, UnitHint, multi_position,
};
use wimu_model::{CalibrationMethod, ErrorTerms, STANDARD_GRAVITY_MPS2};

use super::poses::{Poses, median_magnitude, range_note, rms};
use super::report::{AXES, Criterion, Grade, names};
use super::solution::Solution;
use super::{Datasheet, Source, magnitude, median, nested, steps};
use crate::digits::significant;
use crate::plural::counted;
use crate::recording::{OutputUnit, RateSource, Samples};
use crate::{Code, Problem};

/// Largest plausible residual of poses, mm/s² rms: 5 mg.
const SUSPICIOUS_RMS_MM_S2: f64 = 50.0;
/// Largest plausible residual of rotations, mm/s² rms: twice g √2 · 0.02/2, the 1 σ effect of misalignments of 2 %, which they
/// do not fit.
const SUSPICIOUS_OF_TURNS_RMS_MM_S2: f64 = 280.0;
/// Scatter of the poses of a consumer sensor, mm/s², 1 σ.
const SCATTER_MM_S2: f64 = 10.0;
/// Percentage of the scale factors' variance from which on gravity dominates it.
const DOMINATES_PERCENT: f64 = 50.0;
/// Departure of a scale factor from 1 that is reported: three times the tolerance of usual datasheets, 3 %.
const UNUSUAL: f64 = 0.1;
/// Departure of the magnitude at rest from gravity that is refused.
const WRONG: f64 = 0.25;
/// Relative difference of the data's sensitivity to a usual one that is taken for it.
const NEAR: f64 = 0.1;
/// Largest relative departure of magnitudes from their median that indicates normalised data, as after rounding to four
/// digits. Chosen: a sensor differs by more.
const ROUNDING: f64 = 5e-5;
/// Fewest orientations for that test.
const MIN_ORIENTATIONS: usize = 6;
/// Largest number of rows that can be pose means, and their largest rate, Hz: a pose takes seconds.
const MAX_MEANS: usize = 2000;
const MAX_MEANS_HZ: f64 = 5.0;

/// Poses that cannot be those of an accelerometer in m/s²: of a wrong unit or sensitivity, or normalised.
pub(super) fn refusal(data: &Samples<'_>, found: &Poses, gravity: Gravity) -> Option<Refusal> {
    wrong_unit(data, found, gravity).or_else(|| wrong_magnitude(found, gravity))
}

/// A wrong unit of samples in which few poses were found: in it, noise looks like motion.
fn wrong_unit(data: &Samples<'_>, found: &Poses, gravity: Gravity) -> Option<Refusal> {
    let is_known = !matches!(data.unit, OutputUnit::Counts { nominal: None, .. });
    if !is_known || data.poses || found.poses.len() > 3 {
        return None;
    }
    let mean_mps2 = median_magnitude(data) * found.scale;
    let hint = UnitHint::of(mean_mps2, gravity.mps2())?;
    Some(Refusal::unexpected_magnitude(mean_mps2, hint))
}

/// A magnitude at rest that a wrong sensitivity explains, or one that is the same in every pose.
fn wrong_magnitude(found: &Poses, gravity: Gravity) -> Option<Refusal> {
    let sizes = || found.poses.iter().map(|pose| magnitude(pose.mean_mps2));
    let mean_mps2 = median(sizes())?;
    let refused = |hint| Some(Refusal::unexpected_magnitude(mean_mps2, hint));
    let ratio = mean_mps2 / gravity.mps2();
    let scatter = rms(sizes().map(|size| size / mean_mps2 - 1.0))?;
    // Beyond, it is another unit; where the magnitudes differ, it is one axis.
    if (ratio - 1.0).abs() > WRONG && (0.4..=2.1).contains(&ratio) && scatter < UNUSUAL {
        return refused(UnitHint::Sensitivity);
    }
    let mut different: Vec<&Pose> = Vec::new();
    for pose in &found.poses {
        if !different.iter().any(|other| other.is_like(pose)) {
            different.push(pose);
        }
    }
    let alike = sizes().all(|size| (size / mean_mps2 - 1.0).abs() < ROUNDING);
    // Coarse counts of an accurate sensor are equal too, but whole numbers.
    let counts = |value: &f64| value / found.scale;
    let is_whole = |value: &f64| (counts(value) - counts(value).round()).abs() < 1e-6;
    let mut values = found.poses.iter().flat_map(|pose| &pose.mean_mps2);
    if alike && !values.all(is_whole) && different.len() >= MIN_ORIENTATIONS {
        return refused(UnitHint::Normalised);
    }
    None
}

/// Start times of the poses, so that a person can find them; empty where there are none or too many.
pub(super) fn start_times(data: &Samples<'_>, poses: &[Pose]) -> String {
    if data.poses || poses.is_empty() || poses.len() > 40 {
        return String::new();
    }
    let start = |pose: &Pose| format!("{:.0}", data.since_start_s(pose.first_sample as usize));
    let starts: Vec<String> = poses.iter().map(start).collect();
    format!(" (starting at {} s)", starts.join(", "))
}

/// That an estimate misses the target that was given.
pub(super) fn target(grade: &Grade) -> Option<Problem> {
    if grade.criterion != Criterion::Target || grade.met != Some(false) {
        return None;
    }
    let remedy = "add the recommended poses, hold each longer, or give a larger --target";
    Some(Code::Residuals.warning(grade.to_string()).remedy(remedy))
}

impl Solution<'_> {
    /// Why the data were refused, and which option of the command line helps.
    pub fn reason(&self, refusal: &Refusal) -> String {
        let (poses, options) = (&self.poses, self.options);
        let text = refusal.to_string();
        if let Reason::Unit { magnitude, hint: UnitHint::Sensitivity } = refusal.reason {
            let ratio = magnitude / options.gravity_mps2.unwrap_or(STANDARD_GRAVITY_MPS2);
            return format!("{text} Instead: {}.", self.likely_sensitivity(ratio));
        }
        if looks_like_means(self.data, poses.len()) {
            return text + " The rows look like means over static poses: if they are, add --poses.";
        }
        if poses.len() == 1 && !self.data.poses {
            return text + " For the noise of a sensor at rest use `wimu allan`.";
        }
        if options.method != CalibrationMethod::MultiPosition {
            return text;
        }
        if matches!(refusal.reason, Reason::PoorFit { .. } | Reason::Contradicted { .. }) {
            let (gravity, model) = (self.fitting.gravity, options.multi_position());
            return nested::contradiction(poses, gravity, model).unwrap_or(text);
        }
        if !refusal.needs_poses() {
            return text;
        }
        let with_priors = MultiPosition { priors: true, ..options.multi_position() };
        if !options.model.priors && multi_position(poses, self.fitting.gravity, with_priors).is_ok()
        {
            return text + " --model auto holds what they do not determine at typical tolerances.";
        }
        let is_up = |face: &Face| poses.iter().any(|pose| Face::of(pose) == Some(*face));
        if Face::ALL.iter().all(is_up) {
            return text
                + " All six sides are present: if they were placed squarely, --method six-position estimates 12 parameters.";
        }
        text
    }

    /// All problems but the refusal; `shows_axes` says whether a gyroscope shows swapped axes.
    pub fn problems(&self, estimate: Option<&Estimate>, shows_axes: bool) -> Vec<Problem> {
        let (data, options) = (self.data, self.options);
        let mut problems = data.findings();
        if data.rate.is_some() && (data.poses || options.method != CalibrationMethod::MultiPosition)
        {
            let text =
                "the gyroscope is not calibrated: multi-position does it with continuous samples";
            problems.push(Code::Uncalibrated.note(text));
        }
        if data.info().corrected {
            let text = format!("`{}` was corrected by the device before", data.info().name);
            let remedy =
                "the result is what that correction left: calibrate the sensor's raw output";
            problems.push(Code::AlreadyCorrected.warning(text).remedy(remedy));
        }
        let Some(estimate) = estimate else { return problems };
        problems.extend(not_fitted(estimate));
        problems.extend(placement(&self.poses, estimate));
        problems.extend(self.sensitivity(estimate));
        problems.extend(self.unobserved_by_rotations(estimate));
        let refit = |poses: &[Pose]| self.fitting.of(poses).ok();
        let time_s = |pose: &Pose| data.since_start_s(pose.first_sample as usize);
        let changed = nested::finding(&self.poses, estimate, refit, time_s);
        problems.extend(changed.or_else(|| self.residuals(estimate)));
        problems.extend(self.of_boards());
        let has_sides = options.method == CalibrationMethod::SixPosition && options.sides.is_some();
        if !shows_axes && !has_sides {
            let text = "swapped, mirrored or inverted axes cannot be detected";
            let remedy = "to detect them use --method six-position --sides, or record a gyroscope";
            problems.push(Code::Axes.note(text).remedy(remedy));
        }
        let source = self.fitting.gravity_source;
        let (model, fitted) = (estimate.model.terms(), estimate.fitted);
        problems.extend(gravity(model, &estimate.covariance, fitted, estimate.gravity, source));
        let rejected = self.rejected();
        if !rejected.is_empty() {
            let count = counted(estimate.rejected.len().max(rejected.len()), "pose");
            let text = "left out because the others contradict them";
            let text = format!("{count} {text}: {rejected:?} (from 0)");
            problems.push(Code::PosesLeftOut.warning(text));
        }
        problems
    }

    /// Scale factors far from 1.
    fn sensitivity(&self, estimate: &Estimate) -> Option<Problem> {
        let matrix = estimate.model.terms().matrix;
        let scales = [0, 1, 2].map(|axis| matrix[axis][axis]);
        let is_far = |scale: f64| (scale - 1.0).abs() > UNUSUAL;
        let is_fitted = |axis: usize| estimate.fitted.contains(Parameter::ALL[3 + 4 * axis]);
        let far = (0..3).filter(|axis| is_fitted(*axis) && is_far(scales[*axis]));
        let far = Vec::from_iter(far.map(|axis| format!("{} {:.3}", AXES[axis], scales[axis])));
        if far.is_empty() {
            return None;
        }
        let mean = scales.iter().sum::<f64>() / 3.0;
        let remedy = if is_far(mean) {
            self.likely_sensitivity(mean)
        } else {
            "check these axes for damage or saturation".to_owned()
        };
        let text = format!("scale factors more than 10 % from 1: {}", far.join(", "));
        Some(Code::Sensitivity.warning(text).remedy(remedy))
    }

    /// What rotations about level axes cannot observe.
    fn unobserved_by_rotations(&self, estimate: &Estimate) -> Vec<Problem> {
        let Some(steps) = steps(self.options.method) else { return Vec::new() };
        let mut problems = Vec::new();
        let biases = [Parameter::BiasX, Parameter::BiasY, Parameter::BiasZ];
        if let Some(axis) = biases.into_iter().position(|bias| !estimate.fitted.contains(bias)) {
            let sum: f64 = self.poses.iter().map(|pose| pose.mean_mps2[axis]).sum();
            let mean = sum / self.poses.len() as f64;
            let sine = (mean / estimate.gravity.mps2()).abs().min(1.0);
            let text = format!(
                "all rotations were about {}, which reads {mean:+.2} m/s²: its bias, or an axis {:.0}° from level, which \
                 lowers the scale factors by {:.1} %",
                AXES[axis],
                sine.asin().to_degrees(),
                100.0 * (1.0 - (1.0 - sine * sine).sqrt()),
            );
            let remedy = "rotate about another axis to separate them";
            problems.push(Code::NotObserved.warning(text).remedy(remedy));
        }
        if steps == 3 && self.poses.len() == steps {
            let text = "three steps leave no redundancy: a step that is 8° off changes the scale factor by 4 %";
            let problem = Code::NotObserved.warning(text);
            problems.push(problem.remedy("--method four-angle detects it"));
        }
        problems
    }

    /// Residuals larger than those of an intact sensor.
    fn residuals(&self, estimate: &Estimate) -> Option<Problem> {
        let rms = estimate.fitted_rms_mps2 * 1e3;
        let most = match estimate.method {
            CalibrationMethod::FourAngle | CalibrationMethod::ThreeAngle => {
                SUSPICIOUS_OF_TURNS_RMS_MM_S2
            }
            CalibrationMethod::MultiPosition => most_rms_mm_s2(&self.poses, estimate),
            _ => SUSPICIOUS_RMS_MM_S2,
        };
        (rms > most).then(|| {
            Code::Residuals.warning(format!(
                "the residuals, {rms:.0} mm/s² rms, exceed those of an intact sensor: the model is too small, or poses are \
                 disturbed"
            ))
        })
    }

    /// What a board needs and does not get.
    fn of_boards(&self) -> Option<Problem> {
        match (self.scale.of_board().zip(self.range), self.scale.lsb_per_g) {
            (Some((sensitivity, range)), _) => range_note(range, sensitivity),
            (None, Some(lsb_per_g)) => Some(Code::NotForBoards.warning(format!(
                "{lsb_per_g:.1} LSB/g is outside the range of boards (160 to 1048576): this calibration cannot be pushed or \
                 exported"
            ))),
            (None, None) => Some(no_sensitivity()),
        }
    }

    /// What the sensitivity probably is, where that in use is wrong by the factor `ratio`.
    fn likely_sensitivity(&self, ratio: f64) -> String {
        let Some(used) = self.used_lsb_per_g() else {
            return format!(
                "the sensitivity that converted the data is {ratio:.3} times too small"
            );
        };
        let fitted = used * ratio;
        let shown = (10.0 * used).round() / 10.0;
        let known = Datasheet::KNOWN.iter().flat_map(|sheet| sheet.sensitivities_lsb_per_g);
        let usual: Vec<f64> = match self.options.datasheet.or(self.data.datasheet()) {
            Some(sheet) => sheet.sensitivities_lsb_per_g.to_vec(),
            None => (0..11).map(|k| 256.0 * f64::from(1 << k)).chain(known.copied()).collect(),
        };
        let off = |lsb_per_g: &f64| (fitted / lsb_per_g - 1.0).abs();
        let nearest = usual.into_iter().min_by(|a, b| off(a).total_cmp(&off(b)));
        match nearest.filter(|nearest| off(nearest) < NEAR && off(nearest) < off(&used)) {
            Some(nearest) => {
                format!("{nearest} LSB/g is likely instead of {shown}: --sensitivity {nearest}")
            }
            None => format!("the fit gives {fitted:.0} LSB/g instead of {shown}"),
        }
    }
}

/// Whether the rows are pose means instead of samples: no times or slow ones, few poses found, and nearly all of the magnitude
/// of gravity.
fn looks_like_means(data: &Samples<'_>, found: usize) -> bool {
    let is_slow = data.rate_source == RateSource::Assumed || data.rate_hz < MAX_MEANS_HZ;
    if data.poses || found > 1 || data.len() > MAX_MEANS || !is_slow {
        return false;
    }
    let median = median_magnitude(data);
    let near = |value: &[f64; 3]| (magnitude(*value) / median - 1.0).abs() < 0.2;
    10 * data.values().filter(near).count() >= 9 * data.len()
}

/// Largest plausible residual of nine or more parameters, mm/s² rms: the 99.9 % point of χ² for the usual scatter and the
/// noise of the poses.
fn most_rms_mm_s2(poses: &[Pose], estimate: &Estimate) -> f64 {
    let chi_squared = ChiSquared::new(estimate.dof.max(1) as f64);
    let most = chi_squared.map_or(f64::INFINITY, |chi_squared| chi_squared.inverse_cdf(0.999));
    let scatter = SCATTER_MM_S2.hypot(pose_noise_mps2(poses) * 1e3);
    scatter * (most / estimate.poses as f64).sqrt()
}

/// Largest standard deviation of a pose's mean from white noise, m/s²; 0 if it is unknown.
fn pose_noise_mps2(poses: &[Pose]) -> f64 {
    let of_mean = |pose: &Pose| pose.sd_mps2.map(|sd| sd / f64::from(pose.samples.max(1)).sqrt());
    poses.iter().flat_map(of_mean).fold(0.0, f64::max)
}

/// Why a calibration cannot be pushed or exported.
pub(super) fn no_sensitivity() -> Problem {
    let remedy = "to push this calibration, calibrate again with --sensitivity, the nominal LSB/g of the board's range";
    Code::NotForBoards.note("the data are in m/s² or g, a board needs counts").remedy(remedy)
}

/// The parameters that were not fitted.
fn not_fitted(estimate: &Estimate) -> Vec<Problem> {
    let code = Code::NotObserved;
    let mut problems = Vec::new();
    if !estimate.assumed.is_empty() {
        let names = names(estimate.assumed).join(", ");
        let text = "held at typical tolerances, because the poses do not determine them";
        problems.push(code.note(format!("{text}: {names}")));
    }
    let is_misalignment = |parameter: &Parameter| !matches!(parameter.index(), 0..3 | 3 | 7 | 11);
    let (misalignments, others): (Vec<_>, Vec<_>) =
        estimate.not_observed().iter().partition(is_misalignment);
    if !misalignments.is_empty() {
        let mrad = estimate.sd().matrix[1][0] * 1e3;
        let text = format!("misalignments were not fitted: taken as 0 ± {mrad:.0} mrad");
        problems.push(code.note(text));
    }
    if !others.is_empty() {
        let names = names(others.into_iter().collect()).join(", ");
        problems.push(code.warning(format!(
            "not observed: {names}; taken as ideal, with the standard deviations typical of datasheets"
        )));
    }
    problems
}

/// Errors of the placement and the repeatability of known orientations.
fn placement(poses: &[Pose], estimate: &Estimate) -> Vec<Problem> {
    let mut problems = Vec::new();
    let Some(Sides { placement_sd_rad, declared_sd_rad, revisit_sd_mps2, revisits }) =
        estimate.sides
    else {
        return problems;
    };
    if placement_sd_rad > declared_sd_rad {
        let [shown, declared] = [placement_sd_rad, declared_sd_rad].map(f64::to_degrees);
        let text = format!(
            "placement was worse than declared: {shown:.1}° instead of {declared:.1}° (1 σ); the intervals include this"
        );
        problems.push(Code::Placement.warning(text).remedy("repeat the sides, placed squarely"));
    }
    if revisits == 0 && revisit_sd_mps2 > pose_noise_mps2(poses) {
        let text = format!(
            "each side was measured once: a repeatability of {} mm/s² (1 σ), typical of other sensors, is assumed",
            significant(revisit_sd_mps2 * 1e3, 3)
        );
        problems.push(Code::Placement.note(text).remedy("measure each side twice to determine it"));
    }
    problems
}

/// That the default gravity dominates the intervals of the scale factors.
pub(super) fn gravity(
    model: &ErrorTerms,
    covariance: &Covariance,
    fitted: Parameters,
    gravity: Gravity,
    source: Source,
) -> Option<Problem> {
    let percent = |(axis, parameter): (usize, Parameter)| {
        let of_gravity = model.matrix[axis][axis] * gravity.sd_mps2() / gravity.mps2();
        100.0 * (of_gravity / covariance.sd(parameter)).powi(2)
    };
    let scales = [Parameter::ScaleX, Parameter::ScaleY, Parameter::ScaleZ].into_iter().enumerate();
    let percent =
        scales.filter(|(_, scale)| fitted.contains(*scale)).map(percent).reduce(f64::min)?;
    (source == Source::Default && percent > DOMINATES_PERCENT).then(|| {
        let text = format!(
            "local gravity is not known: 9.80665 ± 0.015 m/s² causes {:.0} % of the variance of the scale factors",
            percent.min(100.0)
        );
        let problem = Code::GravityAssumed.note(text);
        problem.remedy("give --latitude DEG,HEIGHT of the place, or --gravity")
    })
}
