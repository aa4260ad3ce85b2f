//! A simulated hand motion between two rests, as accelerometer and gyroscope measure it.

// The tests and the example `accuracy` use parts of it.
#![allow(dead_code)]

use std::f64::consts::{PI, TAU};

use wimu_integrator::{Navigation, Saturation, State};
use wimu_model::{AngularRateQ20, PeriodNs, SpecificForceQ16};

pub const G: f64 = 9.80665;
/// Duration of each rest, s.
pub const REST_S: f64 = 3.0;
/// Sample rate and period.
pub const HZ: f64 = 200.0;
pub const PERIOD: PeriodNs = PeriodNs(5_000_000);
const NONE: Saturation = Saturation { accelerometer: false, gyroscope: false };

/// Errors of the sensors.
#[derive(Clone, Copy, Debug, Default)]
pub struct Errors {
    /// Standard deviation of a sample of specific force, m/s².
    pub force_noise: f64,
    /// Constant, m/s², body axes.
    pub force_bias: [f64; 3],
    /// Standard deviation of a sample of angular rate, rad/s.
    pub rate_noise: f64,
    /// Constant, rad/s, body axes.
    pub rate_bias: [f64; 3],
}

impl Errors {
    /// An LSM6DSO at [`HZ`]: 0.1 mg/√Hz and 4 mdps/√Hz, calibrated but for the gyroscope's bias.
    pub fn lsm6dso() -> Self {
        Self {
            force_noise: 0.01,
            force_bias: [0.003, -0.002, 0.004],
            rate_noise: 0.04_f64.to_radians(),
            rate_bias: [2.0, -1.0, 0.5].map(f64::to_radians),
        }
    }
}

/// A path of about a metre with loops, turned by up to 70° on the way and to another attitude at its end.
#[derive(Clone, Copy, Debug)]
pub struct Hand {
    /// Duration of the motion, s.
    pub motion_s: f64,
}

impl Hand {
    pub fn total_s(&self) -> f64 {
        2.0 * REST_S + self.motion_s
    }

    /// Displacement 0 to 1 of minimum jerk, and a window that is zero with three derivatives at both ends.
    fn progress(&self, t: f64) -> (f64, f64) {
        let u = ((t - REST_S) / self.motion_s).clamp(0.0, 1.0);
        let window = (1.0 - (1.0 - (PI * u).sin().powi(4)).powi(4)).max(0.0);
        (u * u * u * (10.0 - 15.0 * u + 6.0 * u * u), window)
    }

    /// m, navigation axes.
    pub fn position(&self, t: f64) -> [f64; 3] {
        let (along, w) = self.progress(t);
        let sine = |a: f64, f: f64, p: f64| a * w * (TAU * f * (t - REST_S) + p).sin();
        [
            0.8 * along + sine(0.12, 0.9, 0.3),
            -0.5 * along + sine(0.10, 1.3, 1.1),
            0.3 * along + sine(0.08, 0.7, 2.0),
        ]
    }

    /// Quaternion w, x, y, z from body to navigation axes.
    pub fn attitude(&self, t: f64) -> [f64; 4] {
        let (along, w) = self.progress(t);
        let sine = |a: f64, f: f64| a * w * (TAU * f * (t - REST_S)).sin();
        let angles = [
            0.4 * along + sine(0.9, 0.6),
            -0.3 * along + sine(0.7, 0.8),
            1.2 * along + sine(1.2, 0.5),
        ];
        [2, 1, 0].iter().fold([1.0, 0.0, 0.0, 0.0], |q, &axis| {
            let mut by = [(angles[axis] / 2.0).cos(), 0.0, 0.0, 0.0];
            by[1 + axis] = (angles[axis] / 2.0).sin();
            times(q, by)
        })
    }

    /// Specific force, m/s², and angular rate, rad/s, body axes.
    pub fn sensed(&self, t: f64) -> ([f64; 3], [f64; 3]) {
        const H: f64 = 2e-4;
        let [before, now, after] = [t - H, t, t + H].map(|t| self.position(t));
        let force = [0, 1, 2].map(|i| {
            let gravity = if i == 2 { G } else { 0.0 };
            (before[i] - 2.0 * now[i] + after[i]) / (H * H) + gravity
        });
        let turned = times(conjugate(self.attitude(t - H)), self.attitude(t + H));
        let rate = [0, 1, 2].map(|i| turned[i + 1] / H);
        (rotated(conjugate(self.attitude(t)), force), rate)
    }

    /// The samples at `hz` with `errors`; `noise` gives numbers of standard deviation 1.
    pub fn samples(
        &self,
        hz: f64,
        errors: &Errors,
        mut noise: impl FnMut() -> f64,
    ) -> Vec<(SpecificForceQ16, AngularRateQ20, Saturation)> {
        let count = (self.total_s() * hz) as usize;
        let mut sample = |k: usize| {
            let (force, rate) = self.sensed(k as f64 / hz);
            let force = [0, 1, 2].map(|i| {
                let sensed = force[i] + errors.force_bias[i] + errors.force_noise * noise();
                (sensed * SpecificForceQ16::LSB_PER_MPS2).round() as i32
            });
            let rate =
                [0, 1, 2].map(|i| rate[i] + errors.rate_bias[i] + errors.rate_noise * noise());
            (SpecificForceQ16(force), AngularRateQ20::from_rad_s(rate), NONE)
        };
        (0..=count).map(&mut sample).collect()
    }
}

pub fn times(a: [f64; 4], b: [f64; 4]) -> [f64; 4] {
    [
        a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3],
        a[0] * b[1] + a[1] * b[0] + a[2] * b[3] - a[3] * b[2],
        a[0] * b[2] + a[2] * b[0] + a[3] * b[1] - a[1] * b[3],
        a[0] * b[3] + a[3] * b[0] + a[1] * b[2] - a[2] * b[1],
    ]
}

pub fn distance(a: [f64; 3], b: [f64; 3]) -> f64 {
    (0..3).map(|i| (a[i] - b[i]).powi(2)).sum::<f64>().sqrt()
}

pub fn conjugate(q: [f64; 4]) -> [f64; 4] {
    [q[0], -q[1], -q[2], -q[3]]
}

pub fn rotated(q: [f64; 4], v: [f64; 3]) -> [f64; 3] {
    let [_, x, y, z] = times(times(q, [0.0, v[0], v[1], v[2]]), conjugate(q));
    [x, y, z]
}

/// Angle between two attitudes, rad.
pub fn angle_between(a: [f64; 4], b: [f64; 4]) -> f64 {
    let [w, x, y, z] = times(conjugate(a), b);
    2.0 * (x * x + y * y + z * z).sqrt().atan2(w.abs())
}

/// Attitude and position by the integrator's rule in f64, from a state of it.
#[derive(Clone, Copy, Debug)]
pub struct Rule {
    pub attitude: [f64; 4],
    pub position: [f64; 3],
    pub velocity: [f64; 3],
    previous: Option<([f64; 3], [f64; 3])>,
    gravity: f64,
    dt: f64,
}

impl Rule {
    /// At rest at the origin in a body-to-navigation `attitude`.
    pub fn new(attitude: [f64; 4], gravity: f64, dt: f64) -> Self {
        Self { attitude, position: [0.0; 3], velocity: [0.0; 3], previous: None, gravity, dt }
    }

    /// The same after the sample (`force`, `rate`) of an integrator.
    pub fn continued(
        now: &Navigation,
        state: &State,
        force: SpecificForceQ16,
        gravity: f64,
        dt: f64,
    ) -> Self {
        let quaternion = now.attitude.expect("a gyroscope");
        let attitude = quaternion.map(|q| f64::from(q) / f64::from(1 << 30));
        let previous = state.rotation.and_then(|rotation| rotation.previous);
        let mut a = rotated(attitude, force.to_mps2().0);
        a[2] -= gravity;
        Self {
            position: now.position.to_m(),
            velocity: now.velocity.to_mps(),
            previous: previous.map(|rate| (a, AngularRateQ20(rate).to_rad_s())),
            ..Self::new(attitude, gravity, dt)
        }
    }

    /// The next sample, body axes, m/s² and rad/s.
    pub fn step(&mut self, force: [f64; 3], rate: [f64; 3]) {
        let dt = self.dt;
        if let Some((_, before)) = self.previous {
            let c = [
                before[1] * rate[2] - before[2] * rate[1],
                before[2] * rate[0] - before[0] * rate[2],
                before[0] * rate[1] - before[1] * rate[0],
            ];
            let phi = [0, 1, 2].map(|i| (before[i] + rate[i]) * dt / 2.0 + c[i] * dt * dt / 12.0);
            let angle = phi.iter().map(|x| x * x).sum::<f64>().sqrt();
            let k = if angle > 1e-9 { (angle / 2.0).sin() / angle } else { 0.5 };
            let by = [(angle / 2.0).cos(), phi[0] * k, phi[1] * k, phi[2] * k];
            let q = times(self.attitude, by);
            let norm = q.iter().map(|q| q * q).sum::<f64>().sqrt();
            self.attitude = q.map(|q| q / norm);
        }
        let mut a = rotated(self.attitude, force);
        a[2] -= self.gravity;
        if let Some((before, _)) = self.previous {
            for i in 0..3 {
                let v = self.velocity[i];
                self.velocity[i] += (before[i] + a[i]) * dt / 2.0;
                self.position[i] += (v + self.velocity[i]) * dt / 2.0;
            }
        }
        self.previous = Some((a, rate));
    }
}
