//! Rotations of a body against the east-north-up frame.

/// The rotation from body axes to east-north-up, as a unit quaternion.
///
/// [`LEVEL`](Self::LEVEL) has body x to the east, y to the north, z up.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Attitude([f64; 4]);

impl Attitude {
    /// Body x east, y north, z up.
    pub const LEVEL: Self = Self([1.0, 0.0, 0.0, 0.0]);

    /// Turned from level by the rotation vector `radians`: its direction is the axis, its length
    /// the angle.
    pub fn from_rotation_vector(radians: [f64; 3]) -> Self {
        let angle = norm(radians);
        // sin(angle / 2) / angle, continuous at 0.
        let scale = if angle < 1e-9 { 0.5 } else { libm::sin(angle / 2.0) / angle };
        let [x, y, z] = radians.map(|r| r * scale);
        Self([libm::cos(angle / 2.0), x, y, z])
    }

    /// Rotated from level by the shortest rotation until the body direction `up` (not zero) points up.
    pub fn with_up(up: [f64; 3]) -> Self {
        let length = norm(up);
        let [x, y, z] = up.map(|u| u / length);
        if z < -1.0 + 1e-12 {
            return Self([0.0, 1.0, 0.0, 0.0]);
        }
        // Rotates (x, y, z) to (0, 0, 1): the axis is their cross product (y, −x, 0).
        let w = libm::sqrt((1.0 + z) / 2.0);
        Self([w, y / (2.0 * w), -x / (2.0 * w), 0.0]).normalised()
    }

    /// The attitude with the quaternion W, X, Y, Z, which is not zero.
    pub fn from_quaternion(quaternion: [f64; 4]) -> Self {
        Self(quaternion).normalised()
    }

    /// The unit quaternion, W, X, Y, Z.
    pub fn quaternion(self) -> [f64; 4] {
        self.0
    }

    /// This attitude after first rotating the body by `turn` about its own axes.
    pub fn turned(self, turn: Self) -> Self {
        let ([a, b, c, d], [e, f, g, h]) = (self.0, turn.0);
        Self([
            a * e - b * f - c * g - d * h,
            a * f + b * e + c * h - d * g,
            a * g - b * h + c * e + d * f,
            a * h + b * g - c * f + d * e,
        ])
        .normalised()
    }

    /// A vector in body axes, seen in east-north-up.
    pub fn to_enu(self, body: [f64; 3]) -> [f64; 3] {
        let [w, x, y, z] = self.0;
        let twice = cross([x, y, z], body).map(|v| 2.0 * v);
        let last = cross([x, y, z], twice);
        [0, 1, 2].map(|i| body[i] + w * twice[i] + last[i])
    }

    /// A vector in east-north-up, seen in body axes.
    pub fn to_body(self, enu: [f64; 3]) -> [f64; 3] {
        self.inverse().to_enu(enu)
    }

    /// The angle of the rotation from this attitude to `other`, rad, 0..=π.
    pub fn angle_to(self, other: Self) -> f64 {
        let [w, x, y, z] = self.inverse().turned(other).0;
        2.0 * libm::atan2(norm([x, y, z]), w.abs())
    }

    /// The shortest rotation from this attitude to `other` as a rotation vector, rad, body axes.
    pub fn rotation_vector_to(self, other: Self) -> [f64; 3] {
        let [w, x, y, z] = self.inverse().turned(other).0;
        let half = libm::atan2(norm([x, y, z]), w.abs());
        let sign = if w < 0.0 { -1.0 } else { 1.0 };
        let length = norm([x, y, z]);
        if length < 1e-15 {
            return [0.0; 3];
        }
        [x, y, z].map(|v| sign * v / length * 2.0 * half)
    }

    /// The attitude at `fraction` (0..=1) of the shortest rotation to `other`: constant rate about
    /// one axis, "slerp".
    pub fn toward(self, other: Self, fraction: f64) -> Self {
        let vector = self.rotation_vector_to(other).map(|v| v * fraction);
        self.turned(Self::from_rotation_vector(vector))
    }

    fn inverse(self) -> Self {
        let [w, x, y, z] = self.0;
        Self([w, -x, -y, -z])
    }

    fn normalised(self) -> Self {
        let [w, x, y, z] = self.0;
        let length = libm::sqrt(w * w + x * x + y * y + z * z);
        Self(self.0.map(|q| q / length))
    }
}

/// Angular rate, rad/s, body axes, of a body whose attitude has the rotation vector `radians`, which changes
/// by `per_s` rad/s: the right Jacobian of the rotation group.
pub(crate) fn angular_rate(radians: [f64; 3], per_s: [f64; 3]) -> [f64; 3] {
    let angle = norm(radians);
    let [first, second] = match angle {
        // The terms of lowest order: the next ones are below 10⁻⁹ of them.
        ..1e-4 => [1.0 / 2.0, 1.0 / 6.0],
        _ => [
            (1.0 - libm::cos(angle)) / (angle * angle),
            (angle - libm::sin(angle)) / (angle * angle * angle),
        ],
    };
    let once = cross(radians, per_s);
    let twice = cross(radians, once);
    [0, 1, 2].map(|i| per_s[i] - first * once[i] + second * twice[i])
}

pub(crate) fn norm([x, y, z]: [f64; 3]) -> f64 {
    libm::sqrt(x * x + y * y + z * z)
}

fn cross(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::f64::consts::PI;

    fn vectors() -> impl Strategy<Value = [f64; 3]> {
        [-3.0..3.0, -3.0..3.0, -3.0..3.0_f64]
    }

    fn apart(a: [f64; 3], b: [f64; 3]) -> f64 {
        norm([a[0] - b[0], a[1] - b[1], a[2] - b[2]])
    }

    #[test]
    fn a_quarter_turn_about_up_takes_east_to_north() {
        let turned = Attitude::from_rotation_vector([0.0, 0.0, PI / 2.0]);
        assert!(apart(turned.to_enu([1.0, 0.0, 0.0]), [0.0, 1.0, 0.0]) < 1e-15);
    }

    proptest! {
        #[test]
        fn there_and_back_is_the_same_vector(r in vectors(), v in vectors()) {
            let attitude = Attitude::from_rotation_vector(r);
            prop_assert!(apart(attitude.to_body(attitude.to_enu(v)), v) < 1e-14);
        }

        #[test]
        fn the_chosen_direction_points_up(up in vectors()) {
            prop_assume!(norm(up) > 1e-3);
            let seen = Attitude::with_up(up).to_enu(up.map(|u| u / norm(up)));
            prop_assert!(apart(seen, [0.0, 0.0, 1.0]) < 1e-9, "{seen:?}");
        }

        #[test]
        fn a_turn_begins_here_ends_there_and_takes_the_short_way(
            a in vectors(), b in vectors(), fraction in 0.0..1.0_f64,
        ) {
            let (a, b) = (Attitude::from_rotation_vector(a), Attitude::from_rotation_vector(b));
            let angle = a.angle_to(b);
            prop_assume!(angle < PI - 1e-6);
            prop_assert!(a.toward(b, 0.0).angle_to(a) < 1e-12);
            prop_assert!(a.toward(b, 1.0).angle_to(b) < 1e-12);
            prop_assert!((a.toward(b, fraction).angle_to(a) - fraction * angle).abs() < 1e-12);
        }
    }
}
