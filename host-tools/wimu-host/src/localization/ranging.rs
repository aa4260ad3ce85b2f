//! Ranges that aid the navigator of a unit: states of the anchors, updates, and positions from the ranges of a second.

use std::path::Path;
use std::sync::Arc;

use nalgebra::{Matrix1, Matrix3, Vector3};
use wimu_nav::filter::{Filter, Gate, Innovation};
use wimu_nav::navigator::Navigator;
use wimu_nav::sensor::{Anchor, CorrelatedErrors, LineOfSight, Position, Range};
use wimu_nav::state::{ATTITUDE, Block, POSITION, VELOCITY};

use super::model::Model;
use super::run::{SPEED_MPS, START_M};
use super::start::{LEAST, LENGTH_S, candidates};
use super::{AnchorPosition, RangePrior, RangeRecording, input};
use crate::Result;
use crate::formats::table::Measurements;
use crate::inertial::aids::{Aid, Outcome};

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
    /// An anchor, by its index, whose position is estimated about that of the file, with its standard deviation, m.
    pub(super) surveyed: Option<(usize, f64)>,
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
        Self { anchors, name: name.to_owned(), model: Model::new(prior, planar), surveyed: None }
    }

    /// The anchors of a recording.
    pub(crate) fn of(recording: &RangeRecording, model: Model) -> Self {
        Self {
            anchors: recording.anchors.clone(),
            name: recording.name.clone(),
            model,
            surveyed: None,
        }
    }

    /// The same anchors with another model.
    pub(super) fn with(&self, model: Model) -> Self {
        Self { model, ..self.clone() }
    }

    /// Exchanges the positions of two anchors.
    pub(super) fn exchange(&mut self, a: usize, b: usize) {
        let position_m = self.anchors[a].position_m;
        self.anchors[a].position_m = std::mem::replace(&mut self.anchors[b].position_m, position_m);
    }

    /// Ranges of a table that arrived at a time, s, which is that of rows without one.
    pub(crate) fn ranges(&self, table: &Measurements, arrived_s: f64) -> Result<Vec<Aid>> {
        let (ranges, left_out) = input::samples(table, &self.anchors, &self.name, Some(arrived_s))?;
        match left_out.first().filter(|_| ranges.is_empty()) {
            Some(why) => Err(table.empty(&why.text, "check the names of the anchors")),
            None => Ok(ranges),
        }
    }

    /// Positions that the last of some ranges show, m, each with its standard deviation, the most probable first; none with
    /// fewer than three anchors or twelve ranges.
    pub(crate) fn positions(&self, ranges: &[Aid]) -> Vec<(Vector3<f64>, f64)> {
        let Some(last) = ranges.last() else {
            return Vec::new();
        };
        let from = ranges.partition_point(|range| range.time_s < last.time_s - LENGTH_S);
        let ranges = &ranges[from.min(ranges.len().saturating_sub(LEAST))..];
        let mut seen: Vec<usize> = ranges.iter().map(|range| range.source).collect();
        seen.sort_unstable();
        seen.dedup();
        let least = if self.model.planar { LEAST_ANCHORS - 1 } else { LEAST_ANCHORS };
        if seen.len() < least || ranges.len() < LEAST {
            return Vec::new();
        }
        let found = candidates(&self.positions_m(), ranges, &self.model);
        found.iter().map(|f| (f.position_m, f.deviation_m + START_M)).collect()
    }

    /// Claims the states of the anchors.
    pub(crate) fn claim(&self, navigator: &mut Navigator) -> AnchorStates {
        let model = &self.model;
        let mut claim = |(index, position): (usize, Vector3<f64>)| {
            let mut errors = model.ranges;
            if let Some((_, sd_m)) = self.surveyed.filter(|(surveyed, _)| *surveyed == index) {
                errors.position_m = sd_m;
            }
            navigator.claim(|layout| Anchor::claim(layout, position, &errors))
        };
        let states: Vec<Anchor> =
            self.positions_m().into_iter().enumerate().map(&mut claim).collect();
        navigator.change(|filter| correlate(&states, model.common, filter));
        let ranging = Arc::new(self.clone());
        AnchorStates { ranging, states, delay: None, last_s: None, recent: Vec::new() }
    }

    /// Positions of the anchors, m.
    pub(crate) fn positions_m(&self) -> Vec<Vector3<f64>> {
        self.anchors.iter().map(|anchor| anchor.position_m.into()).collect()
    }
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

/// The anchors in the state of a navigator.
#[derive(Clone, Debug)]
pub(crate) struct AnchorStates {
    ranging: Arc<Ranging>,
    states: Vec<Anchor>,
    /// Delay of the ranges, s.
    pub delay: Option<Block<1>>,
    /// Time of the last range, s.
    last_s: Option<f64>,
    /// Ranges of the last second.
    recent: Vec<(Aid, LineOfSight)>,
}

impl AnchorStates {
    /// Names of the anchors.
    pub fn names(&self) -> impl Iterator<Item = &str> {
        self.ranging.anchors.iter().map(|anchor| anchor.id.as_str())
    }

    /// Updates with a range that was measured `age_s` ago, whose weight is the probability of line of sight. If the last
    /// ranges contradict the path, it jumps to the position that they show.
    pub fn update(&mut self, aid: &Aid, age_s: f64, navigator: &mut Navigator) -> Outcome {
        let model = &self.ranging.model;
        let anchor = &self.states[aid.source];
        let last_s = self.last_s.replace(aid.time_s).unwrap_or(aid.time_s);
        if aid.time_s > last_s {
            navigator.predict(&CorrelatedErrors {
                anchors: &self.states,
                errors: &model.ranges,
                step_s: aid.time_s - last_s,
            });
        }
        let lever_arm_m = aid.lever_arm_m.into();
        let range = Range {
            anchor,
            range_m: aid.value[0],
            deviation_m: model.ranges.noise_m,
            lever_arm_m,
            delay: self.delay,
            age_s,
        };
        let (weighted, found) = range.weighted(navigator.filter(), &model.line_of_sight);
        let updated = navigator.update(&weighted, Gate::Open);
        // A unit that does not move upwards needs none.
        let rises = navigator.filter().covariance(POSITION)[(2, 2)] > 0.0;
        if model.planar && rises {
            let deviation_m = Vector3::new(f64::INFINITY, f64::INFINITY, PLANE_M);
            let plane = Position { position_m: anchor.position_m, deviation_m, lever_arm_m };
            navigator.update(&plane, Gate::Open);
        }
        self.recent.retain(|(range, _)| range.time_s >= aid.time_s - LOST_S);
        self.recent.push((*aid, found));
        Outcome {
            innovation: Innovation {
                statistic: found.innovation_m.powi(2) / found.variance_m2,
                ..updated
            },
            weight: found.weight,
            log_likelihood: found.log_likelihood,
            has_jumped: self.recovers(navigator),
        }
    }

    /// Moves a navigator to the position that the last ranges show, if they contradict the path. Returns whether it jumped.
    fn recovers(&mut self, navigator: &mut Navigator) -> bool {
        if !is_lost(&self.recent) {
            return false;
        }
        let ranges: Vec<Aid> = self.recent.iter().map(|(range, _)| *range).collect();
        let Some((position, position_sd)) = self.ranging.positions(&ranges).first().copied() else {
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

fn is_lost(ranges: &[(Aid, LineOfSight)]) -> bool {
    let is_short = |l: &LineOfSight| l.innovation_m < -LOST_SIGMA * l.variance_m2.sqrt();
    let short = ranges.iter().filter(|(_, l)| is_short(l));
    let short: Vec<usize> = short.map(|(r, _)| r.source).collect();
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
