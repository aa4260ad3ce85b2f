//! Simulated motions of one unit with the truth, and the samples that a unit with drawn errors gives.

use super::Random;
use nalgebra::{Matrix3, Rotation3, Vector3};
use wimu_nav::GRAVITY_MPS2;
use wimu_nav::navigator::Sample;
use wimu_nav::process::ImuErrors;

/// Magnetic field, µT, east-north-up.
pub const FIELD_UT: [f64; 3] = [0.0, 20.0, -44.0];

/// A move of least jerk with a rotation about a fixed axis.
#[derive(Clone, Copy)]
struct Leg {
    start_s: f64,
    lasts_s: f64,
    way_m: Vector3<f64>,
    /// Rotation vector, body frame.
    rotation: Vector3<f64>,
}

/// A sinusoid of position and rotation.
#[derive(Clone, Copy)]
struct Tone {
    way_m: Vector3<f64>,
    rotation: Vector3<f64>,
    rad_s: f64,
    phase: f64,
}

/// A motion: position and attitude at any time.
#[derive(Clone, Default)]
pub struct Travel {
    legs: Vec<Leg>,
    tones: Vec<Tone>,
    /// Time at which the tones begin and end; they swell over a second.
    tones_s: [f64; 2],
    /// Constant velocity.
    pub drift_mps: Vector3<f64>,
}

/// Minimum-jerk step from 0 to 1 (T. Flash and N. Hogan, 1985).
fn smooth(x: f64) -> f64 {
    let x = x.clamp(0.0, 1.0);
    x * x * x * (10.0 - 15.0 * x + 6.0 * x * x)
}

/// Half the interval of numerical derivatives, s.
const H: f64 = 1e-3;

impl Travel {
    /// At rest at the origin.
    pub fn rest() -> Self {
        Self::default()
    }

    /// One more move.
    pub fn leg(mut self, start_s: f64, lasts_s: f64, way_m: [f64; 3], rotation: [f64; 3]) -> Self {
        self.legs.push(Leg { start_s, lasts_s, way_m: way_m.into(), rotation: rotation.into() });
        self
    }

    /// Moves of `size_m` in 1.5 s with rotations, and rests of 2 s between, from 4 s on.
    pub fn stop_and_go(random: &mut Random, count: usize, size_m: f64, rotation: f64) -> Self {
        (0..count).fold(Self::rest(), |travel, k| {
            let way = random.direction().map(|c| c * size_m);
            let turn = random.direction().map(|c| c * rotation);
            travel.leg(4.0 + 3.5 * k as f64, 1.5, way, turn)
        })
    }

    /// An oscillation of a hand between two times: tones of 0.5 to 1.5 Hz.
    pub fn oscillation(random: &mut Random, between_s: [f64; 2], way_m: f64, angle: f64) -> Self {
        let mut travel = Self { tones_s: between_s, ..Self::rest() };
        for _ in 0..4 {
            travel.tones.push(Tone {
                way_m: Vector3::from(random.normals(way_m * 0.5)),
                rotation: Vector3::from(random.normals(angle * 0.5)),
                rad_s: std::f64::consts::TAU * (0.5 + random.uniform()),
                phase: std::f64::consts::TAU * random.uniform(),
            });
        }
        travel
    }

    /// Large rotations and accelerations from the first second.
    pub fn tumbling(random: &mut Random) -> Self {
        let mut way = || random.direction();
        Self::rest().leg(0.2, 1.4, way().map(|c| c * 1.5), way().map(|c| c * 2.0)).leg(
            1.6,
            1.3,
            way().map(|c| c * 1.5),
            way().map(|c| c * 2.0),
        )
    }

    fn swell(&self, t: f64) -> f64 {
        let [begin, end] = self.tones_s;
        smooth(t - begin) * smooth(end - t)
    }

    /// Position, m.
    pub fn position(&self, t: f64) -> Vector3<f64> {
        let moved: Vector3<f64> =
            self.legs.iter().map(|leg| leg.way_m * smooth((t - leg.start_s) / leg.lasts_s)).sum();
        let swung: Vector3<f64> =
            self.tones.iter().map(|tone| tone.way_m * (tone.rad_s * t + tone.phase).sin()).sum();
        moved + swung * self.swell(t) + self.drift_mps * t
    }

    /// Velocity, m/s.
    pub fn velocity(&self, t: f64) -> Vector3<f64> {
        (self.position(t + H) - self.position(t - H)) / (2.0 * H)
    }

    /// Body to navigation frame.
    pub fn attitude(&self, t: f64) -> Rotation3<f64> {
        let swung: Vector3<f64> =
            self.tones.iter().map(|tone| tone.rotation * (tone.rad_s * t + tone.phase).sin()).sum();
        self.legs.iter().fold(Rotation3::new(swung * self.swell(t)), |attitude, leg| {
            let part = smooth((t - leg.start_s) / leg.lasts_s);
            attitude * Rotation3::new(leg.rotation * part)
        })
    }

    /// Specific force, m/s², and angular rate, rad/s, body frame.
    pub fn sensed(&self, t: f64) -> [Vector3<f64>; 2] {
        let positions = [t - H, t, t + H].map(|t| self.position(t));
        let acceleration = (positions[0] - positions[1] * 2.0 + positions[2]) / (H * H);
        let attitude = self.attitude(t);
        let change = self.attitude(t + H).matrix() - self.attitude(t - H).matrix();
        let rate = attitude.matrix().transpose() * change / (2.0 * H);
        let force = attitude.inverse() * (acceleration + Vector3::z() * GRAVITY_MPS2);
        let rate = Vector3::new(
            rate[(2, 1)] - rate[(1, 2)],
            rate[(0, 2)] - rate[(2, 0)],
            rate[(1, 0)] - rate[(0, 1)],
        ) * 0.5;
        [force, rate]
    }

    /// Whether the unit does not move: for updates with zero velocity.
    pub fn at_rest(&self, t: f64) -> bool {
        let moving = |start: f64, end: f64| t > start - 0.01 && t < end + 0.01;
        let [begin, end] = self.tones_s;
        !self.legs.iter().any(|leg| moving(leg.start_s, leg.start_s + leg.lasts_s))
            && (self.tones.is_empty() || !moving(begin, end))
    }

    /// Samples at a rate, Hz, until a time, s.
    pub fn samples(
        &self,
        rate_hz: f64,
        until_s: f64,
        errors: &Errors,
        random: &mut Random,
    ) -> Vec<Sample> {
        let step_s = 1.0 / rate_hz;
        let count = (until_s * rate_hz).round() as usize;
        let one = Matrix3::identity();
        (0..=count)
            .map(|k| {
                let t = k as f64 * step_s;
                let [force, _] = self.sensed(t);
                let [_, rate] = self.sensed(t - errors.delay_s);
                let field = self.attitude(t).inverse() * Vector3::from(FIELD_UT);
                let white = |density: f64, random: &mut Random| {
                    Vector3::from(random.normals(density * rate_hz.sqrt()))
                };
                Sample {
                    step_s: if k == 0 { 0.0 } else { step_s },
                    force_mps2: (one + errors.force_matrix) * force
                        + errors.force_bias
                        + white(errors.force_noise, random),
                    rate_rad_s: Some(
                        (one + errors.rate_matrix) * rate
                            + errors.rate_bias
                            + white(errors.rate_noise, random),
                    ),
                    field_ut: Some(field + Vector3::from(random.normals(errors.field_noise_ut))),
                }
            })
            .collect()
    }
}

/// Errors of a unit.
#[derive(Clone, Copy, Debug)]
pub struct Errors {
    pub force_bias: Vector3<f64>,
    pub rate_bias: Vector3<f64>,
    pub force_matrix: Matrix3<f64>,
    pub rate_matrix: Matrix3<f64>,
    pub delay_s: f64,
    /// Densities, m/s²/√Hz and rad/s/√Hz.
    pub force_noise: f64,
    pub rate_noise: f64,
    pub field_noise_ut: f64,
}

impl Errors {
    /// Noise only.
    pub fn noise(errors: &ImuErrors) -> Self {
        Self {
            force_bias: Vector3::zeros(),
            rate_bias: Vector3::zeros(),
            force_matrix: Matrix3::zeros(),
            rate_matrix: Matrix3::zeros(),
            delay_s: 0.0,
            force_noise: errors.accelerometer_noise,
            rate_noise: errors.gyroscope_noise,
            field_noise_ut: 0.5,
        }
    }

    /// Drawn from the standard deviations that a filter assumes.
    pub fn drawn(errors: &ImuErrors, random: &mut Random) -> Self {
        let mut matrix = |[scale, misalignment]: [f64; 2]| {
            Matrix3::from_fn(|r, c| random.normal() * if r == c { scale } else { misalignment })
        };
        let (force_matrix, rate_matrix) =
            (matrix(errors.accelerometer_matrix), matrix(errors.gyroscope_matrix));
        Self {
            force_bias: Vector3::from(random.normals(errors.accelerometer_bias)),
            rate_bias: Vector3::from(random.normals(errors.gyroscope_bias)),
            force_matrix,
            rate_matrix,
            delay_s: errors.delay_s * random.normal(),
            ..Self::noise(errors)
        }
    }
}
