//! Linear least-squares fit of an ellipsoid: equation (11).

use nalgebra::{Cholesky, Matrix3, SMatrix, SVector, Vector3};

use crate::terms::{self, Theta};
use crate::{Gravity, Pose};

/// Centre c and matrix Q of the ellipsoid (x − c)ᵀ Q (x − c) = 1 nearest to `points`; `None` where
/// the fit is singular. Q is not positive definite if the points are not on an ellipsoid.
pub(crate) fn ellipsoid(
    points: impl Iterator<Item = Vector3<f64>>,
) -> Option<(Vector3<f64>, Matrix3<f64>)> {
    let mut information = SMatrix::<f64, 9, 9>::zeros();
    let mut right = SVector::<f64, 9>::zeros();
    for point in points {
        let [x, y, z] = [point.x, point.y, point.z];
        let [xy, xz, yz, x2, y2, z2] = [x * y, x * z, y * z, x, y, z].map(|value| 2.0 * value);
        let row = SVector::from([x * x, y * y, z * z, xy, xz, yz, x2, y2, z2]);
        information.ger(1.0, &row, &row, 1.0);
        right += row;
    }
    // xᵀSx + 2pᵀx = 1.
    let factor = Cholesky::new(information)?;
    let pivots = factor.l_dirty().diagonal();
    let regular = (0..9).all(|i| pivots[i] * pivots[i] > f64::EPSILON * information[(i, i)]);
    let s = regular.then(|| factor.solve(&right))?;
    let shape = Matrix3::new(s[0], s[3], s[4], s[3], s[1], s[5], s[4], s[5], s[2]);
    let p = Vector3::new(s[6], s[7], s[8]);
    let centre = -(shape.try_inverse()? * p);
    Some((centre, shape / (1.0 - p.dot(&centre))))
}

/// Starting parameters of a nine-parameter fit. `None` when the points are not on an ellipsoid.
pub(crate) fn start(poses: &[Pose], gravity: Gravity) -> Option<Theta> {
    let gravity_mps2 = gravity.mps2();
    let points = poses.iter().map(|pose| Vector3::from(pose.mean_mps2.map(|y| y / gravity_mps2)));
    let (centre, q) = ellipsoid(points)?;
    // y = c + A u with |u| = 1 gives A Aᵀ = Q⁻¹; its Cholesky factor is the triangular A.
    let a = Cholesky::new(q.try_inverse()?)?.unpack();
    let c = centre * gravity_mps2;
    let mut theta = [0.0; terms::COUNT];
    for row in 0..3 {
        theta[row] = c[row];
        for column in 0..=row {
            theta[3 + 3 * row + column] = a[(row, column)];
        }
    }
    theta.iter().all(|t| t.is_finite()).then_some(theta)
}
