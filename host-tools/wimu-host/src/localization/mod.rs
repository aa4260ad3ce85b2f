//! Position from ranges to anchors, alone or with wheel odometry or an inertial sensor: filter and smoother with bias, scale
//! and correlated errors of every anchor. Equations (160) to (168) and (172) of docs/reference/equations.

mod anchors;
mod findings;
mod hypotheses;
mod input;
mod model;
mod ranging;
mod run;
mod scales;
mod start;

use nalgebra::{Rotation3, Vector3};
use wimu_nav::navigator::{Sample, Start as Alignment};

pub(crate) use model::Model;
pub use model::RangePrior;
pub(crate) use ranging::AnchorStates;
pub use ranging::Ranging;

use crate::imu::Imu;
use crate::inertial::aids::{Aid, Mounting};
use crate::inertial::{Holes, InertialPath, Method, PathPoint, StartPose};
use crate::{Code, Problem, Result};
use anchors::Misplaced;
use hypotheses::{Chosen, choose, clock_shift, fits};
use run::{DELAY_S, Motion, Recording, Run};
use start::principal_axes;

/// An anchor as its file has it.
#[derive(Clone, Debug, PartialEq)]
pub struct AnchorPosition {
    /// Name.
    pub id: String,
    /// Position, m: east, north, up.
    pub position_m: [f64; 3],
}

/// Wheel odometry over an interval.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Increment {
    /// Its end, s.
    pub time_s: f64,
    /// Its length, s, above zero.
    pub interval_s: f64,
    /// Distance, m.
    pub distance_m: f64,
    /// Rotation from east towards north, rad.
    pub rotation_rad: f64,
}

/// Ranges and what was recorded beside them.
#[derive(Clone, Debug, Default)]
pub struct RangeRecording {
    /// What errors call it.
    pub name: String,
    /// The anchors.
    pub anchors: Vec<AnchorPosition>,
    /// Whether the anchors have no height: all is in the plane.
    pub planar: bool,
    /// In the order of time, each to an anchor by its index.
    pub ranges: Vec<Aid>,
    /// Wheel odometry; empty without.
    pub increments: Vec<Increment>,
    /// Samples of an inertial sensor.
    pub motion: Option<Imu>,
    /// What was noticed at reading.
    pub findings: Vec<Problem>,
}

/// How to localize.
#[derive(Clone, Debug, PartialEq)]
pub struct LocalizationChoice {
    /// The position is valid as long as its standard deviation is below this, m.
    pub limit_m: f64,
    /// Whether a point rests on all ranges, or on those up to it alone.
    pub smooth: bool,
    /// Pose at the start; `None`: the most probable one.
    pub start: Option<StartPose>,
    /// What is known of the ranges; `None`: that of the kind of recording.
    pub prior: Option<RangePrior>,
    /// The anchors' positions are estimated; standard deviation of a component as given, m.
    pub survey_m: Option<f64>,
    /// Antenna of the unit, m, body axes.
    pub lever_arm_m: [f64; 3],
}

impl Default for LocalizationChoice {
    fn default() -> Self {
        Self {
            limit_m: 1.0,
            smooth: true,
            start: None,
            prior: None,
            survey_m: None,
            lever_arm_m: [0.0; 3],
        }
    }
}

/// A parameter with its standard deviations before and after.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct Parameter {
    /// Estimate.
    pub value: f64,
    /// Standard deviation.
    pub sigma: f64,
    /// Standard deviation of the prior, with mean zero.
    pub prior: f64,
}

impl Parameter {
    /// An estimate with its standard deviation, and that of its prior.
    fn of(estimate: Option<[f64; 2]>, prior: f64) -> Option<Self> {
        estimate.map(|[value, sigma]| Self { value, sigma, prior })
    }

    /// Whether the data say more than the prior.
    pub fn is_observed(&self) -> bool {
        self.sigma < OBSERVED * self.prior
    }
}

/// A parameter is observed if its standard deviation falls below this part of the prior.
const OBSERVED: f64 = 0.7;

/// What was found of an anchor.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct AnchorFound {
    /// Name.
    pub id: String,
    /// Ranges.
    pub ranges: usize,
    /// Fraction of the ranges that probably had no line of sight.
    pub blocked: f64,
    /// Bias, m.
    pub bias_m: Option<Parameter>,
    /// Scale error.
    pub scale: Option<Parameter>,
    /// Position, m, and its standard deviation, where it is estimated.
    pub position_m: [f64; 3],
    /// See [`position_m`](Self::position_m).
    pub position_sd_m: Option<[f64; 3]>,
}

/// Scales of the noise, estimated from the recording.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct Noise {
    /// White noise of a range, m.
    pub white_m: f64,
    /// Error that is correlated over 1 s, m.
    pub correlated_m: f64,
    /// Probability of a range without line of sight.
    pub blocked: f64,
    /// Power spectral density of the acceleration, m²/s³, without other sensors.
    pub acceleration_m2s3: Option<f64>,
}

/// What a path from ranges shows of them.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct Ranged {
    /// In the order of the anchors.
    pub anchors: Vec<AnchorFound>,
    /// Noise of the ranges.
    pub noise: Noise,
    /// Scale error of the odometer.
    pub odometer_scale: Option<Parameter>,
    /// Delay of the ranges after the other sensor, s.
    pub delay_s: Option<Parameter>,
}

/// Samples of an inertial sensor from the first range on, and the attitude that levels them; or why they are not used.
fn inertial(
    motion: &Imu,
    first_s: f64,
) -> std::result::Result<(Motion<'_>, Rotation3<f64>), &'static str> {
    let from = motion.samples.t.partition_point(|t| t.s() < first_s);
    let (times, samples) = (&motion.samples.t[from..], &motion.samples.v[from..]);
    let begin = times.first().ok_or("they end before the first range")?;
    if samples.iter().all(|s| s.rate_rad_s.is_none()) {
        return Err("without a gyroscope the direction of the acceleration is not known");
    }
    let count = times.partition_point(|t| *t < begin.after_s(ALIGNMENT_S));
    let sample = |s: &Sample| Sample { rate_rad_s: None, field_ut: None, ..*s };
    let first: Vec<Sample> = samples[..count].iter().map(sample).collect();
    let aligned = Alignment::align(&first, false).ok_or("they do not show gravity at the start")?;
    Ok((Motion::Inertial(times, samples), aligned.attitude))
}

/// Time of the initial alignment with gravity, s.
const ALIGNMENT_S: f64 = 0.5;

/// Estimates the path of a recording.
///
/// # Errors
/// `data_refused`: too few ranges or anchors, most accelerations no numbers, no position to the limit.
pub fn localize(recording: &RangeRecording, choice: &LocalizationChoice) -> Result<InertialPath> {
    if let Some(motion) = &recording.motion
        && let Some(holes) = Holes::of(motion)?
    {
        let mut whole = recording.clone();
        whole.motion = Some(holes.left_out_of(motion));
        whole.findings.extend(holes.findings);
        return localized(&whole, choice);
    }
    localized(recording, choice)
}

/// The path of a recording of which every inertial sample is a number.
fn localized(recording: &RangeRecording, choice: &LocalizationChoice) -> Result<InertialPath> {
    let mut noticed = recording.findings.clone();
    noticed.extend(findings::before(recording)?);
    findings::same_time(recording)?;
    let first_s = recording.ranges[0].time_s;
    let motion = recording.motion.as_ref();
    let sensed = motion.map(|motion| inertial(motion, first_s));
    if let Some(Err(why)) = &sensed {
        let text = format!("the inertial samples are not used: {why}");
        noticed.push(Code::Navigation.warning(text));
    }
    let (motion, level) = sensed.and_then(std::result::Result::ok).unwrap_or_else(|| {
        let motion = if recording.increments.is_empty() {
            Motion::Free
        } else {
            Motion::Odometry(&recording.increments)
        };
        (motion, Rotation3::identity())
    });
    let prior = Model::of(recording, choice);
    let ranging = Ranging::of(recording, prior);
    let mut problem = Recording {
        ranging: &ranging,
        mounting: Mounting { lever_arm_m: choice.lever_arm_m, ..Mounting::default() },
        ranges: &recording.ranges,
        motion,
        level,
        given: choice.start.as_ref(),
    };
    let at = |error: Problem| error.at(&recording.name);
    let (mut run, mut model, mut chosen) = solved(&problem, prior, choice).map_err(at)?;
    let shift_s = if fits(&model, run.delay()) && !run.navigator.is_contradicted() {
        None
    } else {
        clock_shift(&problem, &model).map_err(at)?
    };
    if let Some(shift_s) = shift_s {
        let shifted = Model { shift_s, ..prior };
        let found = solved(&problem, shifted, choice).map_err(at)?;
        let explains = fits(&found.1, found.0.delay());
        noticed.push(findings::clock(shift_s, explains));
        if explains {
            (run, model, chosen) = found;
        }
    }
    let corrected;
    let is_scaled = model.has_scale() && !prior.has_scale();
    let contradicts = !fits(&model, run.delay())
        || run.navigator.suspected().is_some()
        || run.unlike_biases(&model).next().is_some();
    if (is_scaled || contradicts) && choice.survey_m.is_none() {
        let shifted = Model { shift_s: model.shift_s, ..prior };
        if let Some((error, found, solution)) =
            with_anchors(&problem, shifted, choice, (&model, &chosen))
        {
            noticed.push(error.finding(&ranging, &found));
            corrected = found;
            problem = Recording { ranging: &corrected, ..problem };
            (run, model, chosen) = solution;
        }
    }
    noticed.extend(findings::after(recording, &run, &chosen));
    if chosen.other.is_some() {
        or_mirrored(&mut run.points, &ranging.positions_m(), recording.planar);
    }
    noticed.extend(findings::unlike(recording, &run, &model));
    let (mut path, ranged) = presented(recording, &problem, choice, &model, run);
    noticed.extend(findings::unobserved(&ranged));
    path.findings = noticed;
    path.ranging = Some(ranged);
    let is_mirrored = chosen.other.is_some();
    let remedy = findings::remedy(recording, &ranging.positions_m(), is_mirrored);
    Ok(path.checked(&recording.name, &remedy)?.ended())
}

/// Makes points one of two that are equally probable: themselves, or their mirror images in the plane of the anchors; in the
/// plane where all is, in the line of the anchors.
fn or_mirrored(points: &mut [PathPoint], anchors_m: &[Vector3<f64>], planar: bool) {
    let centre = anchors_m.iter().sum::<Vector3<f64>>() / anchors_m.len() as f64;
    let axes = principal_axes(anchors_m, &centre);
    let normal =
        if planar { Vector3::z().cross(&axes.column(0)) } else { axes.column(2).into_owned() };
    for point in points {
        let from_plane_m = (Vector3::from(point.position_m) - centre).dot(&normal);
        point.or_at(normal * (2.0 * from_plane_m));
    }
}

/// The run with the most probable start and the scales of greatest likelihood.
fn solved(
    problem: &Recording,
    prior: Model,
    choice: &LocalizationChoice,
) -> Result<(Run, Model, Chosen)> {
    let first = choose(problem, &prior).ok_or_else(|| {
        let remedy = "check units and anchors, or give the start: --start E,N,U";
        Code::DataRefused.error("no position explains the first ranges", remedy)
    })?;
    let (mut model, mut chosen) = (prior, first);
    if prior.adapts {
        (model, chosen) = adapted(problem, prior, chosen);
        if !fits(&model, 0.0) && !prior.has_scale() {
            (model, chosen) = with_scale(problem, prior, (model, chosen));
        }
    }
    let run = problem.run(&model, &chosen.start, choice.smooth);
    Ok((run, model, chosen))
}

/// The scales of greatest likelihood, and the most probable start with them.
fn adapted(problem: &Recording, prior: Model, chosen: Chosen) -> (Model, Chosen) {
    let model = scales::adapted(problem, &prior, &chosen.start);
    (model, choose(problem, &model).unwrap_or(chosen))
}

/// The same with a scale error, where it explains the ranges better by Schwarz's criterion; else what was found without.
fn with_scale(
    problem: &Recording,
    prior: Model,
    (model, chosen): (Model, Chosen),
) -> (Model, Chosen) {
    let scaled = prior.with_scale();
    let Some(start) = choose(problem, &scaled) else {
        return (model, chosen);
    };
    let (scaled, start) = adapted(problem, scaled, start);
    let explains = merit(problem, &scaled, &start) > merit(problem, &model, &chosen);
    if explains { (scaled, start) } else { (model, chosen) }
}

/// The same with an error of the file of anchors that explains the ranges, and better, likewise.
fn with_anchors(
    problem: &Recording,
    prior: Model,
    choice: &LocalizationChoice,
    (model, chosen): (&Model, &Chosen),
) -> Option<(Misplaced, Ranging, (Run, Model, Chosen))> {
    let (error, ranging) = Misplaced::search(problem, &prior)?;
    let corrected = Recording { ranging: &ranging, ..*problem };
    let found = solved(&corrected, prior, choice).ok()?;
    // Three coordinates.
    let merit_then = merit(&corrected, &found.1, &found.2) - problem.cost(3);
    let explains = fits(&found.1, found.0.delay()) && merit_then > merit(problem, model, chosen);
    explains.then_some((error, ranging, found))
}

/// Logarithm of the likelihood of all ranges, less the cost of scale errors where the model has them.
fn merit(problem: &Recording, model: &Model, chosen: &Chosen) -> f64 {
    let scales = if model.has_scale() { problem.ranging.anchors.len() + 1 } else { 0 };
    problem.log_likelihood(model, &chosen.start, f64::INFINITY) - problem.cost(scales)
}

fn presented(
    recording: &RangeRecording,
    problem: &Recording,
    choice: &LocalizationChoice,
    model: &Model,
    run: Run,
) -> (InertialPath, Ranged) {
    let method = match problem.motion {
        Motion::Free => Method::Ranges,
        Motion::Odometry(_) => Method::Odometry,
        Motion::Inertial(..) => Method::RangesInertial,
    };
    let scale = model.ranges.scale.hypot(model.common[1]);
    let bias = model.ranges.bias_m.hypot(model.common[0]);
    let anchor = |(index, anchor): (usize, &AnchorPosition)| {
        let own = &run.anchors[index];
        let residuals = run.navigator.residuals.iter().filter(|r| r.source == index);
        let ranges = residuals.clone().count();
        let blocked = residuals.filter(|r| !r.accepted && r.value > 0.0).count();
        AnchorFound {
            id: anchor.id.clone(),
            ranges,
            blocked: blocked as f64 / ranges.max(1) as f64,
            bias_m: Parameter::of(own.bias_m, bias),
            scale: Parameter::of(own.scale, scale),
            position_m: own.position_m.into(),
            position_sd_m: own.position_sd_m.map(Into::into),
        }
    };
    let anchors = recording.anchors.iter().enumerate().map(anchor).collect();
    let odometer_scale = Parameter::of(run.navigator.wheel_scale(), model.odometry.scale);
    let delay_s = Parameter::of(run.delay_s, DELAY_S);
    let free = matches!(problem.motion, Motion::Free);
    let mut path = InertialPath::new(method, run.points, 0, choice.limit_m);
    for point in &mut path.points {
        point.valid = point.sd_m() <= choice.limit_m;
    }
    path.smoothed = choice.smooth;
    path.residuals = run.navigator.residuals;
    path.aids = run.navigator.uses;
    let ranged = Ranged {
        anchors,
        noise: Noise {
            white_m: model.ranges.noise_m,
            correlated_m: model.ranges.correlated_m,
            blocked: model.line_of_sight.probability,
            acceleration_m2s3: free.then_some(model.acceleration),
        },
        odometer_scale,
        delay_s,
    };
    (path, ranged)
}
