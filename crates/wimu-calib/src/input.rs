//! Checks that every method makes before it computes.

use crate::{Gravity, Pose, Refusal, UnitHint};

/// Refuses poses that are not finite, whose mean magnitude cannot be gravity in m/s², or in which an axis
/// falls silent at its end.
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
            return Err(Refusal::NotFinite { pose });
        }
        sum += libm::sqrt(entry.mean_mps2.iter().map(|y| y * y).sum());
        count += 1.0;
    }
    if count == 0.0 {
        return Ok(());
    }
    let mean_mps2 = sum / count;
    match unit(mean_mps2, gravity.mps2()) {
        Some(hint) => Err(match stands(poses, mean_mps2) {
            Some(axis) => Refusal::AxisStuck { axis },
            None => Refusal::UnexpectedMagnitude { mean_mps2, hint },
        }),
        None => match silent_at_its_end(poses.clone()).or_else(|| nothing_between(poses)) {
            Some(axis) => Err(Refusal::Saturated { axis }),
            None => Ok(()),
        },
    }
}

/// Of the mean magnitude: the spread of an axis that stands, how much it reads then, and the spread of one that turns.
const STANDS: f64 = 0.01;
const MOST_OF_IT: f64 = 0.7;
const TURNS: f64 = 0.1;

/// The axis that is nearly all of the magnitude in every pose while another turns: stuck at full scale.
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
    (0..3)
        .any(|axis| axis != stuck && spread(axis) > TURNS)
        .then_some(stuck)
}

/// How many poses differ, counted up to `enough`: one that is equal to another to the last digit is the
/// same again.
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

/// So many samples with noise are not all alike.
const MANY_SAMPLES: u32 = 30;

/// The axis that says one and the same all through the pose where it is highest or lowest, while its
/// noise shows in two poses of three.
fn silent_at_its_end<'a>(poses: impl Iterator<Item = &'a Pose> + Clone) -> Option<usize> {
    (0..3).find(|&axis| {
        let (mut count, mut noisy) = (0, 0);
        // Reading, and whether it is silent.
        let mut low = (f64::INFINITY, false);
        let mut high = (f64::NEG_INFINITY, false);
        for pose in poses.clone() {
            let (mean, sd) = (pose.mean_mps2[axis], pose.sd_mps2[axis]);
            let silent = sd <= 0.0 && pose.samples >= MANY_SAMPLES;
            count += 1;
            noisy += usize::from(sd > 0.0 && pose.rounding_sd_mps2[axis] <= 0.0);
            if mean < low.0 {
                low = (mean, silent);
            }
            if mean > high.0 {
                high = (mean, silent);
            }
        }
        3 * noisy >= 2 * count && (low.1 || high.1)
    })
}

/// Fewer poses than this may all lie in the corners of a cube.
const CORNERS: usize = 5;

/// An axis, where each of the three has two silent readings and nothing between in all poses: its two ends.
fn nothing_between<'a>(poses: impl Iterator<Item = &'a Pose> + Clone) -> Option<usize> {
    let two = |axis: usize| {
        let readings = || poses.clone().map(move |pose| pose.mean_mps2[axis]);
        let [low, high] = extremes(readings());
        low < high && readings().all(|y| y == low || y == high)
    };
    let silent =
        |pose: &Pose| pose.samples >= MANY_SAMPLES && pose.sd_mps2.iter().all(|sd| *sd <= 0.0);
    let count = poses.clone().count();
    (count > CORNERS && poses.clone().all(silent) && (0..3).all(two)).then_some(0)
}

/// What |y| of this mean size looks like where it cannot be gravity in m/s².
pub(crate) fn unit(mean_mps2: f64, gravity_mps2: f64) -> Option<UnitHint> {
    // Bias and scale factor within the error model's bounds move |y| by less than this.
    if (0.4..=2.1).contains(&(mean_mps2 / gravity_mps2)) {
        return None;
    }
    Some(match mean_mps2 {
        m if (0.7..1.4).contains(&m) => UnitHint::G,
        m if (85.0..108.0).contains(&m) => UnitHint::Mps2TakenForG,
        m if (700.0..1400.0).contains(&m) => UnitHint::MilliGOrCounts,
        m if m > 100.0 && m < 1e6 => UnitHint::Counts,
        _ => UnitHint::NotGravity,
    })
}

/// An axis whose reading changes by less than this over all poses, m/s², is not turned, 0.6°.
const TURNED_MPS2: f64 = 0.1;
/// No axis rests at more than so many times gravity.
const BEYOND_GRAVITY: f64 = 1.3;
/// Poses that read exactly alike at the end of an axis's range, though they differ, are clipped.
const CLIPPED: usize = 3;

/// The axis that reads the same in every pose, though another does not.
pub(crate) fn stuck_axis(poses: &[Pose]) -> Option<usize> {
    let spread = |axis: usize| {
        let [low, high] = ends(poses, axis);
        high - low
    };
    let turns = |axis: &usize| spread(*axis) >= TURNED_MPS2;
    (0..3).find(turns)?;
    (0..3).find(|axis| !turns(axis))
}

/// The axis that reads the same in every pose while gravity leaves the others: dead, where an axis
/// that was never turned leaves |y| as it is. Or that reads more than gravity, or does so without the noise of the
/// others.
pub(crate) fn dead_axis(poses: &[Pose], gravity: Gravity) -> Option<usize> {
    let [low, high] = extremes(magnitudes(poses));
    stuck_axis(poses).filter(|&axis| {
        let [_, most] = ends(poses, axis).map(f64::abs);
        let silent =
            |pose: &Pose, axis: usize| pose.samples >= MANY_SAMPLES && pose.sd_mps2[axis] <= 0.0;
        let others = || (0..3).filter(move |other| *other != axis);
        let alone = poses.iter().all(|pose| silent(pose, axis))
            && others().any(|other| poses.iter().all(|pose| !silent(pose, other)));
        high - low > 0.3 * high || most > BEYOND_GRAVITY * gravity.mps2() || alone
    })
}

/// Poses of which some are as long as others in another unit.
pub(crate) fn mixed_units(poses: &[Pose]) -> Option<Refusal> {
    let longest = magnitudes(poses).fold(0.0, f64::max);
    // A g of 9.8 m/s², a quarter allowed either way.
    let shorter = |size: &f64| (7.3..13.0).contains(&(longest / size));
    let pose = magnitudes(poses).position(|size| shorter(&size))?;
    let rest = magnitudes(poses).filter(|size| !shorter(size));
    // Both kinds are of one length each.
    let alike = rest.fold(f64::INFINITY, f64::min) > 0.6 * longest;
    alike.then_some(Refusal::MixedUnits { pose })
}

fn magnitudes(poses: &[Pose]) -> impl Iterator<Item = f64> {
    poses
        .iter()
        .map(|pose| libm::sqrt(pose.mean_mps2.iter().map(|y| y * y).sum()))
}

/// The axis at whose highest or lowest reading several poses end that are not one orientation.
pub(crate) fn clipped_axis(poses: &[Pose]) -> Option<usize> {
    (0..3).find(|&axis| {
        ends(poses, axis).into_iter().any(|end| {
            let mut first: Option<&Pose> = None;
            let differing = poses.iter().filter(|pose| {
                if pose.mean_mps2[axis] != end {
                    return false;
                }
                let first = *first.get_or_insert(pose);
                let apart = (0..3).map(|i| (pose.mean_mps2[i] - first.mean_mps2[i]).abs());
                apart.fold(0.0, f64::max) >= TURNED_MPS2
            });
            differing.count() + 1 >= CLIPPED
        })
    })
}

/// The lowest and the highest reading of an axis.
fn ends(poses: &[Pose], axis: usize) -> [f64; 2] {
    extremes(poses.iter().map(|pose| pose.mean_mps2[axis]))
}

/// Minimum and maximum.
pub(crate) fn extremes(values: impl Iterator<Item = f64>) -> [f64; 2] {
    values.fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], value| {
        [low.min(value), high.max(value)]
    })
}
