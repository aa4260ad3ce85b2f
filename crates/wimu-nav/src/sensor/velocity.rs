//! Velocity: zero at a rest, or bounded in motion. Equations (121) and (122).

use nalgebra::{Matrix3, RealField, Vector3};

use super::{Measurement, Prediction};
use crate::filter::{Filter, Gate};
use crate::rotation::real;
use crate::state::{Block, Jacobian, POSITION, VELOCITY};

/// Velocity of the unit, navigation frame.
#[derive(Clone, Copy, Debug)]
pub struct Velocity<R> {
    /// m/s.
    pub velocity_mps: Vector3<R>,
    /// Standard deviation of a component, m/s.
    pub deviation_mps: R,
    /// A velocity that is added to it, m/s: of a platform, or one that a rest does not show.
    pub offset: Option<Block<3>>,
}

impl<R: RealField + Copy> Velocity<R> {
    /// Zero with a standard deviation of a component, m/s.
    pub fn zero(deviation_mps: R, offset: Option<Block<3>>) -> Self {
        Self { velocity_mps: Vector3::zeros(), deviation_mps, offset }
    }
}

impl<R: RealField + Copy, const N: usize> Measurement<R, N, 3> for Velocity<R> {
    fn predict(&self, filter: &Filter<R, N>) -> Prediction<R, N, 3> {
        let mut jacobian = Jacobian::zeros().with(VELOCITY, Matrix3::identity());
        let mut innovation = self.velocity_mps - filter.state.get(VELOCITY);
        if let Some(offset) = self.offset {
            jacobian = jacobian.with(offset, -Matrix3::identity());
            innovation += filter.state.get(offset);
        }
        Prediction {
            innovation,
            jacobian,
            covariance: Matrix3::identity() * (self.deviation_mps * self.deviation_mps),
        }
    }
}

/// Zero velocity at a rest that is certain, whatever the test: if it fails, the covariance is too small, and that of
/// attitude, velocity, position and `bias` is first multiplied by the statistic over its degrees of freedom, with all
/// correlations. The bias of the accelerometer keeps its covariance: it would otherwise absorb the tilt error.
pub fn recover<R: RealField + Copy, const N: usize>(
    filter: &mut Filter<R, N>,
    measurement: &Velocity<R>,
    bias: Block<3>,
) {
    let test = filter.test(measurement);
    let factor = test.statistic / real(test.dof as f64);
    let scaled = bias.start()..bias.start() + 3;
    filter.scale_covariance(|k| k < POSITION.start() + 3 || scaled.contains(&k), factor);
    filter.update(measurement, Gate::Open);
}
