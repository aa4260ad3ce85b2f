//! Moves between rests, each measured from the rest before it; with a gyroscope from the smoothed path.
//!
//! With a gyroscope a move may be curved and rotated. Without one it must be free of rotation: an angular rate of zero
//! takes the place of the gyroscope, and the direction of gravity at both rests shows whether that holds.

use std::ops::Range;

use nalgebra::{Matrix3, Vector3};
use serde::ser::{Serialize, SerializeStruct, Serializer};
use wimu_nav::navigator::{Motion, Navigator, Profile, Sample, Start};
use wimu_nav::state::POSITION;

use super::rests::runs;
use super::smooth::Tape;
use super::unit::Unit;
use super::{Choice, Method, PathPoint, Zupt};

/// The shortest rest between two moves, s.
pub(super) const REST_S: f64 = 0.3;
/// A rest of this length ends a move, even if the filter does not agree, s.
const CERTAIN_REST_S: f64 = 1.0;
/// Alignment uses the end of a rest, s.
const ALIGNMENT_S: f64 = 1.0;
/// Change of gravity's direction without a rotation, rad, 1 σ of a component: 0.2°, noise and vibration at a rest.
const LEVEL_RAD: f64 = 0.0035;
/// Change of the magnetic field's direction without a rotation, rad, 1 σ: 3 µT of 50 µT, at both ends (see
/// `wimu_nav::sensor::Magnetometer`).
const FIELD_RAD: f64 = 0.085;
/// Random walk of the attitude without a rotation, rad/√s (see `Profile::Slide`).
const WALK_RAD: f64 = 0.002;
/// χ² quantile, 2 degrees of freedom, 99.9 %.
const CHI_SQUARE_2: f64 = 13.82;

/// A move between two rests.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Move {
    /// Its start and end, s, as in the file.
    pub from_s: f64,
    /// See [`from_s`](Self::from_s).
    pub to_s: f64,
    /// Displacement, m, east-north-up: on the axes of a smoothed path, else east is next to body x at the start of the
    /// move.
    pub displacement_m: [f64; 3],
    /// Length of the displacement, m, and its standard deviation.
    pub length_m: f64,
    /// See [`length_m`](Self::length_m).
    pub length_sd_m: f64,
    /// Angle by which gravity turned in the body frame, rad.
    pub tilted_rad: f64,
    /// Whether it is known: without a gyroscope not after a rotation, and never where the rest at its end contradicts
    /// it.
    pub valid: bool,
}

/// As JSON without the displacement; the length is null where it is not known.
impl Serialize for Move {
    fn serialize<S: Serializer>(&self, to: S) -> Result<S::Ok, S::Error> {
        let known = |value: f64| self.valid.then_some(value);
        let mut fields = to.serialize_struct("Move", 5)?;
        fields.serialize_field("from_s", &self.from_s)?;
        fields.serialize_field("to_s", &self.to_s)?;
        fields.serialize_field("length_m", &known(self.length_m))?;
        fields.serialize_field("length_sd_m", &known(self.length_sd_m))?;
        fields.serialize_field("tilted_deg", &self.tilted_rad.to_degrees())?;
        fields.end()
    }
}

impl Move {
    /// Its first and last sample.
    pub(super) fn span(&self, times_s: &[f64]) -> (usize, usize) {
        let at = |time_s: f64| times_s.partition_point(|t| *t < time_s);
        (at(self.from_s), at(self.to_s))
    }
}

/// Replaces what the move alone shows by what the whole recording shows, where it was smoothed. A move within which later
/// samples contradict the path is not known.
pub(super) fn smoothed_moves(moves: &mut [Move], points: &[PathPoint], tape: &Tape) {
    let at = |time_s: f64| points.partition_point(|point| point.time_s < time_s);
    for one in moves {
        let (from, to) = (at(one.from_s), at(one.to_s));
        let Some(change) = tape.changes.iter().find(|c| (c.from, c.to) == (from, to)) else {
            one.valid &= tape.contradictions == 0;
            continue;
        };
        let position = |k: usize| Vector3::from(points[k].position_m);
        let displacement = position(to) - position(from);
        (one.length_m, one.length_sd_m) = length(&displacement, &change.covariance);
        one.displacement_m = displacement.into();
    }
}

/// Length of a displacement, m, and its standard deviation.
fn length(displacement: &Vector3<f64>, covariance: &Matrix3<f64>) -> (f64, f64) {
    let direction = displacement.try_normalize(1e-9).unwrap_or_else(Vector3::x);
    let variance = direction.dot(&(covariance * direction));
    (displacement.norm(), variance.max(0.0).sqrt())
}

/// The moves of a unit: none if rests are not used.
pub(super) fn moves(unit: &Unit, rests: &[bool], choice: &Choice, method: Method) -> Vec<Move> {
    let rests = long_rests(unit.times_s, rests);
    let mut found = Vec::new();
    if choice.zupt == Zupt::Off {
        return found;
    }
    let mut at = 0;
    while at + 1 < rests.len() {
        let Some((end, one)) = one_move(unit, &rests, at, choice, method) else {
            at += 1;
            continue;
        };
        found.push(one);
        at = end;
    }
    found
}

fn long_rests(times_s: &[f64], rests: &[bool]) -> Vec<Range<usize>> {
    let mut found = runs(rests);
    found.retain(|rest| times_s[rest.end - 1] - times_s[rest.start] >= REST_S);
    found
}

/// The move that begins at the end of a rest, with the index of the rest at which it ends: the next one that the filter
/// accepts, or that is certain.
fn one_move(
    unit: &Unit,
    rests: &[Range<usize>],
    at: usize,
    choice: &Choice,
    method: Method,
) -> Option<(usize, Move)> {
    let (gyroscope, samples) = (method == Method::Strapdown, unit.samples);
    let profile = if gyroscope { choice.profile } else { Profile::Slide };
    let first = rests[at].clone();
    let begin = unit.times_s[first.end - 1] - ALIGNMENT_S;
    let begin = first.start.max(unit.times_s.partition_point(|t| *t < begin));
    let start = Start::align(&samples[begin..first.end], true)?;
    let mut settings = unit.settings(profile, choice);
    settings.motion = Motion::Gyroscope;
    let mut navigator = unit.navigator(settings, &Start { field_ut: None, ..start });
    let push = |navigator: &mut Navigator, k: usize, rest: bool| {
        let rate_rad_s = if gyroscope { samples[k].rate_rad_s } else { Some(Vector3::zeros()) };
        let sample = Sample { rate_rad_s, field_ut: None, ..samples[k] };
        if unit.clipped.binary_search(&k).is_ok() {
            navigator.interrupt(sample.step_s);
        } else {
            // A fault is counted in the path of the whole recording.
            let _ = navigator.push(&sample, rest);
        }
    };
    (begin..first.end).for_each(|k| push(&mut navigator, k, true));
    navigator.set_origin();
    let mut k = first.end;
    for (end, rest) in rests.iter().enumerate().skip(at + 1) {
        (k..rest.start).for_each(|k| push(&mut navigator, k, false));
        let recoveries = navigator.recoveries();
        (rest.start..rest.end).for_each(|k| push(&mut navigator, k, true));
        k = rest.end;
        let contradicted = !navigator.is_at_rest() || navigator.recoveries() > recoveries;
        let rested_s = unit.times_s[rest.end - 1] - unit.times_s[rest.start];
        if !navigator.is_at_rest() && rested_s < CERTAIN_REST_S {
            continue;
        }
        let filter = navigator.filter();
        let displacement = filter.state.get(POSITION);
        let covariance = filter.covariance(POSITION);
        let (length_m, length_sd_m) = length(&displacement, &covariance);
        let force = |rest: &Range<usize>| -> Vector3<f64> {
            samples[rest.clone()].iter().map(|s| s.force_mps2).sum()
        };
        let tilted_rad = force(&first).angle(&force(rest));
        let lasted_s = unit.times_s[rest.start] - unit.times_s[first.end - 1];
        let level = 2.0 * LEVEL_RAD * LEVEL_RAD + WALK_RAD * WALK_RAD * lasted_s;
        let field = |rest: &Range<usize>| -> Vector3<f64> {
            samples[rest.clone()].iter().filter_map(|s| s.field_ut).sum()
        };
        let [turned, field_level] = [field(&first).angle(&field(rest)), FIELD_RAD * FIELD_RAD];
        let rotated = !gyroscope
            && (tilted_rad * tilted_rad > CHI_SQUARE_2 * level
                || turned * turned > CHI_SQUARE_2 * field_level);
        let found = Move {
            from_s: unit.times_s[first.end - 1],
            to_s: unit.times_s[rest.start],
            displacement_m: displacement.into(),
            length_m,
            length_sd_m,
            tilted_rad,
            valid: !rotated && !contradicted && covariance.sum().is_finite(),
        };
        return Some((end, found));
    }
    None
}
