//! Heading: of a compass, of two antennas, or of a known direction. Equation (171).

use nalgebra::{Matrix1, RealField, RowVector3, Vector3};

use super::{Measurement, Prediction};
use crate::filter::Filter;
use crate::rotation::{real, yaw};
use crate::state::{ATTITUDE, Jacobian};

/// Angle of the body x axis from east towards north.
#[derive(Clone, Copy, Debug)]
pub struct Heading<R> {
    /// rad.
    pub heading_rad: R,
    /// Its standard deviation, rad.
    pub deviation_rad: R,
}

impl<R: RealField + Copy, const N: usize> Measurement<R, N, 1> for Heading<R> {
    /// Where body x is vertical there is no heading, and the measurement has no effect.
    fn predict(&self, filter: &Filter<R, N>) -> Prediction<R, N, 1> {
        let attitude = &filter.state.attitude;
        let forward = attitude * Vector3::x();
        let level = forward.x * forward.x + forward.y * forward.y;
        let off = self.heading_rad - yaw(attitude);
        let derivative = match level > real(1e-6) {
            true => RowVector3::new(
                -forward.x * forward.z / level,
                -forward.y * forward.z / level,
                R::one(),
            ),
            false => RowVector3::zeros(),
        };
        Prediction {
            innovation: Matrix1::new(off.sin().atan2(off.cos())),
            jacobian: Jacobian::zeros().with(ATTITUDE, derivative),
            covariance: Matrix1::new(self.deviation_rad * self.deviation_rad),
        }
    }
}
