//! The filter over ranges with what carries the unit between them, and its smoother.

use nalgebra::{Matrix1, Matrix3, Rotation3, UnitQuaternion, Vector3};
use wimu_nav::filter::{Filter, Gate};
use wimu_nav::process::{
    AccelerationOffset, ConstantVelocity, Odometry, OdometryBlocks, Strapdown, StrapdownBlocks,
    Unmeasured,
};
use wimu_nav::sensor::{Anchor, CorrelatedErrors, LineOfSight, Range};
use wimu_nav::smoother::Recorder as _;
use wimu_nav::state::{ATTITUDE, Block, Layout, LayoutFull, POSITION, Role, VELOCITY};

use super::model::Model;
use super::{Increment, RangeSample, start};
use crate::inertial::{PathPoint, Tape};
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
    pub velocity_sd_mps: f64,
    pub attitude: Rotation3<f64>,
    /// About the horizontal axes, and about the vertical, rad.
    pub attitude_sd_rad: [f64; 2],
    /// Whether the up axis of the anchors points down.
    pub inverted: bool,
}

/// Constant parameters of the sensors, estimated from the whole recording.
#[derive(Clone, Debug, Default)]
pub(super) struct Calibration {
    blocks: Vec<Block<1>>,
    values: Vec<f64>,
    deviations: Vec<f64>,
}

impl Calibration {
    fn of<const N: usize>(filter: &Filter<f64, N>, blocks: Vec<Block<1>>) -> Self {
        let values = blocks.iter().map(|b| filter.state.get(*b).x).collect();
        let deviation = |b: &Block<1>| filter.covariance(*b).x.max(0.0).sqrt();
        let deviations = blocks.iter().map(deviation).collect();
        Self {
            blocks,
            values,
            deviations,
        }
    }

    /// Value and standard deviation of a parameter.
    pub fn parameter(&self, block: Option<Block<1>>) -> Option<[f64; 2]> {
        let k = self.blocks.iter().position(|b| Some(*b) == block)?;
        Some([self.values[k], self.deviations[k]])
    }

    /// The three of a vector.
    pub fn vector(&self, block: Block<3>) -> [Option<[f64; 2]>; 3] {
        let axes = [
            block.part::<1, 0>(),
            block.part::<1, 1>(),
            block.part::<1, 2>(),
        ];
        axes.map(|axis| self.parameter(Some(axis)))
    }
}

/// Standard deviation of gravity in the frame of the anchors, m/s²: a tilt of 3°.
const GRAVITY_SD_MPS2: [f64; 3] = [0.5, 0.5, 0.05];

/// Standard deviation of the delay between two sensors of one recording, s.
pub(super) const DELAY_S: f64 = 0.05;

/// Standard deviation of a position from the first ranges beside that of their noise, m: biases, and what the unit moves
/// within their time.
pub(super) const START_M: f64 = 0.1;

/// A run over a recording.
pub(super) struct Run {
    pub points: Vec<PathPoint>,
    /// Of each range that was used.
    pub judged: Vec<LineOfSight>,
    pub log_likelihood: f64,
    pub anchors: Vec<Anchor<f64>>,
    pub odometry: Option<OdometryBlocks>,
    pub delay: Option<Block<1>>,
    pub calibration: Calibration,
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
    /// States of the filter.
    fn states(&self, model: &Model) -> usize {
        let errors = &model.ranges;
        let own = [errors.bias_m, errors.scale, errors.correlated_m];
        let claimed = own.iter().filter(|sigma| **sigma > 0.0).count();
        let surveyed = if errors.position_m > 0.0 { 3 } else { 0 };
        let other = match self.motion {
            Motion::Free => 0,
            Motion::Odometry(_) => 3,
            Motion::Inertial(..) => 10,
        };
        9 + other + self.anchors.len() * (claimed + surveyed)
    }

    /// [`run_with`](Self::run_with) the smallest filter that has the states.
    ///
    /// # Errors
    /// [`LayoutFull`]: too many anchors.
    pub fn run(
        &self,
        model: &Model,
        start: &Start,
        smooth: bool,
        until_s: f64,
    ) -> Result<Run, LayoutFull> {
        match self.states(model) {
            ..=24 => self.run_with::<24>(model, start, smooth, until_s),
            25..=36 => self.run_with::<36>(model, start, smooth, until_s),
            _ => self.run_with::<64>(model, start, smooth, until_s),
        }
    }

    /// Runs the filter over the ranges up to a time, s, and with `smooth` its smoother.
    ///
    /// # Errors
    /// [`LayoutFull`].
    fn run_with<const N: usize>(
        &self,
        model: &Model,
        start: &Start,
        smooth: bool,
        until_s: f64,
    ) -> Result<Run, LayoutFull> {
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
        let mut input = 0;
        for time_s in times {
            if now < time_s {
                let span = [now, time_s];
                self.predict(model, &states, &mut input, span, &mut filter, &mut tape);
                now = time_s;
            }
            let step_s = time_s - points.last().map_or(time_s, |p: &PathPoint| p.time_s);
            while let Some(sample) = self
                .ranges
                .get(next)
                .filter(|s| s.time_s + model.shift_s <= time_s)
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
            let from = self
                .ranges
                .partition_point(|r| r.time_s + model.shift_s < time_s - LOST_S);
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
            points.push(point(time_s, &filter));
            tape.mark(&mut points);
        }
        tape.finish(&mut points);
        let calibration = Calibration::of(&filter, states.parameters());
        Ok(Run {
            points,
            judged,
            log_likelihood,
            anchors: states.anchors,
            odometry: states.odometry,
            delay: states.delay,
            calibration,
            contradictions: tape.contradictions,
            recoveries,
        })
    }

    /// Times of the ranges and of the other sensor, each once.
    fn times(&self, model: &Model, until_s: f64) -> Vec<f64> {
        let mut times: Vec<f64> = self
            .ranges
            .iter()
            .map(|s| s.time_s + model.shift_s)
            .collect();
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
    ) -> Result<(Filter<f64, N>, States), LayoutFull> {
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
        let anchors = anchors.collect::<Result<Vec<_>, _>>()?;
        let mut filter = Filter::new(&layout, start.attitude);
        self.place(model, start, &mut filter);
        let states = States {
            anchors,
            odometry,
            strapdown,
            delay,
        };
        states.correlate(model, &mut filter);
        Ok((filter, states))
    }

    /// Sets position and velocity.
    fn place<const N: usize>(&self, model: &Model, start: &Start, filter: &mut Filter<f64, N>) {
        let up = if model.planar { 0.0 } else { 1.0 };
        let axes = Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, up));
        let velocity_sd_mps = match self.motion {
            Motion::Odometry(_) => 0.0,
            _ => start.velocity_sd_mps,
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
        input: &mut usize,
        [from, to]: [f64; 2],
        filter: &mut Filter<f64, N>,
        tape: &mut Tape<N>,
    ) {
        let step_s = to - from;
        let errors = CorrelatedErrors {
            anchors: &states.anchors,
            errors: &model.ranges,
            step_s,
        };
        match (self.motion, &states.odometry, &states.strapdown) {
            (Motion::Odometry(increments), Some(blocks), _) => {
                while increments.get(*input).is_some_and(|i| i.time_s <= from) {
                    *input += 1;
                }
                let next = increments
                    .get(*input)
                    .filter(|i| i.time_s - i.interval_s < 0.5 * (from + to));
                let [distance_m, rotation_rad, interval_s] = next.map_or([0.0, 0.0, step_s], |i| {
                    [i.distance_m, i.rotation_rad, i.interval_s]
                });
                let odometry = Odometry {
                    blocks,
                    errors: &model.odometry,
                    distance_m,
                    rotation_rad,
                    interval_s,
                    step_s,
                };
                filter.predict_recorded(&(odometry, errors), tape);
            }
            (Motion::Inertial(times_s, samples), _, Some((blocks, gravity))) => {
                while times_s.get(*input).is_some_and(|t| *t <= from) {
                    *input += 1;
                }
                let mean = mean_sample(times_s, samples, *input);
                match mean {
                    Some([force_mps2, rate_rad_s]) => {
                        let strapdown = Strapdown {
                            blocks,
                            errors: &model.imu,
                            gravity_mps2: model.gravity_mps2,
                            force_mps2,
                            rate_rad_s,
                            step_s,
                        };
                        let offset = AccelerationOffset {
                            block: *gravity,
                            step_s,
                        };
                        filter.predict_recorded(&((strapdown, offset), errors), tape);
                    }
                    None => filter.predict_recorded(&(Unmeasured { step_s }, errors), tape),
                }
            }
            _ => {
                let up = if model.planar {
                    0.0
                } else {
                    model.acceleration
                };
                let free = ConstantVelocity {
                    density: Vector3::new(model.acceleration, model.acceleration, up),
                    step_s,
                };
                filter.predict_recorded(&(free, errors), tape);
            }
        }
    }
}

/// The filter is lost if a part of the ranges of a time, s, from two anchors or more, are too short by many deviations: an
/// obstacle makes ranges longer.
const LOST_S: f64 = 1.0;
const LOST_PART: f64 = 0.2;
const LOST_SIGMA: f64 = 4.0;
/// Ranges below which this is not decided.
const LOST_LEAST: usize = 8;

fn is_lost(ranges: &[RangeSample], judged: &[LineOfSight]) -> bool {
    let short = |l: &LineOfSight| l.innovation_m < -LOST_SIGMA * l.variance_m2.sqrt();
    let pairs = ranges.iter().zip(judged);
    let mut anchors: Vec<usize> = pairs
        .filter(|(_, l)| short(l))
        .map(|(r, _)| r.anchor)
        .collect();
    let count = anchors.len();
    anchors.sort_unstable();
    anchors.dedup();
    judged.len() >= LOST_LEAST
        && anchors.len() > 1
        && count as f64 > LOST_PART * judged.len() as f64
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
    Some([
        mean(a.force_mps2, b.force_mps2),
        mean(a.rate_rad_s?, b.rate_rad_s?),
    ])
}

impl States {
    /// All constant parameters of the ranges and the odometry.
    fn parameters(&self) -> Vec<Block<1>> {
        let of = |anchor: &Anchor<f64>| {
            let offset = anchor
                .offset
                .map(|o| [o.part::<1, 0>(), o.part::<1, 1>(), o.part::<1, 2>()]);
            [anchor.bias, anchor.scale]
                .into_iter()
                .flatten()
                .chain(offset.into_iter().flatten())
                .collect::<Vec<_>>()
        };
        let odometry = self.odometry.iter().map(|odometry| odometry.scale);
        let others = odometry.chain(self.delay);
        self.anchors.iter().flat_map(of).chain(others).collect()
    }

    /// Adds the common part of the biases and scale errors to the covariance.
    fn correlate<const N: usize>(&self, model: &Model, filter: &mut Filter<f64, N>) {
        let biases: Vec<Block<1>> = self.anchors.iter().filter_map(|a| a.bias).collect();
        let scales: Vec<Block<1>> = self.anchors.iter().filter_map(|a| a.scale).collect();
        for (blocks, common) in [(biases, model.common[0]), (scales, model.common[1])] {
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
}

fn point<const N: usize>(time_s: f64, filter: &Filter<f64, N>) -> PathPoint {
    let deviation = |block| {
        let variance = filter.covariance::<3>(block).diagonal();
        variance.map(|v| v.max(0.0).sqrt()).into()
    };
    let attitude = UnitQuaternion::from_rotation_matrix(&filter.state.attitude);
    let covariance_m2 = filter.covariance(POSITION);
    PathPoint {
        time_s,
        position_m: filter.state.get(POSITION).into(),
        velocity_mps: filter.state.get(VELOCITY).into(),
        velocity_sd_mps: deviation(VELOCITY),
        attitude_sd_rad: deviation(ATTITUDE),
        quaternion: [attitude.w, attitude.i, attitude.j, attitude.k],
        rate_rad_s: [0.0; 3],
        rate_covariance: None,
        covariance_m2: covariance_m2.into(),
        filtered_sd_m: covariance_m2.trace().max(0.0).sqrt(),
        resting: false,
        valid: true,
    }
}
