//! A simulated joint: two bodies, a unit on each, and their true rotation.

use nalgebra::{Rotation3, Vector3};
use wimu_host::imu::{Imu, Sample};
use wimu_host::series::Ns;
use wimu_testkit::Random;

const GRAVITY_MPS2: f64 = 9.80665;
/// Time step of the numerical derivatives of the motion, s.
const DERIVATIVE_S: f64 = 1e-3;

/// A joint that moves and turns, and what its units measure.
#[derive(Clone)]
pub struct Rig {
    /// Amplitude of the rotation of the second body about each axis of the joint, rad.
    pub swing_rad: [f64; 3],
    /// Amplitudes of the motion of the first body: rotation, rad, and of the joint, m.
    pub base: [f64; 2],
    /// Amplitude of a rotation of the first body by which both are shaken at 6 s, rad.
    pub shake_rad: f64,
    /// Sample rates, Hz.
    pub rates_hz: [f64; 2],
    /// Rows that hold each sample.
    pub rows: usize,
    /// The second unit's clock is so much behind, s.
    pub behind_s: f64,
    /// Length, s.
    pub seconds: f64,
    /// Whether the sensors have errors: biases of half the standard deviation that the estimator assumes, no play of the joint.
    pub errors: bool,
    /// Magnetic field, µT, east north up; the readings are without error.
    pub field_ut: Option<[f64; 3]>,
    /// Axes of the units to those of their bodies.
    pub mounts: [Rotation3<f64>; 2],
    /// Of the joint from each unit, m, axes of the body.
    pub arms: [Vector3<f64>; 2],
    /// Phases of the sines, rad.
    pub phases: [f64; 12],
    /// Of the random errors.
    pub seed: u64,
}

impl Rig {
    /// A knee: swings by 40° about z of both bodies.
    pub fn knee(seed: u64) -> Self {
        let mut random = Random::new(seed);
        Self {
            swing_rad: [0.0, 0.0, 0.7],
            base: [0.4, 0.15],
            shake_rad: 0.0,
            rates_hz: [50.0; 2],
            rows: 1,
            behind_s: 0.0,
            seconds: 20.0,
            errors: true,
            field_ut: None,
            mounts: [0, 1].map(|_| Rotation3::new(random.normals(0.5).into())),
            arms: [[0.0, -0.2, 0.03], [0.0, 0.15, 0.03]].map(Vector3::from),
            phases: [0; 12].map(|_| random.uniform() * 6.0),
            seed,
        }
    }

    fn wave(&self, k: usize, hz: f64, t: f64) -> f64 {
        (std::f64::consts::TAU * hz * t + self.phases[k]).sin()
    }

    /// Attitude of each unit, axes to the navigation frame.
    fn attitudes(&self, t: f64) -> [Rotation3<f64>; 2] {
        let of = |k: usize, hz: f64| self.wave(k, hz, t);
        let base = Vector3::new(of(0, 0.31), of(1, 0.43), of(2, 0.23)) * self.base[0];
        let shake = (t - 6.0) / 0.6;
        let shake = self.shake_rad * (-shake * shake).exp() * (14.5 * t).sin();
        let base = base + Vector3::new(shake, shake, 0.0);
        let swing = Vector3::from(self.swing_rad);
        let turn = swing.component_mul(&Vector3::new(of(3, 0.7), of(4, 0.9), of(5, 0.8)));
        // A leg: the body's y axis is up.
        let first =
            Rotation3::new(Vector3::x() * std::f64::consts::FRAC_PI_2) * Rotation3::new(base);
        [first * self.mounts[0], first * Rotation3::new(turn) * self.mounts[1]]
    }

    fn positions(&self, t: f64) -> [Vector3<f64>; 2] {
        let of = |k: usize, hz: f64| self.wave(k, hz, t);
        let joint = Vector3::new(of(6, 0.9), of(7, 0.6), of(8, 1.1)) * self.base[1];
        let attitudes = self.attitudes(t);
        [0, 1].map(|k| joint - attitudes[k] * self.mounts[k].inverse() * self.arms[k])
    }

    /// True rotation of the second unit relative to the first.
    pub fn truth(&self, t: f64) -> Rotation3<f64> {
        let [first, second] = self.attitudes(t);
        first.inverse() * second
    }

    /// True axis of the hinge in the axes of each unit.
    pub fn axes(&self) -> [Vector3<f64>; 2] {
        [0, 1].map(|k| self.mounts[k].inverse() * Vector3::z())
    }

    /// What both units record.
    pub fn record(&self) -> [Imu; 2] {
        [0, 1].map(|unit| self.unit(unit))
    }

    fn unit(&self, unit: usize) -> Imu {
        let mut random = Random::new(self.seed * 2 + unit as u64 + 1000);
        let size = f64::from(u8::from(self.errors));
        let rate_hz = self.rates_hz[unit];
        let mut draw = |sd: f64| Vector3::from(random.normals(sd * size));
        let (rate_bias, force_bias, scale) = (draw(0.01), draw(0.05), draw(0.01));
        let mut recording = Imu::new(["thigh", "shank"][unit]);
        for k in 0..(self.seconds * rate_hz) as usize {
            let t = k as f64 / rate_hz;
            let at = |t: f64| (self.attitudes(t)[unit], self.positions(t)[unit]);
            let [before, now, after] = [-DERIVATIVE_S, 0.0, DERIVATIVE_S].map(|h| at(t + h));
            let rate = (before.0.inverse() * after.0).scaled_axis() / (2.0 * DERIVATIVE_S);
            let acceleration = (before.1 + after.1 - now.1 * 2.0) / DERIVATIVE_S.powi(2);
            let force = now.0.inverse() * (acceleration + Vector3::z() * GRAVITY_MPS2);
            let root = rate_hz.sqrt();
            let sample = Sample {
                step_s: 0.0,
                force_mps2: force + force_bias + draw(0.005 * root),
                rate_rad_s: Some(
                    rate + rate.component_mul(&scale) + rate_bias + draw(2.5e-4 * root),
                ),
                field_ut: self.field_ut.map(|field| now.0.inverse() * Vector3::from(field)),
            };
            let late_s = if unit == 1 { self.behind_s } else { 0.0 };
            for row in 0..self.rows {
                let time_s = t + row as f64 / (rate_hz * self.rows as f64) - late_s;
                recording.push(Ns::from_s(time_s), sample);
            }
        }
        recording
    }
}
