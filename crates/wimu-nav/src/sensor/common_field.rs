//! The magnetic field at two units in relative motion. Equation (195).

use nalgebra::{Matrix3, RealField, Vector3};

use super::{Measurement, Prediction};
use crate::filter::Filter;
use crate::state::{ATTITUDE, Block, Jacobian};

/// Readings of two magnetometers: C m₂ = m₁ + d.
#[derive(Clone, Copy, Debug)]
pub struct CommonField<R> {
    /// Readings of the first and the second unit, µT, each in its axes.
    pub field_ut: [Vector3<R>; 2],
    /// Difference of the fields, µT, axes of the first unit.
    pub difference: Block<3>,
    /// Standard deviation of a component of a reading, µT.
    pub noise_ut: R,
}

impl<R: RealField + Copy, const N: usize> Measurement<R, N, 3> for CommonField<R> {
    fn predict(&self, filter: &Filter<R, N>) -> Prediction<R, N, 3> {
        let second = filter.state.attitude * self.field_ut[1];
        let variance = self.noise_ut * self.noise_ut;
        Prediction {
            innovation: self.field_ut[0] + filter.state.get(self.difference) - second,
            jacobian: Jacobian::zeros()
                .with(ATTITUDE, -second.cross_matrix())
                .with(self.difference, -Matrix3::identity()),
            covariance: Matrix3::from_diagonal_element(variance + variance),
        }
    }
}
