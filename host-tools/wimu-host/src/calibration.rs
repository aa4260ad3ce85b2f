//! From data to an error model, its report, and the file that goes to a board.

mod datasheet;
mod export;
mod magnetometer;
mod page;
mod reference;
mod report;
mod update;
mod weights;

pub use datasheet::{DatasheetReport, LimitReport, datasheet};
pub use export::{KalibrNoise, not_in_kalibr, to_c, to_kalibr, to_rust};
pub use magnetometer::{FieldPose, MagnetometerReport, calibrate_magnetometer};
pub use reference::{AxisReport, NoiseSource, Paired, ReferenceReport, compare_with_reference};
pub use report::{
    CalibrationReport, DriftReport, Fit, HELD_SCHEMA, NextPose, OtherUnits, Source, StaticPose,
    describe, not_observed, range_remark, read_parameters, write_report,
};

pub use update::{RestReport, UpdateReport, update};

use std::collections::HashSet;

use wimu_calib::{
    Datasheet, Estimate, Face, Gravity, Guide, Method, Model, MultiPosition, Orientation,
    Parameter, Placement, Pose, Refusal, Term, Terms, UnitHint, best_model, four_angle,
    multi_position_with, six_position, six_position_labelled, three_angle,
};
use wimu_link::message::parameter_id;
use wimu_model::{ErrorTerms, ParameterSet, STANDARD_GRAVITY_MPS2, Sensitivity, TemperatureTerms};

use crate::dataset::{Dataset, Output, OutputUnit, RateSource};
use crate::error::{ErrorCode, HostError, Result};

/// More poses than anyone holds still for.
const MAX_POSES: usize = 1000;
/// Below this a board cannot be told a sensitivity, LSB/*g*: [`Sensitivity::from_lsb_per_g`].
const LEAST_OF_A_BOARD_LSB_PER_G: f64 = 160.0;
/// Most orientations that are advised at once.
const MOST_ADVISED: usize = 6;

/// How to estimate.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub enum MethodChoice {
    /// From the magnitude of gravity, any orientations.
    #[default]
    MultiPosition,
    /// From six known orientations.
    SixPosition,
    /// From turns of four steps about level axes.
    FourAngle,
    /// From turns of three steps about level axes.
    ThreeAngle,
}

impl MethodChoice {
    /// As the command line has it.
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
    /// These.
    Fixed(Model),
    /// Those with the least leave-one-out error.
    Auto,
}

impl Default for ModelChoice {
    fn default() -> Self {
        Self::Fixed(Model::Full9)
    }
}

/// What a calibration is asked for.
#[derive(Clone, Debug, Default)]
pub struct CalibrateOptions {
    /// How to estimate.
    pub method: MethodChoice,
    /// What to fit.
    pub model: ModelChoice,
    /// What to fit in any case on top of the model, with [`MethodChoice::MultiPosition`].
    pub terms: Terms,
    /// Which side was up in each pose, in order, with [`MethodChoice::SixPosition`]; told by what
    /// the poses read where it is not given.
    pub sides: Option<Vec<Face>>,
    /// Local gravity, m/s², taken as exact; 9.80665 ± 0.015 where it is not given.
    pub gravity_mps2: Option<f64>,
    /// Nominal sensitivity, LSB/g; else the board's, else the fit's mean.
    pub sensitivity_lsb_per_g: Option<f64>,
    /// Full-scale range at which the data were taken, ± *g*, where they do not say it.
    pub range_g: Option<u8>,
    /// How well known orientations were squared, degrees, 1 σ; 1 where it is not given.
    pub placement_sd_deg: Option<f64>,
    /// The sensor's datasheet, to compare with; without it the device's sensor, where it is known.
    pub datasheet: Option<&'static Datasheet>,
    /// When, s since 1970 UTC: for the parameter set to say.
    pub utc_s: Option<u64>,
}

/// Static poses in the unit of their dataset.
struct Poses {
    poses: Vec<Pose>,
    /// m/s² per unit under which they were looked for.
    scale: f64,
    /// An axis that stood at its limit in some of them.
    saturated: Option<usize>,
}

impl Poses {
    /// Takes out what is equal to an earlier pose to the last digit: a file that was joined to itself, or
    /// a logger that repeats, tells nothing new. Says how many they were.
    fn take_out_repeated(&mut self) -> usize {
        let all = self.poses.len();
        let mut seen = HashSet::with_capacity(all);
        self.poses
            .retain(|pose| seen.insert(pose.mean_mps2.map(f64::to_bits)));
        all - self.poses.len()
    }

    /// The same at another scale.
    fn scaled(&self, scale: f64) -> Vec<Pose> {
        let change = scale / self.scale;
        let scaled = |pose: &Pose| Pose {
            mean_mps2: pose.mean_mps2.map(|axis| axis * change),
            sd_mps2: pose.sd_mps2.map(|axis| axis * change),
            rounding_sd_mps2: pose.rounding_sd_mps2.map(|axis| axis * change),
            ..*pose
        };
        self.poses.iter().map(scaled).collect()
    }
}

/// Estimates the error model from a dataset.
///
/// Data that do not support an answer give a report that says so, not an error.
///
/// # Errors
/// `usage` when an option is out of bounds.
pub fn calibrate(data: &Dataset, options: &CalibrateOptions) -> Result<CalibrationReport> {
    let usage = |message: String, flag: &str| {
        HostError::new(ErrorCode::Usage, message, format!("check {flag}"))
    };
    let (gravity, gravity_source) = match options.gravity_mps2 {
        Some(mps2) => (
            Gravity::new(mps2, 0.0).map_err(|e| usage(e.to_string(), "--gravity"))?,
            Source::Given,
        ),
        None => (Gravity::UNKNOWN_PLACE, Source::Default),
    };
    let placement = match options.placement_sd_deg {
        Some(degrees) => Placement::new(degrees.to_radians())
            .map_err(|e| usage(e.to_string(), "--placement-sd"))?,
        None => Placement::BY_HAND,
    };
    // A coarse sensor can be calibrated, though no board be told.
    let coarse = |lsb_per_g: &f64| (1.0..LEAST_OF_A_BOARD_LSB_PER_G).contains(lsb_per_g);
    let given_coarse = options.sensitivity_lsb_per_g.filter(coarse);
    let given = options
        .sensitivity_lsb_per_g
        .filter(|lsb_per_g| !coarse(lsb_per_g))
        .map(Sensitivity::from_lsb_per_g)
        .transpose()
        .map_err(|e| usage(e.to_string(), "--sensitivity"))?;

    let (known, source) = match (given, data.unit) {
        (None, _) if given_coarse.is_some() => (None, Some(Source::Given)),
        (Some(given), _) => (Some(given), Some(Source::Given)),
        (None, OutputUnit::Counts { nominal, .. }) => match nominal {
            Some(nominal) => (Some(nominal), Some(Source::Board)),
            None => (None, Some(Source::Fit)),
        },
        (None, OutputUnit::Mps2) => (None, None),
    };
    // For counts of unknown worth the median output, most of it at rest, stands for g at first.
    let scale = match (data.unit, known) {
        (OutputUnit::Mps2, _) => 1.0,
        (OutputUnit::Counts { .. }, Some(known)) => known.mps2_per_lsb(),
        (OutputUnit::Counts { .. }, None) => match given_coarse {
            Some(lsb_per_g) => STANDARD_GRAVITY_MPS2 / lsb_per_g,
            None => gravity.mps2() / median_magnitude(data),
        },
    };
    let mut found = poses(data, scale);
    let repeated = match options.method {
        MethodChoice::MultiPosition => found.take_out_repeated(),
        _ => 0,
    };
    if let Some(sides) = &options.sides
        && sides.len() != found.poses.len()
    {
        return Err(usage(
            format!(
                "--sides names {} poses, the data have {}{}",
                sides.len(),
                found.poses.len(),
                begins(data, &found.poses)
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
            let what = MultiPosition {
                model,
                terms: options.terms,
                reject: true,
            };
            multi_position_with(poses, gravity, what)
        }
        (MethodChoice::MultiPosition, ModelChoice::Auto) => {
            best_model(poses, gravity, options.terms, true)
        }
    };
    let mut fitted = found.poses.clone();
    let saturated = found.saturated.map(|axis| Refusal::Saturated { axis });
    let mut outcome = match wrong_unit(data, &found, gravity).or(saturated) {
        Some(refusal) => Err(refusal),
        None => fit(&fitted),
    };
    let mut sensitivity = known;
    // What the fit says of it, whether or not a board could hold it.
    let mut fitted_lsb_per_g = given_coarse;
    if source == Some(Source::Fit)
        && let Ok(estimate) = &outcome
    {
        // Scaling counts scales A: with the mean scale factor taken out, it is 1.
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
        // Twice: what is left is judged by a fit that rests on it.
        for _ in 0..2 {
            let Ok(estimate) = &outcome else { break };
            let Some(poses) = weights::with_noise(estimate, &bare) else {
                break;
            };
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
    let parameters =
        estimate
            .as_ref()
            .zip(sensitivity.zip(range))
            .map(|(estimate, (sensitivity, range))| ParameterSet {
                model: estimate.model,
                quality: estimate.quality(options.utc_s, &fitted),
                sensor: data.sensor,
                ..ParameterSet::uncalibrated(range.g, sensitivity)
            });
    let mut remarks: Vec<String> = said_of_repeated(repeated)
        .into_iter()
        .chain(remarks(
            data,
            options,
            estimate.as_ref(),
            sensitivity.zip(range),
            lsb_per_g,
        ))
        .collect();
    remarks.extend(noise_seen_mps2.map(|sd| {
        format!(
            "poses of fewer samples scatter more: a noise of {:.0} mm/s² a sample is seen in that, and the \
             poses count by it",
            sd * 1e3
        )
    }));
    Ok(CalibrationReport {
        schema: CalibrationReport::SCHEMA,
        status: if estimate.is_some() { "ok" } else { "refused" },
        reason: refusal
            .as_ref()
            .map(|refusal| reason(refusal, &fitted, data, options)),
        remarks,
        source: data.name.clone(),
        method: options.method.name(),
        terms: terms(estimate.as_ref(), options),
        poses: fitted.len(),
        rate_hz: (!data.poses).then_some(data.rate_hz),
        rate_source: (!data.poses).then_some(data.rate_source),
        gravity_m_s2: gravity.mps2(),
        gravity_sd_m_s2: gravity.sd_mps2(),
        gravity_source,
        sensitivity_lsb_per_g: lsb_per_g,
        sensitivity_source: source.filter(|_| lsb_per_g.is_some()),
        range_g: range.map(|range| range.g),
        range_source: range.map(|range| range.source),
        uncalibrated_rms_mm_s2: rms(fitted
            .iter()
            .map(|pose| magnitude(pose.mean_mps2) - gravity.mps2()))
        .map(|rms| rms * 1e3),
        rejected_poses: match options.method {
            MethodChoice::SixPosition => (0..fitted.len())
                .filter(|index| Face::of(&fitted[*index]).is_none())
                .collect(),
            _ => estimate
                .as_ref()
                .map_or(Vec::new(), |e| e.rejected.as_slice().to_vec()),
        },
        next_poses: match &refusal {
            Some(refusal) => next_poses(refusal, &fitted, options),
            None => advice(&fitted, options, 0),
        },
        poses_worth_adding: match options.method {
            MethodChoice::MultiPosition => Guide::after(wanted(options), &fitted).worth(|_| true),
            _ => 0,
        },
        static_poses: static_poses(&fitted, estimate.as_ref()),
        datasheet: options
            .datasheet
            .or(data.datasheet)
            .zip(estimate.as_ref())
            .map(|(datasheet, estimate)| {
                let (used, range) = match data.unit {
                    OutputUnit::Counts { .. } => (lsb_per_g, range.map(|range| range.g)),
                    OutputUnit::Mps2 => (None, None),
                };
                DatasheetReport::new(datasheet, estimate, used, range)
            }),
        fit: estimate.map(|estimate| numbers(&estimate, range)),
        parameter_id: parameters.as_ref().map(|set| parameter_id(set).to_string()),
        parameters,
    })
}

fn said_of_repeated(poses: usize) -> Option<String> {
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

/// When poses begin, for a person to find them by.
fn begins(data: &Dataset, poses: &[Pose]) -> String {
    if data.poses || poses.is_empty() || poses.len() > 40 {
        return String::new();
    }
    let begin = |pose: &Pose| format!("{:.0}", data.since_start_s(pose.first_sample as usize));
    let begins: Vec<String> = poses.iter().map(begin).collect();
    format!(", which begin {} s after the start", begins.join(", "))
}

/// Why it was refused, and what on the command line mends it.
fn reason(refusal: &Refusal, poses: &[Pose], data: &Dataset, options: &CalibrateOptions) -> String {
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
    let mut reason = refusal.to_string();
    if looks_like_means(data, has) {
        return reason + "; the rows look like means over static poses: if they are, add --poses";
    }
    if has == 1 && !data.poses {
        reason += "; what a sensor that lies still tells is its noise: `wimu allan`";
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

/// More rows than anyone has poses.
const MOST_MEANS: usize = 2000;

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

/// Samples among which hardly a pose is found may be in another unit than is said: then their noise
/// passes for motion. Those of unknown worth have none.
fn wrong_unit(data: &Dataset, found: &Poses, gravity: Gravity) -> Option<Refusal> {
    let known = match data.unit {
        OutputUnit::Mps2 => true,
        OutputUnit::Counts { nominal, .. } => nominal.is_some(),
    };
    if !known || data.poses || found.poses.len() > 3 {
        return None;
    }
    let mean_mps2 = median_magnitude(data) * found.scale;
    let hint = not_gravity(mean_mps2, gravity)?;
    Some(Refusal::UnexpectedMagnitude { mean_mps2, hint })
}

/// What an output that is so long at rest, m/s², looks like where it cannot be gravity.
fn not_gravity(mps2: f64, gravity: Gravity) -> Option<UnitHint> {
    let typical = Pose::from_mean([mps2, 0.0, 0.0]);
    let bias = MultiPosition {
        model: Model::Bias3,
        ..MultiPosition::default()
    };
    match multi_position_with(&[typical; 4], gravity, bias) {
        Err(Refusal::UnexpectedMagnitude { hint, .. }) => Some(hint),
        _ => None,
    }
}

/// More than poses of a sound sensor leave, mm/s² rms: 5 mg.
const SUSPICIOUS_RMS_MM_S2: f64 = 50.0;

/// Why a calibration cannot go to a board.
const NO_SENSITIVITY: &str = "the data are in m/s² or g, not in counts: to push or export this calibration, calibrate \
     again with --sensitivity, the nominal LSB/g of the board's range";

/// What the numbers do not show.
fn remarks(
    data: &Dataset,
    options: &CalibrateOptions,
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
        revisit_sd_mps2,
        revisits,
        unexplained,
        ..
    } = estimate.method
    {
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
    let left = estimate.rms_mps2 * 1e3;
    if left > SUSPICIOUS_RMS_MM_S2 && estimate.rejected.as_slice().is_empty() {
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

fn poses(data: &Dataset, scale: f64) -> Poses {
    let mut saturated = None;
    let poses = if data.poses {
        let pose = |(index, output): (usize, &Output)| Pose {
            samples: output.samples,
            temperature_c: output.temperature_c,
            first_sample: index as u64,
            // Without times nothing shows a drift.
            time_s: output.time_s.unwrap_or(0.0),
            ..Pose::from_mean(output.value.map(|axis| axis * scale))
        };
        data.outputs.iter().enumerate().map(pose).collect()
    } else {
        let si = |output: &Output| output.value.map(|axis| axis * scale);
        let forces: Vec<[f64; 3]> = data.outputs.iter().map(si).collect();
        let poses = data.rests(&forces);
        saturated = saturated_axis(forces.into_iter(), &poses);
        poses
    };
    Poses {
        poses,
        scale,
        saturated,
    }
}

/// So many samples at rest at one end of an axis, and so many times those at the next value, are at its
/// limit, where noise is more than so many steps of the output: of free ones few are at their end.
const AT_THE_LIMIT: usize = 10;
const PER_NEXT: usize = 3;
const FINE_STEPS: f64 = 2.0;

/// The axis that stood at its limit in some poses, all the time or when its noise took it there.
fn saturated_axis(samples: impl Iterator<Item = [f64; 3]>, poses: &[Pose]) -> Option<usize> {
    let mut values = [const { Vec::new() }; 3];
    let mut holds = poses.iter().peekable();
    for (index, sample) in (0..).zip(samples) {
        while holds
            .next_if(|pose| index >= pose.first_sample + u64::from(pose.samples))
            .is_some()
        {}
        if holds.peek().is_some_and(|pose| index >= pose.first_sample) {
            for (values, value) in values.iter_mut().zip(sample) {
                values.push(value);
            }
        }
    }
    (0..3).find(|&axis| {
        let values = &mut values[axis];
        values.sort_by(f64::total_cmp);
        let steps = values.windows(2).map(|pair| pair[1] - pair[0]);
        let step = steps
            .filter(|step| *step > 0.0)
            .fold(f64::INFINITY, f64::min);
        let mut noises: Vec<f64> = poses.iter().map(|pose| pose.sd_mps2[axis]).collect();
        noises.sort_by(f64::total_cmp);
        let usual = noises.get(noises.len() / 2).copied().unwrap_or(0.0);
        // Values from that end on.
        let at_limit = |from_end: &mut dyn Iterator<Item = f64>| {
            let mut counts = [0; 2];
            let (mut place, mut last) = (0, None);
            for value in from_end {
                place += usize::from(last.is_some_and(|last: f64| last != value));
                last = Some(value);
                match counts.get_mut(place) {
                    Some(count) => *count += 1,
                    None => break,
                }
            }
            counts[0] >= AT_THE_LIMIT && counts[0] >= PER_NEXT * counts[1]
        };
        usual > FINE_STEPS * step
            && (at_limit(&mut values.iter().copied())
                || at_limit(&mut values.iter().rev().copied()))
    })
}

/// m/s² per unit of a dataset's values: by the sensitivity given, else the board's, else so that the
/// median output is `gravity_mps2`.
pub(crate) fn mps2_per_unit(data: &Dataset, given: Option<Sensitivity>, gravity_mps2: f64) -> f64 {
    match (data.unit, given) {
        (OutputUnit::Mps2, _) => 1.0,
        (_, Some(known))
        | (
            OutputUnit::Counts {
                nominal: Some(known),
                ..
            },
            None,
        ) => known.mps2_per_lsb(),
        _ => gravity_mps2 / median_magnitude(data),
    }
}

fn median_magnitude(data: &Dataset) -> f64 {
    median(data.outputs.iter().map(|output| magnitude(output.value)))
        .filter(|median| *median > 0.0)
        .unwrap_or(1.0)
}

fn median(values: impl Iterator<Item = f64>) -> Option<f64> {
    let mut values: Vec<f64> = values.collect();
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied()
}

fn magnitude(vector: [f64; 3]) -> f64 {
    vector.iter().map(|axis| axis * axis).sum::<f64>().sqrt()
}

fn rms(values: impl Iterator<Item = f64>) -> Option<f64> {
    let (sum, count) = values.fold((0.0, 0.0), |(sum, count), value| {
        (sum + value * value, count + 1.0)
    });
    (count > 0.0).then(|| (sum / count).sqrt())
}

/// A full-scale range, and who said it.
#[derive(Clone, Copy)]
struct Range {
    /// ± *g*.
    g: u8,
    source: Source,
}

impl Range {
    /// As the data say it, else as given, else as 16 bits have it at this sensitivity.
    fn of(unit: OutputUnit, given: Option<u8>, sensitivity: Option<Sensitivity>) -> Option<Self> {
        let board = match unit {
            OutputUnit::Counts { range_g, .. } => range_g,
            OutputUnit::Mps2 => None,
        };
        let told = |source| move |g| Self { g, source };
        let likely = || sensitivity.map(likely_range_g);
        (board.map(told(Source::Board)))
            .or_else(|| given.map(told(Source::Given)))
            .or_else(|| likely().map(told(Source::SixteenBits)))
    }

    /// That nobody has said it.
    fn remark(self, sensitivity: Sensitivity) -> Option<String> {
        (self.source == Source::SixteenBits).then(|| {
            format!(
                "the range is not known: ±{} g is taken, as of 16 bits at {:.0} LSB/g; a board takes the \
                 calibration only at its range: say it with --range",
                self.g,
                sensitivity.lsb_per_g()
            )
        })
    }
}

/// The usual full-scale range of 16 bits at this sensitivity: the power of two below it, a tenth
/// allowed for the sensor's own scale error.
fn likely_range_g(sensitivity: Sensitivity) -> u8 {
    let full_scale_g = 1.1 * 32768.0 / sensitivity.lsb_per_g();
    2_u8.pow((full_scale_g.log2().floor() as u32).min(7))
}

/// What was fitted, or was to be.
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

fn numbers(estimate: &Estimate, range: Option<Range>) -> Fit {
    let known = range.filter(|range| range.source != Source::SixteenBits);
    let range_g = known.map(|range| range.g);
    let sd = estimate.sd();
    let bias = estimate.model.terms().bias_mps2;
    let matrix = estimate.model.terms().matrix;
    Fit {
        fitted: estimate.fitted.iter().map(|p| p.to_string()).collect(),
        not_observed: estimate
            .not_observed()
            .iter()
            .map(|p| p.to_string())
            .collect(),
        dof: estimate.dof,
        rms_mm_s2: estimate.rms_mps2 * 1e3,
        max_mm_s2: estimate.max_mps2 * 1e3,
        loo_rms_mm_s2: estimate.loo_rms_mps2.map(|loo| loo * 1e3),
        condition: estimate.condition,
        worst_sd_mm_s2: estimate.worst_sd_mps2 * 1e3,
        coverage: estimate.coverage,
        temperature_c: estimate.temperature_c,
        temperature_range_c: estimate.temperature_range_c,
        drift: estimate.drift.map(|drift| DriftReport {
            change_m_s2: drift.change_mps2,
            sd_m_s2: estimate.term_sd.drift_mps2,
            span_s: drift.span_s,
        }),
        placement_sd_deg: match estimate.method {
            Method::SixPosition {
                placement_sd_rad, ..
            } => Some(placement_sd_rad.to_degrees()),
            _ => None,
        },
        revisit_sd_mm_s2: match estimate.method {
            Method::SixPosition {
                revisit_sd_mps2, ..
            } => Some(revisit_sd_mps2 * 1e3),
            _ => None,
        },
        model: *estimate.model.terms(),
        sd: ErrorTerms {
            bias_mps2: sd.bias_mps2,
            matrix: sd.matrix,
            temperature: TemperatureTerms {
                reference_c: 0.0,
                bias_mps2_per_k: estimate.term_sd.bias_mps2_per_k,
                bias_mps2_per_k2: [0.0; 3],
                scale_per_k: estimate.term_sd.scale_per_k,
            },
            nonlinearity: estimate.term_sd.nonlinearity,
        },
        half_width_95: Parameter::ALL.map(|parameter| {
            let seen = !estimate.not_observed().contains(parameter);
            seen.then(|| estimate.half_width_95(parameter))
        }),
        units: OtherUnits {
            bias_mg: bias.map(|b| b * 1e3 / STANDARD_GRAVITY_MPS2),
            bias_percent_of_full_scale: range_g.map(|range_g| {
                bias.map(|b| b * 100.0 / (STANDARD_GRAVITY_MPS2 * f64::from(range_g)))
            }),
            scale_error_ppm: [0, 1, 2].map(|axis| (matrix[axis][axis] - 1.0) * 1e6),
        },
        covariance: *estimate.covariance.matrix(),
    }
}

/// What is listed of each pose.
fn static_poses(poses: &[Pose], estimate: Option<&Estimate>) -> Vec<StaticPose> {
    if poses.len() > MAX_POSES {
        return Vec::new();
    }
    let one = |pose: &Pose| StaticPose {
        mean_m_s2: pose.mean_mps2,
        sd_m_s2: pose.sd_mps2,
        samples: pose.samples,
        first_sample: pose.first_sample,
        time_s: pose.time_s,
        temperature_c: pose.temperature_c,
        residual_mm_s2: estimate.map(|estimate| estimate.residual_mps2(pose) * 1e3),
    };
    poses.iter().map(one).collect()
}

/// Standard deviations of nothing.
fn no_terms() -> ErrorTerms {
    ErrorTerms {
        matrix: [[0.0; 3]; 3],
        temperature: TemperatureTerms {
            reference_c: 0.0,
            ..TemperatureTerms::default()
        },
        ..ErrorTerms::default()
    }
}

/// Poses that would help against this refusal.
fn next_poses(refusal: &Refusal, poses: &[Pose], options: &CalibrateOptions) -> Vec<NextPose> {
    match *refusal {
        Refusal::NotObservable { .. } | Refusal::Confounded { .. } => advice(poses, options, 1),
        // One more like the pose that decides alone.
        Refusal::PoorPrediction { pose, .. } => {
            let again = poses.get(pose).map(nearest).map(NextPose::from);
            again.into_iter().chain(advice(poses, options, 1)).collect()
        }
        Refusal::PoseMissing { .. } => Face::ALL
            .into_iter()
            .filter(|face| poses.iter().all(|pose| Face::of(pose) != Some(*face)))
            .map(|face| Orientation::from(face).into())
            .collect(),
        Refusal::TooFewPoses { have, need, .. } => advice(poses, options, need - have),
        _ => Vec::new(),
    }
}

/// The orientations that add most to these poses, as many as are worth it, `least` in any case.
fn advice(poses: &[Pose], options: &CalibrateOptions, least: usize) -> Vec<NextPose> {
    if options.method != MethodChoice::MultiPosition {
        return Vec::new();
    }
    let mut guide = Guide::after(wanted(options), poses);
    let count = guide.worth(|_| true).min(MOST_ADVISED).max(least);
    let next = |remaining| {
        let next = guide.next_of(remaining, |_| true)?;
        guide.take(next.up());
        Some(next.into())
    };
    (1..=count).rev().map_while(next).collect()
}

/// The orientation that a pose is nearest to.
fn nearest(pose: &Pose) -> Orientation {
    let along = |orientation: &Orientation| -> f64 {
        orientation
            .up()
            .iter()
            .zip(pose.mean_mps2)
            .map(|(a, b)| a * b)
            .sum()
    };
    Orientation::ALL
        .into_iter()
        .max_by(|a, b| along(a).total_cmp(&along(b)))
        .unwrap_or(Face::ZUp.into())
}

#[cfg(test)]
mod tests;
