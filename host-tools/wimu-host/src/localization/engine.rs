//! The filter over ranges with what carries the unit between them, and its smoother.

use nalgebra::{Matrix1, Matrix3, Rotation3, Vector3};
use wimu_nav::filter::{Filter, Gate};
use wimu_nav::process::{
    AccelerationOffset, ConstantVelocity, Odometry, OdometryBlocks, Strapdown, StrapdownBlocks,
    Unmeasured,
};
use wimu_nav::sensor::{Anchor, CorrelatedErrors, LineOfSight, Range};
use wimu_nav::smoother::Recorder as _;
use wimu_nav::state::{Block, Layout, LayoutFull, POSITION, Role, VELOCITY};

use super::model::Model;
use super::{Increment, RangeSample, start};
use crate::inertial::{PathPoint, StartPose, Tape};
use crate::motion::UnitSample;
use crate::{Code, Result};

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
type Estimate = [f64; 2];

/// An anchor at the end of a run.
#[derive(Clone, Copy, Debug)]
pub(super) struct AnchorEstimate {
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
    /// Of each range that was used.
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

/// States of the filter with all their blocks.
struct States {
    anchors: Vec<Anchor<f64>>,
    odometry: Option<OdometryBlocks>,
    /// With the error of gravity in the frame of the anchors, m/s².
    strapdown: Option<(StrapdownBlocks, Block<3>)>,
    /// Delay of the ranges after the other sensor, s.
    delay: Option<Block<1>>,
}

impl Recording<'_> {
    /// Runs the smallest filter that has the states over the ranges up to a time, s, and with `smooth` its smoother.
    ///
    /// # Errors
    /// `data_refused`: too many anchors.
    pub fn run(&self, model: &Model, start: &Start, smooth: bool, until_s: f64) -> Result<Run> {
        self.run_with::<24>(model, start, smooth, until_s)
            .or_else(|_| self.run_with::<36>(model, start, smooth, until_s))
            .or_else(|_| self.run_with::<64>(model, start, smooth, until_s))
            .map_err(|error| {
                let remedy = "give at most 22 anchors; with --survey at most 9";
                Code::DataRefused.error(format!("too many anchors: {error}"), remedy)
            })
    }

    fn run_with<const N: usize>(
        &self,
        model: &Model,
        start: &Start,
        smooth: bool,
        until_s: f64,
    ) -> std::result::Result<Run, LayoutFull> {
        let model = &Model {
            gravity_mps2: if start.inverted { -1.0 } else { 1.0 } * model.gravity_mps2,
            ..*model
        };
        let (mut filter, states) = self.filter::<N>(model, start)?;
        let mut tape = Tape::<N>::new(smooth, Vec::new());
        tape.restarted(&filter);
        let (mut points, mut judged) = (Vec::new(), Vec::new());
        let (mut log_likelihood, mut next, mut known) = (0.0, 0, 0);
        let mut recoveries = Vec::new();
        let times = self.times(model, until_s);
        let mut now = times.first().copied().unwrap_or_default();
        for time_s in times {
            let step_s = time_s - now;
            if step_s > 0.0 {
                self.predict(model, &states, [now, time_s], &mut filter, &mut tape);
                now = time_s;
            }
            while let Some(sample) =
                self.ranges.get(next).filter(|s| s.time_s + model.shift_s <= time_s)
            {
                let range = Range {
                    anchor: &states.anchors[sample.anchor],
                    range_m: sample.range_m,
                    deviation_m: model.ranges.noise_m,
                    lever_arm_m: model.lever_arm_m.into(),
                    delay: states.delay,
                };
                let (weighted, found) = range.weighted(&filter, &model.line_of_sight);
                judged.push(found);
                log_likelihood += found.log_likelihood;
                if found.innovation_m.abs() <= model.gate * found.variance_m2.sqrt() {
                    filter.update_recorded(&weighted, Gate::Open, &mut tape);
                }
                next += 1;
            }
            tape.updated(&filter, step_s);
            let from = self.ranges.partition_point(|r| r.time_s + model.shift_s < time_s - LOST_S);
            let recent = from.max(known)..next;
            let window = &self.ranges[recent.clone()];
            if model.gate.is_infinite() && is_lost(window, &judged[recent]) {
                let found = start::candidates(self.anchors, window, model);
                if let Some(found) = found.first() {
                    let again = Start {
                        position_m: found.position_m,
                        position_sd_m: found.deviation_m + START_M,
                        ..*start
                    };
                    self.place(model, &again, &mut filter);
                    tape.restarted(&filter);
                    recoveries.push(time_s);
                    known = next;
                }
            }
            points.push(PathPoint::of(time_s, &filter));
            tape.mark(&mut points);
        }
        tape.finish(&mut points);
        let estimate = |block: Block<1>| {
            let variance = filter.covariance(block).x;
            [filter.state.get(block).x, variance.max(0.0).sqrt()]
        };
        let anchor = |anchor: &Anchor<f64>| AnchorEstimate {
            position_m: anchor.position(&filter.state),
            position_sd_m: anchor.offset.map(|block| {
                let variances = filter.covariance(block).diagonal();
                variances.map(|v| v.max(0.0).sqrt())
            }),
            bias_m: anchor.bias.map(estimate),
            scale: anchor.scale.map(estimate),
        };
        Ok(Run {
            points,
            judged,
            log_likelihood,
            anchors: states.anchors.iter().map(anchor).collect(),
            odometer_scale: states.odometry.map(|blocks| estimate(blocks.scale)),
            delay_s: states.delay.map(estimate),
            contradictions: tape.contradictions,
            recoveries,
        })
    }

    /// Times of the ranges and of the other sensor, each once.
    fn times(&self, model: &Model, until_s: f64) -> Vec<f64> {
        let mut times: Vec<f64> = self.ranges.iter().map(|s| s.time_s + model.shift_s).collect();
        match self.motion {
            Motion::Free => {}
            Motion::Odometry(increments) => times.extend(increments.iter().map(|i| i.time_s)),
            Motion::Inertial(times_s, _) => times.extend(times_s),
        }
        times.retain(|t| *t <= until_s);
        times.sort_by(f64::total_cmp);
        times.dedup();
        times
    }

    fn filter<const N: usize>(
        &self,
        model: &Model,
        start: &Start,
    ) -> std::result::Result<(Filter<f64, N>, States), LayoutFull> {
        let [tilt, heading] = start.attitude_sd_rad;
        let mut layout = Layout::<f64, N>::new([tilt, tilt, heading], 0.0, 0.0);
        let strapdown = match self.motion {
            Motion::Inertial(..) => {
                let blocks = StrapdownBlocks::claim(&mut layout, &model.imu)?;
                let gravity = layout.claim(Role::Estimated, GRAVITY_SD_MPS2)?;
                Some((blocks, gravity))
            }
            _ => None,
        };
        let odometry = match self.motion {
            Motion::Odometry(_) => Some(OdometryBlocks::claim(&mut layout, &model.odometry)?),
            _ => None,
        };
        let delay = match self.motion {
            Motion::Free => None,
            _ => Some(layout.claim(Role::Estimated, [DELAY_S])?),
        };
        let anchors = self.anchors.iter();
        let anchors = anchors.map(|position| Anchor::claim(&mut layout, *position, &model.ranges));
        let anchors = anchors.collect::<std::result::Result<Vec<_>, _>>()?;
        let mut filter = Filter::new(&layout, start.attitude);
        self.place(model, start, &mut filter);
        let states = States { anchors, odometry, strapdown, delay };
        correlate(&states.anchors, model.common, &mut filter);
        Ok((filter, states))
    }

    /// Sets position and velocity.
    fn place<const N: usize>(&self, model: &Model, start: &Start, filter: &mut Filter<f64, N>) {
        let up = f64::from(!model.planar);
        let axes = Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, up));
        let velocity_sd_mps = match self.motion {
            Motion::Odometry(_) => 0.0,
            _ => SPEED_MPS,
        };
        filter.state.set(POSITION, start.position_m);
        filter.set_covariance(POSITION, &(axes * start.position_sd_m.powi(2)));
        filter.state.set(VELOCITY, Vector3::zeros());
        filter.set_covariance(VELOCITY, &(axes * velocity_sd_mps.powi(2)));
    }

    /// Predicts from a time to another, with the sample of the other sensor between them.
    fn predict<const N: usize>(
        &self,
        model: &Model,
        states: &States,
        [from, to]: [f64; 2],
        filter: &mut Filter<f64, N>,
        tape: &mut Tape<N>,
    ) {
        let step_s = to - from;
        let errors = CorrelatedErrors { anchors: &states.anchors, errors: &model.ranges, step_s };
        match (self.motion, &states.odometry, &states.strapdown) {
            (Motion::Odometry(increments), Some(blocks), _) => {
                let next = increments.partition_point(|i| i.time_s <= from);
                let next =
                    (increments.get(next)).filter(|i| i.time_s - i.interval_s < 0.5 * (from + to));
                let odometry = Odometry {
                    blocks,
                    errors: &model.odometry,
                    distance_m: next.map_or(0.0, |i| i.distance_m),
                    rotation_rad: next.map_or(0.0, |i| i.rotation_rad),
                    interval_s: next.map_or(step_s, |i| i.interval_s),
                    step_s,
                };
                filter.predict_recorded(&(odometry, errors), tape);
            }
            (Motion::Inertial(times_s, samples), _, Some((blocks, gravity))) => {
                let next = times_s.partition_point(|t| *t <= from);
                let Some([force_mps2, rate_rad_s]) = mean_sample(times_s, samples, next) else {
                    return filter
                        .predict_recorded(&(Unmeasured { step_s, since_s: 0.0 }, errors), tape);
                };
                let strapdown = Strapdown {
                    blocks,
                    errors: &model.imu,
                    gravity_mps2: model.gravity_mps2,
                    force_mps2,
                    rate_rad_s,
                    step_s,
                };
                let offset = AccelerationOffset { block: *gravity, step_s };
                filter.predict_recorded(&((strapdown, offset), errors), tape);
            }
            _ => {
                let up = f64::from(!model.planar);
                let free = ConstantVelocity {
                    density: Vector3::new(1.0, 1.0, up) * model.acceleration,
                    step_s,
                };
                filter.predict_recorded(&(free, errors), tape);
            }
        }
    }
}

/// The filter is lost if a part of the ranges of a time, s, from two anchors or more, are too short by many deviations: an
/// obstacle makes ranges longer.
pub(super) const LOST_S: f64 = 1.0;
const LOST_PART: f64 = 0.2;
const LOST_SIGMA: f64 = 4.0;
/// Ranges below which this is not decided.
const LOST_LEAST: usize = 8;

pub(super) fn is_lost(ranges: &[RangeSample], judged: &[LineOfSight]) -> bool {
    let is_short = |l: &LineOfSight| l.innovation_m < -LOST_SIGMA * l.variance_m2.sqrt();
    let pairs = ranges.iter().zip(judged).filter(|(_, l)| is_short(l));
    let short: Vec<usize> = pairs.map(|(r, _)| r.anchor).collect();
    judged.len() >= LOST_LEAST
        && short.iter().any(|anchor| *anchor != short[0])
        && short.len() as f64 > LOST_PART * judged.len() as f64
}

/// A longer interval between two samples of an IMU is a gap, s.
const GAP_S: f64 = 0.25;

/// Mean specific force and angular rate between a sample and the one before it.
fn mean_sample(times_s: &[f64], samples: &[UnitSample], k: usize) -> Option<[Vector3<f64>; 2]> {
    let before = k.checked_sub(1)?;
    let (a, b) = (samples.get(before)?, samples.get(k)?);
    if times_s[k] - times_s[before] > GAP_S {
        return None;
    }
    let mean = |a: [f64; 3], b: [f64; 3]| (Vector3::from(a) + Vector3::from(b)) * 0.5;
    Some([mean(a.force_mps2, b.force_mps2), mean(a.rate_rad_s?, b.rate_rad_s?)])
}

/// Adds the common part of the biases and scale errors to the covariance.
pub(super) fn correlate<const N: usize>(
    anchors: &[Anchor<f64>],
    common: [f64; 2],
    filter: &mut Filter<f64, N>,
) {
    let biases: Vec<Block<1>> = anchors.iter().filter_map(|a| a.bias).collect();
    let scales: Vec<Block<1>> = anchors.iter().filter_map(|a| a.scale).collect();
    for (blocks, common) in [(biases, common[0]), (scales, common[1])] {
        let variance = Matrix1::new(common * common);
        for block in &blocks {
            let own = filter.covariance(*block);
            filter.set_covariance(*block, &(own + variance));
        }
        for (k, block) in blocks.iter().enumerate() {
            for other in &blocks[..k] {
                filter.set_cross_covariance(*block, *other, &variance);
            }
        }
    }
}
