//! Ranges that aid the navigator of a unit: states of the anchors, updates, and positions from the ranges of a second.

use std::path::Path;

use nalgebra::{Matrix3, Vector3};
use wimu_nav::filter::Gate;
use wimu_nav::navigator::{Model as Motion, Navigator};
use wimu_nav::sensor::{Anchor, CorrelatedErrors, LineOfSight, Position, Range};
use wimu_nav::smoother::Recorder;
use wimu_nav::state::{ATTITUDE, LayoutFull};

use super::engine::{LOST_S, SPEED_MPS, START_M, correlate, is_lost};
use super::model::Model;
use super::start::{LEAST, LENGTH_S, candidates};
use super::{AnchorPosition, RangePrior, RangeSample, input};
use crate::Result;
use crate::csv::columns::Table;

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
    model: Model,
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
    pub(crate) fn ranges(&self, table: &Table, arrived_s: f64) -> Result<Vec<RangeSample>> {
        let (ranges, left_out) = input::samples(table, &self.anchors, &self.name, Some(arrived_s))?;
        match left_out.first().filter(|_| ranges.is_empty()) {
            Some(why) => Err(table.empty(&why.text, "check the names of the anchors")),
            None => Ok(ranges),
        }
    }

    /// Positions that the last of some ranges show, m, each with its standard deviation, the most probable first; none with
    /// fewer than three anchors or twelve ranges.
    pub(crate) fn positions(&self, ranges: &[RangeSample]) -> Vec<(Vector3<f64>, f64)> {
        let Some(last) = ranges.last() else {
            return Vec::new();
        };
        let from = ranges.partition_point(|range| range.time_s < last.time_s - LENGTH_S);
        let ranges = &ranges[from.min(ranges.len().saturating_sub(LEAST))..];
        let mut seen: Vec<usize> = ranges.iter().map(|range| range.anchor).collect();
        seen.sort_unstable();
        seen.dedup();
        if seen.len() < LEAST_ANCHORS || ranges.len() < LEAST {
            return Vec::new();
        }
        let anchors: Vec<Vector3<f64>> = self.anchors.iter().map(|a| a.position_m.into()).collect();
        let found = candidates(&anchors, ranges, &self.model);
        let found = found.iter().map(|f| (f.position_m, f.deviation_m + START_M));
        found.collect()
    }
}

/// The anchors in the state of a navigator.
#[derive(Clone, Debug, Default)]
pub(crate) struct AnchorStates {
    states: Vec<Anchor<f64>>,
    /// Time of the last range, s.
    last_s: Option<f64>,
    /// Ranges of the last second.
    recent: Vec<(RangeSample, LineOfSight)>,
}

impl AnchorStates {
    /// # Errors
    /// [`LayoutFull`].
    pub fn claim<M: Motion<f64, N>, const N: usize, L: Recorder<f64, N>>(
        ranging: &Ranging,
        navigator: &mut Navigator<f64, M, N, L>,
    ) -> std::result::Result<Self, LayoutFull> {
        let errors = &ranging.model.ranges;
        let states = navigator.claim(|layout| {
            let anchors = ranging.anchors.iter();
            let mut claim = |a: &AnchorPosition| Anchor::claim(layout, a.position_m.into(), errors);
            anchors.map(&mut claim).collect::<std::result::Result<Vec<_>, _>>()
        })?;
        navigator.correlate(|filter| correlate(&states, ranging.model.common, filter));
        Ok(Self { states, ..Self::default() })
    }

    /// Updates with a range, whose weight is the probability of line of sight.
    pub fn update<M: Motion<f64, N>, const N: usize, L: Recorder<f64, N>>(
        &mut self,
        ranging: &Ranging,
        sample: RangeSample,
        lever_arm_m: [f64; 3],
        navigator: &mut Navigator<f64, M, N, L>,
    ) -> Option<LineOfSight> {
        let model = &ranging.model;
        let anchor = self.states.get(sample.anchor)?;
        let last_s = self.last_s.replace(sample.time_s).unwrap_or(sample.time_s);
        if sample.time_s > last_s {
            navigator.predict(&CorrelatedErrors {
                anchors: &self.states,
                errors: &model.ranges,
                step_s: sample.time_s - last_s,
            });
        }
        let range = Range {
            anchor,
            range_m: sample.range_m,
            deviation_m: model.ranges.noise_m,
            lever_arm_m: lever_arm_m.into(),
            delay: None,
        };
        let (weighted, found) = range.weighted(navigator.filter(), &model.line_of_sight);
        navigator.update(&weighted, Gate::Open);
        if model.planar {
            let unknown = f64::INFINITY;
            let plane = Position {
                position_m: anchor.position_m,
                deviation_m: Vector3::new(unknown, unknown, PLANE_M),
                lever_arm_m: lever_arm_m.into(),
            };
            navigator.update(&plane, Gate::Open);
        }
        let kept = |(range, _): &(RangeSample, _)| range.time_s >= sample.time_s - LOST_S;
        self.recent.retain(kept);
        self.recent.push((sample, found));
        Some(found)
    }

    /// Moves a navigator to the position that the last ranges show, if they contradict the path. Returns whether it jumped.
    pub fn recovers<M: Motion<f64, N>, const N: usize, L: Recorder<f64, N>>(
        &mut self,
        ranging: &Ranging,
        navigator: &mut Navigator<f64, M, N, L>,
    ) -> bool {
        let (ranges, judged): (Vec<_>, Vec<_>) = self.recent.iter().copied().unzip();
        if !is_lost(&ranges, &judged) {
            return false;
        }
        let Some((position, position_sd)) = ranging.positions(&ranges).first().copied() else {
            return false;
        };
        self.recent.clear();
        let attitude: Matrix3<f64> = navigator.filter().covariance(ATTITUDE);
        let solution = navigator.solution();
        navigator.set_pose(
            position,
            solution.velocity_mps.into(),
            navigator.heading(),
            [position_sd, SPEED_MPS, attitude[(2, 2)].sqrt()],
        );
        true
    }
}
