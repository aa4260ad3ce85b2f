//! The hypothesis test: whether further terms explain the residuals of an estimate, by Fisher's variance ratio: equation
//! (43a).
//!
//! The estimate is nested in the model with the terms. Their derivatives, less their projection on those of the fitted
//! parameters, explain a part of the sum of squares; its ratio to the rest is the statistic.

use alloc::vec::Vec;

use nalgebra::{DMatrix, DVector, Vector3};

use crate::{Estimate, POSE_SCATTER_DOF, POSE_SCATTER_MPS2, Pose, Term};

/// A column with a smaller fraction independent of the others is not tested: of an exponential beside a line 0.01 is.
const MIN_INDEPENDENT: f64 = 0.001;
/// Smallest to largest diagonal element of the triangular factor of derivatives that determine the parameters.
const MIN_PIVOT: f64 = 1e-3;

/// A pose as the test sees it.
#[derive(Clone, Copy, Debug)]
pub struct TestedPose {
    /// Its index.
    pub index: usize,
    /// Upward direction, sensor axes.
    pub up: [f64; 3],
    /// Time, s.
    pub time_s: f64,
    /// From the first pose, 0, to the last, 1.
    pub progress: f64,
    /// Temperature above the mean of the session, K; 0 if it is unknown.
    pub warmer_k: f64,
}

/// Residuals of an estimate in the order of time.
#[derive(Clone, Debug)]
pub struct Unexplained {
    poses: Vec<TestedPose>,
    /// Square root of the weight of each.
    root: Vec<f64>,
    /// Orthonormal basis of the derivatives by the fitted parameters, weighted.
    basis: DMatrix<f64>,
    /// Weighted residuals, less their projections on the basis.
    left: DVector<f64>,
}

/// The test of some terms.
#[derive(Clone, Debug)]
pub struct Nested {
    /// Estimates of the terms.
    pub size: Vec<f64>,
    /// Sum of squares that the terms explain, and the rest, (m/s²)².
    pub squares: [f64; 2],
    /// Their degrees of freedom.
    pub dof: [usize; 2],
}

impl Nested {
    /// Fisher's variance ratio; with at least `floor_mps2` of residual.
    pub fn statistic(&self, floor_mps2: f64) -> f64 {
        let [explained, rest] = self.squares;
        let [terms, dof] = self.dof.map(|dof| dof as f64);
        explained / terms / (rest / dof + floor_mps2 * floor_mps2)
    }

    /// With the usual scatter of poses as prior observations of the residuals' variance.
    #[must_use]
    pub fn with_usual_scatter(mut self) -> Self {
        self.squares[1] += POSE_SCATTER_DOF as f64 * POSE_SCATTER_MPS2 * POSE_SCATTER_MPS2;
        self.dof[1] += POSE_SCATTER_DOF;
        self
    }
}

impl Unexplained {
    /// Of the poses that were fitted, or with `all` of the rejected ones too. `None` where they have no times or do not
    /// exceed the parameters.
    pub fn new(poses: &[Pose], estimate: &Estimate, all: bool) -> Option<Self> {
        let mut order: Vec<usize> =
            (0..poses.len()).filter(|k| all || !estimate.rejected.contains(k)).collect();
        order.sort_by(|a, b| poses[*a].time_s.total_cmp(&poses[*b].time_s));
        // Poses of one orientation in succession share an error (42b): the first of them stands for all.
        order.dedup_by(|next, before| poses[*before].is_like(&poses[*next]));
        let (first_s, last_s) = (poses[*order.first()?].time_s, poses[*order.last()?].time_s);
        let bias = Vector3::from(estimate.model.terms().bias_mps2);
        let tested = |k: &usize| {
            let pose = &poses[*k];
            let up = (Vector3::from(pose.mean_mps2) - bias).try_normalize(0.0)?;
            let reference_c = estimate.temperature_c.unwrap_or(0.0);
            Some(TestedPose {
                index: *k,
                up: up.into(),
                time_s: pose.time_s,
                progress: (pose.time_s - first_s) / (last_s - first_s),
                warmer_k: pose.temperature_c.unwrap_or(reference_c) - reference_c,
            })
        };
        let tested = order.iter().map(tested).collect::<Option<Vec<TestedPose>>>()?;
        let count = tested.len();
        let parameters = fitted(&tested[0], estimate).len();
        if !(last_s > first_s && count > parameters + 1) {
            return None;
        }
        let noise: Vec<f64> = order.iter().map(|k| poses[*k].mean_free_noise()).collect();
        let common = estimate.pose_sd_mps2 * estimate.pose_sd_mps2;
        let mean_noise = noise.iter().sum::<f64>() / count as f64;
        let root = |noise: &f64| libm::sqrt((common + mean_noise) / (common + noise));
        let root: Vec<f64> = noise.iter().map(root).collect();
        let residuals = DVector::from_fn(count, |row, _| {
            root[row] * estimate.residual_mps2(&poses[order[row]])
        });
        let mut derivatives = DMatrix::zeros(count, parameters);
        for (row, pose) in tested.iter().enumerate() {
            for (column, value) in fitted(pose, estimate).into_iter().enumerate() {
                derivatives[(row, column)] = root[row] * value;
            }
        }
        let factor = derivatives.qr();
        let diagonal = factor.r().diagonal();
        if diagonal.amin() <= MIN_PIVOT * diagonal.amax() {
            return None;
        }
        let basis = factor.q();
        let left = &residuals - &basis * basis.tr_mul(&residuals);
        Some(Self { poses: tested, root, basis, left })
    }

    /// The poses, in the order of time.
    pub fn poses(&self) -> &[TestedPose] {
        &self.poses
    }

    /// Number of parameters of the estimate.
    pub fn parameters(&self) -> usize {
        self.basis.ncols()
    }

    /// The test of `terms` terms, of which `derivative` is that of |f| at a pose by one. `None` if they cannot be told from
    /// the fitted parameters.
    pub fn with(
        &self,
        terms: usize,
        derivative: impl Fn(&TestedPose, usize) -> f64,
    ) -> Option<Nested> {
        let count = self.poses.len();
        let whole = DMatrix::from_fn(count, terms, |row, c| {
            self.root[row] * derivative(&self.poses[row], c)
        });
        let own = &whole - &self.basis * self.basis.tr_mul(&whole);
        let normal = own.tr_mul(&own).cholesky()?;
        let pivots = normal.l_dirty().diagonal();
        let independent =
            |c: usize| pivots[c] * pivots[c] > MIN_INDEPENDENT * whole.column(c).norm_squared();
        let freedom = count.checked_sub(self.basis.ncols() + terms).filter(|dof| *dof > 0)?;
        let right = own.tr_mul(&self.left);
        let size = normal.solve(&right);
        let explained = size.dot(&right);
        let rest = (self.left.norm_squared() - explained).max(0.0);
        (0..terms).all(independent).then(|| Nested {
            size: size.iter().copied().collect(),
            squares: [explained, rest],
            dof: [terms, freedom],
        })
    }
}

/// Derivatives of |f| by the parameters of an estimate, in units of the error at 1 g.
fn fitted(pose: &TestedPose, estimate: &Estimate) -> Vec<f64> {
    let [x, y, z] = pose.up;
    let mut columns = alloc::vec![x, y, z, x * x, y * y, z * z, x * y, x * z, y * z];
    for term in estimate.terms.iter() {
        columns.extend(pose.up.map(|c| match term {
            Term::Drift => c * pose.progress,
            Term::BiasTemperature => c * pose.warmer_k,
            Term::ScaleTemperature => c * c * pose.warmer_k,
            Term::Quadratic => c * c * c,
        }));
    }
    columns
}
