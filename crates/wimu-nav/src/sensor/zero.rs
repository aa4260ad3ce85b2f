//! States that are zero: angular rate and angular acceleration at a rest.

use nalgebra::{Matrix2, RealField, SMatrix, SVector, Vector3};

use super::{Measurement, Prediction};
use crate::filter::Filter;
use crate::state::{ATTITUDE, Block, Jacobian};

/// A block is zero.
#[derive(Clone, Copy, Debug)]
pub struct Zero<R, const W: usize> {
    /// Its states.
    pub block: Block<W>,
    /// Standard deviation of each state.
    pub deviation: [R; W],
}

impl<R: RealField + Copy, const N: usize, const W: usize> Measurement<R, N, W> for Zero<R, W> {
    fn predict(&self, filter: &Filter<R, N>) -> Prediction<R, N, W> {
        let variance = SVector::from(self.deviation.map(|d| d * d));
        Prediction {
            innovation: -filter.state.get(self.block),
            jacobian: Jacobian::zeros().with(self.block, SMatrix::identity()),
            covariance: SMatrix::from_diagonal(&variance),
        }
    }
}

/// The angular rate is about the vertical: otherwise the specific force of constant velocity would turn in the body.
#[derive(Clone, Copy, Debug)]
pub struct VerticalRate<R> {
    /// Angular rate, body frame.
    pub block: Block<3>,
    /// Standard deviation of each horizontal component, rad/s.
    pub deviation: R,
}

impl<R: RealField + Copy, const N: usize> Measurement<R, N, 2> for VerticalRate<R> {
    fn predict(&self, filter: &Filter<R, N>) -> Prediction<R, N, 2> {
        let attitude = filter.state.attitude.matrix();
        let rate: Vector3<R> = attitude * filter.state.get(self.block);
        let turned = -rate.cross_matrix();
        Prediction {
            innovation: -rate.xy(),
            jacobian: Jacobian::zeros()
                .with(ATTITUDE, turned.fixed_rows::<2>(0).into_owned())
                .with(self.block, attitude.fixed_rows::<2>(0).into_owned()),
            covariance: Matrix2::from_diagonal_element(self.deviation * self.deviation),
        }
    }
}
