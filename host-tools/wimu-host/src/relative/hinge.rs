//! The axis of a hinge, from the relative angular rate. Equation (196).

use std::f64::consts::{PI, TAU};

use nalgebra::{Matrix3, Rotation3, UnitQuaternion, Vector3};

use super::engine::Pose;
use crate::stats::{cauchy_weights, median};

/// Standard deviation of an axis that is given, rad: 1°, mounting by hand.
const GIVEN_RAD: f64 = 0.0175;
/// Interval over which errors of the relative rate are correlated, s.
const CORRELATED_S: f64 = 1.0;
/// Relative rate from which the joint moves, rad/s: ten times the bias of a gyroscope at 1 deg/s.
const MOVES_RAD_S: f64 = 0.17;

/// Rounds of weighting.
const ROUNDS: usize = 20;

/// The axis of the joint in the axes of each unit.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct Hinge {
    /// Unit vectors; the positive angle rotates the second unit about it.
    pub axes: [[f64; 3]; 2],
    /// Standard deviation of a component across, rad.
    pub sd_rad: [f64; 2],
    /// Whether it was given, or found.
    pub given: bool,
    /// Root mean square of the relative rate across the axis over that along it: 0 for a hinge, 1 for a ball joint in
    /// all directions.
    pub across: f64,
}

impl Hinge {
    /// A given axis, the same in the axes of both units.
    pub(super) fn given(axis: [f64; 3]) -> Option<Self> {
        let axis = Vector3::from(axis).try_normalize(1e-9)?;
        Some(Self { axes: [axis.into(); 2], sd_rad: [GIVEN_RAD; 2], given: true, across: 0.0 })
    }

    /// The principal direction of the relative rate. `None` where the joint does not move.
    pub(super) fn found(poses: &[Pose]) -> Option<Self> {
        let moving: Vec<&Pose> = poses
            .iter()
            .filter(|pose| pose.measured && relative(pose).norm() > MOVES_RAD_S)
            .collect();
        let moving_s: f64 = moving.iter().map(|pose| pose.step_s).sum();
        if moving_s < CORRELATED_S {
            return None;
        }
        let theta_rad = median(moving.iter().map(|pose| (pose.covariance.trace() / 3.0).sqrt()))?;
        let (first, across) = principal(moving.iter().map(|pose| relative(pose)))?;
        let second =
            principal(moving.iter().map(|pose| pose.attitude.inverse() * relative(pose)))?.0;
        // The largest component of the first unit's axis is positive.
        let first = first * first[first.iamax()].signum();
        let agrees: f64 = moving.iter().map(|pose| (pose.attitude * second).dot(&first)).sum();
        let second = second * agrees.signum();
        // An attitude error moves what the second unit (for its own axes, the first) turns relative to the joint.
        let (mut products, mut squares) = (0.0, 0.0);
        for pose in &moving {
            let along = relative(pose).dot(&first);
            products += along * (pose.attitude * pose.rate_rad_s[1]).dot(&first);
            squares += along * along;
        }
        let share = products / squares;
        let random = across / (moving_s / CORRELATED_S).sqrt();
        Some(Self {
            axes: [first.into(), second.into()],
            sd_rad: [share, share - 1.0].map(|share| random.hypot(share * theta_rad)),
            given: false,
            across,
        })
    }

    /// The angle about the axis, rad, ± π: zero where the shortest rotation takes one axis to the other.
    pub(super) fn angle(&self, attitude: &Rotation3<f64>) -> f64 {
        let [first, second] = self.axes.map(Vector3::from);
        let zero = Rotation3::rotation_between(&second, &first);
        let zero = zero.unwrap_or_else(|| {
            let other = Vector3::x().cross(&first).try_normalize(0.1);
            let other = other.unwrap_or_else(|| Vector3::y().cross(&first));
            Rotation3::new(other.normalize() * PI)
        });
        let rotation = attitude * zero.inverse();
        let quaternion = UnitQuaternion::from_rotation_matrix(&rotation);
        let half = quaternion.imag().dot(&first).atan2(quaternion.w);
        let angle = 2.0 * half;
        angle - TAU * (angle / TAU).round()
    }
}

/// Angular rate of the second unit relative to the first, rad/s, axes of the first.
pub(super) fn relative(pose: &Pose) -> Vector3<f64> {
    pose.attitude * pose.rate_rad_s[1] - pose.rate_rad_s[0]
}

/// Direction of the largest second moment, and the root of the ratio of the second largest to it. Vectors far across have little
/// weight: wobble and shocks are not Gaussian. `None` of none.
fn principal(vectors: impl Iterator<Item = Vector3<f64>>) -> Option<(Vector3<f64>, f64)> {
    let vectors: Vec<Vector3<f64>> = vectors.collect();
    let mut weights = vec![1.0; vectors.len()];
    let mut found = None;
    for _ in 0..ROUNDS {
        let weighted = vectors.iter().zip(&weights);
        let moment: Matrix3<f64> = weighted.map(|(v, w)| v * v.transpose() * *w).sum();
        let eigen = moment.symmetric_eigen();
        let mut order = [0, 1, 2];
        order.sort_by(|a, b| eigen.eigenvalues[*b].total_cmp(&eigen.eigenvalues[*a]));
        let [largest, next] = [0, 1].map(|k| eigen.eigenvalues[order[k]]);
        if largest.is_nan() || largest <= 0.0 {
            return None;
        }
        let direction = eigen.eigenvectors.column(order[0]).into_owned();
        let across: Vec<f64> = vectors.iter().map(|v| v.cross(&direction).norm()).collect();
        weights = cauchy_weights(&across);
        found = Some((direction, (next.max(0.0) / largest).sqrt()));
    }
    found
}
