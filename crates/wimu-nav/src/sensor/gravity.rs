//! Gravity at a rest: C (f − b) = g. Equation (131).

use nalgebra::{Matrix3, RealField, Vector3};

use super::{Measurement, Prediction};
use crate::filter::Filter;
use crate::process::{StrapdownBlocks, by_elements};
use crate::state::{ATTITUDE, Jacobian};

/// Mean specific force at a rest.
#[derive(Clone, Copy, Debug)]
pub struct Gravity<'a, R> {
    /// m/s², body frame.
    pub force_mps2: Vector3<R>,
    /// States of the strapdown model.
    pub blocks: &'a StrapdownBlocks,
    /// Gravity, m/s².
    pub gravity_mps2: R,
    /// Standard deviation of a component, m/s²: acceleration of a rest.
    pub deviation_mps2: R,
}

impl<R: RealField + Copy, const N: usize> Measurement<R, N, 3> for Gravity<'_, R> {
    fn predict(&self, filter: &Filter<R, N>) -> Prediction<R, N, 3> {
        let to_navigation = *filter.state.attitude.matrix();
        let force = self.force_mps2 - filter.state.get(self.blocks.accelerometer_bias);
        let up = to_navigation * force;
        let mut jacobian = Jacobian::zeros()
            .with(ATTITUDE, -up.cross_matrix())
            .with(self.blocks.accelerometer_bias, -to_navigation);
        if let Some(considered) = &self.blocks.considered {
            let derivative = -by_elements(&to_navigation, &force);
            jacobian = jacobian.with(considered.accelerometer_matrix, derivative);
        }
        Prediction {
            innovation: Vector3::z() * self.gravity_mps2 - up,
            jacobian,
            covariance: Matrix3::identity() * (self.deviation_mps2 * self.deviation_mps2),
        }
    }
}
