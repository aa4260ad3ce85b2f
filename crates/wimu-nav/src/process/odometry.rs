//! Wheel odometry in the plane: increments of distance and heading are measured. Equations (165) and (166).

use nalgebra::{Matrix3, RealField, Vector3};

use super::{Process, Transition};
use crate::rotation::{about_up, real, yaw};
use crate::state::{ATTITUDE, Block, Layout, LayoutFull, POSITION, Role, State, VELOCITY};

/// Errors of wheel odometry, all as standard deviations. The defaults are those of a robot on grass, with a gyroscope: chosen
/// on Plaza 1 (reference/localization).
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub struct OdometryErrors<R> {
    /// Scale factor of the distance.
    pub scale: R,
    /// Drift of the heading, rad/s.
    pub drift_rad_s: R,
    /// Random walk of the drift, rad/s/√s.
    pub drift_walk: R,
    /// Slip of an increment along and across the direction of motion, over its distance.
    pub slip: [R; 2],
    /// Noise of the distance, m/√s.
    pub distance_noise: R,
    /// Error of the rotation of an increment, over the rotation.
    pub rotation: R,
    /// Noise of the heading, rad/√s.
    pub heading_noise: R,
}

impl<R: RealField> Default for OdometryErrors<R> {
    fn default() -> Self {
        Self {
            scale: real(0.02),
            drift_rad_s: real(5e-3),
            drift_walk: real(1e-4),
            slip: [real(0.1), real(0.15)],
            distance_noise: real(0.045),
            rotation: real(0.01),
            heading_noise: real(0.0034),
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
    ///
    /// # Errors
    /// [`LayoutFull`].
    pub fn claim<R: RealField + Copy, const N: usize>(
        layout: &mut Layout<R, N>,
        errors: &OdometryErrors<R>,
    ) -> Result<Self, LayoutFull> {
        Ok(Self {
            scale: layout.claim(Role::Estimated, [errors.scale])?,
            drift: layout.claim(Role::Estimated, [errors.drift_rad_s])?,
        })
    }
}

/// An increment, or the fraction of it up to a time within it. The body moves along its x axis.
#[derive(Clone, Copy, Debug)]
pub struct Odometry<'a, R> {
    /// Its states.
    pub blocks: &'a OdometryBlocks,
    /// Errors of the odometry.
    pub errors: &'a OdometryErrors<R>,
    /// Distance and rotation of the whole increment, m, rad (positive: from east to north).
    pub distance_m: R,
    /// See [`distance_m`](Self::distance_m).
    pub rotation_rad: R,
    /// Duration of the whole increment, s, above zero.
    pub interval_s: R,
    /// Length of the step, s.
    pub step_s: R,
}

impl<R: RealField + Copy, const N: usize> Process<R, N> for Odometry<'_, R> {
    fn propagate(&self, state: &mut State<R, N>, transition: &mut Transition<R, N>) {
        let (dt, half) = (self.step_s, real::<R>(0.5));
        let fraction = dt / self.interval_s;
        let distance = self.distance_m * fraction;
        let travelled = distance * (state.get(self.blocks.scale).x + real(1.0));
        let rotation = self.rotation_rad * fraction + state.get(self.blocks.drift).x * dt;
        let (sine, cosine) = (yaw(&state.attitude) + rotation * half).sin_cos();
        let forward = Vector3::new(cosine, sine, R::zero());
        let left = Vector3::new(-sine, cosine, R::zero());

        let moved = state.get(POSITION) + forward * travelled;
        state.set(POSITION, moved);
        if dt > R::zero() {
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

impl<R: RealField + Copy> Odometry<'_, R> {
    /// Slip and noise of the increment are independent of those of the others; a part of it has its fraction of their variance.
    fn noise<const N: usize>(
        &self,
        forward: &Vector3<R>,
        left: &Vector3<R>,
        travelled: R,
        transition: &mut Transition<R, N>,
    ) {
        let (errors, dt) = (self.errors, self.step_s);
        let square = |x: R| x * x;
        let fraction = dt / self.interval_s;
        let [along, across] = errors.slip.map(|slip| square(slip * self.distance_m) * fraction);
        let along = along + square(errors.distance_noise) * dt;
        let angle = square(errors.rotation * self.rotation_rad) * fraction
            + square(errors.heading_noise) * dt;
        let arm = left * (travelled * real(0.5));
        let up = Vector3::z();
        let outer = |v: &Vector3<R>, variance: R| -> Matrix3<R> { v * v.transpose() * variance };
        let position = outer(forward, along) + outer(left, across) + outer(&arm, angle);
        transition.add_covariance(POSITION, POSITION, position);
        transition.add_covariance(POSITION, ATTITUDE, arm * up.transpose() * angle);
        transition.add_covariance(ATTITUDE, ATTITUDE, outer(&up, angle));
        transition.add_noise(self.blocks.drift, square(errors.drift_walk) * dt);
    }
}
