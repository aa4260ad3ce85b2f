//! Position: a fix, or a bound.

use nalgebra::{Matrix3, RealField, Vector3};

use super::{Measurement, Prediction};
use crate::filter::Filter;
use crate::state::{Jacobian, POSITION};

/// Position of the unit, navigation frame.
#[derive(Clone, Copy, Debug)]
pub struct Position<R> {
    /// m.
    pub position_m: Vector3<R>,
    /// Standard deviation of a component, m.
    pub deviation_m: R,
}

impl<R: RealField + Copy, const N: usize> Measurement<R, N, 3> for Position<R> {
    fn predict(&self, filter: &Filter<R, N>) -> Prediction<R, N, 3> {
        Prediction {
            innovation: self.position_m - filter.state.get(POSITION),
            jacobian: Jacobian::zeros().with(POSITION, Matrix3::identity()),
            covariance: Matrix3::from_diagonal_element(self.deviation_m * self.deviation_m),
        }
    }
}
