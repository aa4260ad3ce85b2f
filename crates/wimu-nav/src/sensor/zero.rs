//! States that are zero: angular rate and angular acceleration at a rest.

use nalgebra::{SMatrix, SVector};

use super::{Measurement, Prediction};
use crate::filter::Filter;
use crate::state::{Block, Jacobian};
use nalgebra::RealField;

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
