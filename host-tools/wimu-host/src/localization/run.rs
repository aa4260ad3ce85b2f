//! Runs along ranges, with what carries the unit between them.

use nalgebra::{Rotation3, Vector3};
use wimu_nav::navigator::{self as core, Profile, Sample, Settings};
use wimu_nav::state::Role;

use super::model::Model;
use super::ranging::{AnchorEstimate, Estimate, flatten};
use super::{Increment, Ranging};
use crate::inertial::aids::{Aid, Mounting};
use crate::inertial::{Carrier, Navigator, PathPoint, StartPose, Step, run};
use crate::series::Ns;
use crate::stats::{IMPROBABLE, median};

/// What carries the unit from one range to the next.
#[derive(Clone, Copy, Debug)]
pub(super) enum Motion<'a> {
    /// Unknown, white acceleration.
    Free,
    /// Wheel odometry in the plane.
    Odometry(&'a [Increment]),
    /// Specific force and angular rate, at these times.
    Inertial(&'a [Ns], &'a [Sample]),
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

/// Standard deviation of gravity in the frame of the anchors, m/s²: a tilt of 3°.
const GRAVITY_SD_MPS2: [f64; 3] = [0.5, 0.5, 0.05];

/// Standard deviation of the delay between two sensors of one recording, s.
pub(super) const DELAY_S: f64 = 0.05;

/// Standard deviation of a position from the first ranges beside that of their noise, m: biases, and what the unit moves
/// within their time.
pub(super) const START_M: f64 = 0.1;

/// Standard deviation of the velocity at the start, m/s: walking speed.
pub(super) const SPEED_MPS: f64 = 1.0;

/// A run over a recording: its points and the navigator at its end.
pub(super) struct Run {
    pub points: Vec<PathPoint>,
    pub navigator: Navigator,
    /// Estimates of the anchors.
    pub anchors: Vec<AnchorEstimate>,
    pub delay_s: Option<Estimate>,
}

impl Run {
    /// Anchors, by their index, whose bias, m, is farther from the median than own biases are beforehand; none of fewer than
    /// three, of which either may be wrong.
    pub fn unlike_biases(&self, model: &Model) -> impl Iterator<Item = (usize, f64)> {
        let biases = self.anchors.iter().map(|anchor| anchor.bias_m).enumerate();
        let known = biases.filter_map(|(index, bias)| Some((index, bias?)));
        let known: Vec<(usize, Estimate)> = known.collect();
        let middle_m = median(known.iter().map(|(_, [bias_m, _])| *bias_m)).unwrap_or_default();
        let own_m = model.ranges.bias_m;
        let is_unlike = move |(_, [bias_m, sd_m]): &(usize, Estimate)| {
            (bias_m - middle_m).abs() > IMPROBABLE * own_m.hypot(*sd_m)
        };
        let is_known = known.len() > 2;
        let found = known.into_iter().filter(move |own| is_known && is_unlike(own));
        found.map(|(index, [bias_m, _])| (index, bias_m))
    }

    /// The delay, s, or zero where it is not estimated.
    pub fn delay(&self) -> f64 {
        self.delay_s.map_or(0.0, |[delay_s, _]| delay_s)
    }
}

/// A recording to localize.
#[derive(Clone, Copy, Debug)]
pub(super) struct Recording<'a> {
    pub ranging: &'a Ranging,
    /// Antenna of the unit.
    pub mounting: Mounting,
    pub ranges: &'a [Aid],
    pub motion: Motion<'a>,
    /// Attitude that levels the inertial sensor at its first sample.
    pub level: Rotation3<f64>,
    /// Pose at the start, where it is given.
    pub given: Option<&'a StartPose>,
}

impl Recording<'_> {
    /// What parameters cost of the log-likelihood of all ranges: Schwarz's criterion.
    pub fn cost(&self, parameters: usize) -> f64 {
        0.5 * parameters as f64 * (self.ranges.len() as f64).ln()
    }

    /// Logarithm of the likelihood of the ranges up to a time, s.
    pub fn log_likelihood(&self, model: &Model, start: &Start, until_s: f64) -> f64 {
        self.navigated(model, start, until_s, None).log_likelihood
    }

    /// What navigates along the ranges up to a time, s, and records with `smooth` or without it.
    pub fn navigated(
        &self,
        model: &Model,
        start: &Start,
        until_s: f64,
        smooth: Option<bool>,
    ) -> Navigator {
        let mut core = self.core(model, start);
        let ranging = self.ranging.with(*model);
        let wheels = matches!(self.motion, Motion::Odometry(_));
        let steps = self.steps(model, until_s);
        let at = |range: &Aid| Aid {
            time_s: range.time_s + model.shift_s,
            ..range.mounted(&self.mounting)
        };
        let aids: Vec<Aid> = self.ranges.iter().map(at).collect();
        // Ranges before the first sample are used with it.
        let first_s = steps.first().map_or(0.0, |step| step.time_s);
        let first_s = aids.first().map_or(first_s, |aid| aid.time_s.min(first_s));
        let mut anchors = ranging.claim(&mut core);
        if !matches!(self.motion, Motion::Free) {
            anchors.delay = Some(core.claim(|layout| layout.claim(Role::Estimated, [DELAY_S])));
        }
        let mut navigator = Navigator::new(core, first_s, false, true);
        if wheels {
            navigator = navigator.on_wheels(model.odometry);
        }
        navigator.anchors = Some(anchors);
        if let Some(smooth) = smooth {
            navigator.record(smooth, Vec::new());
        }
        run(&mut navigator, &aids, None, &steps);
        navigator
    }

    /// Navigates along all ranges, and with `smooth` goes back over them.
    pub fn run(&self, model: &Model, start: &Start, smooth: bool) -> Run {
        let mut navigator = self.navigated(model, start, f64::INFINITY, Some(smooth));
        let (points, _) = navigator.finish(&mut []);
        let states = navigator.anchors.as_ref();
        let anchors = states.map(|states| states.estimates(navigator.core.filter()));
        let delay_s = states.and_then(|states| states.delay).map(|block| navigator.estimate(block));
        Run { points, anchors: anchors.unwrap_or_default(), delay_s, navigator }
    }

    /// A navigator at a start. Without an inertial sensor it is in the plane where the anchors are.
    fn core(&self, model: &Model, start: &Start) -> core::Navigator {
        let gravity_mps2 = if start.inverted { -1.0 } else { 1.0 } * model.gravity_mps2;
        let mut settings = Settings::of(Profile::Free);
        settings.gravity_mps2 = gravity_mps2;
        settings.errors = model.imu;
        (settings.motion, settings.frame_mps2) = match self.motion {
            Motion::Inertial(..) => (core::Motion::Gyroscope, GRAVITY_SD_MPS2),
            _ => (core::Motion::Process, [0.0; 3]),
        };
        let [tilt_rad, heading_rad] = start.attitude_sd_rad;
        let mut begin = core::Start::moving(start.attitude, gravity_mps2);
        begin.tilt_rad = tilt_rad;
        let mut navigator = core::Navigator::new(settings, &begin);
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
            Motion::Inertial(sampled, _) => {
                let next = |time_s: f64| sampled.get(sampled.partition_point(|t| t.s() < time_s));
                times.retain(|time_s| next(*time_s).is_none_or(|next| next.s() - time_s > SOON_S));
                times.extend(sampled.iter().map(|time| time.s()));
            }
        }
        times.retain(|t| *t <= until_s);
        times.sort_by(f64::total_cmp);
        times.dedup();
        times
    }

    /// The steps up to a time, s.
    fn steps(&self, model: &Model, until_s: f64) -> Vec<Step> {
        let times = self.times(model, until_s);
        let before = times.first().into_iter().chain(&times);
        let step = |(from, to): (&f64, &f64)| Step {
            time_s: *to,
            step_s: to - from,
            carrier: self.carrier(model, [*from, *to]),
            resting: false,
            stance_mps: None,
        };
        before.zip(&times).map(step).collect()
    }

    /// What carries the unit from a time to another: the sample of the other sensor there, or the part of its increment.
    fn carrier(&self, model: &Model, [from, to]: [f64; 2]) -> Carrier {
        match self.motion {
            Motion::Inertial(times, samples) => {
                let at = times.partition_point(|t| t.s() < to);
                let found = samples.get(at).filter(|_| times[at].s() == to);
                found.map_or(Carrier::Unmeasured, |found| {
                    Carrier::Sample(Sample { step_s: to - from, field_ut: None, ..*found })
                })
            }
            Motion::Odometry(increments) => {
                let next = increments.partition_point(|i| i.time_s <= from);
                let within = |i: &&Increment| i.time_s - i.interval_s < 0.5 * (from + to);
                Carrier::Wheels(increments.get(next).filter(within).copied())
            }
            Motion::Free => {
                let up = f64::from(!model.planar);
                Carrier::Free(Vector3::new(1.0, 1.0, up) * model.acceleration)
            }
        }
    }
}

/// A range is used at the next inertial sample, if that is not later than this, s: constant velocity over it is right to 1 cm
/// at 2 m/s².
const SOON_S: f64 = 0.1;
