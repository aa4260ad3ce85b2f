//! Poses that would help.

use wimu_calib::{Face, Guide, Orientation, Pose, Refusal};

use super::{CalibrateOptions, MethodChoice, NextPose, wanted};

/// Most orientations that are advised at once.
const MOST_ADVISED: usize = 6;
/// Until there are so many more poses than parameters they are planned together: one by one, each the best at
/// its time, they are not the best of as many.
const SPARE: usize = 3;

/// Poses that would help against this refusal.
pub(super) fn next_poses(
    refusal: &Refusal,
    poses: &[Pose],
    options: &CalibrateOptions,
) -> Vec<NextPose> {
    match *refusal {
        // The same orientation once more tells little: it may have the same error again.
        Refusal::NotObservable { .. }
        | Refusal::Confounded { .. }
        | Refusal::PoorPrediction { .. } => advice(poses, options, 1),
        // One in place of the bad one, and one to tell it from.
        Refusal::PoseContradicted { .. } => advice(poses, options, 2),
        Refusal::PoseMissing { .. } => Face::ALL
            .into_iter()
            .filter(|face| poses.iter().all(|pose| Face::of(pose) != Some(*face)))
            .map(|face| Orientation::from(face).into())
            .collect(),
        Refusal::TooFewPoses { have, need, .. } => {
            advice(poses, options, need.saturating_sub(have))
        }
        _ => Vec::new(),
    }
}

/// The orientations that add most to these poses, as many as are worth it, `least` in any case.
pub(super) fn advice(poses: &[Pose], options: &CalibrateOptions, least: usize) -> Vec<NextPose> {
    if options.method != MethodChoice::MultiPosition {
        return Vec::new();
    }
    let mut guide = Guide::after(wanted(options), poses);
    let count = guide.worth(|_| true).min(MOST_ADVISED).max(least);
    let enough = wanted(options).fitted().iter().count() + SPARE;
    let planned = count.max(enough.saturating_sub(poses.len()));
    let next = |remaining| {
        let next = guide.next_of(remaining, |_| true)?;
        guide.take(next.up());
        Some(next.into())
    };
    ((planned - count + 1)..=planned)
        .rev()
        .map_while(next)
        .collect()
}

#[cfg(test)]
mod tests;
