//! Strapdown integration with a 15-state error-state Kalman filter and zero-velocity updates.
//!
//! J. Solà, "Quaternion kinematics for the error-state Kalman filter" (2017), chapter 7; rests by the SHOE likelihood
//! ratio (Skog et al., IEEE Trans. Biomed. Eng. 57, 2010). States: position, velocity, attitude, biases of gyroscope and
//! accelerometer. z is up, heading arbitrary until a start is given.

use nalgebra::{Matrix3, SMatrix, SVector, UnitQuaternion, Vector3};
use wimu_model::STANDARD_GRAVITY_MPS2;

use crate::command::Point;
use crate::table::{Result, Table, XYZ};
use crate::truth::{Truth, heading};

type Matrix = SMatrix<f64, 15, 15>;
const UP: Vector3<f64> = Vector3::new(0.0, 0.0, STANDARD_GRAVITY_MPS2);
/// Standard deviation of the velocity at a rest, m/s; those of position, velocity and heading of a start that is given.
const ZERO_MPS: f64 = 0.01;
const GIVEN: [f64; 9] = [0.002, 0.002, 0.002, 0.02, 0.02, 0.02, 0.0, 0.0, 0.005];

/// Detector: samples of its window, deviations of specific force, m/s², and angular rate, rad/s, threshold. Noise densities,
/// m/s²/√Hz and rad/s/√Hz, and random walks of the biases of gyroscope and accelerometer. Deviations of position, velocity,
/// tilt and both biases at the start.
pub struct Settings {
    window: usize,
    force: f64,
    rate: f64,
    threshold: f64,
    density: [f64; 4],
    start: [f64; 5],
}

/// Detector as published with the pyshoe recordings; noise that stands for scale factors and clipping too.
pub const FOOT: Settings = Settings {
    window: 5,
    force: 0.00098,
    rate: 8.727e-5,
    threshold: 3.5e7,
    density: [0.05, 0.003, 2e-5, 5e-5],
    start: [1e-4, 0.01, 0.009, 9e-4, 0.005],
};

/// Chosen on three recordings of BROAD.
pub const HAND: Settings = Settings {
    window: 35,
    force: 0.1,
    rate: 0.015,
    threshold: 12.0,
    density: [0.005, 2.5e-4, 2e-4, 3e-4],
    start: [1e-4, 1e-3, 0.05, 0.02, 0.1],
};

/// The path; at each of `starts`, s, position, velocity and heading are those of the truth.
pub fn path(table: &Table, s: &Settings, truth: &Truth, starts: &[f64]) -> Result<Vec<Point>> {
    let (times, force) = (table.times()?, table.vectors("Accelerometer # (m/s²)", XYZ)?);
    let rate = table.vectors("Gyroscope # (rad/s)", XYZ)?;
    let rests = rests(&force, &rate, s);
    let level = force.iter().take(20).sum::<Vector3<f64>>();
    let mut q = UnitQuaternion::rotation_between(&level, &UP).unwrap_or_default();
    let [mut p, mut v, mut rate_bias, mut force_bias] = [Vector3::zeros(); 4];
    let sd = SVector::<f64, 15>::from_fn(|row, _| if row == 8 { 1e-5 } else { s.start[row / 3] });
    let mut covariance = Matrix::from_diagonal(&sd.map(|sd| sd * sd));
    let (mut points, mut starts) = (Vec::new(), starts.iter().peekable());
    for k in 0..times.len() {
        let dt = if k == 0 { 0.0 } else { times[k] - times[k - 1] };
        let half = UnitQuaternion::new(0.5 * dt * (rate[k] - rate_bias));
        let middle = q * half;
        let f = middle * (force[k] - force_bias);
        p += dt * v + 0.5 * dt * dt * (f - UP);
        v += dt * (f - UP);
        q = middle * half;
        let mut change = Matrix::identity();
        let rotation = middle.to_rotation_matrix().into_inner();
        let mut set = |row, column, block: Matrix3<f64>| {
            change.fixed_view_mut::<3, 3>(row, column).copy_from(&(block * dt));
        };
        set(0, 3, Matrix3::identity());
        set(3, 6, -f.cross_matrix());
        set(3, 12, -rotation);
        set(6, 9, -rotation);
        covariance = change * covariance * change.transpose();
        (3..15).for_each(|row| covariance[(row, row)] += s.density[row / 3 - 1].powi(2) * dt);
        if rests[k] {
            let cross = covariance.fixed_columns::<3>(3).into_owned();
            let innovation = cross.fixed_rows::<3>(3) + Matrix3::identity() * ZERO_MPS.powi(2);
            let gain = cross * innovation.try_inverse().unwrap_or_default();
            let error = -gain * v;
            let part = |row| -> Vector3<f64> { error.fixed_rows::<3>(row).into() };
            (p, v, q) = (p + part(0), v + part(3), UnitQuaternion::new(part(6)) * q);
            (rate_bias, force_bias) = (rate_bias + part(9), force_bias + part(12));
            covariance -= gain * innovation * gain.transpose();
            covariance = 0.5 * (covariance + covariance.transpose());
        }
        let start = starts.next_if(|start_s| **start_s <= times[k]);
        if let Some((position, velocity, yaw)) = start.and_then(|_| truth.start(times[k])) {
            let turn = yaw - heading(Some(q)).unwrap_or(yaw);
            q = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), turn) * q;
            (p, v) = (position, velocity);
            for row in (0..9).filter(|row| GIVEN[*row] > 0.0) {
                covariance.row_mut(row).fill(0.0);
                covariance.column_mut(row).fill(0.0);
                covariance[(row, row)] = GIVEN[row].powi(2);
            }
        }
        let sigma = Vector3::from_fn(|row, _| covariance[(row, row)].max(0.0).sqrt());
        points.push(Point { sigma, attitude: Some(q), ..Point::new(times[k], p) });
    }
    Ok(points)
}

/// Whether the unit rests at each sample.
fn rests(force: &[Vector3<f64>], rate: &[Vector3<f64>], s: &Settings) -> Vec<bool> {
    let mut found = vec![false; force.len()];
    for (k, (force, rate)) in force.windows(s.window).zip(rate.windows(s.window)).enumerate() {
        let gravity = force.iter().sum::<Vector3<f64>>().normalize() * STANDARD_GRAVITY_MPS2;
        let size = |f: &Vector3<f64>, w: &Vector3<f64>| {
            (f - gravity).norm_squared() / s.force.powi(2) + w.norm_squared() / s.rate.powi(2)
        };
        let sum: f64 = force.iter().zip(rate).map(|(f, w)| size(f, w)).sum();
        found[k + s.window / 2] = sum / (s.window as f64) < s.threshold;
    }
    found
}
