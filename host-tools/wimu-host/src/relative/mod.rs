//! Digital protractor: rotation and hinge angle between two units on two bodies that a joint connects. Equations (190) to
//! (194) and (196) of docs/reference/equations.

mod clock;
mod engine;
mod findings;
mod hinge;
mod live;
mod pair;
mod report;

use std::f64::consts::TAU;

use nalgebra::{Rotation3, UnitQuaternion, Vector3};

pub use clock::Clock;
pub use hinge::Hinge;
pub use live::{Body, LiveRelative};

use crate::imu::Imu;
use crate::inertial::check_units;
use crate::{Code, Problem, Result};
use engine::{Model, Run};
use pair::{Step, Unit, steps};

/// Headings of the second unit that are tried.
const HEADINGS: u32 = 8;
/// Motion by which a heading is chosen, s.
const CHOICE_S: f64 = 30.0;
/// Difference of the logarithms of two likelihoods below which two headings are equally probable: odds of 1 to 150.
const AMBIGUOUS: f64 = 5.0;
/// Runs with the axis that the run before has found.
const PASSES: usize = 2;
/// Interval at the start that is levelled, s.
const LEVEL_S: f64 = 0.5;

/// What is known of the joint.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct RelativeChoice {
    /// Axis of the hinge, in the axes of both units; `None`: it is found.
    pub hinge: Option<[f64; 3]>,
}

/// Rotation between two units at a time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RelativePoint {
    /// s, clock of the first unit.
    pub time_s: f64,
    /// Angle of the hinge, rad: zero where the axes of units that are mounted alike are parallel.
    pub angle_rad: f64,
    /// Its standard deviation, rad.
    pub sigma_rad: f64,
    /// Axes of the second unit to those of the first, W X Y Z.
    pub quaternion: [f64; 4],
    /// Standard deviation of the rotation about the axes of the first unit, rad.
    pub attitude_sd_rad: [f64; 3],
    /// Whether both units had samples, and the filter an answer.
    pub valid: bool,
}

/// Rotation between two units.
#[derive(Clone, Debug)]
pub struct RelativePath {
    /// In the order of time.
    pub points: Vec<RelativePoint>,
    /// Axis of the joint.
    pub hinge: Hinge,
    /// Clock of the second unit.
    pub clock: Clock,
    /// Normalised innovation squared of the joint over its degrees of freedom, mean: 1 at most where the bodies have a point in
    /// common.
    pub joint_nis: f64,
    /// Position of the joint from each unit, m, in its axes, about: it is not observed along the axis of a hinge.
    pub lever_arms_m: [[f64; 3]; 2],
    /// What was noticed.
    pub findings: Vec<Problem>,
}

/// Estimates the rotation of the second unit relative to the first.
///
/// # Errors
/// `data_refused`: a unit without a gyroscope, outputs in another unit, one recording twice, no common time, no motion of the joint where its axis is
/// not given.
pub fn relative(recordings: [&Imu; 2], choice: &RelativeChoice) -> Result<RelativePath> {
    Ok(search(recordings, choice)?.0)
}

/// The rotation, and the start and the model of its last run.
fn search(
    recordings: [&Imu; 2],
    choice: &RelativeChoice,
) -> Result<(RelativePath, Rotation3<f64>, Model)> {
    let names = recordings.map(|recording| recording.name.as_str()).join(" and ");
    let at = |error: Problem| error.at(&names);
    recordings.into_iter().try_for_each(check_units)?;
    let given = choice.hinge.map(|axis| {
        let remedy = "give three numbers that are not all zero, such as --setup hinge=[0,0,1]";
        Hinge::given(axis).ok_or_else(|| Code::Usage.error("the hinge axis is zero", remedy))
    });
    let given = given.transpose()?;
    let units = units(recordings).map_err(at)?;
    let (clock, mut noticed) = clock::coarse(&units).map_err(at)?;
    let mut model =
        Model { hinge: given, bias_mps2: recordings[0].bias_mps2().max(recordings[1].bias_mps2()) };
    let all = steps(&units, clock.offset_s);
    let start = start(&all, &model, &mut noticed).map_err(at)?;
    let clock = clock::refined(&units, clock, start, &model, &mut noticed);
    let all = steps(&units, clock.offset_s);
    let mut run = engine::run(&all, start, &model);
    let hinge = match given {
        Some(hinge) => hinge,
        None => {
            let found = |run: &Run| {
                Hinge::found(&run.poses).ok_or_else(|| at(findings::no_motion(&run.poses)))
            };
            let mut hinge = found(&run)?;
            for _ in 0..PASSES {
                if hinge.is_a_hinge() {
                    model.hinge = Some(hinge);
                    run = engine::run(&all, start, &model);
                }
                hinge = found(&run)?;
            }
            hinge
        }
    };
    let mut found = presented(run, hinge, clock);
    noticed.extend(recordings.iter().flat_map(|r| r.findings.iter().cloned()));
    noticed.extend(findings::after(&found));
    found.findings = noticed;
    if found.points.iter().any(|point| point.valid) {
        Ok((found, start, model))
    } else {
        Err(at(findings::no_answer()))
    }
}

fn units(recordings: [&Imu; 2]) -> Result<[Unit; 2]> {
    let [first, second] = recordings;
    let force =
        |recording: &'_ Imu| Vec::from_iter(recording.samples.v.iter().map(|s| s.force_mps2));
    if force(first) == force(second) {
        let remedy = "give the recordings of two units on two bodies";
        return Err(Code::DataRefused.error("both have the same samples", remedy));
    }
    let unit = |recording: &Imu| {
        Unit::of(recording).ok_or_else(|| {
            let remedy = "--relative needs an accelerometer and a gyroscope in both units";
            Code::DataRefused.error(format!("{} has no angular rates", recording.name), remedy)
        })
    };
    Ok([unit(first)?, unit(second)?])
}

/// The rotation at the start: both units level, and the heading of the second one of greatest likelihood.
fn start(steps: &[Step], model: &Model, noticed: &mut Vec<Problem>) -> Result<Rotation3<f64>> {
    let until_s = |duration_s: f64| {
        let end_s = steps.first().map_or(0.0, |first| first.time_s + duration_s);
        &steps[..steps.partition_point(|step| step.time_s <= end_s)]
    };
    let level = |k: usize| {
        let sum: Vector3<f64> = until_s(LEVEL_S).iter().map(|step| step.force_mps2[k]).sum();
        Rotation3::rotation_between(&sum, &Vector3::z())
            .unwrap_or_else(|| Rotation3::from_axis_angle(&Vector3::x_axis(), TAU / 2.0))
    };
    let levels = [level(0), level(1)];
    let mut tried = Vec::new();
    for k in 0..HEADINGS {
        let angle = TAU * f64::from(k) / f64::from(HEADINGS);
        let heading = Rotation3::from_axis_angle(&Vector3::z_axis(), angle);
        let start = levels[0].inverse() * heading * levels[1];
        let run = engine::run(until_s(CHOICE_S), start, model);
        let Some(last) = run.poses.last().filter(|_| run.log_likelihood.is_finite()) else {
            continue;
        };
        tried.push((run.log_likelihood, start, last.attitude));
    }
    tried.sort_by(|a, b| b.0.total_cmp(&a.0));
    let Some((best, start, end)) = tried.first().copied() else {
        return Err(findings::no_answer());
    };
    let other =
        |tried: &&(f64, _, Rotation3<f64>)| tried.2.angle_to(&end) > 2.0 * engine::START_RAD;
    if let Some((next, ..)) = tried.iter().find(other)
        && best - next < AMBIGUOUS
    {
        noticed.push(findings::ambiguous());
    }
    Ok(start)
}

/// The angle about a hinge, continuous: more than half a revolution is not folded.
struct Angle {
    hinge: Hinge,
    clock_sd_s: f64,
    /// The last one, rad.
    last: Option<f64>,
}

impl Angle {
    fn new(hinge: Hinge, clock: &Clock) -> Self {
        Self { hinge, clock_sd_s: clock.sd_s, last: None }
    }

    fn point(&mut self, pose: &engine::Pose) -> RelativePoint {
        let axis = Vector3::from(self.hinge.axes[0]);
        let folded = self.hinge.angle(&pose.attitude);
        let turns = self.last.map_or(0.0, |last| ((last - folded) / TAU).round());
        let angle_rad = folded + TAU * turns;
        self.last = Some(angle_rad);
        let by_clock = (pose.attitude * pose.rate_rad_s[1]).dot(&axis) * self.clock_sd_s;
        let quaternion = UnitQuaternion::from_rotation_matrix(&pose.attitude);
        let [x, y, z] = quaternion.imag().into();
        RelativePoint {
            time_s: pose.time_s,
            angle_rad,
            sigma_rad: axis.dot(&(pose.covariance * axis)).sqrt().hypot(by_clock),
            quaternion: [quaternion.w, x, y, z],
            attitude_sd_rad: pose.covariance.diagonal().map(f64::sqrt).into(),
            valid: pose.measured,
        }
    }
}

fn presented(run: Run, hinge: Hinge, clock: Clock) -> RelativePath {
    let mut angle = Angle::new(hinge, &clock);
    RelativePath {
        points: run.poses.iter().map(|pose| angle.point(pose)).collect(),
        hinge,
        clock,
        joint_nis: run.joint_nis,
        lever_arms_m: run.lever_arms_m.map(Into::into),
        findings: Vec::new(),
    }
}
