//! Messages of a calibration: reasons for a refusal, and findings.

use wimu_calib::{
    BeyondBounds, Estimate, Face, Method, Model, Parameter, Pose, Reason, Refusal, Term, Terms,
    UnitHint,
};
use wimu_model::{STANDARD_GRAVITY_MPS2, Sensitivity};

use super::input::{magnitude, median, median_magnitude};
use super::range::Range;
use super::{CalibrateOptions, MethodChoice, ModelChoice, sensitivity};
use crate::digits::significant;
use crate::plural::counted;
use crate::recording::{OutputUnit, RateSource, Samples};
use crate::{Code, Problem};

/// How many poses were left out because they repeat an earlier one, and how.
pub(super) fn left_out(poses: usize, why: &str) -> Option<Problem> {
    (poses > 0).then(|| {
        let count = counted(poses, "pose");
        let text = format!("{count} left out: {why}; pose numbers count only the others");
        Code::PosesLeftOut.note(text)
    })
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

/// Why the data were refused, and which option of the command line helps.
pub(super) fn reason(
    refusal: &Refusal,
    poses: &[Pose],
    data: &Samples<'_>,
    options: &CalibrateOptions,
    used_lsb_per_g: Option<f64>,
) -> String {
    let has = poses.len();
    if let Reason::Placement { index: pose, steps: steps @ 3..=4 } = refusal.reason {
        let degrees = 360 / steps.max(1);
        if has < steps {
            return format!(
                "{} found, a rotation has {steps} steps of {degrees}°: rotate about one axis of the sensor, in one \
                 direction, and hold it still for two seconds at each step",
                counted(has, "static pose")
            );
        }
        if has < pose + steps {
            let last = if has > pose + 1 { format!(" to {}", has - 1) } else { String::new() };
            return format!(
                "poses {pose}{last} (from 0) are {} instead of {steps} steps of {degrees}° about a level axis: give \
                 {steps} poses for each rotation, in order, and no others{}",
                has - pose,
                start_times(data, poses)
            );
        }
    }
    let mut reason = refusal.to_string();
    if let Reason::Unit { magnitude, hint: UnitHint::Sensitivity } = refusal.reason {
        let ratio = magnitude / options.gravity_mps2.unwrap_or(STANDARD_GRAVITY_MPS2);
        let datasheet = options.datasheet.or(data.datasheet());
        return reason + "; " + &sensitivity::likely(ratio, used_lsb_per_g, datasheet);
    }
    if looks_like_means(data, has) {
        return reason + "; the rows look like means over static poses: if they are, add --poses";
    }
    if let (Reason::TooFew { .. }, Some(deg_per_s)) = (refusal.reason, slow_rotation(data)) {
        return reason
            + &format!(
                "; the sensor rotated all the time, at {deg_per_s:.0}°/s: hold it still in each pose"
            );
    }
    if has == 1 && !data.poses {
        return reason + "; for the noise of a sensor at rest use `wimu allan`";
    }
    if matches!(refusal.reason, Reason::PoorFit { .. } | Reason::Contradicted { .. }) {
        reason.extend(what_changed(poses, options));
    }
    if !refusal.needs_poses() || options.method != MethodChoice::MultiPosition {
        return reason;
    }
    let fixed = options.model != ModelChoice::Auto;
    if fixed && has > Model::Bias3.parameters() {
        return reason + "; --model auto chooses the model that these poses support best";
    }
    let up = |face: &Face| poses.iter().any(|pose| Face::of(pose) == Some(*face));
    if Face::ALL.iter().all(up) {
        reason += "; all six sides are present: if they were placed squarely, --method six-position estimates all \
         12 parameters";
    }
    reason
}

/// Which effect may have changed the bias between poses, and which option fits it.
fn what_changed(poses: &[Pose], options: &CalibrateOptions) -> Option<String> {
    let of = |value: fn(&Pose) -> Option<f64>| {
        let values: Option<Vec<f64>> = poses.iter().map(value).collect();
        let values = values.filter(|values| !values.is_empty())?;
        let low = values.iter().copied().fold(f64::INFINITY, f64::min);
        let high = values.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        Some([low, high])
    };
    let warmed = options.terms.contains(Term::BiasTemperature);
    if options.method != MethodChoice::MultiPosition || warmed {
        return None;
    }
    if let Some([low, high]) = of(|pose| pose.temperature_c).filter(|[low, high]| high - low >= 1.0)
    {
        return Some(format!(
            "; the temperature changed from {low:.0} to {high:.0} °C: --model auto+temperature fits its effect"
        ));
    }
    let tried = options.terms.contains(Term::Drift) || options.model == ModelChoice::Auto;
    let [begin, end] = of(|pose| Some(pose.time_s)).filter(|_| !tried)?;
    (end > begin).then(|| "; the bias may have drifted: --model auto+drift fits that".to_owned())
}

/// Largest number of rows that can be pose means.
const MAX_MEANS: usize = 2000;

/// Angle between the means of successive seconds of a sensor that is rotated slowly by hand, degrees. Chosen.
const SLOW_ROTATION: std::ops::RangeInclusive<f64> = 0.5..=30.0;

/// Median angular rate, degrees per second, of a sensor that was rotated slowly and never held still.
fn slow_rotation(data: &Samples<'_>) -> Option<f64> {
    let second = data.rate_hz.round().max(1.0) as usize;
    let values: Vec<[f64; 3]> = data.values().collect();
    let means: Vec<[f64; 3]> = values
        .chunks_exact(second)
        .filter(|_| !data.poses)
        .map(|samples| {
            let sum = |axis: usize| samples.iter().map(|value| value[axis]).sum::<f64>();
            [0, 1, 2].map(|axis| sum(axis) / second as f64)
        })
        .collect();
    let between = |pair: &[[f64; 3]]| {
        let dot: f64 = (0..3).map(|axis| pair[0][axis] * pair[1][axis]).sum();
        let cosine = dot / (magnitude(pair[0]) * magnitude(pair[1]));
        cosine.clamp(-1.0, 1.0).acos().to_degrees()
    };
    let angles: Vec<f64> = means.windows(2).map(between).collect();
    let turning = angles.iter().filter(|angle| SLOW_ROTATION.contains(angle)).count();
    let enough = angles.len() >= 20 && 10 * turning >= 9 * angles.len();
    median(angles).filter(|_| enough)
}

/// Whether the rows are pose means instead of samples: no times, few poses found, and nearly all of the magnitude of
/// gravity.
fn looks_like_means(data: &Samples<'_>, found: usize) -> bool {
    if data.poses || found > 1 || data.len() > MAX_MEANS {
        return false;
    }
    let median = median_magnitude(data);
    let near = |value: &[f64; 3]| (magnitude(*value) / median - 1.0).abs() < 0.2;
    let alike = data.values().filter(near).count();
    data.rate_source == RateSource::Assumed && 10 * alike >= 9 * data.len()
}

/// Rejected poses that appear to be in g among poses in m/s².
fn in_another_unit(poses: &[Pose], estimate: &Estimate) -> Option<Problem> {
    let g = estimate.gravity.mps2();
    let short = |k: &&usize| {
        let pose = poses.get(**k);
        pose.is_some_and(|pose| (7.3..13.0).contains(&(g / magnitude(pose.mean_mps2))))
    };
    let short: Vec<String> = estimate.rejected.iter().filter(short).map(usize::to_string).collect();
    (!short.is_empty()).then(|| {
        let text = format!(
            "poses that were left out appear to be in g, the others in m/s²: {} (from 0)",
            short.join(", ")
        );
        Code::PosesLeftOut.warning(text).remedy("use one unit")
    })
}

/// What rotations about level axes cannot observe.
fn unobserved_by_rotations(poses: &[Pose], estimate: &Estimate) -> Vec<Problem> {
    let steps = match estimate.method {
        Method::FourAngle => 4,
        Method::ThreeAngle => 3,
        _ => return Vec::new(),
    };
    let mut findings = Vec::new();
    let unseen = [Parameter::BiasX, Parameter::BiasY, Parameter::BiasZ]
        .into_iter()
        .position(|bias| !estimate.fitted.contains(bias));
    if let Some(axis) = unseen {
        let mean = poses.iter().map(|pose| pose.mean_mps2[axis]).sum::<f64>() / poses.len() as f64;
        let share = (mean / estimate.gravity.mps2()).abs().min(1.0);
        let text = format!(
            "all rotations were about {}, which reads {mean:+.2} m/s²: its bias, or an axis {:.0}° from level, which lowers \
             the scale factors by {:.1} %",
            ["X", "Y", "Z"][axis],
            share.asin().to_degrees(),
            100.0 * (1.0 - (1.0 - share * share).sqrt()),
        );
        let finding = Code::NotObserved.warning(text);
        findings.push(finding.remedy("rotate about another axis to separate them"));
    }
    if steps == 3 && poses.len() == steps {
        let text = "three steps leave no redundancy: a step that is 8° off changes the scale factor by 4 %";
        let finding = Code::NotObserved.warning(text);
        findings.push(finding.remedy("--method four-angle detects it"));
    }
    findings
}

/// Largest plausible residual of poses, mm/s² rms: 5 mg.
const SUSPICIOUS_RMS_MM_S2: f64 = 50.0;

/// Largest plausible residual of rotations, mm/s² rms: twice g √2 · 0.02/2, the 1 σ effect of misalignments of 2 %, which they do not fit.
const SUSPICIOUS_OF_TURNS_RMS_MM_S2: f64 = 280.0;

/// Scatter of the poses of a consumer sensor, mm/s², 1 σ.
const SCATTER_MM_S2: f64 = 10.0;
/// Normal deviate that is exceeded with a probability of 0.1 %.
const UNLIKELY: f64 = 3.09;

/// Largest plausible residual of nine or more parameters, mm/s² rms: the 99.9 % point of χ² (Wilson and Hilferty) for the
/// usual scatter and the noise of the poses.
fn most_rms_mm_s2(poses: &[Pose], estimate: &Estimate) -> f64 {
    let dof = estimate.dof.max(1) as f64;
    let ninths = 2.0 / (9.0 * dof);
    let ratio = (1.0 - ninths + UNLIKELY * ninths.sqrt()).powi(3);
    let scatter = SCATTER_MM_S2.hypot(pose_noise_mps2(poses) * 1e3);
    scatter * (ratio * dof / estimate.poses as f64).sqrt()
}

/// A model that fits better than the one that was selected, but is not plausible.
fn beyond_bounds(beyond: BeyondBounds) -> Problem {
    let BeyondBounds { model, terms, error } = beyond;
    let with = match terms == Terms::NONE {
        true => String::new(),
        false => format!(" with {terms}"),
    };
    let text = format!("the {model}{with} fits much better, but is not plausible: {error}");
    let finding = Code::SmallerModel.warning(text);
    finding.remedy("a smaller model was used, whose intervals do not include this: check the sensor and the data")
}

/// Why a calibration cannot be pushed or exported.
pub(super) fn no_sensitivity() -> Problem {
    let remedy = "to push this calibration, calibrate again with --sensitivity, the nominal LSB/g of the board's range";
    Code::NotForBoards.note("the data are in m/s² or g, a board needs counts").remedy(remedy)
}

/// Largest standard deviation of a pose's mean from white noise, m/s²; 0 if it is unknown.
fn pose_noise_mps2(poses: &[Pose]) -> f64 {
    poses
        .iter()
        .flat_map(|pose| pose.sd_mps2.map(|sd| sd / f64::from(pose.samples.max(1)).sqrt()))
        .fold(0.0, f64::max)
}

/// What a user should know beside the numbers.
pub(super) fn findings(
    data: &Samples<'_>,
    options: &CalibrateOptions,
    poses: &[Pose],
    estimate: Option<&Estimate>,
    changed: Option<Problem>,
    board: Option<(Sensitivity, Range)>,
    lsb_per_g: Option<f64>,
) -> Vec<Problem> {
    let mut findings = data.findings();
    if data.rate.is_some() && (data.poses || options.method != MethodChoice::MultiPosition) {
        let note =
            "the gyroscope is not calibrated: multi-position does it with continuous samples";
        findings.push(Code::Uncalibrated.note(note));
    }
    if data.info().corrected {
        let text = format!("`{}` was corrected by the device before", data.info().name);
        let finding = Code::AlreadyCorrected.warning(text);
        findings.push(
            finding.remedy(
                "the result is what that correction left: calibrate the sensor's raw output",
            ),
        );
    }
    let Some(estimate) = estimate else {
        return findings;
    };
    let missing = |parameters: &[Parameter]| {
        parameters.iter().all(|parameter| !estimate.fitted.contains(*parameter))
    };
    let scales = missing(&[Parameter::ScaleX, Parameter::ScaleY, Parameter::ScaleZ]);
    if scales {
        let text = "scale factors were not fitted: taken as 1";
        findings.push(Code::NotObserved.note(text));
    }
    let misalignments = missing(&[Parameter::MisalignmentXy, Parameter::MisalignmentXz]);
    if misalignments {
        let mrad = estimate.sd().matrix[1][0] * 1e3;
        let text = format!("misalignments were not fitted: taken as 0 ± {mrad:.0} mrad");
        findings.push(Code::NotObserved.note(text));
    }
    let others: Vec<String> = estimate
        .not_observed()
        .iter()
        .filter(|parameter| match parameter.index() {
            0..3 => true,
            3 | 7 | 11 => !scales,
            _ => !misalignments,
        })
        .map(|parameter| parameter.to_string())
        .collect();
    if !others.is_empty() {
        findings.push(Code::NotObserved.warning(format!(
            "not observed: {}; taken as ideal, with the standard deviations typical of datasheets",
            others.join(", ")
        )));
    }
    findings.extend(placement(poses, estimate));
    findings.extend(in_another_unit(poses, estimate));
    findings.extend(estimate.beyond_bounds.map(beyond_bounds));
    let datasheet = options.datasheet.or(data.datasheet());
    let counts = matches!(data.unit, OutputUnit::Counts { .. });
    let used = lsb_per_g.filter(|_| counts);
    findings.extend(sensitivity::finding(estimate, used, datasheet));
    findings.extend(unobserved_by_rotations(poses, estimate));
    let rms = estimate.fitted_rms_mps2 * 1e3;
    let most = match estimate.method {
        Method::FourAngle | Method::ThreeAngle => SUSPICIOUS_OF_TURNS_RMS_MM_S2,
        Method::MultiPosition(Model::Full9) => most_rms_mm_s2(poses, estimate),
        _ => SUSPICIOUS_RMS_MM_S2,
    };
    let explained = changed.is_some() || estimate.beyond_bounds.is_some();
    findings.extend(changed);
    if rms > most && !explained {
        findings.push(Code::Residuals.warning(format!(
            "the residuals, {rms:.0} mm/s² rms, are larger than those of an intact sensor: the model is too small, or poses \
             are disturbed"
        )));
    }
    findings.extend(board.and_then(|(sensitivity, range)| range.finding(sensitivity)));
    if let (None, Some(lsb_per_g)) = (board, lsb_per_g) {
        findings.push(Code::NotForBoards.warning(format!(
            "{lsb_per_g:.1} LSB/g is outside the range of boards (160 to 1048576): this calibration cannot be pushed or exported"
        )));
    }
    if lsb_per_g.is_none() {
        findings.push(no_sensitivity());
    }
    if options.method != MethodChoice::SixPosition || options.sides.is_none() {
        let text = "swapped, mirrored or inverted axes cannot be detected";
        let finding = Code::Axes.note(text);
        findings.push(finding.remedy("to detect them use --method six-position --sides"));
    }
    findings
}

/// Errors of the placement and the repeatability of known orientations.
fn placement(poses: &[Pose], estimate: &Estimate) -> Vec<Problem> {
    let mut findings = Vec::new();
    let Method::SixPosition {
        placement_sd_rad,
        declared_sd_rad,
        misplaced,
        revisit_sd_mps2,
        revisits,
        unexplained,
    } = estimate.method
    else {
        return findings;
    };
    let declared = declared_sd_rad.to_degrees();
    if let Some(side) = misplaced {
        let or = match side.or_opposite {
            true => " or the opposite side",
            false => "",
        };
        let text = format!(
            "side {} up{or} was placed {:.1}° off, declared is {declared:.1}° (1 σ); the intervals of its axis include this",
            side.face,
            side.tilt_rad.to_degrees()
        );
        let finding = Code::Placement.warning(text);
        findings.push(finding.remedy("repeat it, placed squarely"));
    }
    if placement_sd_rad > declared_sd_rad {
        findings.push(Code::Placement.warning(format!(
            "placement was worse than declared: {:.1}° instead of {declared:.1}° (1 σ); the intervals include this",
            placement_sd_rad.to_degrees()
        )));
    }
    let mm = revisit_sd_mps2 * 1e3;
    if unexplained {
        findings.push(Code::Placement.warning(format!(
            "visits of one side differ by {mm:.1} mm/s² (1 σ), more than noise and placement explain: drift, or different \
             placement; the standard deviations include this"
        )));
    } else if revisits == 0 && revisit_sd_mps2 > pose_noise_mps2(poses) {
        let text = format!(
            "each side was measured once: a repeatability of {} mm/s² (1 σ), typical of other sensors, is assumed",
            significant(mm, 3)
        );
        let finding = Code::Placement.note(text);
        findings.push(finding.remedy("measure each side twice to determine it"));
    }
    findings
}
