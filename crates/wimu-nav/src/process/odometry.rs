//! Wheel odometry in the plane: increments of distance and heading are measured. Equations (165) and (166).

use nalgebra::{Matrix3, Vector3};

use super::{Process, Transition};
use crate::rotation::{about_up, yaw};
use crate::state::{ATTITUDE, Block, Layout, POSITION, Role, State, VELOCITY};

/// Errors of wheel odometry, all as standard deviations. The defaults are those of a robot on grass, with a gyroscope: chosen
/// on Plaza 1 (reference/localization).
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub struct OdometryErrors {
    /// Scale factor of the distance.
    pub scale: f64,
    /// Drift of the heading, rad/s.
    pub drift_rad_s: f64,
    /// Random walk of the drift, rad/s/√s.
    pub drift_walk: f64,
    /// Slip of an increment along and across the direction of motion, over its distance.
    pub slip: [f64; 2],
    /// Noise of the distance, m/√s.
    pub distance_noise: f64,
    /// Error of the rotation of an increment, over the rotation.
    pub rotation: f64,
    /// Noise of the heading, rad/√s.
    pub heading_noise: f64,
}

impl Default for OdometryErrors {
    fn default() -> Self {
        Self {
            scale: 0.02,
            drift_rad_s: 5e-3,
            drift_walk: 1e-4,
            slip: [0.1, 0.15],
            distance_noise: 0.045,
            rotation: 0.01,
            heading_noise: 0.0034,
        }
    }
}

/// States of the odometry beside position and attitude.
#[derive(Clone, Copy, Debug)]
pub struct OdometryBlocks {
    /// Scale error s: true distance = (1 + s) × measured distance.
    pub scale: Block<1>,
    /// Drift of the heading, rad/s: true rotation = measured rotation + drift × time.
    pub drift: Block<1>,
}

impl OdometryBlocks {
    /// Claims two states.
    pub fn claim(layout: &mut Layout, errors: &OdometryErrors) -> Self {
        Self {
            scale: layout.claim(Role::Estimated, [errors.scale]),
            drift: layout.claim(Role::Estimated, [errors.drift_rad_s]),
        }
    }
}

/// An increment, or the fraction of it up to a time within it. The body moves along its x axis.
#[derive(Clone, Copy, Debug)]
pub struct Odometry<'a> {
    /// Its states.
    pub blocks: &'a OdometryBlocks,
    /// Errors of the odometry.
    pub errors: &'a OdometryErrors,
    /// Distance and rotation of the whole increment, m, rad (positive: from east to north).
    pub distance_m: f64,
    /// See [`distance_m`](Self::distance_m).
    pub rotation_rad: f64,
    /// Duration of the whole increment, s, above zero.
    pub interval_s: f64,
    /// Length of the step, s.
    pub step_s: f64,
}

impl Process for Odometry<'_> {
    fn propagate(&self, state: &mut State, transition: &mut Transition) {
        let (dt, half) = (self.step_s, 0.5);
        let fraction = dt / self.interval_s;
        let distance = self.distance_m * fraction;
        let travelled = distance * (state.get(self.blocks.scale).x + 1.0);
        let rotation = self.rotation_rad * fraction + state.get(self.blocks.drift).x * dt;
        let (sine, cosine) = libm::sincos(yaw(&state.attitude) + rotation * half);
        let forward = Vector3::new(cosine, sine, 0.0);
        let left = Vector3::new(-sine, cosine, 0.0);

        let moved = state.get(POSITION) + forward * travelled;
        state.set(POSITION, moved);
        if dt > 0.0 {
            state.set(VELOCITY, forward * (travelled / dt));
        }
        state.attitude = about_up(rotation) * state.attitude;

        let up = Vector3::z();
        let by_heading = left * travelled * up.transpose();
        transition.add(POSITION, ATTITUDE, by_heading);
        transition.add(POSITION, self.blocks.scale, forward * distance);
        transition.add(POSITION, self.blocks.drift, left * (travelled * dt * half));
        transition.add(ATTITUDE, self.blocks.drift, up * dt);
        self.noise(&forward, &left, travelled, transition);
    }
}

impl Odometry<'_> {
    /// Slip and noise of the increment are independent of those of the others; a part of it has its fraction of their variance.
    fn noise(
        &self,
        forward: &Vector3<f64>,
        left: &Vector3<f64>,
        travelled: f64,
        transition: &mut Transition,
    ) {
        let (errors, dt) = (self.errors, self.step_s);
        let square = |x: f64| x * x;
        let fraction = dt / self.interval_s;
        let [along, across] = errors.slip.map(|slip| square(slip * self.distance_m) * fraction);
        let along = along + square(errors.distance_noise) * dt;
        let angle = square(errors.rotation * self.rotation_rad) * fraction
            + square(errors.heading_noise) * dt;
        let arm = left * (travelled * 0.5);
        let up = Vector3::z();
        let outer =
            |v: &Vector3<f64>, variance: f64| -> Matrix3<f64> { v * v.transpose() * variance };
        let position = outer(forward, along) + outer(left, across) + outer(&arm, angle);
        transition.add_covariance(POSITION, POSITION, position);
        transition.add_covariance(POSITION, ATTITUDE, arm * up.transpose() * angle);
        transition.add_covariance(ATTITUDE, ATTITUDE, outer(&up, angle));
        transition.add_noise(self.blocks.drift, square(errors.drift_walk) * dt);
    }
}
