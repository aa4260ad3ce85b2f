//! Scales of the noise, by the likelihood of the ranges: equation (167).

use wimu_nav::state::LayoutFull;

use super::engine::{Motion, Recording, Start};
use super::model::Model;

/// Ranges that are used, at most: several minutes of a usual system.
const MOST: usize = 12_000;
/// Factors of the search, the coarse one first.
const FACTORS: [f64; 2] = [2.0, std::f64::consts::SQRT_2];
/// Least gain of the log-likelihood of a step.
const GAIN: f64 = 1.0;
/// Steps of a scale in one direction, at most.
const STEPS: usize = 8;
/// Least noise of a range, m: time stamps of ultra-wideband radios (DW1000 data sheet, 3 cm).
const LEAST_NOISE_M: f64 = 0.03;
/// Largest probability of a range without line of sight: with more, nothing distinguishes the others.
const MOST_BLOCKED: f64 = 0.6;

/// A scale, where the model has it and allows the value.
fn scaled(model: &Model, motion: &Motion, which: usize, factor: f64) -> Option<Model> {
    let mut model = *model;
    let value = match which {
        0 => &mut model.ranges.noise_m,
        1 => &mut model.ranges.correlated_m,
        2 => &mut model.line_of_sight.probability,
        _ => &mut model.acceleration,
    };
    *value *= factor;
    let moved = *value > 0.0 && (which < 3 || matches!(motion, Motion::Free));
    let allowed =
        model.ranges.noise_m >= LEAST_NOISE_M && model.line_of_sight.probability <= MOST_BLOCKED;
    (moved && allowed).then_some(model)
}

/// The model with the scales of greatest likelihood.
///
/// # Errors
/// [`LayoutFull`].
pub(super) fn adapted(
    recording: &Recording,
    model: &Model,
    start: &Start,
) -> Result<Model, LayoutFull> {
    let part = Recording {
        ranges: &recording.ranges[..recording.ranges.len().min(MOST)],
        ..*recording
    };
    let until_s = part.ranges.last().map_or(0.0, |r| r.time_s + model.shift_s);
    let likelihood = |model: &Model| Ok(part.run(model, start, false, until_s)?.log_likelihood);
    let (mut best, mut most) = (*model, likelihood(model)?);
    for factor in FACTORS {
        let mut moved = true;
        while moved {
            moved = false;
            for (which, factor) in (0..4).flat_map(|which| [(which, factor), (which, 1.0 / factor)])
            {
                for _ in 0..STEPS {
                    let Some(next) = scaled(&best, &part.motion, which, factor) else {
                        break;
                    };
                    let found = likelihood(&next)?;
                    if found < most + GAIN {
                        break;
                    }
                    (best, most, moved) = (next, found, true);
                }
            }
        }
    }
    Ok(best)
}
