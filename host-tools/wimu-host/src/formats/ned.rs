//! North-east-down axes of autopilots, converted to the east-north-up navigation axes of wimu.

use std::f64::consts::FRAC_1_SQRT_2;

/// A vector.
pub(super) fn vector([north, east, down]: [f64; 3]) -> [f64; 3] {
    [east, north, -down]
}

/// A rotation from body axes to north-east-down (W, X, Y, Z), as one to east-north-up.
pub(super) fn attitude([w, x, y, z]: [f64; 4]) -> [f64; 4] {
    // The rotation from north-east-down to east-north-up is (0, 1, 1, 0)/√2, from the left.
    [-x - y, w + z, w - z, y - x].map(|value| value * FRAC_1_SQRT_2)
}

/// The rotation from body axes to north-east-down of roll, pitch and yaw, rad (rotations about
/// z, then y, then x).
pub(super) fn of_angles([roll, pitch, yaw]: [f64; 3]) -> [f64; 4] {
    let (sr, cr) = (roll / 2.0).sin_cos();
    let (sp, cp) = (pitch / 2.0).sin_cos();
    let (sy, cy) = (yaw / 2.0).sin_cos();
    [
        cr * cp * cy + sr * sp * sy,
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
    ]
}
