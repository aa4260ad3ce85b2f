//! Ranges that aid the navigator of a unit: states of the anchors, updates, and positions from the ranges of a second.

use std::path::Path;

use nalgebra::{Matrix1, Matrix3, Vector3};
use wimu_nav::filter::{Filter, Gate};
use wimu_nav::navigator::Navigator;
use wimu_nav::sensor::{Anchor, CorrelatedErrors, LineOfSight, Position, Range};
use wimu_nav::state::{ATTITUDE, Block, POSITION, VELOCITY};

use super::engine::{AnchorEstimate, SPEED_MPS, START_M};
use super::model::Model;
use super::start::{LEAST, LENGTH_S, candidates};
use super::{AnchorPosition, RangePrior, RangeSample, input};
use crate::Result;
use crate::formats::table::Measurements;

/// Anchors in this many directions show a position, with a second one that may be its mirror image.
const LEAST_ANCHORS: usize = 3;
/// Standard deviation of the height above anchors without one, m: all is in their plane.
const PLANE_M: f64 = 1.0;

/// Anchors, and what is known of the ranges to them.
#[derive(Clone, Debug, PartialEq)]
pub struct Ranging {
    /// The anchors.
    pub anchors: Vec<AnchorPosition>,
    /// What errors call them.
    name: String,
    pub(crate) model: Model,
}

impl Ranging {
    /// Reads anchors as [`RangeRecording::read`](super::RangeRecording::read) does. `errors`: standard deviations of noise, m,
    /// bias, m, and scale error.
    ///
    /// # Errors
    /// `file_unreadable`, `csv_missing_column`, `csv_bad_number`, `no_rows`.
    pub fn read(file: &Path, errors: Option<[f64; 3]>) -> Result<Self> {
        let (anchors, planar) = input::anchors(file)?;
        let usual = RangePrior::ULTRA_WIDEBAND;
        let prior = errors.map_or(usual, |errors| usual.with_errors(errors));
        Ok(Self::new(&crate::untrusted::name(file), anchors, planar, &prior))
    }

    /// Anchors of a name; without heights all is in their plane.
    pub fn new(name: &str, anchors: Vec<AnchorPosition>, planar: bool, prior: &RangePrior) -> Self {
        Self { anchors, name: name.to_owned(), model: Model::new(prior, planar) }
    }

    /// Ranges of a table that arrived at a time, s, which is that of rows without one.
    pub(crate) fn ranges(&self, table: &Measurements, arrived_s: f64) -> Result<Vec<RangeSample>> {
        let (ranges, left_out) = input::samples(table, &self.anchors, &self.name, Some(arrived_s))?;
        match left_out.first().filter(|_| ranges.is_empty()) {
            Some(why) => Err(table.empty(&why.text, "check the names of the anchors")),
            None => Ok(ranges),
        }
    }

    /// Positions that the last of some ranges show, m, each with its standard deviation, the most probable first; none with
    /// fewer than three anchors or twelve ranges.
    pub(crate) fn positions(&self, ranges: &[RangeSample]) -> Vec<(Vector3<f64>, f64)> {
        positions(&self.positions_m(), &self.model, ranges)
    }

    /// The anchors in the state of a navigator.
    pub(crate) fn claim(&self, navigator: &mut Navigator) -> AnchorStates {
        AnchorStates::claim(&self.positions_m(), &self.model, navigator)
    }

    /// Positions of the anchors, m.
    pub(crate) fn positions_m(&self) -> Vec<Vector3<f64>> {
        self.anchors.iter().map(|anchor| anchor.position_m.into()).collect()
    }
}

fn positions(
    anchors: &[Vector3<f64>],
    model: &Model,
    ranges: &[RangeSample],
) -> Vec<(Vector3<f64>, f64)> {
    let Some(last) = ranges.last() else {
        return Vec::new();
    };
    let from = ranges.partition_point(|range| range.time_s < last.time_s - LENGTH_S);
    let ranges = &ranges[from.min(ranges.len().saturating_sub(LEAST))..];
    let mut seen: Vec<usize> = ranges.iter().map(|range| range.anchor).collect();
    seen.sort_unstable();
    seen.dedup();
    let least = if model.planar { LEAST_ANCHORS - 1 } else { LEAST_ANCHORS };
    if seen.len() < least || ranges.len() < LEAST {
        return Vec::new();
    }
    let found = candidates(anchors, ranges, model);
    found.iter().map(|f| (f.position_m, f.deviation_m + START_M)).collect()
}

/// The anchors in the state of a navigator.
#[derive(Clone, Debug, Default)]
pub(crate) struct AnchorStates {
    states: Vec<Anchor>,
    /// Delay of the ranges, s.
    pub delay: Option<Block<1>>,
    /// Time of the last range, s.
    last_s: Option<f64>,
    /// Ranges of the last second.
    recent: Vec<(RangeSample, LineOfSight)>,
}

impl AnchorStates {
    /// Claims the states of anchors at positions, m.
    pub fn claim(anchors: &[Vector3<f64>], model: &Model, navigator: &mut Navigator) -> Self {
        let claim = |position: &Vector3<f64>| {
            navigator.claim(|layout| Anchor::claim(layout, *position, &model.ranges))
        };
        let states: Vec<Anchor> = anchors.iter().map(claim).collect();
        navigator.change(|filter| correlate(&states, model.common, filter));
        Self { states, ..Self::default() }
    }

    /// Updates with a range that was measured `age_s` ago, whose weight is the probability of line of sight.
    pub fn update(
        &mut self,
        model: &Model,
        sample: RangeSample,
        age_s: f64,
        navigator: &mut Navigator,
    ) -> LineOfSight {
        let anchor = &self.states[sample.anchor];
        let last_s = self.last_s.replace(sample.time_s).unwrap_or(sample.time_s);
        if sample.time_s > last_s {
            navigator.predict(&CorrelatedErrors {
                anchors: &self.states,
                errors: &model.ranges,
                step_s: sample.time_s - last_s,
            });
        }
        let lever_arm_m = model.lever_arm_m.into();
        let range = Range {
            anchor,
            range_m: sample.range_m,
            deviation_m: model.ranges.noise_m,
            lever_arm_m,
            delay: self.delay,
            age_s,
        };
        let (weighted, found) = range.weighted(navigator.filter(), &model.line_of_sight);
        navigator.update(&weighted, Gate::Open);
        // A unit that does not move upwards needs none.
        let rises = navigator.filter().covariance(POSITION)[(2, 2)] > 0.0;
        if model.planar && rises {
            let deviation_m = Vector3::new(f64::INFINITY, f64::INFINITY, PLANE_M);
            let plane = Position { position_m: anchor.position_m, deviation_m, lever_arm_m };
            navigator.update(&plane, Gate::Open);
        }
        self.recent.retain(|(range, _)| range.time_s >= sample.time_s - LOST_S);
        self.recent.push((sample, found));
        found
    }

    /// Moves a navigator to the position that the last ranges show, if they contradict the path. Returns whether it jumped.
    pub fn recovers(
        &mut self,
        anchors: &[Vector3<f64>],
        model: &Model,
        navigator: &mut Navigator,
    ) -> bool {
        if !is_lost(&self.recent) {
            return false;
        }
        let ranges: Vec<RangeSample> = self.recent.iter().map(|(range, _)| *range).collect();
        let Some((position, position_sd)) = positions(anchors, model, &ranges).first().copied()
        else {
            return false;
        };
        self.recent.clear();
        let filter = navigator.filter();
        let heading_sd = filter.covariance(ATTITUDE)[(2, 2)].sqrt();
        let is_flat = filter.covariance(POSITION)[(2, 2)] == 0.0;
        let velocity = navigator.solution().velocity_mps.into();
        let heading = navigator.heading();
        navigator.set_pose(position, velocity, heading, [position_sd, SPEED_MPS, heading_sd]);
        if is_flat {
            navigator.change(flatten);
        }
        true
    }

    /// What is estimated of each anchor.
    pub fn estimates(&self, filter: &Filter) -> Vec<AnchorEstimate> {
        let estimate = |block: Block<1>| {
            [filter.state.get(block).x, filter.covariance(block).x.max(0.0).sqrt()]
        };
        let deviation = |block: Block<3>| {
            let variances = filter.covariance(block).diagonal();
            variances.map(|v| v.max(0.0).sqrt())
        };
        let of = |anchor: &Anchor| AnchorEstimate {
            position_m: anchor.position(&filter.state),
            position_sd_m: anchor.offset.map(deviation),
            bias_m: anchor.bias.map(estimate),
            scale: anchor.scale.map(estimate),
        };
        self.states.iter().map(of).collect()
    }
}

/// Makes height and vertical velocity certain.
pub(super) fn flatten(filter: &mut Filter) {
    for block in [POSITION, VELOCITY] {
        let mut covariance: Matrix3<f64> = filter.covariance(block);
        covariance[(2, 2)] = 0.0;
        filter.set_covariance(block, &covariance);
    }
}

/// The path is lost if a part of the ranges of a time, s, from two anchors or more, are too short by many deviations: an
/// obstacle makes ranges longer.
const LOST_S: f64 = 1.0;
const LOST_PART: f64 = 0.2;
const LOST_SIGMA: f64 = 4.0;
/// Ranges below which this is not decided.
const LOST_LEAST: usize = 8;

fn is_lost(ranges: &[(RangeSample, LineOfSight)]) -> bool {
    let is_short = |l: &LineOfSight| l.innovation_m < -LOST_SIGMA * l.variance_m2.sqrt();
    let short = ranges.iter().filter(|(_, l)| is_short(l));
    let short: Vec<usize> = short.map(|(r, _)| r.anchor).collect();
    ranges.len() >= LOST_LEAST
        && short.iter().any(|anchor| *anchor != short[0])
        && short.len() as f64 > LOST_PART * ranges.len() as f64
}

/// Adds the common part of the biases and scale errors to the covariance.
fn correlate(anchors: &[Anchor], common: [f64; 2], filter: &mut Filter) {
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
