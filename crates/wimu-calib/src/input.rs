//! Plausibility checks of the poses, common to all methods.

use alloc::format;

use crate::{Gravity, Pose, Reason, Refusal, UnitHint};

/// Refuses poses that are not finite, or whose mean magnitude cannot be gravity in m/s².
pub(crate) fn check<'a>(
    poses: impl Iterator<Item = &'a Pose> + Clone,
    gravity: Gravity,
) -> Result<(), Refusal> {
    let mut sum = 0.0;
    let mut count = 0.0;
    for (pose, entry) in poses.clone().enumerate() {
        let finite = entry.mean_mps2.iter().all(|y| y.is_finite())
            && entry.sd_mps2.iter().all(|sd| sd.is_finite())
            && entry.rounding_sd_mps2.iter().all(|sd| sd.is_finite());
        if !finite {
            let text = format!("Pose {pose} (from 0) is not finite. Remove it.");
            return Err(Refusal::new(Reason::Input { index: pose }, text));
        }
        sum += libm::sqrt(entry.mean_mps2.iter().map(|y| y * y).sum());
        count += 1.0;
    }
    if count == 0.0 {
        return Ok(());
    }
    let mean_mps2 = sum / count;
    match UnitHint::of(mean_mps2, gravity.mps2()) {
        Some(hint) => Err(match stands(poses, mean_mps2) {
            Some(axis) => Refusal::stuck(axis),
            None => Refusal::unexpected_magnitude(mean_mps2, hint),
        }),
        None => Ok(()),
    }
}

/// Relative to the mean magnitude: largest range of a constant axis, its smallest reading, and
/// smallest range of a rotated axis.
const STANDS: f64 = 0.01;
const MOST_OF_IT: f64 = 0.7;
const TURNS: f64 = 0.1;

/// The axis that is nearly all of the magnitude in every pose, although another one changes: stuck
/// at full scale.
fn stands<'a>(poses: impl Iterator<Item = &'a Pose> + Clone, mean_mps2: f64) -> Option<usize> {
    let ends = |axis: usize| extremes(poses.clone().map(|pose| pose.mean_mps2[axis]));
    let spread = |axis: usize| {
        let [low, high] = ends(axis);
        (high - low) / mean_mps2
    };
    let stuck = (0..3).find(|&axis| {
        let [low, high] = ends(axis);
        spread(axis) < STANDS && low.abs().min(high.abs()) > MOST_OF_IT * mean_mps2
    })?;
    (0..3).any(|axis| axis != stuck && spread(axis) > TURNS).then_some(stuck)
}

/// Number of different poses, counted up to `enough`; exactly equal poses are the same one.
pub(crate) fn different(poses: &[Pose], enough: usize) -> usize {
    let mut count = 0;
    for (k, pose) in poses.iter().enumerate() {
        let before = poses.iter().take(k);
        let again = |other: &Pose| other.mean_mps2 == pose.mean_mps2;
        count += usize::from(!before.clone().any(again));
        if count == enough {
            break;
        }
    }
    count
}

/// Number of samples that, with noise, cannot all be equal.
const MANY_SAMPLES: u32 = 30;

/// Whether an axis is constant within a pose.
fn silent(pose: &Pose, axis: usize) -> bool {
    pose.samples >= MANY_SAMPLES && pose.sd_mps2[axis] <= 0.0
}

/// Smallest range of the readings of an axis that was rotated, m/s²: 0.6°.
const TURNED_MPS2: f64 = 0.1;
/// Largest reading of an axis at rest, relative to gravity.
const BEYOND_GRAVITY: f64 = 1.3;
/// Number of different poses with exactly the same extreme reading that indicates clipping.
const CLIPPED: usize = 3;

/// The axis with the same reading in every pose, while another one changes.
pub(crate) fn stuck_axis(poses: &[Pose]) -> Option<usize> {
    let spread = |axis: usize| {
        let [low, high] = ends(poses, axis);
        high - low
    };
    let turns = |axis: &usize| spread(*axis) >= TURNED_MPS2;
    (0..3).find(turns)?;
    (0..3).find(|axis| !turns(axis))
}

/// The constant axis that is defective: the magnitude of the output varies, it exceeds gravity, or
/// it lacks the noise of the others. An intact axis that was not rotated leaves the magnitude
/// constant.
pub(crate) fn dead_axis(poses: &[Pose], gravity: Gravity) -> Option<usize> {
    let [low, high] = extremes(magnitudes(poses));
    stuck_axis(poses).filter(|&axis| {
        let [_, most] = ends(poses, axis).map(f64::abs);
        let others = || (0..3).filter(move |other| *other != axis);
        let alone = poses.iter().all(|pose| silent(pose, axis))
            && others().any(|other| poses.iter().all(|pose| !silent(pose, other)));
        high - low > 0.3 * high || most > BEYOND_GRAVITY * gravity.mps2() || alone
    })
}

fn magnitudes(poses: &[Pose]) -> impl Iterator<Item = f64> {
    poses.iter().map(|pose| libm::sqrt(pose.mean_mps2.iter().map(|y| y * y).sum()))
}

/// The axis with an extreme reading that is the same in several different poses.
pub(crate) fn clipped_axis(poses: &[Pose]) -> Option<usize> {
    let outputs = || poses.iter().map(|pose| pose.mean_mps2);
    (0..3).find(|axis| is_clipped(outputs(), *axis, TURNED_MPS2, CLIPPED))
}

/// Whether an extreme reading of an axis is the same in `count` outputs that are `turned` apart on another axis.
pub(crate) fn is_clipped(
    outputs: impl Iterator<Item = [f64; 3]> + Clone,
    axis: usize,
    turned: f64,
    count: usize,
) -> bool {
    extremes(outputs.clone().map(|y| y[axis])).into_iter().any(|end| {
        let mut at = outputs.clone().filter(|y| y[axis] == end);
        let Some(first) = at.next() else { return false };
        let apart = |y: [f64; 3]| (0..3).map(|i| (y[i] - first[i]).abs()).fold(0.0, f64::max);
        at.filter(|y| apart(*y) > turned).count() + 1 >= count
    })
}

/// Range of the readings of an axis.
fn ends(poses: &[Pose], axis: usize) -> [f64; 2] {
    extremes(poses.iter().map(|pose| pose.mean_mps2[axis]))
}

/// Minimum and maximum.
pub(crate) fn extremes(values: impl Iterator<Item = f64>) -> [f64; 2] {
    values.fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], value| {
        [low.min(value), high.max(value)]
    })
}
