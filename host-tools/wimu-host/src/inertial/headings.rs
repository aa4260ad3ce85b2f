//! A path whose samples and fixes arrive, at several headings until fixes or ranges rule out all but one.

use nalgebra::{Matrix3, Vector3};
use wimu_nav::state::{POSITION, VELOCITY};

use super::fixes::{Aided, Fixes};
use super::track::{Input, Track};
use super::unit::{HEADINGS, Unit, sample};
use super::{Choice, Method, PathPoint, Residual, StartPose};
use crate::localization::AnchorStates;
use crate::{Code, Problem, Result};

/// Difference of the logarithms of two likelihoods beyond which the smaller one is ruled out: odds of 1 to 2·10⁹.
const RULED_OUT: f64 = 21.4;
/// Standard deviation of a heading of which nothing is known, rad.
const ANY_HEADING: f64 = 1.81;

impl Unit<'_> {
    /// The path from the first sample on.
    pub fn begin(&self, choice: &Choice, method: Method) -> Result<Headings> {
        self.accepts(choice, method)?;
        let samples: Vec<_> = self.samples.iter().map(sample).collect();
        let inputs = self.inputs(&samples, choice, method);
        let rests: Vec<bool> = inputs.iter().map(|input| input.resting).collect();
        let mut start = self.start(&samples, &rests, choice)?;
        let at_rest = self.first_rest(&rests).is_some();
        let anchors = choice.fixes.ranging.as_ref().map(|ranging| ranging.claim(&mut start));
        Ok(Headings {
            tracks: vec![Track::new(start, choice, self.times_s[0], at_rest)],
            placed: choice.start.is_some() && anchors.is_none(),
            anchors,
            given: choice.start,
            limit_m: choice.limit_m,
            jumped_s: None,
            residuals: Vec::new(),
        })
    }
}

/// A path at several headings, until fixes rule out all but one.
pub(super) struct Headings {
    tracks: Vec<Track>,
    /// States of the anchors of ranges.
    anchors: Option<AnchorStates>,
    /// Pose at the start in the frame of the anchors.
    given: Option<StartPose>,
    limit_m: f64,
    /// Whether the path is in the frame of the fixes.
    placed: bool,
    /// When it was moved to it, s.
    jumped_s: Option<f64>,
    /// Residuals of the most probable track since they were taken.
    pub residuals: Vec<Residual>,
}

impl Headings {
    fn best(&self) -> Option<&Track> {
        let likelihood = |track: &&Track| track.aiding.log_likelihood;
        let ordered = |a: &&_, b: &&_| likelihood(a).total_cmp(&likelihood(b));
        self.tracks.iter().max_by(ordered)
    }

    /// Moves the path at a time, s, to positions that fixes or ranges show, each at all headings.
    fn place(&mut self, positions: &[(Vector3<f64>, f64)], time_s: f64) {
        let track = &self.tracks[0];
        let turn = |k| f64::from(k) * std::f64::consts::TAU / f64::from(HEADINGS);
        let given = self.given.and_then(|pose| pose.heading_rad);
        let headings: Vec<f64> =
            given.map_or_else(|| (0..HEADINGS).map(turn).collect(), |heading| vec![heading]);
        let pairs = positions
            .iter()
            .flat_map(|position| headings.iter().map(move |heading| (position, heading)));
        let all = pairs.map(|(position, heading)| {
            let mut track = track.clone();
            track.place(*position, None, *heading);
            track.aiding.anchors = self.anchors.clone();
            track
        });
        self.tracks = all.collect();
        (self.placed, self.jumped_s) = (true, Some(time_s));
    }

    /// Whether all headings have the position of the best one to the limit, also after the time of further samples.
    fn agree(&self, best: &Track, inputs: &[Input]) -> bool {
        let ends = inputs.first().zip(inputs.last());
        let ahead_s = ends.map_or(0.0, |(first, last)| last.time_s - first.time_s);
        let at = |track: &Track| {
            let state = &track.navigator.filter().state;
            state.get(POSITION) + state.get(VELOCITY) * ahead_s
        };
        let apart = |track: &Track| (at(track) - at(best)).norm();
        self.tracks.iter().all(|track| apart(track) <= self.limit_m)
    }

    /// Drops headings that are ruled out, and those that have come to the solution of a more probable one.
    fn prune(&mut self) {
        self.tracks.sort_by(|a, b| b.aiding.log_likelihood.total_cmp(&a.aiding.log_likelihood));
        let mut kept: Vec<Track> = Vec::new();
        for track in self.tracks.drain(..) {
            let same = |other: &Track| {
                let apart = track.navigator.heading() - other.navigator.heading();
                let apart = apart.sin().atan2(apart.cos()).abs();
                let covariance = other.navigator.solution().attitude_covariance;
                let [here, there] = [&track, other].map(|track| track.navigator.filter());
                let distance = here.state.get(POSITION) - there.state.get(POSITION);
                let variance =
                    there.covariance(POSITION).trace() + here.covariance(POSITION).trace();
                apart < Matrix3::from(covariance)[(2, 2)].sqrt()
                    && distance.norm_squared() < variance
            };
            let is_lost = kept.first().is_some_and(|best| {
                best.aiding.log_likelihood - track.aiding.log_likelihood > RULED_OUT
            });
            if !is_lost && !kept.iter().any(same) {
                kept.push(track);
            }
        }
        self.tracks = kept;
    }

    /// Takes samples.
    pub fn advance(&mut self, inputs: &[Input], fixes: &Fixes) {
        for input in inputs {
            if !self.placed {
                let positions = fixes.positions(input.time_s, self.given.as_ref());
                if !positions.is_empty() {
                    self.place(&positions, input.time_s);
                }
            }
            for track in &mut self.tracks {
                track.step(input, fixes);
            }
            let mut residuals = self.tracks.iter_mut().map(|track| &mut track.aiding.residuals);
            self.residuals.extend(residuals.next().map(std::mem::take).unwrap_or_default());
            residuals.for_each(Vec::clear);
        }
        if self.tracks.len() > 1 {
            self.prune();
        }
    }

    /// The point after further samples, which are not taken.
    pub fn ahead(&self, inputs: &[Input], fixes: &Fixes) -> Option<PathPoint> {
        let mut track = self.best()?.clone();
        let unplaced = Fixes::default();
        let fixes = if self.placed { fixes } else { &unplaced };
        let mut last = None;
        for input in inputs {
            last = Some(track.step(input, fixes));
        }
        let mut point = last?;
        track.segments.scale(&mut point);
        point.valid &= track.has_origin() && self.agree(self.best()?, inputs);
        if self.tracks.len() > 1 {
            point.attitude_sd_rad[2] = ANY_HEADING;
        }
        Some(point)
    }

    /// Headings that are possible.
    pub fn headings(&self) -> usize {
        self.tracks.len()
    }

    /// What happened to fixes and ranges.
    pub fn aided(&self) -> [Aided; 2] {
        let of = |track: &Track| [track.aiding.fixes, track.aiding.ranges];
        self.best().map_or_else(Default::default, of)
    }

    /// What was noticed.
    pub fn findings(&self, fixes: &Fixes) -> Vec<Problem> {
        let mut found = Vec::new();
        if let Some(jumped_s) = self.jumped_s {
            let whose = fixes.ranging.as_ref().map_or("fixes", |_| "anchors");
            let text = format!("the path was moved to the frame of the {whose} at {jumped_s:.2} s");
            found.push(Code::Navigation.note(text));
        }
        if fixes.ranging.is_some() && !self.placed {
            let text = "the path is not yet in the frame of the anchors: no twelve ranges to three of them within 3 s";
            let remedy = "see whether ranges arrive, or give the start: --start";
            found.push(Code::Navigation.note(text).remedy(remedy));
        }
        if let Some(best) = self.best() {
            found.extend(best.findings(fixes.ranging.as_ref()));
        }
        found
    }
}
