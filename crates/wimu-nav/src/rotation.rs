//! Rotations. An attitude is the rotation C from body to navigation frame (east, north, up); its error θ is a rotation
//! vector in the navigation frame, C_true = exp(θ) C: equation (112) (Solà, "Quaternion kinematics for the error-state
//! Kalman filter", 2017, section 7).

use nalgebra::{Matrix3, Rotation3, Vector3};

/// Angle of the body x axis from east towards north, rad.
pub(crate) fn yaw(attitude: &Rotation3<f64>) -> f64 {
    libm::atan2(attitude[(1, 0)], attitude[(0, 0)])
}

/// Rotation about the vertical, rad.
pub(crate) fn about_up(angle: f64) -> Rotation3<f64> {
    Rotation3::from_axis_angle(&Vector3::z_axis(), angle)
}

/// Attitude at rest from the specific force, which points up, and the magnetic field (TRIAD; M. Shuster and S. Oh,
/// "Three-axis attitude determination from vector observations", 1981). Without a field, or where it is vertical, east
/// is next to the body x axis. `None` where the specific force has no direction.
pub(crate) fn level(
    specific_force: &Vector3<f64>,
    field: Option<&Vector3<f64>>,
) -> Option<Rotation3<f64>> {
    let up = specific_force.try_normalize(1e-6)?;
    let east = field
        .and_then(|field| {
            let across = field.cross(&up);
            across.try_normalize(field.norm() * 0.05)
        })
        .or_else(|| (Vector3::x() - up * up.x).try_normalize(0.1))
        .or_else(|| (Vector3::y() - up * up.y).try_normalize(0.1))?;
    let north = up.cross(&east);
    let rows = [east, north, up].map(|row| row.transpose());
    Some(Rotation3::from_matrix_unchecked(Matrix3::from_rows(&rows)))
}

/// The same rotation with rows of length one at right angles, after many products. One step of Newton's iteration for
/// the polar decomposition (Higham, "Functions of Matrices", 2008, section 8.3).
pub(crate) fn orthonormal(rotation: &Rotation3<f64>) -> Rotation3<f64> {
    let m = rotation.matrix();
    let corrected = (Matrix3::identity() * 1.5 - m * m.transpose() * 0.5) * m;
    Rotation3::from_matrix_unchecked(corrected)
}
