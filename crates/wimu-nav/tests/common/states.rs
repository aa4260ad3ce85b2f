//! States of a filter one by one.

use nalgebra::{DVector, Matrix1, Rotation3, SMatrix, Vector3};
use wimu_nav::filter::Filter;
use wimu_nav::state::{ATTITUDE, Block, POSITION, State, VELOCITY};

/// The states of a block of three.
pub fn three(block: Block<3>) -> Vec<Block<1>> {
    vec![block.part::<1, 0>(), block.part::<1, 1>(), block.part::<1, 2>()]
}

/// The states of a block of nine.
pub fn nine(block: Block<9>) -> Vec<Block<1>> {
    [block.part::<3, 0>(), block.part::<3, 3>(), block.part::<3, 6>()]
        .into_iter()
        .flat_map(three)
        .collect()
}

/// Attitude, velocity, position, then the given blocks of three.
pub fn states(blocks: &[Block<3>]) -> Vec<Block<1>> {
    [ATTITUDE, VELOCITY, POSITION].iter().chain(blocks).flat_map(|block| three(*block)).collect()
}

/// Covariance of all states that are given; zero for the others.
pub fn covariance<const N: usize>(filter: &Filter, states: &[Block<1>]) -> SMatrix<f64, N, N> {
    let mut all = SMatrix::zeros();
    for row in states {
        for column in states {
            all[(row.start(), column.start())] = filter.cross_covariance(*row, *column)[(0, 0)];
        }
    }
    all
}

/// Zero covariance of the given states.
pub fn certain(filter: &mut Filter, states: &[Block<1>]) {
    for state in states {
        filter.set_covariance(*state, &Matrix1::zeros());
    }
}

/// The state that differs by an error: the attitude by a rotation, navigation frame, the others by a sum.
pub fn shifted(state: &State, error: &DVector<f64>) -> State {
    let mut out = state.clone();
    let angle: Vector3<f64> = error.fixed_rows::<3>(0).into_owned();
    out.attitude = Rotation3::new(angle) * state.attitude;
    out.vector += error;
    out.vector.fixed_rows_mut::<3>(0).fill(0.0);
    out
}

/// Error of a state against another, for small angles: the logarithm by the angle's cosine has no digits there.
pub fn difference(a: &State, b: &State) -> DVector<f64> {
    let mut out = &a.vector - &b.vector;
    let m = a.attitude * b.attitude.transpose();
    let angle =
        Vector3::new(m[(2, 1)] - m[(1, 2)], m[(0, 2)] - m[(2, 0)], m[(1, 0)] - m[(0, 1)]) * 0.5;
    out.fixed_rows_mut::<3>(0).copy_from(&angle);
    out
}
