//! Linear least-squares fit of an ellipsoid: equation (11).

use nalgebra::{Cholesky, Matrix3, Vector3};

use crate::linear::{Real, real};
use crate::symmetric::{MOST, Scaled, Symmetric, add};
use crate::terms::{Slot, Theta};
use crate::{Gravity, Model, Pose};

/// Centre c and matrix Q of the ellipsoid (x − c)ᵀ Q (x − c) = 1 nearest to `points`; `None` where
/// the fit is singular. Q is not positive definite if the points are not on an ellipsoid.
pub(crate) fn ellipsoid<R: Real>(
    points: impl Iterator<Item = Vector3<R>>,
) -> Option<(Vector3<R>, Matrix3<R>)> {
    let mut information = Symmetric::zero(9);
    let mut right = [R::zero(); MOST];
    let two: R = real(2.0);
    for point in points {
        let [x, y, z] = [point.x, point.y, point.z];
        let [xy, xz, yz, x2, y2, z2] = [x * y, x * z, y * z, x, y, z].map(|value| two * value);
        let row = [x * x, y * y, z * z, xy, xz, yz, x2, y2, z2];
        information.add_outer(&row, R::one());
        add(&mut right, R::one(), &row);
    }
    // xᵀSx + 2pᵀx = 1.
    let (s, _) = Scaled::new(&information, R::zero())?.solve(&right);
    let shape = Matrix3::new(s[0], s[3], s[4], s[3], s[1], s[5], s[4], s[5], s[2]);
    let p = Vector3::new(s[6], s[7], s[8]);
    let centre = -(shape.try_inverse()? * p);
    Some((centre, shape / (R::one() - p.dot(&centre))))
}

/// Starting parameters of a nine-parameter fit. `None` for other models, or when the points are not on an ellipsoid.
pub(crate) fn start<R: Real>(poses: &[Pose], gravity: Gravity, model: Model) -> Option<Theta<R>> {
    if model != Model::Full9 {
        return None;
    }
    let gravity_mps2 = gravity.mps2();
    let points =
        poses.iter().map(|pose| Vector3::from(pose.mean_mps2.map(|y| real(y / gravity_mps2))));
    let (centre, q) = ellipsoid::<R>(points)?;
    // y = c + A u with |u| = 1 gives A Aᵀ = Q⁻¹; its Cholesky factor is the triangular A.
    let a = Cholesky::new(q.try_inverse()?)?.unpack();
    let c = centre * real::<R>(gravity_mps2);
    let mut theta = [R::zero(); Slot::COUNT];
    for row in 0..3 {
        theta[row] = c[row];
        for column in 0..=row {
            theta[3 + 3 * row + column] = a[(row, column)];
        }
    }
    theta.iter().all(|t| t.is_finite()).then_some(theta)
}
