//! Position: a fix, or a bound. Equation (170).

use nalgebra::{Matrix3, RealField, Vector3};

use super::{Measurement, Prediction};
use crate::filter::Filter;
use crate::state::{ATTITUDE, Jacobian, POSITION};

/// Position of a point of the unit, navigation frame.
#[derive(Clone, Copy, Debug)]
pub struct Position<R> {
    /// m.
    pub position_m: Vector3<R>,
    /// Standard deviation of each component, m; infinite where it is not measured, as of a height alone.
    pub deviation_m: Vector3<R>,
    /// The point from the origin of the unit, m, body frame: an antenna.
    pub lever_arm_m: Vector3<R>,
}

impl<R: RealField + Copy, const N: usize> Measurement<R, N, 3> for Position<R> {
    fn predict(&self, filter: &Filter<R, N>) -> Prediction<R, N, 3> {
        let arm = filter.state.attitude * self.lever_arm_m;
        let shown = filter.state.get(POSITION) + arm;
        // A component without a measurement: no derivative, no innovation, any variance.
        let one = R::one();
        let measured = self.deviation_m.map(|sd| sd.is_finite());
        let rows = Matrix3::from_diagonal(&measured.map(|m| if m { one } else { R::zero() }));
        let off =
            (self.position_m - shown).zip_map(&measured, |off, m| if m { off } else { R::zero() });
        let variance = self.deviation_m.map(|sd| if sd.is_finite() { sd * sd } else { one });
        Prediction {
            innovation: off,
            jacobian: Jacobian::zeros()
                .with(POSITION, rows)
                .with(ATTITUDE, rows * -arm.cross_matrix()),
            covariance: Matrix3::from_diagonal(&variance),
        }
    }
}
