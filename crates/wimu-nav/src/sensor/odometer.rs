//! Speed over ground by the wheels of an axle: equation (186).

use nalgebra::{Matrix1, RealField, Vector3};

use super::non_holonomic::AxleVelocity;
use super::{Measurement, Mounting, Prediction};
use crate::filter::Filter;
use crate::rotation::real;
use crate::state::Block;

/// A reading of an odometer.
#[derive(Clone, Copy, Debug)]
pub struct Odometer<'a, R> {
    /// The mounting of the unit.
    pub mounting: &'a Mounting,
    /// Scale error s: true speed = (1 + s) × measured speed.
    pub scale: Block<1>,
    /// Measured speed, m/s, positive forward.
    pub speed_mps: R,
    /// Standard deviation of its noise, m/s.
    pub deviation_mps: R,
    /// Angular rate, rad/s, body frame.
    pub rate_rad_s: Vector3<R>,
}

impl<R: RealField + Copy, const N: usize> Measurement<R, N, 1> for Odometer<'_, R> {
    fn predict(&self, filter: &Filter<R, N>) -> Prediction<R, N, 1> {
        let axle = AxleVelocity::of(&filter.state, self.mounting, &self.rate_rad_s);
        let scale = filter.state.get(self.scale).x;
        let row = axle.forward.transpose();
        let across = axle.velocity - axle.forward * axle.forward.dot(&axle.velocity);
        let measured = self.speed_mps * (scale + real(1.0));
        Prediction {
            innovation: Matrix1::new(measured - axle.forward.dot(&axle.velocity)),
            jacobian: axle
                .jacobian(&row, self.mounting)
                .with(self.mounting.forward, across.transpose() / axle.length)
                .with(self.scale, Matrix1::new(-self.speed_mps)),
            covariance: Matrix1::new(self.deviation_mps * self.deviation_mps),
        }
    }
}
