//! A navigator along ranges, with what carries the unit between them.

use nalgebra::{Rotation3, Vector3};
use wimu_nav::navigator::{self, Navigator, Profile, Settings};
use wimu_nav::process::{ConstantVelocity, Odometry, OdometryBlocks};
use wimu_nav::sensor::LineOfSight;
use wimu_nav::state::{Block, Role};

use super::model::Model;
use super::ranging::{AnchorStates, flatten};
use super::{Increment, RangeSample};
use crate::inertial::{PathPoint, StartPose, Tape, sample};
use crate::motion::UnitSample;

/// What carries the unit from one range to the next.
#[derive(Clone, Copy, Debug)]
pub(super) enum Motion<'a> {
    /// Unknown, white acceleration.
    Free,
    /// Wheel odometry in the plane.
    Odometry(&'a [Increment]),
    /// Specific force and angular rate, at these times, s.
    Inertial(&'a [f64], &'a [UnitSample]),
}

/// Where the unit is at the first range, with standard deviations of a component.
#[derive(Clone, Copy, Debug)]
pub(super) struct Start {
    pub position_m: Vector3<f64>,
    pub position_sd_m: f64,
    pub attitude: Rotation3<f64>,
    /// About the horizontal axes, and about the vertical, rad.
    pub attitude_sd_rad: [f64; 2],
    /// Whether the up axis of the anchors points down.
    pub inverted: bool,
}

/// Value and standard deviation of a state at the end of a run.
pub(crate) type Estimate = [f64; 2];

/// An anchor at the end of a run.
#[derive(Clone, Copy, Debug)]
pub(crate) struct AnchorEstimate {
    pub position_m: Vector3<f64>,
    /// Standard deviation of its components, m, where it is estimated.
    pub position_sd_m: Option<Vector3<f64>>,
    pub bias_m: Option<Estimate>,
    pub scale: Option<Estimate>,
}

/// Standard deviation of gravity in the frame of the anchors, m/s²: a tilt of 3°.
const GRAVITY_SD_MPS2: [f64; 3] = [0.5, 0.5, 0.05];

/// Standard deviation of the delay between two sensors of one recording, s.
pub(super) const DELAY_S: f64 = 0.05;

/// Standard deviation of a position from the first ranges beside that of their noise, m: biases, and what the unit moves
/// within their time.
pub(super) const START_M: f64 = 0.1;

/// Standard deviation of the velocity at the start, m/s: walking speed.
pub(super) const SPEED_MPS: f64 = 1.0;

/// A run over a recording.
pub(super) struct Run {
    pub points: Vec<PathPoint>,
    /// Of each range.
    pub judged: Vec<LineOfSight>,
    pub log_likelihood: f64,
    pub anchors: Vec<AnchorEstimate>,
    pub odometer_scale: Option<Estimate>,
    pub delay_s: Option<Estimate>,
    pub contradictions: usize,
    /// Times at which the filter was lost and began again at the position that the last ranges show.
    pub recoveries: Vec<f64>,
}

/// A recording to localize.
#[derive(Clone, Copy, Debug)]
pub(super) struct Recording<'a> {
    /// Positions, m.
    pub anchors: &'a [Vector3<f64>],
    pub ranges: &'a [RangeSample],
    pub motion: Motion<'a>,
    /// Attitude that levels the inertial sensor at its first sample.
    pub level: Rotation3<f64>,
    /// Pose at the start, where it is given.
    pub given: Option<&'a StartPose>,
}

impl Recording<'_> {
    /// Navigates along the ranges up to a time, s, and with `smooth` goes back over them.
    pub fn run(&self, model: &Model, start: &Start, smooth: bool, until_s: f64) -> Run {
        let mut navigator = self.navigator(model, start);
        let odometry = matches!(self.motion, Motion::Odometry(_))
            .then(|| navigator.claim(|layout| OdometryBlocks::claim(layout, &model.odometry)));
        let mut anchors = AnchorStates::claim(self.anchors, model, &mut navigator);
        if !matches!(self.motion, Motion::Free) {
            anchors.delay = Some(navigator.claim(|l| l.claim(Role::Estimated, [DELAY_S])));
        }
        let mut tape = Tape::new(smooth, Vec::new(), &mut navigator);
        let (mut points, mut judged, mut recoveries) = (Vec::new(), Vec::new(), Vec::new());
        let times = self.times(model, until_s);
        let mut now = times.first().copied().unwrap_or_default();
        for time_s in times {
            if time_s > now {
                self.step(model, odometry.as_ref(), [now, time_s], &mut navigator);
                now = time_s;
            }
            let next = self.ranges[judged.len()..].iter();
            for range in next.take_while(|r| r.time_s + model.shift_s <= time_s) {
                let age_s = time_s - range.time_s - model.shift_s;
                judged.push(anchors.update(model, *range, age_s, &mut navigator));
            }
            if anchors.recovers(self.anchors, model, &mut navigator) {
                recoveries.push(time_s);
            }
            points.push(PathPoint::of(time_s, navigator.filter()));
            tape.mark(&mut navigator, &mut points);
        }
        tape.finish(&mut navigator, &mut points);
        let filter = navigator.filter();
        let estimate = |block: Block<1>| {
            [filter.state.get(block).x, filter.covariance(block).x.max(0.0).sqrt()]
        };
        Run {
            points,
            log_likelihood: judged.iter().map(|found| found.log_likelihood).sum(),
            judged,
            anchors: anchors.estimates(filter),
            odometer_scale: odometry.map(|blocks| estimate(blocks.scale)),
            delay_s: anchors.delay.map(estimate),
            contradictions: tape.contradictions,
            recoveries,
        }
    }

    /// A navigator at a start. Without an inertial sensor it is in the plane where the anchors are.
    fn navigator(&self, model: &Model, start: &Start) -> Navigator {
        let gravity_mps2 = if start.inverted { -1.0 } else { 1.0 } * model.gravity_mps2;
        let mut settings = Settings::of(Profile::Free);
        settings.gravity_mps2 = gravity_mps2;
        settings.errors = model.imu;
        (settings.motion, settings.frame_mps2) = match self.motion {
            Motion::Inertial(..) => (navigator::Motion::Gyroscope, GRAVITY_SD_MPS2),
            _ => (navigator::Motion::Process, [0.0; 3]),
        };
        let [tilt_rad, heading_rad] = start.attitude_sd_rad;
        let mut begin = navigator::Start::moving(start.attitude, gravity_mps2);
        begin.tilt_rad = tilt_rad;
        let mut navigator = Navigator::new(settings, &begin);
        let velocity_mps = match self.motion {
            Motion::Odometry(_) => 0.0,
            _ => SPEED_MPS,
        };
        let deviations = [start.position_sd_m, velocity_mps, heading_rad];
        let heading = navigator.heading();
        navigator.set_pose(start.position_m, Vector3::zeros(), heading, deviations);
        if model.planar {
            navigator.change(flatten);
        }
        navigator
    }

    /// Times of the ranges and of the other sensor, each once. Of ranges beside inertial samples those that have no sample
    /// soon after them.
    fn times(&self, model: &Model, until_s: f64) -> Vec<f64> {
        let mut times: Vec<f64> = self.ranges.iter().map(|s| s.time_s + model.shift_s).collect();
        match self.motion {
            Motion::Free => {}
            Motion::Odometry(increments) => times.extend(increments.iter().map(|i| i.time_s)),
            Motion::Inertial(times_s, _) => {
                let next = |time_s: &f64| times_s.get(times_s.partition_point(|t| t < time_s));
                times.retain(|time_s| next(time_s).is_none_or(|next| next - time_s > SOON_S));
                times.extend(times_s);
            }
        }
        times.retain(|t| *t <= until_s);
        times.sort_by(f64::total_cmp);
        times.dedup();
        times
    }

    /// From a time to another, with the sample of the other sensor there, or the part of its increment between them.
    fn step(
        &self,
        model: &Model,
        odometry: Option<&OdometryBlocks>,
        [from, to]: [f64; 2],
        navigator: &mut Navigator,
    ) {
        let step_s = to - from;
        match (self.motion, odometry) {
            (Motion::Inertial(times_s, samples), _) => {
                let at = times_s.partition_point(|t| *t < to);
                match samples.get(at).filter(|_| times_s[at] == to) {
                    Some(found) => {
                        // Every number is finite, and the step is above zero.
                        let found = sample(&UnitSample { step_s, ..*found });
                        let _fault = navigator.push(&found, false).err();
                    }
                    None => navigator.interrupt(step_s),
                }
            }
            (Motion::Odometry(increments), Some(blocks)) => {
                let next = increments.partition_point(|i| i.time_s <= from);
                let within = |i: &&Increment| i.time_s - i.interval_s < 0.5 * (from + to);
                let next = increments.get(next).filter(within);
                let odometry = Odometry {
                    blocks,
                    errors: &model.odometry,
                    distance_m: next.map_or(0.0, |i| i.distance_m),
                    rotation_rad: next.map_or(0.0, |i| i.rotation_rad),
                    interval_s: next.map_or(step_s, |i| i.interval_s),
                    step_s,
                };
                navigator.travel(&odometry, step_s);
            }
            _ => {
                let up = f64::from(!model.planar);
                let density = Vector3::new(1.0, 1.0, up) * model.acceleration;
                navigator.travel(&ConstantVelocity { density, step_s }, step_s);
            }
        }
    }
}

/// A range is used at the next inertial sample, if that is not later than this, s: constant velocity over it is right to 1 cm
/// at 2 m/s².
const SOON_S: f64 = 0.1;
