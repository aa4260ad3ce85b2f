//! Estimation of the noise per sample from pose means of different numbers of samples.

use nalgebra::{DMatrix, DVector};
use wimu_calib::{Estimate, Parameter, Pose};

use crate::stats::norm;

/// Smallest ratio of the largest to the smallest number of samples: below it the noise is not observable.
const MIN_RATIO: u32 = 4;
/// Fewest degrees of freedom.
const MIN_DOF: usize = 4;
/// Gain in log-likelihood that is exceeded by chance once in twenty times: half the 95 % quantile of χ²₁.
const MIN_GAIN: f64 = 1.92;

/// The poses with the standard deviation of a sample, where the residuals under `estimate` show that means of fewer
/// samples are noisier; `None` where they do not, or where it is known.
pub fn with_noise(estimate: &Estimate, poses: &[Pose]) -> Option<Vec<Pose>> {
    let counts = || poses.iter().map(|pose| pose.samples.max(1));
    let differ = counts().max()? / counts().min()? >= MIN_RATIO;
    // All rejected poses must be listed.
    let named = estimate.rejected.count() == estimate.rejected.as_slice().len();
    if !differ
        || !named
        || estimate.dof < MIN_DOF
        || poses.iter().any(|pose| pose.sd_mps2 != [0.0; 3])
    {
        return None;
    }
    let kept = |(index, _): &(usize, &Pose)| !estimate.rejected.as_slice().contains(index);
    let rows: Vec<Row> = (poses.iter().enumerate().filter(kept))
        .map(|(_, pose)| Row {
            residual: estimate.residual_mps2(pose),
            samples: f64::from(pose.samples.max(1)),
            by_parameter: by_parameter(estimate, pose),
        })
        .collect();
    let variance = noise(&rows)?;
    let with = |pose: &Pose| Pose { sd_mps2: [variance.sqrt(); 3], ..*pose };
    Some(poses.iter().map(with).collect())
}

/// The residual of a pose.
struct Row {
    residual: f64,
    samples: f64,
    /// Derivatives of the residual by the basic parameters that were fitted.
    by_parameter: Vec<f64>,
}

/// Derivatives of |f|: the direction for the bias, products of the direction for A.
fn by_parameter(estimate: &Estimate, pose: &Pose) -> Vec<f64> {
    let length = norm(pose.mean_mps2);
    let up = pose.mean_mps2.map(|y| y / length.max(f64::MIN_POSITIVE));
    let fitted = |parameter: &Parameter| estimate.fitted.contains(*parameter);
    let derivative = |parameter: Parameter| match parameter.index() {
        axis @ 0..3 => up[axis],
        place => up[(place - 3) / 3] * up[(place - 3) % 3],
    };
    Parameter::ALL.into_iter().filter(fitted).map(derivative).collect()
}

/// The likeliest variance of a sample, for residuals of variance `common + variance / samples`;
/// `None` where a common variance alone is as likely. Restricted maximum likelihood: it does not depend on the
/// weights of the fit.
fn noise(rows: &[Row]) -> Option<f64> {
    // Both variances by `share`, the fraction of the noise per sample in a mean of one sample.
    let likelihood = |share: f64| {
        let parameters = rows.first()?.by_parameter.len();
        let mut normal = DMatrix::zeros(parameters, parameters);
        let mut right = DVector::zeros(parameters);
        let (mut squares, mut logs) = (0.0, 0.0);
        for row in rows {
            let relative = (1.0 - share) + share / row.samples;
            squares += row.residual * row.residual / relative;
            logs += relative.ln();
            for (i, a) in row.by_parameter.iter().enumerate() {
                right[i] += a * row.residual / relative;
                for (j, b) in row.by_parameter.iter().enumerate() {
                    normal[(i, j)] += a * b / relative;
                }
            }
        }
        let (explained, log_determinant) = solve(normal, &right)?;
        let free = rows.len().checked_sub(parameters).filter(|free| *free > 0)? as f64;
        let variance = (squares - explained).max(0.0) / free;
        let log = free * variance.max(f64::MIN_POSITIVE).ln() + logs + log_determinant;
        Some((-0.5 * log, share * variance))
    };
    let (equal, _) = likelihood(0.0)?;
    // From 10⁻³ to 10⁶ of the common variance, and the noise alone.
    let shares = (-12..=24).map(|k| 10_f64.powf(0.25 * f64::from(k)));
    let shares = shares.map(|ratio| ratio / (1.0 + ratio)).chain([1.0]);
    let (best, variance) = shares.filter_map(likelihood).max_by(|a, b| a.0.total_cmp(&b.0))?;
    (best - equal > MIN_GAIN && variance > 0.0).then_some(variance)
}

/// rᵀ N⁻¹ r and ln det N of normal equations; `None` where they are singular.
fn solve(normal: DMatrix<f64>, right: &DVector<f64>) -> Option<(f64, f64)> {
    let size = normal.diagonal();
    let lower = normal.cholesky()?.unpack();
    let pivots = lower.diagonal();
    if pivots.iter().zip(&size).any(|(pivot, size)| pivot * pivot <= 1e-12 * size) {
        return None;
    }
    let explained = lower.solve_lower_triangular(right)?.norm_squared();
    Some((explained, 2.0 * pivots.iter().map(|pivot| pivot.ln()).sum::<f64>()))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Residuals whose mean square is what it should be, of poses with 10 or 1000 samples.
    fn rows(common: f64, variance: f64) -> Vec<Row> {
        (0..40)
            .map(|k| {
                let samples = if k % 2 == 0 { 10.0 } else { 1000.0 };
                // 0.2 to 1.8, twenty of each, mean 1.
                let spread: f64 = 0.2 + 1.6 * f64::from(k / 2) / 19.0;
                Row {
                    residual: ((common + variance / samples) * spread).sqrt(),
                    samples,
                    by_parameter: Vec::new(),
                }
            })
            .collect()
    }

    #[test]
    fn the_noise_comes_back_and_equal_scatter_is_none() {
        let found = noise(&rows(1e-6, 1e-2)).unwrap();
        assert!((0.6e-2..1.6e-2).contains(&found), "{found}");
        let found = noise(&rows(0.0, 1e-2)).unwrap();
        assert!((0.8e-2..1.2e-2).contains(&found), "{found}");
        assert_eq!(noise(&rows(1e-6, 0.0)), None);
        assert_eq!(noise(&rows(0.0, 0.0)), None);
    }

    #[test]
    fn normal_equations_are_solved_and_singular_ones_refused() {
        // N⁻¹ r = (1, 2): rᵀ N⁻¹ r = 8 · 1 + 8 · 2, det N = 8.
        let normal = DMatrix::from_row_slice(2, 2, &[4.0, 2.0, 2.0, 3.0]);
        let (explained, log) = solve(normal, &DVector::from_element(2, 8.0)).unwrap();
        assert!((explained - 24.0).abs() < 1e-12 && (log - 8_f64.ln()).abs() < 1e-12);
        let ones = DMatrix::from_element(2, 2, 1.0);
        assert_eq!(solve(ones, &DVector::from_element(2, 1.0)), None);
    }
}
