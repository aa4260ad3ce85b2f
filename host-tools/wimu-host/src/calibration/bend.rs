//! Whether the bias moved in another course than the straight line of a drift.

use wimu_calib::{Estimate, Pose, Term};

use super::input::magnitude;

/// Columns of the fit: bias, symmetric matrix, drift; then what bends.
const FITTED: usize = 12;
const BENDS: usize = 3;
/// Degrees of freedom that have to be left.
const SPARE: usize = 3;
/// Standard deviations that chance has once in 500 times, one-sided.
const BEYOND_CHANCE: f64 = 2.88;
/// A column of which less is its own is none.
const OWN: f64 = 1e-6;

/// What a bias that bends under a drift does to the answer; `None` where the poses show none.
pub(super) fn remark(poses: &[Pose], estimate: &Estimate) -> Option<&'static str> {
    let drift = estimate
        .drift
        .filter(|_| estimate.terms.contains(Term::Drift))?;
    let rejected = estimate.rejected.as_slice();
    let kept: Vec<&Pose> = (0..)
        .zip(poses)
        .filter_map(|(k, pose)| (!rejected.contains(&k)).then_some(pose))
        .collect();
    let freedom = kept.len().checked_sub(FITTED + BENDS + SPARE)? + SPARE;
    let mut columns: Vec<Vec<f64>> = vec![Vec::new(); FITTED + BENDS];
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
    // Each column, and then what is left, less what the columns before it explain.
    let mut basis: Vec<Vec<f64>> = Vec::new();
    let mut by_bends = 0.0;
    for (number, column) in columns.into_iter().enumerate() {
        let whole = dot(&column, &column);
        let own = without(column, &basis);
        let square = dot(&own, &own);
        if square <= OWN * whole {
            return None;
        }
        let unit: Vec<f64> = own.iter().map(|value| value / square.sqrt()).collect();
        if number >= FITTED {
            by_bends += dot(&unit, &left).powi(2);
        }
        basis.push(unit);
    }
    let rest = without(left, &basis);
    let noise = dot(&rest, &rest) / freedom as f64;
    let ratio = by_bends / BENDS as f64 / noise;
    (fisher(ratio, BENDS as f64, freedom as f64) > BEYOND_CHANCE).then_some(
        "the bias did not move in a straight line, as when a sensor warms up: the bias at the end is farther off than \
         its interval says; record again when the sensor is warm, or with its temperature and --model auto+temperature",
    )
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

/// `column` less what lies along the unit vectors of `basis`.
fn without(mut column: Vec<f64>, basis: &[Vec<f64>]) -> Vec<f64> {
    for unit in basis {
        let along = dot(&column, unit);
        for (value, unit) in column.iter_mut().zip(unit) {
            *value -= along * unit;
        }
    }
    column
}

/// Fisher's ratio of `a` and `b` degrees of freedom in standard deviations, by Wilson and Hilferty's cube roots.
fn fisher(ratio: f64, a: f64, b: f64) -> f64 {
    let root = ratio.cbrt();
    let [a, b] = [a, b].map(|freedom| 2.0 / (9.0 * freedom));
    ((1.0 - b) * root - (1.0 - a)) / (b * root * root + a).sqrt()
}
