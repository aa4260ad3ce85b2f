//! Scales of the noise, by the likelihood of the ranges: equation (167).

use super::model::Model;
use super::run::{Motion, Recording, Start};
use crate::inertial::Residual;
use crate::inertial::aids::Aid;

/// Ranges that are used, at most: several minutes of a usual system.
pub(super) const MOST: usize = 12_000;
/// Factors of the search, the coarse one first.
const FACTORS: [f64; 2] = [2.0, std::f64::consts::SQRT_2];
/// Least gain of the log-likelihood of a step.
const GAIN: f64 = 1.0;
/// Steps of a scale in one direction, and rounds through all directions, at most.
const STEPS: usize = 8;
const ROUNDS: usize = 20;
/// Least noise of a range, m: time stamps of ultra-wideband radios (DW1000 data sheet, 3 cm).
const LEAST_NOISE_M: f64 = 0.03;
/// Largest standard deviation of the common bias, m: antenna delays are smaller; more is a clock, or other anchors.
const MOST_BIAS_M: f64 = 2.0;
/// Largest probability of a range without line of sight: with more, nothing distinguishes the others.
const MOST_BLOCKED: f64 = 0.6;

/// Ranges that are too short with a lower weight than this under the first model, if they are not more than this part, are
/// left out of the search: no noise explains an anchor that has moved.
const FAR_WEIGHT: f64 = 0.01;
const MOST_FAR: f64 = 0.2;
/// Directions of the search. The last but one is that of a likelihood that changes little: the range's error is slow, or the
/// unit moves. The last is the bias that all anchors have in common, such as an antenna delay: a wide prior from the
/// beginning would cost accuracy of calibrated ranges.
const DIRECTIONS: usize = 6;

/// The model a step further, where it has the scale and allows the value.
fn scaled(model: &Model, motion: &Motion, direction: usize, factor: f64) -> Option<Model> {
    let mut model = *model;
    match direction {
        0 => model.ranges.noise_m *= factor,
        1 => model.ranges.correlated_m *= factor,
        2 => model.line_of_sight.probability *= factor,
        3 => model.acceleration *= factor,
        5 => model.common[0] *= factor,
        _ => {
            model.ranges.correlated_m *= factor;
            model.acceleration /= factor;
        }
    }
    let is_free = matches!(motion, Motion::Free);
    let has = match direction {
        1 => model.ranges.correlated_m > 0.0,
        5 => model.common[0] > 0.0,
        3 | 4 => is_free,
        _ => true,
    };
    let allowed = model.ranges.noise_m >= LEAST_NOISE_M
        && model.common[0] <= MOST_BIAS_M
        && model.line_of_sight.probability <= MOST_BLOCKED;
    (has && allowed).then_some(model)
}

/// The model with the scales of greatest likelihood.
pub(super) fn adapted(recording: &Recording, model: &Model, start: &Start) -> Model {
    let used = &recording.ranges[..recording.ranges.len().min(MOST)];
    let until_s = used.last().map_or(0.0, |r| r.time_s + model.shift_s);
    let first = recording.navigated(model, start, until_s, None);
    let is_far = |range: &Residual| range.weight < FAR_WEIGHT && range.value < 0.0;
    let pairs = used.iter().zip(&first.residuals);
    let near: Vec<Aid> = pairs.filter(|(_, l)| !is_far(l)).map(|(r, _)| *r).collect();
    let few = (used.len() - near.len()) as f64 <= MOST_FAR * used.len() as f64;
    let part = Recording { ranges: if few { &near } else { used }, ..*recording };
    let likelihood = |model: &Model| part.log_likelihood(model, start, until_s);
    let (mut best, mut most) = (*model, likelihood(model));
    for factor in FACTORS {
        for _ in 0..ROUNDS {
            let before = most;
            for (which, factor) in
                (0..DIRECTIONS).flat_map(|which| [(which, factor), (which, 1.0 / factor)])
            {
                for _ in 0..STEPS {
                    let Some(next) = scaled(&best, &part.motion, which, factor) else {
                        break;
                    };
                    let found = likelihood(&next);
                    let gains = found >= most + GAIN;
                    if !gains {
                        break;
                    }
                    (best, most) = (next, found);
                }
            }
            if most == before {
                break;
            }
        }
    }
    best
}
