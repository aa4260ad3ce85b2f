//! Attitude from gravity and a reference direction, held during motion: equation (7) of
//! docs/EQUATIONS.md.

use wimu_model::{PositionNm, VelocityNmps, root};

use crate::segment::{product, round_shift};

/// Fraction bits of a direction.
pub(crate) const DIRECTION_BITS: u32 = 30;
/// cos 10°, of the product of two directions.
const HEADED_AS: i128 = 1_135_406_036_351_323_008;

/// Axes of the navigation frame in body axes: unit vectors east, north, up, 2⁻³⁰ per LSB.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub(crate) struct Attitude {
    pub(crate) axes: [[i32; 3]; 3],
}

impl Attitude {
    /// Level attitude with body x east.
    pub(crate) const LEVEL: Self = Self {
        axes: [
            [1 << DIRECTION_BITS, 0, 0],
            [0, 1 << DIRECTION_BITS, 0],
            [0, 0, 1 << DIRECTION_BITS],
        ],
    };

    /// From specific force at rest (any unit) and the previous east direction, both in body axes.
    /// `None` if the force is zero.
    ///
    /// Plain f64 in a fixed order: the same bits on every target.
    pub(crate) fn from_rest(force: [i64; 3], east_before: [i32; 3]) -> Option<Self> {
        let up = unit(force.map(|f| f as f64))?;
        // If the previous east is vertical now, another axis replaces it.
        let forward = [east_before.map(f64::from), [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]]
            .into_iter()
            .find_map(|direction| {
                let direction = unit(direction)?;
                let along = dot(direction, up);
                let level = [0, 1, 2].map(|axis| direction[axis] - along * up[axis]);
                // Within 6° of the vertical a heading is noise.
                (dot(level, level) > 0.01).then_some(level)
            })?;
        let east = unit(forward)?;
        let north = cross(up, east);
        Some(Self { axes: [east, north, up].map(|axis| axis.map(to_direction)) })
    }

    /// Cosine of the angle between specific force at rest and this attitude's up.
    pub(crate) fn cosine_to(&self, force: [i64; 3]) -> f64 {
        let up = self.axes[2].map(f64::from);
        match (unit(force.map(|f| f as f64)), unit(up)) {
            (Some(force), Some(up)) => dot(force, up),
            _ => 0.0,
        }
    }

    pub(crate) fn east(&self) -> [i32; 3] {
        self.axes[0]
    }

    /// Angle of the direction `forward` clockwise from north, rad, −π..=π; 0 where it is vertical.
    pub(crate) fn heading_rad(&self, forward: [i32; 3]) -> f64 {
        let forward = forward.map(f64::from);
        let [east, north, _] = self.axes.map(|axis| dot(axis.map(f64::from), forward));
        libm::atan2(east, north)
    }

    /// The quaternion w, x, y, z of the same rotation [Shepperd 1978].
    pub(crate) fn quaternion(&self) -> [f64; 4] {
        let m = (self.axes).map(|row| row.map(|r| f64::from(r) / (1_u32 << DIRECTION_BITS) as f64));
        // 4 q_i² of each component; division by the largest is safe.
        let squares: [f64; 4] = [
            1.0 + m[0][0] + m[1][1] + m[2][2],
            1.0 + m[0][0] - m[1][1] - m[2][2],
            1.0 - m[0][0] + m[1][1] - m[2][2],
            1.0 - m[0][0] - m[1][1] + m[2][2],
        ];
        let wx = m[2][1] - m[1][2];
        let wy = m[0][2] - m[2][0];
        let wz = m[1][0] - m[0][1];
        let xy = m[1][0] + m[0][1];
        let xz = m[0][2] + m[2][0];
        let yz = m[2][1] + m[1][2];
        let largest = (0..4).fold(0, |l, i| if squares[i] > squares[l] { i } else { l });
        let column = match largest {
            0 => [squares[0], wx, wy, wz],
            1 => [wx, squares[1], xy, xz],
            2 => [wy, xy, squares[2], yz],
            _ => [wz, xz, yz, squares[3]],
        };
        let scale = 2.0 * root::sqrt(squares[largest]);
        column.map(|q| q / scale)
    }

    /// Whether this east is within 10° of another attitude's.
    pub(crate) fn is_headed_as(&self, other: &Self) -> bool {
        let along: i128 = (self.east().iter().zip(other.east()))
            .map(|(a, b)| i128::from(i64::from(*a) * i64::from(b)))
            .sum();
        along >= HEADED_AS
    }

    pub(crate) fn position(&self, body_nm: [i64; 3]) -> PositionNm {
        PositionNm(self.rotate(body_nm))
    }

    pub(crate) fn velocity(&self, body_nmps: [i64; 3]) -> VelocityNmps {
        VelocityNmps(self.rotate(body_nmps))
    }

    fn rotate(&self, body: [i64; 3]) -> [i64; 3] {
        self.axes.map(|axis| {
            let sum: i128 = (0..3).map(|i| product(body[i].into(), axis[i].into())).sum();
            round_shift(sum, DIRECTION_BITS)
        })
    }
}

pub(crate) fn to_direction(value: f64) -> i32 {
    let scaled = value * (1_u32 << DIRECTION_BITS) as f64;
    (scaled + if scaled < 0.0 { -0.5 } else { 0.5 }) as i32
}

pub(crate) fn unit(v: [f64; 3]) -> Option<[f64; 3]> {
    let norm = root::sqrt(dot(v, v));
    (norm > 0.0).then(|| v.map(|x| x / norm))
}

fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

fn cross(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn level_rest_is_the_level_attitude() {
        let level = Attitude::from_rest([0, 0, 642_688], Attitude::LEVEL.east());
        assert_eq!(level, Some(Attitude::LEVEL));
    }

    #[test]
    fn a_rest_on_the_nose_still_has_a_heading() {
        let nose_up = Attitude::from_rest([642_688, 0, 0], Attitude::LEVEL.east()).unwrap();
        assert_eq!(nose_up.axes[2], [1 << 30, 0, 0]);
        assert_eq!(nose_up.rotate([5, 0, 0]), [0, 0, 5]);
        assert_eq!(nose_up.quaternion().map(|q| q * q), [0.25; 4].map(|_: f64| 0.5 * 0.5));
    }

    #[test]
    fn no_force_has_no_attitude() {
        assert_eq!(Attitude::from_rest([0; 3], Attitude::LEVEL.east()), None);
    }
}
