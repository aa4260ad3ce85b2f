//! Detection of poses in a disturbed field by a robust fit.

use alloc::vec::Vec;

use super::fit::{Iron, Magnitude, Scaled, inverse_soft, sphere, start};
use super::{EARTHS_NT, FEWEST, MagneticPose};
use crate::least_squares::ResidualModel;

/// Scales of the Cauchy cost, fractions of the field: residuals from one to the next are ignored step by step.
const SCALES: [f64; 4] = [0.3, 0.1, 0.03, 0.01];
/// Largest relative deviation of the field magnitude of an inlier.
const AGREES: f64 = 0.02;
/// Largest ratio of the axes of the ellipsoid by soft iron. A longer ellipsoid fits any poses.
const MOST_STRETCH: f64 = 2.0;

/// The rms relative disturbance of the field, and the disturbed poses; `None` if the poses do not show it. Equation (56).
pub(super) fn disturbed(poses: &[MagneticPose]) -> Option<(f64, Vec<usize>)> {
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
    if count < FEWEST || 2 * count <= poses.len() || count == poses.len() {
        return None;
    }
    let disturbed = (0..poses.len()).filter(|k| off[*k].abs() >= AGREES).collect();
    let squares: f64 = off.iter().map(|off| off * off).sum();
    Some((libm::sqrt(squares / poses.len() as f64), disturbed))
}

/// Number of inliers.
fn agreeing(off: &[f64]) -> usize {
    off.iter().filter(|off| off.abs() < AGREES).count()
}
