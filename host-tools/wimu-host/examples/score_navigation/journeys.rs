//! Simulated journeys of one unit with their truth. Each draws its motion and its sensor errors independently.

use std::f64::consts::TAU;

use nalgebra::{Matrix3, Rotation3, Vector3};
use wimu_host::motion::{MotionRecording, Truth, UnitSample};
use wimu_model::STANDARD_GRAVITY_MPS2;
use wimu_testkit::Random;

use crate::recording::{Recording, SIMULATED};
use crate::settings::Settings;

const RATE_HZ: f64 = 100.0;
/// Rest before and after the motion, s.
const REST_S: f64 = 3.0;
/// Earth's field, µT, east-north-up, and how much of it changes over half a metre and more.
const FIELD_UT: [f64; 3] = [0.0, 20.0, -44.0];
const IRON_UT: f64 = 2.0;

/// Standard deviations of the sensor errors: the table of starting values of the estimator's design.
#[derive(Clone, Copy, Debug)]
pub struct SensorErrors {
    /// Noise densities: m/s²/√Hz, rad/s/√Hz; of the field µT a sample.
    pub accelerometer_noise: f64,
    pub gyroscope_noise: f64,
    pub field_noise: f64,
    /// Constant biases, m/s², rad/s, and their random walks, m/s²/√s, rad/s/√s.
    pub accelerometer_bias: f64,
    pub gyroscope_bias: f64,
    pub accelerometer_bias_walk: f64,
    pub gyroscope_bias_walk: f64,
    /// Scale and misalignment.
    pub accelerometer_matrix: [f64; 2],
    pub gyroscope_matrix: [f64; 2],
}

impl SensorErrors {
    pub const TABLE: Self = Self {
        accelerometer_noise: 0.005,
        gyroscope_noise: 2.5e-4,
        field_noise: 1.0,
        accelerometer_bias: 0.1,
        gyroscope_bias: TAU / 360.0,
        accelerometer_bias_walk: 3e-4,
        gyroscope_bias_walk: 2e-4,
        accelerometer_matrix: [0.005, 0.003],
        gyroscope_matrix: [0.01, 0.005],
    };
}

/// Kinds of journeys, in turn.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// Eight moves of 0.3 to 1 m in 1 to 3 s with rests of 1 to 3 s, turning by up to 0.8 rad about any axis.
    StopAndGo,
    /// 20 s in a hand: tones of 0.4 to 1 Hz in position and attitude.
    Hand,
    /// Twelve steps of 0.7 m in 0.6 s with pauses of 0.8 s.
    Steps,
}

pub const KINDS: [Kind; 3] = [Kind::StopAndGo, Kind::Hand, Kind::Steps];

/// Draws of vectors.
pub trait Draw {
    fn vector(&mut self, sd: f64) -> Vector3<f64>;
    fn axis(&mut self) -> Vector3<f64>;
    fn between(&mut self, from: f64, to: f64) -> f64;
}

impl Draw for Random {
    fn vector(&mut self, sd: f64) -> Vector3<f64> {
        self.normals(sd).into()
    }

    fn axis(&mut self) -> Vector3<f64> {
        self.vector(1.0).normalize()
    }

    fn between(&mut self, from: f64, to: f64) -> f64 {
        from + (to - from) * self.uniform()
    }
}

/// A move of least jerk.
struct Move {
    start_s: f64,
    duration_s: f64,
    /// m, navigation frame; rad, body frame.
    displacement: Vector3<f64>,
    rotation: Vector3<f64>,
}

/// Part of an oscillation: amplitudes in m and rad, angular frequency, phase.
struct Tone {
    displacement: Vector3<f64>,
    rotation: Vector3<f64>,
    omega: f64,
    phase: f64,
}

/// Position and attitude at any time.
struct Motion {
    heading: f64,
    moves: Vec<Move>,
    tones: Vec<Tone>,
    end_s: f64,
}

/// From 0 to 1 with bounded jerk.
fn smooth(x: f64) -> f64 {
    let x = x.clamp(0.0, 1.0);
    x * x * x * (10.0 - 15.0 * x + 6.0 * x * x)
}

impl Motion {
    fn new(kind: Kind, random: &mut Random) -> Self {
        let heading = TAU * random.uniform();
        let mut motion = Self { heading, moves: Vec::new(), tones: Vec::new(), end_s: REST_S };
        match kind {
            Kind::StopAndGo => {
                for _ in 0..8 {
                    let displacement = random.axis() * random.between(0.3, 1.0);
                    let rotation = random.axis() * random.between(0.0, 0.8);
                    let duration_s = random.between(1.0, 3.0);
                    motion.add(displacement, rotation, duration_s, random.between(1.0, 3.0));
                }
            }
            Kind::Steps => {
                for _ in 0..12 {
                    let ahead = Vector3::new(heading.cos(), heading.sin(), 0.0);
                    let length = 0.7 + 0.05 * random.normal();
                    motion.add(ahead * length, random.vector(0.1), 0.6, 0.8);
                }
            }
            Kind::Hand => {
                for _ in 0..6 {
                    motion.tones.push(Tone {
                        displacement: random.vector(0.06),
                        rotation: random.vector(0.04),
                        omega: TAU * random.between(0.4, 1.0),
                        phase: TAU * random.uniform(),
                    });
                }
                motion.end_s += 20.0;
            }
        }
        motion.end_s += REST_S;
        motion
    }

    fn add(
        &mut self,
        displacement: Vector3<f64>,
        rotation: Vector3<f64>,
        lasts_s: f64,
        rest_s: f64,
    ) {
        self.moves.push(Move { start_s: self.end_s, duration_s: lasts_s, displacement, rotation });
        self.end_s += lasts_s + rest_s;
    }

    /// Tones set in and end within a second.
    fn tone(&self, t: f64, part: impl Fn(&Tone) -> Vector3<f64>) -> Vector3<f64> {
        let envelope = smooth(t - REST_S) * smooth(self.end_s - REST_S - t);
        let sum: Vector3<f64> =
            self.tones.iter().map(|tone| part(tone) * (tone.omega * t + tone.phase).sin()).sum();
        envelope * sum
    }

    /// m, navigation frame.
    fn position(&self, t: f64) -> Vector3<f64> {
        let part = |m: &Move| m.displacement * smooth((t - m.start_s) / m.duration_s);
        self.moves.iter().map(part).sum::<Vector3<f64>>() + self.tone(t, |tone| tone.displacement)
    }

    fn acceleration(&self, t: f64) -> Vector3<f64> {
        let h = 3e-4;
        (self.position(t - h) - 2.0 * self.position(t) + self.position(t + h)) / (h * h)
    }

    /// Body to navigation frame.
    fn attitude(&self, t: f64) -> Rotation3<f64> {
        let mut attitude = Rotation3::from_axis_angle(&Vector3::z_axis(), self.heading);
        for m in self.moves.iter().take_while(|m| m.start_s < t) {
            attitude *= Rotation3::new(m.rotation * smooth((t - m.start_s) / m.duration_s));
        }
        attitude * Rotation3::new(self.tone(t, |tone| tone.rotation))
    }

    /// rad/s, body frame.
    fn rate(&self, t: f64) -> Vector3<f64> {
        let h = 1e-4;
        small_angle(&(self.attitude(t - h).inverse() * self.attitude(t + h))) / (2.0 * h)
    }
}

/// Rotation vector, rad, up to its cube: the logarithm loses half the digits of small angles.
pub fn small_angle(rotation: &Rotation3<f64>) -> Vector3<f64> {
    let m = rotation.matrix();
    0.5 * Vector3::new(m.m32 - m.m23, m.m13 - m.m31, m.m21 - m.m12)
}

/// Kind of the journey of this number.
pub fn kind(number: u64) -> Kind {
    KINDS[(number % KINDS.len() as u64) as usize]
}

/// Journey `number` of a seed, at 100 Hz.
pub fn journey(kind: Kind, seed: u64, number: u64, errors: &SensorErrors) -> Recording {
    let mut random = Random::new(seed.wrapping_mul(0x1_0000_0001).wrapping_add(number * 7919 + 17));
    let motion = Motion::new(kind, &mut random);
    let matrix = |random: &mut Random, [scale, misalignment]: [f64; 2]| {
        Matrix3::from_fn(|r, c| random.normal() * if r == c { scale } else { misalignment })
    };
    let force_matrix = matrix(&mut random, errors.accelerometer_matrix);
    let rate_matrix = matrix(&mut random, errors.gyroscope_matrix);
    let mut force_bias = random.vector(errors.accelerometer_bias);
    let mut rate_bias = random.vector(errors.gyroscope_bias);
    let step_s = 1.0 / RATE_HZ;
    let count = (motion.end_s * RATE_HZ) as usize;
    let (mut times, mut samples, mut truth) = (Vec::new(), Vec::new(), Vec::new());
    for k in 0..count {
        let t = k as f64 * step_s;
        let attitude = motion.attitude(t);
        let position = motion.position(t);
        let up = Vector3::z() * STANDARD_GRAVITY_MPS2;
        let force = attitude.inverse() * (motion.acceleration(t) + up);
        let rate = motion.rate(t);
        let iron =
            |i: usize| IRON_UT * (2.0 * position[i] + 1.3 * position[(i + 1) % 3] + i as f64).sin();
        let field = attitude.inverse() * Vector3::from_fn(|i, _| FIELD_UT[i] + iron(i));
        force_bias += random.vector(errors.accelerometer_bias_walk * step_s.sqrt());
        rate_bias += random.vector(errors.gyroscope_bias_walk * step_s.sqrt());
        let force_noise = random.vector(errors.accelerometer_noise * RATE_HZ.sqrt());
        let rate_noise = random.vector(errors.gyroscope_noise * RATE_HZ.sqrt());
        let field_noise = random.vector(errors.field_noise);
        times.push(t);
        samples.push(UnitSample {
            step_s: if k == 0 { 0.0 } else { step_s },
            force_mps2: (force + force_matrix * force + force_bias + force_noise).into(),
            field_ut: Some((field + field_noise).into()),
            rate_rad_s: Some((rate + rate_matrix * rate + rate_bias + rate_noise).into()),
        });
        let q = nalgebra::UnitQuaternion::from_rotation_matrix(&attitude);
        truth.push(Some(Truth { position_m: position.into(), quaternion: [q.w, q.i, q.j, q.k] }));
    }
    let name = format!("journey {number} ({kind:?})");
    let mut recording = MotionRecording::new(name, times, samples);
    recording.truth = truth;
    // What its calibration leaves unknown.
    let turn_on = recording.bias_mps2();
    let [scale, misalignment] = errors.accelerometer_matrix.map(|sd| sd * sd);
    let mut covariance = [[0.0; 12]; 12];
    for (place, row) in covariance.iter_mut().enumerate() {
        row[place] = match place {
            0..3 => (errors.accelerometer_bias.powi(2) - turn_on * turn_on).max(0.0),
            3 | 7 | 11 => scale,
            _ => misalignment,
        };
    }
    recording.covariance = Some(covariance);
    Recording::new(recording, Settings::HAND, SIMULATED)
}
