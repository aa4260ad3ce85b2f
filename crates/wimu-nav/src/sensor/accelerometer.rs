//! Specific force of a body whose acceleration is a state: f = Cᵀ (a + g) + b, equation (123).

use nalgebra::{Matrix3, RealField, Vector3};

use super::{Measurement, Prediction, SecondOrder};
use crate::filter::Filter;
use crate::state::{ATTITUDE, Block, Jacobian};

/// A reading.
#[derive(Clone, Copy, Debug)]
pub struct SpecificForce<R> {
    /// m/s², body frame.
    pub force_mps2: Vector3<R>,
    /// Acceleration, m/s², navigation frame.
    pub acceleration: Block<3>,
    /// Bias, m/s², body frame.
    pub bias: Block<3>,
    /// Gravity, m/s².
    pub gravity_mps2: R,
    /// Standard deviation of a component, m/s².
    pub deviation_mps2: R,
}

impl<R: RealField + Copy, const N: usize> Measurement<R, N, 3> for SpecificForce<R> {
    fn predict(&self, filter: &Filter<R, N>) -> Prediction<R, N, 3> {
        let force = filter.state.get(self.acceleration) + Vector3::z() * self.gravity_mps2;
        let to_body = filter.state.attitude.matrix().transpose();
        let second = SecondOrder::of(filter, &force, self.acceleration);
        let predicted = to_body * (force + second.mean) + filter.state.get(self.bias);
        let noise = self.deviation_mps2 * self.deviation_mps2;
        Prediction {
            innovation: self.force_mps2 - predicted,
            jacobian: Jacobian::zeros()
                .with(ATTITUDE, to_body * force.cross_matrix())
                .with(self.acceleration, to_body)
                .with(self.bias, Matrix3::identity()),
            covariance: Matrix3::identity() * noise
                + to_body * second.covariance * to_body.transpose(),
        }
    }
}
