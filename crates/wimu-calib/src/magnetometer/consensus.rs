//! Detection of poses in a disturbed field by a robust fit.

use alloc::vec::Vec;

use nalgebra::{Matrix3, Vector3};

use super::fit::{Iron, Magnitude, Scaled, inverse_soft, sphere, start};
use super::{EARTHS_NT, FEWEST, MagneticPose};
use crate::least_squares::ResidualModel;

/// Scales of the Cauchy cost, fractions of the field: residuals from one to the next are ignored step by step.
const SCALES: [f64; 4] = [0.3, 0.1, 0.03, 0.01];
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
    let field = Magnitude(poses.iter().map(point).collect());
    let mut off: Option<Vec<f64>> = None;
    for first in start(field.0.iter().copied()).into_iter().chain([sphere(&field.0)]) {
        let robust = |theta: Iron, scale: f64| field.fit(&theta, Some(scale)).map(|fit| fit.at);
        let Some(theta) = SCALES.into_iter().try_fold(first, robust) else { continue };
        let axes = inverse_soft(&theta).symmetric_eigenvalues();
        let field_nt = scaled.unit_nt / libm::cbrt(axes.product());
        // A longer ellipsoid fits any poses.
        if axes.max() < axes.min() * MOST_STRETCH && EARTHS_NT.contains(&field_nt) {
            let found: Vec<f64> = field.rows(&theta)?.residual.iter().copied().collect();
            if off.as_ref().is_none_or(|before| agreeing(before) < agreeing(&found)) {
                off = Some(found);
            }
        }
    }
    let off = off?;
    let count = agreeing(&off);
    let left = poses.len() - count;
    if count >= FEWEST && 2 * count > poses.len() && left > 0 {
        let disturbed = (0..poses.len()).filter(|k| off[*k].abs() >= AGREES).collect();
        let squares: f64 = off.iter().map(|off| off * off).sum();
        return Some((libm::sqrt(squares / n), disturbed, left));
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

/// Number of inliers.
fn agreeing(off: &[f64]) -> usize {
    off.iter().filter(|off| off.abs() < AGREES).count()
}
