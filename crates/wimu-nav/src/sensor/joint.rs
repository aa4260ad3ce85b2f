//! A joint of two units in relative motion: a common point, and a common axis. Equations (193) and (194).

use nalgebra::{Matrix2, Matrix3, RealField, SMatrix, Vector3};

use super::{Measurement, Prediction};
use crate::filter::Filter;
use crate::state::{ATTITUDE, Block, Jacobian, POSITION};

/// A point that both bodies have in common: p = r₁ − C r₂.
#[derive(Clone, Copy, Debug)]
pub struct CommonPoint<R> {
    /// Position of the joint from each unit, m, in its axes.
    pub lever_arms: [Block<3>; 2],
    /// Standard deviation of a component, m: play of the joint, and bodies that bend.
    pub deviation_m: R,
}

impl<R: RealField + Copy, const N: usize> Measurement<R, N, 3> for CommonPoint<R> {
    fn predict(&self, filter: &Filter<R, N>) -> Prediction<R, N, 3> {
        let to_first = *filter.state.attitude.matrix();
        let [first, second] = self.lever_arms.map(|arm| filter.state.get(arm));
        let second = to_first * second;
        Prediction {
            innovation: first - second - filter.state.get(POSITION),
            jacobian: Jacobian::zeros()
                .with(POSITION, Matrix3::identity())
                .with(ATTITUDE, -second.cross_matrix())
                .with(self.lever_arms[0], -Matrix3::identity())
                .with(self.lever_arms[1], to_first),
            covariance: Matrix3::from_diagonal_element(self.deviation_m * self.deviation_m),
        }
    }
}

/// An axis that both bodies have in common: C j₂ = j₁, by the two components across j₁.
#[derive(Clone, Copy, Debug)]
pub struct CommonAxis<R> {
    /// Unit vector of the hinge axis in the axes of each unit.
    pub axes: [Block<3>; 2],
    /// Standard deviation of a component, rad: play of the hinge.
    pub deviation_rad: R,
}

impl<R: RealField + Copy, const N: usize> Measurement<R, N, 2> for CommonAxis<R> {
    fn predict(&self, filter: &Filter<R, N>) -> Prediction<R, N, 2> {
        let to_first = *filter.state.attitude.matrix();
        let [first, second] = self.axes.map(|axis| filter.state.get(axis));
        let second = to_first * second;
        let across = across(&first);
        Prediction {
            innovation: across * (first - second),
            jacobian: Jacobian::zeros()
                .with(ATTITUDE, across * -second.cross_matrix())
                .with(self.axes[0], -across)
                .with(self.axes[1], across * to_first),
            covariance: Matrix2::from_diagonal_element(self.deviation_rad * self.deviation_rad),
        }
    }
}

/// Rows: two unit vectors at right angles to each other and to `axis`.
fn across<R: RealField + Copy>(axis: &Vector3<R>) -> SMatrix<R, 2, 3> {
    let other = match axis.x.abs() < axis.y.abs().max(axis.z.abs()) {
        true => Vector3::x(),
        false => Vector3::y(),
    };
    let first = axis.cross(&other).normalize();
    let second = axis.cross(&first).normalize();
    SMatrix::from_rows(&[first.transpose(), second.transpose()])
}
