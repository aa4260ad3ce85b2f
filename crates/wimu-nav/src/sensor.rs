//! Sensors by kind: what they should show, and how that depends on the state.

mod direction;
mod multi_range;
mod position;
mod reading;
mod reduced_array;
mod velocity;

pub(crate) use direction::FieldHeading;
pub use direction::{CommonAxis, Gravity, Heading, MagneticField, Magnetometer, SpecificForce};
pub use multi_range::{Transfer, TransferModel};
pub use position::{
    Anchor, Antenna, CommonPoint, CorrelatedErrors, LineOfSight, NonLineOfSight, Position, Range,
    RangeErrors,
};
pub use reading::Reading;
pub use reduced_array::{ArrayNoise, Prior, ReducedArray};
pub use velocity::{Known, Mounting, NonHolonomic, Odometer, Velocity, VerticalRate, recover};

use alloc::vec::Vec;

use nalgebra::{DMatrix, DVector, SMatrix, SVector};

use crate::filter::Filter;
use crate::state::{Block, POSITION, VELOCITY};

/// A measurement of any number of values.
pub trait Measurement {
    /// Prediction from the state and covariance before the update.
    fn predict(&self, filter: &Filter) -> Prediction;
}

/// A measurement whose time is known to a standard deviation, s: what the unit moves within it is noise.
#[derive(Clone, Copy, Debug)]
pub struct Timed<M> {
    /// The measurement.
    pub measurement: M,
    /// s.
    pub time_sd_s: f64,
}

impl<M: Measurement> Measurement for Timed<M> {
    fn predict(&self, filter: &Filter) -> Prediction {
        let mut prediction = self.measurement.predict(filter);
        if self.time_sd_s > 0.0 {
            let velocity = filter.state.get(VELOCITY);
            let mut moved = DVector::zeros(prediction.z.len());
            for (state, derivative) in prediction.h().filter(|(k, _)| POSITION.contains(*k)) {
                let speed = velocity[state - POSITION.start()];
                moved += DVector::from_column_slice(derivative) * speed;
            }
            let variance = self.time_sd_s * self.time_sd_s;
            prediction.r.ger(variance, &moved, &moved, 1.0);
        }
        prediction
    }
}

/// Measured minus predicted values, their derivative, and the covariance of their noise.
#[derive(Clone, Debug)]
pub struct Prediction {
    /// Measured minus predicted values.
    pub z: DVector<f64>,
    /// Covariance of the noise.
    pub r: DMatrix<f64>,
    /// Degrees of freedom: the components that are measured.
    pub dof: usize,
    /// States with a derivative, and the derivative of the predicted values with respect to the error (true minus estimated)
    /// of each: the columns of H in (118) that are not zero.
    states: Vec<usize>,
    columns: Vec<f64>,
}

impl Prediction {
    /// Innovation and covariance of the noise of values that depend on no state.
    pub fn new<const M: usize>(z: SVector<f64, M>, r: SMatrix<f64, M, M>) -> Self {
        Self {
            z: DVector::from_column_slice(z.as_slice()),
            r: DMatrix::from_column_slice(M, M, r.as_slice()),
            dof: M,
            states: Vec::new(),
            columns: Vec::new(),
        }
    }

    /// The same, with the derivative with respect to a block of which none was given.
    #[must_use]
    pub fn by<const M: usize, const W: usize>(
        mut self,
        block: Block<W>,
        derivative: SMatrix<f64, M, W>,
    ) -> Self {
        debug_assert_eq!(M, self.z.len(), "rows of the derivative");
        self.states.extend(block.start()..block.start() + W);
        self.columns.extend_from_slice(derivative.as_slice());
        self
    }

    /// The same, with the derivative with respect to a block if it is among the states.
    #[must_use]
    pub fn by_some<const M: usize, const W: usize>(
        self,
        block: Option<Block<W>>,
        derivative: SMatrix<f64, M, W>,
    ) -> Self {
        match block {
            Some(block) => self.by(block, derivative),
            None => self,
        }
    }

    /// States with a derivative, and that derivative.
    fn h(&self) -> impl Iterator<Item = (usize, &[f64])> {
        self.states.iter().copied().zip(self.columns.chunks_exact(self.z.len().max(1)))
    }

    /// P Hᵀ.
    pub(crate) fn times_ht(&self, p: &DMatrix<f64>) -> DMatrix<f64> {
        let mut product = DMatrix::zeros(p.nrows(), self.z.len());
        for (state, derivative) in self.h() {
            for (mut column, h) in product.column_iter_mut().zip(derivative) {
                column.axpy(*h, &p.column(state), 1.0);
            }
        }
        product
    }

    /// H A.
    pub(crate) fn by_h(&self, a: &DMatrix<f64>) -> DMatrix<f64> {
        let mut product = DMatrix::zeros(self.z.len(), a.ncols());
        for (mut sums, column) in product.column_iter_mut().zip(a.column_iter()) {
            for (state, derivative) in self.h() {
                for (sum, h) in sums.iter_mut().zip(derivative) {
                    *sum += h * column[state];
                }
            }
        }
        product
    }

    /// The derivative with respect to a block.
    pub fn derivative<const M: usize, const W: usize>(
        &self,
        block: Block<W>,
    ) -> SMatrix<f64, M, W> {
        let mut found = SMatrix::<f64, M, W>::zeros();
        for (state, derivative) in self.h().filter(|(state, _)| block.contains(*state)) {
            found.column_mut(state - block.start()).copy_from_slice(derivative);
        }
        found
    }
}
