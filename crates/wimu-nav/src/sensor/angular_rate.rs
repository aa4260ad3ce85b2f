//! Zero angular rate at a rest: the gyroscope shows its bias.

use nalgebra::{Matrix3, RealField, Vector3};

use super::{Measurement, Prediction};
use crate::filter::Filter;
use crate::state::{Block, Jacobian};

/// A reading of a gyroscope that does not rotate.
#[derive(Clone, Copy, Debug)]
pub struct ZeroAngularRate<R> {
    /// rad/s, body frame.
    pub rate_rad_s: Vector3<R>,
    /// Bias of the gyroscope, rad/s.
    pub bias: Block<3>,
    /// Standard deviation of a component, rad/s: noise of the reading, and rotation that the detector does not see.
    pub deviation_rad_s: R,
}

impl<R: RealField + Copy, const N: usize> Measurement<R, N, 3> for ZeroAngularRate<R> {
    fn predict(&self, filter: &Filter<R, N>) -> Prediction<R, N, 3> {
        let variance = self.deviation_rad_s * self.deviation_rad_s;
        Prediction {
            innovation: self.rate_rad_s - filter.state.get(self.bias),
            jacobian: Jacobian::zeros().with(self.bias, Matrix3::identity()),
            covariance: Matrix3::from_diagonal_element(variance),
        }
    }
}
