//! Where the unit starts: positions from the first ranges, and headings where nothing shows one, by the likelihood of the
//! ranges that follow.

use std::f64::consts::{PI, TAU};

use nalgebra::{Rotation3, Vector3};

use super::findings::last_shift;
use super::model::Model;
use super::run::{DELAY_S, Motion, Recording, START_M, Start};
use super::start::candidates;
use crate::Result;
use crate::lag::likeliest;

/// A hypothesis is followed for this time, s: without a heading, until the unit has moved.
const TRIAL_S: f64 = 10.0;
const HEADING_TRIAL_S: f64 = 60.0;
/// Headings that are tried, and the standard deviation of each, rad.
const HEADINGS: u32 = 12;
const HEADING_SD: f64 = 0.3;
/// Standard deviations of a start that is given, m and rad.
const GIVEN_M: f64 = 0.3;
const GIVEN_HEADING: f64 = 0.05;
/// Tilt of a start in motion, rad: see `wimu_nav::navigator`.
const TILT: f64 = 0.1;
/// Logarithm of the odds below which two starts are equally probable, 150 to 1.
const DECIDED: f64 = 5.0;
/// Two positions or headings that differ by less, m and rad, are one.
const SAME_M: f64 = 1.0;

/// The start, and another one that is as probable.
pub(super) struct Chosen {
    pub start: Start,
    pub other: Option<Start>,
}

/// The most probable start; `None` without a candidate.
pub(super) fn choose(recording: &Recording, model: &Model) -> Option<Chosen> {
    let starts = starts(recording, model);
    let first_s = recording.ranges.first().map_or(0.0, |r| r.time_s + model.shift_s);
    let trial_s = match recording.motion {
        Motion::Free => TRIAL_S,
        _ => HEADING_TRIAL_S,
    };
    let mut order = judged(recording, model, &starts, first_s + trial_s);
    if order.len() > 1 && order[0].0 - order[1].0 < DECIDED {
        let close: Vec<Start> = order.iter().take(2).map(|(_, start)| *start).collect();
        order = judged(recording, model, &close, f64::INFINITY);
    }
    let mut start = order.first()?.1;
    let equal = order.get(1).filter(|(found, _)| order[0].0 - found < DECIDED);
    let mut other = equal
        .map(|(_, other)| *other)
        .filter(|other| (other.position_m - start.position_m).norm() > SAME_M);
    // Of a position and its mirror image, the upper one.
    if let Some(above) = other.filter(|o| o.position_m.z > start.position_m.z) {
        (start, other) = (above, Some(start));
    }
    Some(Chosen { start, other })
}

/// Log-likelihoods of the ranges up to a time, s, the greatest first.
fn judged(
    recording: &Recording,
    model: &Model,
    starts: &[Start],
    until_s: f64,
) -> Vec<(f64, Start)> {
    if let [only] = starts {
        return vec![(0.0, *only)];
    }
    let judge = |start: &Start| (recording.log_likelihood(model, start, until_s), *start);
    let mut found: Vec<(f64, Start)> = starts.iter().map(judge).collect();
    found.sort_by(|a, b| b.0.total_cmp(&a.0));
    found
}

fn starts(recording: &Recording, model: &Model) -> Vec<Start> {
    let given = recording.given;
    let positions: Vec<(Vector3<f64>, f64)> = match given {
        Some(pose) => vec![(pose.position_m.into(), GIVEN_M)],
        None => {
            let found = candidates(&recording.ranging.positions_m(), recording.ranges, model);
            found.iter().map(|f| (f.position_m, f.deviation_m + START_M)).collect()
        }
    };
    let tilt = match recording.motion {
        Motion::Inertial(..) => TILT,
        _ => 0.0,
    };
    let headings: Vec<(f64, f64)> =
        match (recording.motion, given.and_then(|pose| pose.heading_rad)) {
            (Motion::Free, _) => vec![(0.0, 0.0)],
            (_, Some(heading)) => vec![(heading, GIVEN_HEADING)],
            _ => (0..HEADINGS)
                .map(|k| (TAU * f64::from(k) / f64::from(HEADINGS), HEADING_SD))
                .collect(),
        };
    let poses: &[bool] = match recording.motion {
        Motion::Inertial(..) => &[false, true],
        _ => &[false],
    };
    let mut starts = Vec::new();
    for (position_m, position_sd_m) in positions {
        for ((heading, heading_sd), inverted) in
            headings.iter().flat_map(|h| poses.iter().map(move |p| (h, *p)))
        {
            let about_east =
                Rotation3::from_axis_angle(&Vector3::x_axis(), if inverted { PI } else { 0.0 });
            let about_up = Rotation3::from_axis_angle(&Vector3::z_axis(), *heading);
            starts.push(Start {
                position_m,
                position_sd_m,
                attitude: about_up * about_east * recording.level,
                attitude_sd_rad: [tilt, *heading_sd],
                inverted,
            });
        }
    }
    starts
}

/// Shifts of the clock that are tried, s, and the gain of the log-likelihood that shows one.
const SHIFTS_S: [f64; 6] = [0.25, 0.5, 1.0, 2.0, 4.0, 8.0];
/// End of the search, s.
pub(super) const LAST_SHIFT_S: f64 = 12.0;
const SHIFT_GAIN: f64 = 50.0;
/// They are tried if the ranges contradict the path, their noise is larger than assumed by this factor, or the delay that was
/// found is larger than this number of its prior's standard deviations.
const CLOCK_NOISE: f64 = 1.5;
const CLOCK_DELAY: f64 = 2.0;
/// The first ranges that are compared for it, at most.
const SHIFT_RANGES: usize = 3000;
/// The shift is found to this, s: half of what the state of the delay allows.
const SHIFT_S: f64 = 0.03;

/// Whether the noise of the ranges, and their delay, s, are those that were assumed.
pub(super) fn fits(model: &Model, delay_s: f64) -> bool {
    let noise_m = model.ranges.noise_m.hypot(model.ranges.correlated_m);
    noise_m < CLOCK_NOISE * model.expected_m
        && model.line_of_sight.probability < 0.5
        && delay_s.abs() < CLOCK_DELAY * DELAY_S
}

/// Time that the clock of the ranges is behind that of the other sensor, s, where it explains the ranges far better. Each
/// shift has its own most probable start. Equation (172).
///
/// # Errors
/// `data_refused`: the best one is at the end of the search.
pub(super) fn clock_shift(recording: &Recording, model: &Model) -> Result<Option<f64>> {
    if matches!(recording.motion, Motion::Free) {
        return Ok(None);
    }
    let part = Recording {
        ranges: &recording.ranges[..recording.ranges.len().min(SHIFT_RANGES)],
        ..*recording
    };
    let last_s = part.ranges.last().map_or(0.0, |r| r.time_s);
    let shifted = |shift_s: f64| Model { shift_s, ..*model };
    let likelihood = |shift_s: f64, start: &Start| {
        part.log_likelihood(&shifted(shift_s), start, last_s + shift_s.max(0.0))
    };
    let chosen = |shift_s: f64| {
        let Chosen { start, .. } = choose(&part, &shifted(shift_s))?;
        Some((likelihood(shift_s, &start), shift_s, start))
    };
    let mut best = chosen(0.0);
    let least = best.map_or(f64::NEG_INFINITY, |(found, ..)| found) + SHIFT_GAIN;
    for shift_s in SHIFTS_S.into_iter().flat_map(|s| [s, -s]) {
        let found = chosen(shift_s);
        let most = best.map_or(f64::NEG_INFINITY, |(most, ..)| most);
        best = found.filter(|(found, ..)| *found > most).or(best);
    }
    let Some((_, shift_s, start)) = best.filter(|(most, ..)| *most > least) else {
        return Ok(None);
    };
    let steps_s = [0.25 * shift_s.abs(), SHIFT_S];
    let reach_s = LAST_SHIFT_S - shift_s.abs();
    let near = |shift_s: f64| Some(likelihood(shift_s, &start));
    let found = likeliest(shift_s, steps_s, reach_s, near);
    Ok(Some(found.ok_or_else(|| last_shift(shift_s))?.offset_s))
}
