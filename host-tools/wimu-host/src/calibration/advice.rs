//! Recommended poses.

use wimu_calib::{Face, Guide, Orientation, Pose, Reason, Refusal};

use super::{CalibrateOptions, MethodChoice, NextPose, wanted};

/// Largest number of orientations recommended at once.
const MAX_ADVISED: usize = 6;
/// Up to this many more poses than parameters are planned together: chosen one by one they would not be the best set.
const PLANNED_BEYOND: usize = 3;

/// Poses that would resolve this refusal.
pub(super) fn next_poses(
    refusal: &Refusal,
    poses: &[Pose],
    options: &CalibrateOptions,
) -> Vec<NextPose> {
    match refusal.reason {
        // A repeated orientation adds little: its error may be the same.
        Reason::NotObservable | Reason::PoorPrediction { .. } => advice(poses, options, 1),
        // One that replaces the disturbed pose, and one that identifies it.
        Reason::Contradicted { .. } => advice(poses, options, 2),
        Reason::TooFew { .. } if options.method == MethodChoice::SixPosition => Face::ALL
            .into_iter()
            .filter(|face| poses.iter().all(|pose| Face::of(pose) != Some(*face)))
            .map(|face| Orientation::from(face).into())
            .collect(),
        Reason::TooFew { have, need } => advice(poses, options, need.saturating_sub(have)),
        _ => Vec::new(),
    }
}

/// The orientations that improve the fit of these poses most: all worthwhile ones, at least `least`.
pub(super) fn advice(poses: &[Pose], options: &CalibrateOptions, least: usize) -> Vec<NextPose> {
    if options.method != MethodChoice::MultiPosition {
        return Vec::new();
    }
    let mut guide = Guide::after(wanted(options), poses);
    let count = guide.worth(|_| true).min(MAX_ADVISED).max(least);
    let enough = wanted(options).fitted().iter().count() + PLANNED_BEYOND;
    let planned = count.max(enough.saturating_sub(poses.len()));
    let next = |remaining| {
        let next = guide.next_of(remaining, |_| true)?;
        guide.take(next.up());
        Some(next.into())
    };
    ((planned - count + 1)..=planned).rev().map_while(next).collect()
}
