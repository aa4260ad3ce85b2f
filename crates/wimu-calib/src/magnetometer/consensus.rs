//! Detection of poses in a disturbed field by random sample consensus (RANSAC).

use alloc::vec::Vec;

use nalgebra::{Matrix3, Vector3};

use super::fit::{Iron, Scaled, hard, inverse_soft, start};
use super::{EARTHS_NT, FEWEST, MagneticPose};

/// Number of poses in a sample: the parameters of an ellipsoid.
const TRIAL: usize = 9;
/// Number of samples: one of them is undisturbed with probability 0.95 if three of eight poses are
/// disturbed.
const TRIALS: u32 = 300;
/// Largest number of refits to the inliers.
const REFITS: usize = 5;
/// Largest relative deviation of the field magnitude of an inlier.
const AGREES: f64 = 0.02;
/// Largest ratio of the axes of the ellipsoid by soft iron. A longer ellipsoid fits any poses.
const MOST_STRETCH: f64 = 2.0;
/// Smallest eigenvalue of the scatter of the orientations, whose eigenvalues have sum one.
const SPREAD: f64 = 0.12;
/// Smallest over largest eigenvalue of the scatter of the outputs.
const LEAST_DEPTH: f64 = 0.02;

/// The rms relative disturbance of the field, the disturbed poses, and their number; `None` if the
/// poses do not show it. Equation (56).
pub(super) fn disturbed(poses: &[MagneticPose]) -> Option<(f64, Vec<usize>, usize)> {
    let n = poses.len() as f64;
    let scaled = Scaled::of(poses.iter())?;
    let point = |p: &MagneticPose| scaled.point(p);
    let off = |theta: &Iron, p: &MagneticPose| {
        (inverse_soft(theta) * (point(p) - hard(theta))).norm() - 1.0
    };
    // Number of inliers, reduced by their squared deviations.
    let agreeing = |theta: &Iron| {
        let lack = |p: &MagneticPose| (off(theta, p) / AGREES).abs().min(1.0);
        poses.iter().map(|p| 1.0 - lack(p) * lack(p)).sum::<f64>()
    };
    // The ellipsoid through `points`, if it is plausible for a magnetometer in the field of the
    // Earth.
    let ellipsoid = |points: &mut dyn Iterator<Item = Vector3<f64>>| -> Option<Iron> {
        let theta = start(points)?;
        let axes = inverse_soft(&theta).symmetric_eigenvalues();
        let field_nt = scaled.unit_nt / libm::cbrt(axes.product());
        let sound = axes.max() < axes.min() * MOST_STRETCH && EARTHS_NT.contains(&field_nt);
        sound.then_some(theta)
    };
    // Refits to the inliers while their number increases.
    let refined = |mut score: f64, mut theta: Iron| {
        for _ in 0..REFITS {
            let mut points = poses.iter().filter(|p| off(&theta, p).abs() < AGREES).map(point);
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
    // A fixed pseudorandom sequence, for reproducible results.
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
        // Noise distorts a fit through nine poses: nearly as many inliers suffice for refinement.
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
        let strays = poses.iter().enumerate().filter(|(_, p)| off(&theta, p).abs() >= AGREES);
        let found = strays.map(|(k, _)| k).collect();
        let squares = poses.iter().map(|p| off(&theta, p) * off(&theta, p));
        return Some((libm::sqrt(squares.sum::<f64>() / n), found, left));
    }
    // Few inliers: was the sensor turned in all directions?
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
    Some((share, Vec::new(), poses.len()))
}
