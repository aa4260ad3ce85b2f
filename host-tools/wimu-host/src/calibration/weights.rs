//! Estimation of the noise per sample from pose means of different numbers of samples.

use nalgebra::{DMatrix, DVector};
use wimu_calib::{Estimate, POSE_SCATTER_MPS2, Parameter, Pose};

use crate::stats::norm;

/// Smallest ratio of the largest to the smallest number of samples: below it the noise is not observable.
const MIN_RATIO: u32 = 4;
/// Fewest means of so few samples: one or two may be disturbed otherwise.
const MIN_FEW: usize = 3;
/// Fewest degrees of freedom.
const MIN_DOF: usize = 4;
/// Gain in log-likelihood that is exceeded by chance once in twenty times: half the 95 % quantile of χ²₁.
const MIN_GAIN: f64 = 1.92;

/// The poses with the standard deviation of a sample, where the residuals under `estimate` show that means of fewer
/// samples are noisier; `None` where they do not, or where it is known.
pub fn with_noise(estimate: &Estimate, poses: &[Pose]) -> Option<Vec<Pose>> {
    let counts = || poses.iter().map(|pose| pose.samples.max(1));
    let most = counts().max()?;
    let differ = counts().filter(|count| most / count >= MIN_RATIO).count() >= MIN_FEW;
    if !differ || estimate.dof < MIN_DOF || poses.iter().any(|pose| pose.sd_mps2 != [0.0; 3]) {
        return None;
    }
    let kept = |(index, _): &(usize, &Pose)| !estimate.rejected.contains(index);
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

/// The likeliest variance of a sample, for residuals of variance `common + variance / samples`, of which the common one is at
/// least that of the usual scatter of poses; `None` where a common variance alone is as likely. Restricted maximum
/// likelihood: it does not depend on the weights of the fit.
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
        Some((-0.5 * log, share * variance, (1.0 - share) * variance))
    };
    let (equal, ..) = likelihood(0.0)?;
    // From 10⁻³ to 10⁶ of the common variance.
    let shares = (-12..=24).map(|k| 10_f64.powf(0.25 * f64::from(k)));
    let found = shares.filter_map(|ratio| likelihood(ratio / (1.0 + ratio)));
    let found = found.filter(|(.., common)| *common >= POSE_SCATTER_MPS2 * POSE_SCATTER_MPS2);
    let (best, variance, _) = found.max_by(|a, b| a.0.total_cmp(&b.0))?;
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
