//! Process models: how state and covariance change between two samples.

mod carried;
mod odometry;
mod relative;
mod rigid_array;
mod simple;
mod strapdown;

pub use carried::{Carried, CarriedBlocks};
pub use odometry::{Odometry, OdometryBlocks, OdometryErrors};
pub use relative::{Relative, RelativeBlocks};
pub use rigid_array::{ArrayForce, RigidArray, RigidArrayBlocks};
pub use simple::{AccelerationOffset, ConstantVelocity, GaussMarkov, RandomWalk, Unmeasured};
pub(crate) use strapdown::by_elements;
pub use strapdown::{ImuErrors, Strapdown, StrapdownBlocks};

use alloc::vec;
use alloc::vec::Vec;

use nalgebra::{DMatrix, Matrix3, SMatrix};

use crate::state::{Block, State};

/// How a part of the state changes over a step. A pair of processes is a process: each acts on its own blocks.
pub trait Process {
    /// Moves the state over the step, and adds the derivative and the noise of the step.
    fn propagate(&self, state: &mut State, transition: &mut Transition);
}

impl<A: Process, B: Process> Process for (A, B) {
    fn propagate(&self, state: &mut State, transition: &mut Transition) {
        self.0.propagate(state, transition);
        self.1.propagate(state, transition);
    }
}

impl<A: Process> Process for Option<A> {
    fn propagate(&self, state: &mut State, transition: &mut Transition) {
        if let Some(process) = self {
            process.propagate(state, transition);
        }
    }
}

/// Part of F − 1: up to three rows and three columns.
#[derive(Clone, Debug)]
struct Part {
    row: usize,
    rows: usize,
    column: usize,
    columns: usize,
    matrix: Matrix3<f64>,
}

/// Derivative F of the errors after a step by those before it, and the diagonal covariance Q of the noise of the step.
/// F is the identity plus blocks.
#[derive(Clone, Debug)]
pub struct Transition {
    parts: Vec<Part>,
    noise: Vec<f64>,
    /// Blocks of Q beside the diagonal.
    covariances: Vec<Part>,
}

impl Transition {
    pub(crate) fn new(states: usize) -> Self {
        Self { parts: Vec::new(), noise: vec![0.0; states], covariances: Vec::new() }
    }

    /// Adds a block to F − 1.
    pub fn add<const V: usize, const W: usize>(
        &mut self,
        row: Block<V>,
        column: Block<W>,
        matrix: SMatrix<f64, V, W>,
    ) {
        for (first, top) in
            (0..W).step_by(3).flat_map(|first| (0..V).step_by(3).map(move |top| (first, top)))
        {
            let (rows, columns) = ((V - top).min(3), (W - first).min(3));
            let mut part = Matrix3::zeros();
            let view = matrix.view((top, first), (rows, columns));
            part.view_mut((0, 0), (rows, columns)).copy_from(&view);
            self.parts.push(Part {
                row: row.start() + top,
                rows,
                column: column.start() + first,
                columns,
                matrix: part,
            });
        }
    }

    /// Adds a variance to the noise of every state of a block. For a random walk it is density² × step.
    pub fn add_noise<const W: usize>(&mut self, block: Block<W>, variance: f64) {
        for k in block.start()..block.start() + W {
            self.noise[k] += variance;
        }
    }

    /// Adds a variance to the noise of one state of a block, for `k` below `W`.
    pub(crate) fn add_noise_at<const W: usize>(
        &mut self,
        block: Block<W>,
        k: usize,
        variance: f64,
    ) {
        self.noise[block.start() + k.min(W - 1)] += variance;
    }

    /// Adds the covariance of the noise of two blocks: a block of Q, and for different blocks its transpose.
    pub fn add_covariance(&mut self, row: Block<3>, column: Block<3>, matrix: Matrix3<f64>) {
        let part = Part { row: row.start(), rows: 3, column: column.start(), columns: 3, matrix };
        self.covariances.push(part);
    }

    /// F A in place of A.
    pub(crate) fn multiply(&self, matrix: &mut DMatrix<f64>) {
        let before = matrix.clone();
        for (mut column, before) in matrix.column_iter_mut().zip(before.column_iter()) {
            for part in &self.parts {
                for r in 0..part.rows {
                    let products =
                        (0..part.columns).map(|k| part.matrix[(r, k)] * before[part.column + k]);
                    column[part.row + r] += products.sum::<f64>();
                }
            }
        }
    }

    /// F P Fᵀ + Q.
    pub(crate) fn apply(&self, covariance: &mut DMatrix<f64>) {
        self.multiply(covariance);
        let before = covariance.clone();
        for part in &self.parts {
            for r in 0..part.rows {
                for k in 0..part.columns {
                    let factor = part.matrix[(r, k)];
                    let added = before.column(part.column + k);
                    covariance.column_mut(part.row + r).axpy(factor, &added, 1.0);
                }
            }
        }
        for (k, noise) in self.noise.iter().enumerate() {
            covariance[(k, k)] += noise;
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
