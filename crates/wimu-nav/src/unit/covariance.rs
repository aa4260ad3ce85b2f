//! The covariance of the states in blocks of three, held symmetric.

use crate::Real;
use crate::vector::Matrix;

/// Attitude, angular rate (or the bias of what measures it), acceleration, its integral, bias,
/// magnetic disturbance, velocity, position, the bias's rise after switching on.
pub(super) const STATES: usize = 27;

/// A block's first state.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Block(pub usize);

pub(super) const PHI: Block = Block(0);
pub(super) const OMEGA: Block = Block(3);
pub(super) const ACCELERATION: Block = Block(6);
pub(super) const SWING: Block = Block(9);
pub(super) const BIAS: Block = Block(12);
pub(super) const FIELD: Block = Block(15);
pub(super) const VELOCITY: Block = Block(18);
pub(super) const POSITION: Block = Block(21);
pub(super) const RISE: Block = Block(24);

/// A row of H: the factor of each state of up to three blocks.
pub(super) type Row<R, const N: usize> = [(Block, [R; 3]); N];

#[derive(Clone, Debug)]
pub(super) struct Covariance<R>([[R; STATES]; STATES]);

impl<R: Real> Covariance<R> {
    pub fn zero() -> Self {
        Self([[R::default(); STATES]; STATES])
    }

    pub fn block(&self, row: Block, column: Block) -> Matrix<R> {
        core::array::from_fn(|i| core::array::from_fn(|j| self.0[row.0 + i][column.0 + j]))
    }

    /// Puts a block's own covariance.
    pub fn set(&mut self, at: Block, value: &Matrix<R>) {
        for i in 0..3 {
            for j in 0..3 {
                self.0[at.0 + i][at.0 + j] = value[i][j];
            }
        }
    }

    /// Variances of a block.
    pub fn variance(&self, at: Block) -> [R; 3] {
        core::array::from_fn(|i| self.0[at.0 + i][at.0 + i])
    }

    /// Adds to the variance of a block's state `i`.
    pub fn add(&mut self, at: Block, i: usize, variance: R) {
        self.0[at.0 + i][at.0 + i] += variance;
    }

    /// Adds to the covariance of two blocks' states `i`.
    pub fn add_between(&mut self, one: Block, other: Block, i: usize, covariance: R) {
        self.0[one.0 + i][other.0 + i] += covariance;
        self.0[other.0 + i][one.0 + i] += covariance;
    }

    /// P ← F P Fᵀ for F that adds `m` times block `from` to block `to`.
    pub fn couple(&mut self, to: Block, from: Block, m: &Matrix<R>) {
        let source: [[R; STATES]; 3] = core::array::from_fn(|k| self.0[from.0 + k]);
        for i in 0..3 {
            let row = &mut self.0[to.0 + i];
            for j in 0..STATES {
                row[j] += m[i][0] * source[0][j] + m[i][1] * source[1][j] + m[i][2] * source[2][j];
            }
        }
        self.close(to, from, m);
    }

    /// The same where `m` is a number times the unit matrix.
    pub fn couple_by(&mut self, to: Block, from: Block, by: R) {
        let source: [[R; STATES]; 3] = core::array::from_fn(|k| self.0[from.0 + k]);
        for i in 0..3 {
            let row = &mut self.0[to.0 + i];
            for j in 0..STATES {
                row[j] += by * source[i][j];
            }
        }
        self.close(to, from, &crate::vector::diagonal(by));
    }

    /// Does with the columns what was done with the rows.
    fn close(&mut self, to: Block, from: Block, m: &Matrix<R>) {
        for i in 0..3 {
            let cross: [R; 3] = core::array::from_fn(|k| self.0[to.0 + i][from.0 + k]);
            for j in 0..3 {
                self.0[to.0 + i][to.0 + j] +=
                    cross[0] * m[j][0] + cross[1] * m[j][1] + cross[2] * m[j][2];
            }
        }
        self.mirror(to);
    }

    /// A block's columns from its rows.
    fn mirror(&mut self, at: Block) {
        let rows: [[R; STATES]; 3] = core::array::from_fn(|k| self.0[at.0 + k]);
        for j in 0..STATES {
            for i in 0..3 {
                self.0[j][at.0 + i] = rows[i][j];
            }
        }
    }

    /// Multiplies a block's states by `factor` and adds `noise` to their variances.
    pub fn shrink(&mut self, at: Block, factor: R, noise: R) {
        for i in 0..3 {
            for value in &mut self.0[at.0 + i] {
                *value = *value * factor;
            }
            for j in 0..3 {
                let square = &mut self.0[at.0 + i][at.0 + j];
                *square = *square * factor;
            }
            self.0[at.0 + i][at.0 + i] += noise;
        }
        self.mirror(at);
    }

    /// Turns a block.
    pub fn rotate(&mut self, at: Block, by: &Matrix<R>) {
        let rows: [[R; STATES]; 3] = core::array::from_fn(|k| self.0[at.0 + k]);
        for i in 0..3 {
            for j in 0..STATES {
                self.0[at.0 + i][j] =
                    by[i][0] * rows[0][j] + by[i][1] * rows[1][j] + by[i][2] * rows[2][j];
            }
        }
        let within = self.block(at, at);
        for i in 0..3 {
            for j in 0..3 {
                self.0[at.0 + i][at.0 + j] = crate::vector::dot(within[i], by[j]);
            }
        }
        self.mirror(at);
    }

    /// A state that is known exactly.
    pub fn know(&mut self, state: usize) {
        self.0[state] = [R::default(); STATES];
        for row in &mut self.0 {
            row[state] = R::default();
        }
    }

    /// P hᵀ of a row, and h P hᵀ.
    pub fn project<const N: usize>(&self, row: &Row<R, N>) -> ([R; STATES], R) {
        let mut column = [R::default(); STATES];
        for (at, factors) in row {
            for (i, factor) in factors.iter().enumerate() {
                if *factor != R::default() {
                    let source = &self.0[at.0 + i];
                    for j in 0..STATES {
                        column[j] += *factor * source[j];
                    }
                }
            }
        }
        let square = pick(row, &column);
        (column, square)
    }

    /// P ← P − c cᵀ / s. A variance that rounding takes below zero becomes zero, and what goes with it.
    pub fn reduce(&mut self, column: &[R; STATES], s: R) {
        let by = R::from_f64(1.0) / s;
        for (i, row) in self.0.iter_mut().enumerate() {
            let factor = column[i] * by;
            for j in 0..STATES {
                row[j] -= factor * column[j];
            }
        }
        for state in 0..STATES {
            if self.0[state][state] < R::default() {
                self.know(state);
            }
        }
    }
}

/// h v.
pub(super) fn pick<R: Real, const N: usize>(row: &Row<R, N>, v: &[R; STATES]) -> R {
    let mut sum = R::default();
    for (at, factors) in row {
        for (i, factor) in factors.iter().enumerate() {
            sum += *factor * v[at.0 + i];
        }
    }
    sum
}
