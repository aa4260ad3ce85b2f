//! Calibration of a coarse accelerometer by a finer one on the same body: equation (222).
//!
//! Their [`Reading`](super::Reading)s are merged afterwards.

use nalgebra::{Matrix3, Matrix4, Matrix4x3, Vector3, Vector4};

/// Recursive least squares of the error model of a coarse accelerometer relative to a finer one, output = b + A f: (222).
#[derive(Clone, Debug)]
pub struct Transfer {
    information: Matrix4<f64>,
    right: Matrix4x3<f64>,
    /// Part of the information about A that is noise of the finer one.
    attenuation: f64,
}

/// The model found: b, A, and the covariance of an element of b and the row of A beside it, equal for all three.
#[derive(Clone, Debug)]
pub struct TransferModel {
    /// m/s².
    pub bias_mps2: Vector3<f64>,
    /// 1 for equal scale factors and parallel axes.
    pub matrix: Matrix3<f64>,
    /// Of an element of b, then a row of A.
    pub covariance: Matrix4<f64>,
    inverse: Matrix3<f64>,
}

impl Transfer {
    /// Before: b is 0 ± `bias_mps2`, A is the identity ± `matrix` (1 σ of an element).
    pub fn new(bias_mps2: f64, matrix: f64) -> Self {
        let [b, a] = [bias_mps2, matrix].map(|deviation| 1.0 / (deviation * deviation));
        let information = Matrix4::from_diagonal(&Vector4::new(b, a, a, a));
        let mut right = Matrix4x3::zeros();
        right.fixed_view_mut::<3, 3>(1, 0).fill_diagonal(a);
        Self { information, right, attenuation: 0.0 }
    }

    /// Adds both outputs at one time, m/s², with the variance of their difference on an axis, and that of the finer one's
    /// noise.
    pub fn push(&mut self, fine: &Vector3<f64>, coarse: &Vector3<f64>, variance: f64, noise: f64) {
        let row = fine.insert_row(0, 1.0);
        self.attenuation += noise / variance;
        self.information += row * row.transpose() / variance;
        self.right += row * coarse.transpose() / variance;
    }

    /// The model; `None` where numbers are not finite or A is singular.
    pub fn model(&self) -> Option<TransferModel> {
        let noise = Matrix4::from_diagonal(&Vector4::new(0.0, 1.0, 1.0, 1.0)) * self.attenuation;
        let without = (self.information - noise).cholesky();
        let covariance = without.or_else(|| self.information.cholesky())?.inverse();
        let found = (covariance * self.right).transpose();
        let matrix: Matrix3<f64> = found.fixed_columns::<3>(1).into();
        let inverse = matrix.try_inverse()?;
        let finite = found.iter().chain(inverse.iter()).all(|v| v.is_finite());
        finite.then(|| TransferModel {
            bias_mps2: found.column(0).into(),
            matrix,
            covariance,
            inverse,
        })
    }
}

impl TransferModel {
    /// The specific force in the axes and scale of the finer one, m/s², and the variance of each axis, from an output whose
    /// noise has this variance.
    pub fn to_fine(&self, coarse: &Vector3<f64>, variance: f64) -> (Vector3<f64>, Vector3<f64>) {
        let force = self.inverse * (coarse - self.bias_mps2);
        let row = force.insert_row(0, 1.0);
        let total = variance + row.dot(&(self.covariance * row));
        let gains = self.inverse.component_mul(&self.inverse);
        (force, gains * Vector3::repeat(total))
    }
}
