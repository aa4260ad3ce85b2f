//! Attitude from gravity and a reference direction, held during motion: equation (7) of
//! docs/reference/equations.

use wimu_model::{PositionNm, VelocityNmps, root};

use crate::segment::{product, round_shift};

/// Fraction bits of a direction.
pub(crate) const DIRECTION_BITS: u32 = 30;
const ONE: i32 = 1 << DIRECTION_BITS;
/// cos 10°, of the product of two directions.
const HEADED_AS: i64 = 1_135_406_036_351_323_008;

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
    pub(crate) fn from_rest(force: [i64; 3], east_before: [i32; 3]) -> Option<Self> {
        let up = direction(force)?;
        // If the previous east is vertical now, another axis replaces it.
        let level = [east_before, [0, ONE, 0], [ONE, 0, 0]].into_iter().find_map(|forward| {
            let forward = direction(forward.map(i64::from))?;
            let along = (dot(forward, up) >> DIRECTION_BITS) as i32;
            let level = [0, 1, 2].map(|axis| {
                forward[axis] - ((i64::from(along) * i64::from(up[axis])) >> DIRECTION_BITS) as i32
            });
            // Within 6° of the vertical a heading is noise: sin² 6° is 1 %.
            (dot(level, level) > dot([0, 0, ONE], [0, 0, ONE]) / 100).then_some(level)
        })?;
        let east = direction(level.map(i64::from))?;
        Some(Self { axes: [east, cross(up, east), up] })
    }

    /// Cosine of the angle between specific force at rest and this attitude's up, 2⁻³⁰.
    pub(crate) fn cosine_to(&self, force: [i64; 3]) -> i32 {
        direction(force).map_or(0, |force| (dot(force, self.axes[2]) >> DIRECTION_BITS) as i32)
    }

    pub(crate) fn east(&self) -> [i32; 3] {
        self.axes[0]
    }

    /// Angle of the direction `forward` clockwise from north, rad, −π..=π; 0 where it is vertical.
    pub(crate) fn heading_rad(&self, forward: [i32; 3]) -> f64 {
        let [east, north, _] = self.axes.map(|axis| dot(axis, forward) as f64);
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
        dot(self.east(), other.east()) >= HEADED_AS
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

/// The unit vector along `v`, to about 2⁻³⁰; `None` for zero.
pub(crate) fn direction(v: [i64; 3]) -> Option<[i32; 3]> {
    let largest = v.iter().fold(0, |largest, axis| largest | axis.unsigned_abs());
    if largest == 0 {
        return None;
    }
    // The largest component gets 30 bits.
    let shift = 34 - largest.leading_zeros() as i32;
    let v = v.map(|axis| if shift > 0 { axis >> shift } else { axis << -shift });
    let square: u64 = v.iter().map(|axis| axis.unsigned_abs().pow(2)).sum();
    // Twice the length; its square fits 64 bits.
    let length = (4 * square).isqrt() as i64;
    Some(v.map(|axis| {
        let doubled = axis << (DIRECTION_BITS + 1);
        ((doubled + (length / 2) * doubled.signum()) / length) as i32
    }))
}

/// a · b, 2⁻⁶⁰.
fn dot(a: [i32; 3], b: [i32; 3]) -> i64 {
    (0..3).map(|axis| i64::from(a[axis]) * i64::from(b[axis])).sum()
}

fn cross(a: [i32; 3], b: [i32; 3]) -> [i32; 3] {
    let [a, b] = [a, b].map(|v| v.map(i64::from));
    let product = |i: usize, j: usize| (a[i] * b[j] - a[j] * b[i] + (1 << 29)) >> DIRECTION_BITS;
    [(1, 2), (2, 0), (0, 1)].map(|(i, j)| product(i, j) as i32)
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
