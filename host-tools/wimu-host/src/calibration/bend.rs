//! Test whether the bias drift was linear in time.

use wimu_calib::{Estimate, Pose, Term};

use super::input::magnitude;
use crate::finding::{Finding, FindingCode};

/// Columns of the fit: bias, symmetric matrix and linear drift; then the quadratic drift.
const FITTED: usize = 12;
const QUADRATIC: usize = 3;
/// Fewest degrees of freedom left.
const MIN_DOF: usize = 3;
/// Threshold of the test, standard deviations: exceeded by chance once in 500 times (one-sided).
const THRESHOLD: f64 = 2.88;
/// A column with a smaller fraction independent of the others makes the fit singular.
const MIN_INDEPENDENT: f64 = 1e-6;

/// A significant quadratic drift beside the linear one that was fitted.
pub(super) fn finding(poses: &[Pose], estimate: &Estimate) -> Option<Finding> {
    let drift = estimate
        .drift
        .filter(|_| estimate.terms.contains(Term::Drift))?;
    let rejected = estimate.rejected.as_slice();
    let kept: Vec<&Pose> = (0..)
        .zip(poses)
        .filter_map(|(k, pose)| (!rejected.contains(&k)).then_some(pose))
        .collect();
    let freedom = kept.len().checked_sub(FITTED + QUADRATIC + MIN_DOF)? + MIN_DOF;
    let mut columns: Vec<Vec<f64>> = vec![Vec::new(); FITTED + QUADRATIC];
    let mut left = Vec::new();
    for pose in kept {
        let size = magnitude(pose.mean_mps2);
        let [x, y, z] = pose.mean_mps2.map(|axis| axis / size);
        let s = (pose.time_s - drift.end_s) / drift.span_s;
        let row = [
            [x, y, z],
            [x * x, y * y, z * z],
            [x * y, x * z, y * z],
            [x * s, y * s, z * s],
            [x * s * s, y * s * s, z * s * s],
        ];
        for (column, value) in columns.iter_mut().zip(row.into_iter().flatten()) {
            column.push(value);
        }
        left.push(estimate.residual_mps2(pose));
    }
    // Gram and Schmidt: each column, then the residuals, less their projections on the columns before.
    let mut basis: Vec<Vec<f64>> = Vec::new();
    let mut by_quadratic = 0.0;
    for (number, column) in columns.into_iter().enumerate() {
        let whole = dot(&column, &column);
        let own = without(column, &basis);
        let square = dot(&own, &own);
        if square <= MIN_INDEPENDENT * whole {
            return None;
        }
        let unit: Vec<f64> = own.iter().map(|value| value / square.sqrt()).collect();
        if number >= FITTED {
            by_quadratic += dot(&unit, &left).powi(2);
        }
        basis.push(unit);
    }
    let rest = without(left, &basis);
    let noise = dot(&rest, &rest) / freedom as f64;
    let ratio = by_quadratic / QUADRATIC as f64 / noise;
    let text = "the bias drift was not linear, as during warm-up: the error of the bias at the end exceeds its interval";
    let finding = || FindingCode::Residuals.warning(text);
    (normal_of_fisher(ratio, QUADRATIC as f64, freedom as f64) > THRESHOLD).then(|| {
        finding().remedy(
            "record again when the sensor is warm, or with its temperature and --model auto+temperature",
        )
    })
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

/// `column` less its projections on the unit vectors of `basis`.
fn without(mut column: Vec<f64>, basis: &[Vec<f64>]) -> Vec<f64> {
    for unit in basis {
        let along = dot(&column, unit);
        for (value, unit) in column.iter_mut().zip(unit) {
            *value -= along * unit;
        }
    }
    column
}

/// Fisher's variance ratio with `a` and `b` degrees of freedom as a standard normal deviate (Wilson and Hilferty).
fn normal_of_fisher(ratio: f64, a: f64, b: f64) -> f64 {
    let root = ratio.cbrt();
    let [a, b] = [a, b].map(|freedom| 2.0 / (9.0 * freedom));
    ((1.0 - b) * root - (1.0 - a)) / (b * root * root + a).sqrt()
}
