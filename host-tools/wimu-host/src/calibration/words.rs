//! What a calibration says beside its numbers.

use wimu_calib::{Estimate, Face, Method, Model, Parameter, Pose, Refusal, Term};
use wimu_model::Sensitivity;

use super::input::{magnitude, median, median_magnitude};
use super::range::Range;
use super::{CalibrateOptions, MethodChoice, ModelChoice, bend};
use crate::dataset::{Dataset, Output, RateSource};

pub(super) fn said_of_repeated(poses: usize) -> Option<String> {
    let one = poses == 1;
    (poses > 0).then(|| {
        format!(
            "{poses} pose{} equal to {} to the last digit and tell{} nothing new: left out, and not \
             counted where poses are numbered",
            if one { " is" } else { "s are" },
            if one { "another" } else { "others" },
            if one { "s" } else { "" },
        )
    })
}

pub(super) fn said_of_closing(poses: usize) -> Option<String> {
    let one = poses == 1;
    (poses > 0).then(|| {
        format!(
            "{poses} pose{} back at the beginning of a turn and tell{} of nothing but that: left out, and not counted \
             where poses are numbered",
            if one { " is" } else { "s are" },
            if one { "s" } else { "" },
        )
    })
}

/// When poses begin, for a person to find them by.
pub(super) fn begins(data: &Dataset, poses: &[Pose]) -> String {
    if data.poses || poses.is_empty() || poses.len() > 40 {
        return String::new();
    }
    let begin = |pose: &Pose| format!("{:.0}", data.since_start_s(pose.first_sample as usize));
    let begins: Vec<String> = poses.iter().map(begin).collect();
    format!(", which begin {} s after the start", begins.join(", "))
}

/// Why it was refused, and what on the command line mends it.
pub(super) fn reason(
    refusal: &Refusal,
    poses: &[Pose],
    data: &Dataset,
    options: &CalibrateOptions,
) -> String {
    let has = poses.len();
    if let Refusal::NotATurn { steps, .. } = *refusal
        && has < steps
    {
        return format!(
            "{has} static pose{} found, a turn has {steps} steps of {}°: turn about one axis of the \
             sensor, in one direction, and hold it still for two seconds at each step",
            if has == 1 { "" } else { "s" },
            360 / steps.max(1)
        );
    }
    if let Refusal::NotATurn { pose, steps } = *refusal
        && has < pose + steps
    {
        let one = has == pose + 1;
        return format!(
            "{} (from 0) {} not {steps} steps of {}° about a level axis but {}: each turn needs {steps} poses, in order, \
             and no others{}",
            if one {
                format!("pose {pose}")
            } else {
                format!("poses {pose} to {}", has - 1)
            },
            if one { "is" } else { "are" },
            360 / steps.max(1),
            has - pose,
            begins(data, poses)
        );
    }
    let mut reason = refusal.to_string();
    if looks_like_means(data, has) {
        return reason + "; the rows look like means over static poses: if they are, add --poses";
    }
    if let (Refusal::TooFewPoses { .. }, Some(per_s)) = (refusal, turned_slowly(data)) {
        reason += &format!(
            "; the sensor was turned all the time, by {per_s:.0}° in a second: a pose is where it stands still"
        );
    }
    if has == 1 && !data.poses {
        reason += "; what a sensor that lies still tells is its noise: `wimu allan`";
    }
    if matches!(
        refusal,
        Refusal::PoorFit { .. } | Refusal::PoseContradicted { .. }
    ) {
        reason.extend(what_changed(poses, options));
    }
    let lacks = matches!(
        refusal,
        Refusal::TooFewPoses { .. }
            | Refusal::NotObservable { .. }
            | Refusal::Confounded { .. }
            | Refusal::PoorPrediction { .. }
    );
    if !lacks || options.method != MethodChoice::MultiPosition {
        return reason;
    }
    let fixed = options.model != ModelChoice::Auto;
    if fixed && has > Model::Bias3.parameters() {
        reason += "; --model auto takes the model that these poses support best";
    }
    let up = |face: &Face| poses.iter().any(|pose| Face::of(pose) == Some(*face));
    if Face::ALL.iter().all(up) {
        reason += "; all six sides are there: where they were squared, --method six-position gives \
                   all 12 parameters";
    }
    reason
}

/// What may have moved the bias between poses that one bias does not fit, and what fits that.
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
            "; the temperature went from {low:.0} to {high:.0} °C meanwhile: --model auto+temperature fits what that \
             does to the sensor"
        ));
    }
    let tried = options.terms.contains(Term::Drift) || options.model == ModelChoice::Auto;
    let [begin, end] = of(|pose| Some(pose.time_s)).filter(|_| !tried)?;
    (end > begin).then(|| "; or the bias moved meanwhile: --model auto+drift fits that".to_owned())
}

/// More rows than anyone has poses.
const MOST_MEANS: usize = 2000;

/// In degrees per second, of seconds that nearly all differ: as of a sensor that nobody puts down.
const SLOW_TURN: std::ops::RangeInclusive<f64> = 0.5..=30.0;

/// How fast a sensor was turned, degrees per second, that never stood still and was not shaken either.
fn turned_slowly(data: &Dataset) -> Option<f64> {
    let second = data.rate_hz.round().max(1.0) as usize;
    let means: Vec<[f64; 3]> = data
        .outputs
        .chunks_exact(second)
        .filter(|_| !data.poses)
        .map(|samples| {
            let sum = |axis: usize| samples.iter().map(|sample| sample.value[axis]).sum::<f64>();
            [0, 1, 2].map(|axis| sum(axis) / second as f64)
        })
        .collect();
    let between = |pair: &[[f64; 3]]| {
        let dot: f64 = (0..3).map(|axis| pair[0][axis] * pair[1][axis]).sum();
        let cosine = dot / (magnitude(pair[0]) * magnitude(pair[1]));
        cosine.clamp(-1.0, 1.0).acos().to_degrees()
    };
    let angles: Vec<f64> = means.windows(2).map(between).collect();
    let turning = angles
        .iter()
        .filter(|angle| SLOW_TURN.contains(angle))
        .count();
    let enough = angles.len() >= 20 && 10 * turning >= 9 * angles.len();
    median(angles.into_iter()).filter(|_| enough)
}

/// Whether rows among which hardly a rest is found are each of the length of gravity, and too far apart
/// for samples.
fn looks_like_means(data: &Dataset, found: usize) -> bool {
    if data.poses || found > 1 || data.outputs.len() > MOST_MEANS {
        return false;
    }
    let median = median_magnitude(data);
    let near = |output: &&Output| (magnitude(output.value) / median - 1.0).abs() < 0.2;
    let alike = data.outputs.iter().filter(near).count();
    data.rate_source == RateSource::Assumed && 10 * alike >= 9 * data.outputs.len()
}

/// Poses left out because they are in g among m/s².
fn in_another_unit(poses: &[Pose], estimate: &Estimate) -> Option<String> {
    let g = estimate.gravity.mps2();
    let short = |k: &&usize| {
        let pose = poses.get(**k);
        pose.is_some_and(|pose| (7.3..13.0).contains(&(g / magnitude(pose.mean_mps2))))
    };
    let short: Vec<String> = estimate
        .rejected
        .as_slice()
        .iter()
        .filter(short)
        .map(usize::to_string)
        .collect();
    let one = short.len() == 1;
    (!short.is_empty()).then(|| {
        format!(
            "pose{} {} (from 0), left out, look{} like g among poses in m/s²: give all in one unit",
            if one { "" } else { "s" },
            short.join(", "),
            if one { "s" } else { "" },
        )
    })
}

/// What turns cannot show of themselves.
fn what_a_turn_hides(poses: &[Pose], estimate: &Estimate) -> Vec<String> {
    let steps = match estimate.method {
        Method::FourAngle => 4,
        Method::ThreeAngle => 3,
        _ => return Vec::new(),
    };
    let mut remarks = Vec::new();
    let unseen = [Parameter::BiasX, Parameter::BiasY, Parameter::BiasZ]
        .into_iter()
        .position(|bias| !estimate.fitted.contains(bias));
    if let Some(axis) = unseen {
        let mean = poses.iter().map(|pose| pose.mean_mps2[axis]).sum::<f64>() / poses.len() as f64;
        let share = (mean / estimate.gravity.mps2()).abs().min(1.0);
        remarks.push(format!(
            "all turns were about {}, which reads {mean:+.2} m/s²: that is its bias, or an axle {:.0}° from level, \
             which takes {:.1} % from the scale factors; a turn about another axis tells which",
            ["X", "Y", "Z"][axis],
            share.asin().to_degrees(),
            100.0 * (1.0 - (1.0 - share * share).sqrt()),
        ));
    }
    if steps == 3 && poses.len() == steps {
        remarks.push(
            "nothing is left of three steps to check them by: one that is 8° off passes for 4 % of scale factor; \
             --method four-angle shows it"
                .to_owned(),
        );
    }
    remarks
}

/// No sensor reads every orientation this nearly alike, as a share.
const NORMALISED: f64 = 1e-4;
/// Orientations that show it.
const FEWEST_NORMALISED: usize = 6;

/// Poses that are all of one length were divided by it: nothing of the sensor is left in that.
fn normalised(poses: &[Pose], estimate: &Estimate) -> Option<&'static str> {
    let sizes = || poses.iter().map(|pose| magnitude(pose.mean_mps2));
    let first = sizes().next()?;
    let alike = sizes().all(|size| (size / first - 1.0).abs() < NORMALISED);
    let enough = estimate.orientations >= FEWEST_NORMALISED;
    (alike && enough).then_some(
        "every pose is of the same length to 0.01 %, as no sensor has it: the data look normalised, or corrected \
         already; what the sensor itself put out is needed",
    )
}

/// More than poses of a sound sensor leave, mm/s² rms: 5 mg.
const SUSPICIOUS_RMS_MM_S2: f64 = 50.0;

/// The same of turns, mm/s² rms: misalignments, which they do not fit, of 2 % of each axis leave g √2 0.02/2, 1 σ; twice that.
const SUSPICIOUS_OF_TURNS_RMS_MM_S2: f64 = 280.0;

/// Why a calibration cannot go to a board.
pub(super) const NO_SENSITIVITY: &str = "the data are in m/s² or g, not in counts: to push or export this calibration, calibrate \
     again with --sensitivity, the nominal LSB/g of the board's range";

/// What the numbers do not show.
pub(super) fn remarks(
    data: &Dataset,
    options: &CalibrateOptions,
    poses: &[Pose],
    estimate: Option<&Estimate>,
    told: Option<(Sensitivity, Range)>,
    lsb_per_g: Option<f64>,
) -> Vec<String> {
    let mut remarks = Vec::new();
    if data.rate_source == RateSource::Assumed && !data.poses {
        let timed = data.outputs.iter().any(|output| output.time_s.is_some());
        remarks.push(format!(
            "the data have no {}: {} Hz assumed",
            if timed {
                "two times within a second of each other (is their unit right?)"
            } else {
                "times"
            },
            data.rate_hz
        ));
    }
    remarks.extend(data.gaps_remark());
    let Some(estimate) = estimate else {
        return remarks;
    };
    let missing = |parameters: &[Parameter]| {
        parameters
            .iter()
            .all(|parameter| !estimate.fitted.contains(*parameter))
    };
    let [mut scales, mut misalignments] = [false; 2];
    if missing(&[Parameter::ScaleX, Parameter::ScaleY, Parameter::ScaleZ]) {
        scales = true;
        remarks.push("scale factors were not fitted and are taken as 1".to_owned());
    }
    if missing(&[Parameter::MisalignmentXy, Parameter::MisalignmentXz]) {
        misalignments = true;
        remarks.push("misalignments were not fitted and are taken as 0".to_owned());
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
        remarks.push(format!(
            "nothing here shows {}: taken as those of a perfect sensor, as uncertain as datasheets have it",
            others.join(", ")
        ));
    }
    if let Method::SixPosition {
        placement_sd_rad,
        declared_sd_rad,
        misplaced,
        revisit_sd_mps2,
        revisits,
        unexplained,
    } = estimate.method
    {
        let declared = declared_sd_rad.to_degrees();
        if let Some(side) = misplaced {
            let or = if side.or_opposite {
                " or the opposite side"
            } else {
                ""
            };
            remarks.push(format!(
                "the side {} up{or} was placed about {:.1}° off, declared is {declared:.1}° (1 σ): the \
                 intervals of its axis include it; put it up again, square",
                side.face,
                side.tilt_rad.to_degrees()
            ));
        }
        if placement_sd_rad > declared_sd_rad {
            remarks.push(format!(
                "the sides were placed worse than declared, {:.1}° rather than {declared:.1}° (1 σ): the \
                 intervals include it",
                placement_sd_rad.to_degrees()
            ));
        }
        let mm = revisit_sd_mps2 * 1e3;
        if unexplained {
            remarks.push(format!(
                "visits of one side differ by more than noise and placement explain, {mm:.1} mm/s² (1 σ): \
                 the sensor drifts, or was not put down alike; the standard deviations include it"
            ));
        } else if revisits == 0 && mm > 0.0 {
            remarks.push(format!(
                "each side was up once: that a position comes back to {mm:.1} mm/s² (1 σ) is taken \
                 from other sensors; put each up twice to see it"
            ));
        }
    }
    remarks.extend(in_another_unit(poses, estimate));
    remarks.extend(bend::remark(poses, estimate).map(str::to_owned));
    remarks.extend(normalised(poses, estimate).map(str::to_owned));
    remarks.extend(what_a_turn_hides(poses, estimate));
    let left = estimate.rms_mps2 * 1e3;
    let most = match estimate.method {
        Method::FourAngle | Method::ThreeAngle => SUSPICIOUS_OF_TURNS_RMS_MM_S2,
        _ => SUSPICIOUS_RMS_MM_S2,
    };
    if left > most && estimate.rejected.as_slice().is_empty() {
        remarks.push(format!(
            "what is left, {left:.0} mm/s² rms, is more than poses of a sound sensor leave: the model \
             is too small, or poses are bad"
        ));
    }
    remarks.extend(told.and_then(|(sensitivity, range)| range.remark(sensitivity)));
    if let (None, Some(lsb_per_g)) = (told, lsb_per_g) {
        remarks.push(format!(
            "{lsb_per_g:.1} LSB/g is outside what a board can be told (160 to 65536): this calibration \
             cannot be pushed or exported"
        ));
    }
    if lsb_per_g.is_none() {
        remarks.push(NO_SENSITIVITY.to_owned());
    }
    if options.method != MethodChoice::SixPosition || options.sides.is_none() {
        remarks.push(
            "nothing here shows axes that are swapped, mirrored or inverted: --method six-position \
             --sides does"
                .to_owned(),
        );
    }
    remarks
}
