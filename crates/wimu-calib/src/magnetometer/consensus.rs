//! Which poses were disturbed, where the others agree on one field.

use nalgebra::{Matrix3, Vector3};

use super::fit::{Iron, Scaled, hard, inverse_soft, start};
use super::{EARTHS_NT, FEWEST, MagneticPose};
use crate::Rejected;

/// Poses of a trial: as many as the ellipsoid has parameters.
const TRIAL: usize = 9;
/// Of so many trials one is without a disturbed pose, 19 times of 20, where three of eight are disturbed.
const TRIALS: u32 = 300;
/// Fits to those that agree, at most.
const REFITS: usize = 5;
/// A pose agrees when its field is within this share of all others'.
const AGREES: f64 = 0.02;
/// Soft iron stretches the field no more than this, one direction against another. A longer ellipsoid
/// passes by all poses, and tells nothing.
const MOST_STRETCH: f64 = 2.0;
/// The eigenvalues of the directions' scatter sum to one.
const SPREAD: f64 = 0.12;
/// Least variance of the field's output along any direction, per that along another.
const LEAST_DEPTH: f64 = 0.02;

/// The share of the field that is disturbed, rms, the poses where it is, and how many there are; `None`
/// where the poses do not say that. Equation (56).
pub(super) fn disturbed(poses: &[MagneticPose]) -> Option<(f64, Rejected, usize)> {
    let n = poses.len() as f64;
    let scaled = Scaled::of(poses.iter())?;
    let point = |p: &MagneticPose| scaled.point(p);
    let off = |theta: &Iron, p: &MagneticPose| {
        (inverse_soft(theta) * (point(p) - hard(theta))).norm() - 1.0
    };
    // Poses that agree, less how far they are from doing so perfectly.
    let agreeing = |theta: &Iron| {
        let lack = |p: &MagneticPose| (off(theta, p) / AGREES).abs().min(1.0);
        poses.iter().map(|p| 1.0 - lack(p) * lack(p)).sum::<f64>()
    };
    // Through so many points, if it can be that of a magnetometer in the Earth's field.
    let ellipsoid = |points: &mut dyn Iterator<Item = Vector3<f64>>| -> Option<Iron> {
        let theta = start(points)?;
        let axes = inverse_soft(&theta).symmetric_eigenvalues();
        let field_nt = scaled.unit_nt / libm::cbrt(axes.product());
        let sound = axes.max() < axes.min() * MOST_STRETCH && EARTHS_NT.contains(&field_nt);
        sound.then_some(theta)
    };
    // All that agree make it better, and more agree with that.
    let refined = |mut score: f64, mut theta: Iron| {
        for _ in 0..REFITS {
            let mut points = poses
                .iter()
                .filter(|p| off(&theta, p).abs() < AGREES)
                .map(point);
            let Some(better) = ellipsoid(&mut points) else {
                break;
            };
            let more = agreeing(&better);
            if more <= score {
                break;
            }
            (score, theta) = (more, better);
        }
        (score, theta)
    };
    let mut best: Option<(f64, Iron)> = None;
    let mut most_at_first = 0.0_f64;
    // Any numbers that look random do; the same ones give the same answer every time.
    let mut state = 1_u64;
    for _ in 0..TRIALS {
        let mut chosen = [usize::MAX; TRIAL];
        for place in 0..TRIAL {
            loop {
                state = state
                    .wrapping_mul(6_364_136_223_846_793_005)
                    .wrapping_add(1_442_695_040_888_963_407);
                let pick = (state >> 33) as usize % poses.len();
                if !chosen.contains(&pick) {
                    chosen[place] = pick;
                    break;
                }
            }
        }
        let mut points = chosen.iter().filter_map(|k| poses.get(*k)).map(point);
        let Some(theta) = ellipsoid(&mut points) else {
            continue;
        };
        let score = agreeing(&theta);
        most_at_first = most_at_first.max(score);
        // Noise bends what goes through nine poses: nearly as good is good enough to be refined.
        if score < 0.75 * most_at_first {
            continue;
        }
        let found = refined(score, theta);
        if best.is_none_or(|(most, _)| found.0 > most) {
            best = Some(found);
        }
    }
    let (_, theta) = best?;
    let agree = poses.iter().filter(|p| off(&theta, p).abs() < AGREES);
    let count = agree.count();
    let left = poses.len() - count;
    if count >= FEWEST && 2 * count > poses.len() && left > 0 {
        let mut found = Rejected::default();
        for (k, _) in poses
            .iter()
            .enumerate()
            .filter(|(_, p)| off(&theta, p).abs() >= AGREES)
        {
            found = found.with(k);
        }
        let squares = poses.iter().map(|p| off(&theta, p) * off(&theta, p));
        return Some((libm::sqrt(squares.sum::<f64>() / n), found, left));
    }
    // Hardly any agree: was it turned to all sides, in a field that has all directions?
    let scatter = |v: &dyn Fn(&MagneticPose) -> Vector3<f64>| {
        let sum: Matrix3<f64> = poses.iter().map(|p| v(p) * v(p).transpose()).sum();
        let values = sum.symmetric_eigenvalues();
        [values.min(), values.max()].map(|value| value / n)
    };
    let ups = scatter(&|p| Vector3::from(p.up).normalize());
    let fields = scatter(&point);
    let turned = ups[0] > SPREAD && fields[0] > LEAST_DEPTH * fields[1];
    if !turned || 2 * count > poses.len() {
        return None;
    }
    let size = |p: &MagneticPose| point(p).norm();
    let mean = poses.iter().map(size).sum::<f64>() / n;
    let spread = poses.iter().map(|p| size(p) / mean - 1.0);
    let share = libm::sqrt(spread.map(|s| s * s).sum::<f64>() / n);
    Some((share, Rejected::default(), poses.len()))
}
