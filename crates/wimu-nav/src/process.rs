//! Process models: how state and covariance change between two samples.

mod acceleration_offset;
mod carried;
mod constant_velocity;
mod gauss_markov;
mod odometry;
mod relative;
mod rigid_array;
mod strapdown;
mod unmeasured;

pub use acceleration_offset::AccelerationOffset;
pub use carried::{Carried, CarriedBlocks};
pub use constant_velocity::ConstantVelocity;
pub use gauss_markov::{GaussMarkov, RandomWalk};
pub use odometry::{Odometry, OdometryBlocks, OdometryErrors};
pub use relative::{Relative, RelativeBlocks};
pub use rigid_array::{ArrayForce, RigidArray, RigidArrayBlocks};
pub(crate) use strapdown::by_elements;
pub use strapdown::{ConsideredBlocks, ImuErrors, Strapdown, StrapdownBlocks};
pub use unmeasured::Unmeasured;

use heapless::Vec;
use nalgebra::{Matrix3, RealField, SMatrix, SVector};

use crate::state::{Block, State};

/// How a part of the state changes over a step. A pair of processes is a process: each acts on its own blocks.
pub trait Process<R, const N: usize> {
    /// Moves the state over the step, and adds the derivative and the noise of the step.
    fn propagate(&self, state: &mut State<R, N>, transition: &mut Transition<R, N>);
}

impl<R, const N: usize, A: Process<R, N>, B: Process<R, N>> Process<R, N> for (A, B) {
    fn propagate(&self, state: &mut State<R, N>, transition: &mut Transition<R, N>) {
        self.0.propagate(state, transition);
        self.1.propagate(state, transition);
    }
}

/// Part of F − 1: up to three rows and three columns.
#[derive(Clone, Debug)]
struct Part<R> {
    row: usize,
    rows: usize,
    column: usize,
    columns: usize,
    matrix: Matrix3<R>,
}

/// Derivative F of the errors after a step by those before it, and the diagonal covariance Q of the noise of the step.
/// F is the identity plus blocks.
#[derive(Clone, Debug)]
pub struct Transition<R, const N: usize> {
    parts: Vec<Part<R>, N>,
    noise: SVector<R, N>,
    /// Blocks of Q beside the diagonal.
    covariances: Vec<Part<R>, N>,
    /// Whether there were more than `N` blocks: then the covariance is not defined.
    overflow: bool,
}

impl<R: RealField + Copy, const N: usize> Transition<R, N> {
    pub(crate) fn new() -> Self {
        Self {
            parts: Vec::new(),
            noise: SVector::zeros(),
            covariances: Vec::new(),
            overflow: false,
        }
    }

    /// Adds a block to F − 1. A model has at most `N` groups of up to three rows and three columns.
    pub fn add<const V: usize, const W: usize>(
        &mut self,
        row: Block<V>,
        column: Block<W>,
        matrix: SMatrix<R, V, W>,
    ) {
        for (first, top) in
            (0..W).step_by(3).flat_map(|first| (0..V).step_by(3).map(move |top| (first, top)))
        {
            let (rows, columns) = ((V - top).min(3), (W - first).min(3));
            let mut part = Matrix3::zeros();
            let view = matrix.view((top, first), (rows, columns));
            part.view_mut((0, 0), (rows, columns)).copy_from(&view);
            let part = Part {
                row: row.start() + top,
                rows,
                column: column.start() + first,
                columns,
                matrix: part,
            };
            self.overflow |= self.parts.push(part).is_err();
        }
    }

    /// Adds a variance to the noise of every state of a block. For a random walk it is density² × step.
    pub fn add_noise<const W: usize>(&mut self, block: Block<W>, variance: R) {
        for k in block.start()..block.start() + W {
            self.noise[k] += variance;
        }
    }

    /// F A in place of A.
    pub(crate) fn multiply(&self, matrix: &mut SMatrix<R, N, N>) {
        let before = *matrix;
        for part in &self.parts {
            for c in 0..N {
                for r in 0..part.rows {
                    let mut sum = matrix[(part.row + r, c)];
                    for k in 0..part.columns {
                        sum += part.matrix[(r, k)] * before[(part.column + k, c)];
                    }
                    matrix[(part.row + r, c)] = sum;
                }
            }
        }
    }

    /// Adds a variance to the noise of one state of a block, for `k` below `W`.
    pub(crate) fn add_noise_at<const W: usize>(&mut self, block: Block<W>, k: usize, variance: R) {
        self.noise[block.start() + k.min(W - 1)] += variance;
    }

    /// Adds the covariance of the noise of two blocks: a block of Q, and for different blocks its transpose.
    pub fn add_covariance(&mut self, row: Block<3>, column: Block<3>, matrix: Matrix3<R>) {
        let part = Part { row: row.start(), rows: 3, column: column.start(), columns: 3, matrix };
        self.overflow |= self.covariances.push(part).is_err();
    }

    /// F P Fᵀ + Q.
    pub(crate) fn apply(&self, covariance: &mut SMatrix<R, N, N>) {
        if self.overflow {
            covariance.fill(R::zero() / R::zero());
            return;
        }
        self.multiply(covariance);
        let before = *covariance;
        for part in &self.parts {
            for r in 0..part.rows {
                for k in 0..part.columns {
                    let factor = part.matrix[(r, k)];
                    for c in 0..N {
                        covariance[(c, part.row + r)] += factor * before[(c, part.column + k)];
                    }
                }
            }
        }
        for k in 0..N {
            covariance[(k, k)] += self.noise[k];
        }
        for part in &self.covariances {
            for r in 0..3 {
                for c in 0..3 {
                    let (row, column) = (part.row + r, part.column + c);
                    covariance[(row, column)] += part.matrix[(r, c)];
                    if part.row != part.column {
                        covariance[(column, row)] += part.matrix[(r, c)];
                    }
                }
            }
        }
    }
}
