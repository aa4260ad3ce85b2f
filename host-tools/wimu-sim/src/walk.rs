//! Simulated walks for localization: ranges to anchors of a hall, a six-axis unit on a shoe, and position fixes.

use std::f64::consts::TAU;

use wimu_host::imu::{Imu, Sample};
use wimu_host::inertial::aids::position::POSITION;
use wimu_host::inertial::{Aid, Aids};
use wimu_host::localization::{AnchorPosition, RangeRecording};
pub use wimu_host::navigation::distance_m;
use wimu_host::series::{Flags, Ns};
use wimu_model::STANDARD_GRAVITY_MPS2;

use crate::attitude::Attitude;
use crate::motion::{Motion, Pose, smooth_step};
use crate::random::Random;

/// Anchors of a hall of 9 m × 7 m, m: east, north, up. They are not in a plane.
pub const HALL_M: [[f64; 3]; 6] = [
    [0.0, 0.0, 0.2],
    [9.0, 0.0, 2.5],
    [9.0, 7.0, 0.3],
    [0.0, 7.0, 2.6],
    [4.5, 0.0, 1.4],
    [4.5, 7.0, 1.2],
];
/// Ranges of each anchor a second.
const RANGES_HZ: f64 = 10.0;
/// Standard deviations of the errors of a range, m: bias common to all anchors and bias of each (antenna delays, together
/// 0.1 m), error correlated over 1 s (reflections), white noise (DW1000 data sheet).
const COMMON_M: f64 = 0.07;
const OWN_M: f64 = 0.07;
const CORRELATED_M: f64 = 0.06;
const NOISE_M: f64 = 0.03;
/// Excess of a range without line of sight, m, uniform: a person or a wall.
const EXCESS_M: [f64; 2] = [0.3, 3.0];

/// Ranges with what a calibration does not know.
#[derive(Clone, Debug)]
pub struct RangeWalk {
    /// Ranges and anchors, in the order of time.
    pub recording: RangeRecording,
    /// True bias of each anchor, m.
    pub biases_m: Vec<f64>,
    /// Of each range, whether it has no line of sight.
    pub blocked: Vec<bool>,
}

/// Position of a unit that is carried through the hall, m, at a time, s: a closed curve at walking speed.
pub fn carried_m(t: f64) -> [f64; 3] {
    [
        4.5 + 3.2 * libm::sin(0.25 * t),
        3.5 + 2.4 * libm::cos(0.17 * t),
        1.2 + 0.7 * libm::sin(0.31 * t),
    ]
}

impl RangeWalk {
    /// Ranges of [`carried_m`] to some anchors over a time, s; a fraction of them has no line of sight.
    pub fn new(seed: u64, anchors_m: &[[f64; 3]], duration_s: f64, blocked: f64) -> Self {
        Self::along(seed, anchors_m, duration_s, blocked, carried_m)
    }

    /// The same along another path, m at a time, s.
    pub fn along(
        seed: u64,
        anchors_m: &[[f64; 3]],
        duration_s: f64,
        blocked: f64,
        position_m: impl Fn(f64) -> [f64; 3],
    ) -> Self {
        let mut random = Random::new(seed, 20);
        let common_m = COMMON_M * random.gaussian();
        let biases_m: Vec<f64> =
            (anchors_m.iter()).map(|_| common_m + OWN_M * random.gaussian()).collect();
        let decay = libm::exp(-1.0 / RANGES_HZ);
        let mut correlated_m: Vec<f64> =
            (anchors_m.iter()).map(|_| CORRELATED_M * random.gaussian()).collect();
        let (mut ranges, mut hidden) = (Vec::new(), Vec::new());
        for k in 0..(duration_s * RANGES_HZ) as usize {
            let time_s = k as f64 / RANGES_HZ;
            for (anchor, anchor_m) in anchors_m.iter().enumerate() {
                let drift = CORRELATED_M * (1.0 - decay * decay).sqrt() * random.gaussian();
                correlated_m[anchor] = decay * correlated_m[anchor] + drift;
                let is_blocked = random.uniform(0.0, 1.0) < blocked;
                let excess_m = random.uniform(EXCESS_M[0], EXCESS_M[1]) * f64::from(is_blocked);
                let error_m = biases_m[anchor]
                    + correlated_m[anchor]
                    + NOISE_M * random.gaussian()
                    + excess_m;
                let range_m = distance_m(position_m(time_s), *anchor_m) + error_m;
                ranges.push(Aid::range(time_s, anchor, range_m));
                hidden.push(is_blocked);
            }
        }
        let named = |(k, position_m): (usize, &[f64; 3])| AnchorPosition {
            id: format!("A{}", k + 1),
            position_m: *position_m,
        };
        Self {
            recording: RangeRecording {
                name: "simulated ranges".to_owned(),
                anchors: anchors_m.iter().enumerate().map(named).collect(),
                ranges,
                ..RangeRecording::default()
            },
            biases_m,
            blocked: hidden,
        }
    }
}

/// Length of a stride, m; duration of its swing and of its stance, s: walking at 1.2 m/s.
const STRIDE_M: f64 = 1.3;
const SWING_S: f64 = 0.6;
const STANCE_S: f64 = 0.5;
/// Rest before the first and after the last stride, s.
const REST_S: f64 = 3.0;
/// Largest height of the shoe, m, and largest pitch, rad.
const LIFT_M: f64 = 0.12;
const PITCH: f64 = 0.7;

/// Strides of a shoe along a line of corners: still in the stances, with height, pitch and heading that change in the swings.
#[derive(Clone, Debug)]
pub struct Strides {
    /// Position of each stance, m, east and north, and its heading, rad.
    prints: Vec<([f64; 2], f64)>,
}

impl Strides {
    /// Strides from corner to corner, m, east and north.
    pub fn along(corners_m: &[[f64; 2]]) -> Self {
        let mut prints: Vec<([f64; 2], f64)> = Vec::new();
        for pair in corners_m.windows(2) {
            let way = [pair[1][0] - pair[0][0], pair[1][1] - pair[0][1]];
            let heading = libm::atan2(way[1], way[0]);
            let heading = match prints.last() {
                // The shorter rotation.
                Some((_, last)) => last + (heading - last + TAU / 2.0).rem_euclid(TAU) - TAU / 2.0,
                None => heading,
            };
            let count = (libm::hypot(way[0], way[1]) / STRIDE_M).ceil().max(1.0);
            if prints.is_empty() {
                prints.push((pair[0], heading));
            }
            for k in 1..=count as usize {
                let part = k as f64 / count;
                prints.push(([0, 1].map(|axis| pair[0][axis] + part * way[axis]), heading));
            }
        }
        Self { prints }
    }
}

impl Motion for Strides {
    fn pose(&self, t: f64) -> Pose {
        let period_s = SWING_S + STANCE_S;
        let since_s = (t - REST_S).max(0.0);
        let last = self.prints.len() - 1;
        let from = ((since_s / period_s) as usize).min(last);
        let ((a, heading), (b, next)) = (self.prints[from], self.prints[(from + 1).min(last)]);
        let tau = ((since_s - from as f64 * period_s) / SWING_S).clamp(0.0, 1.0);
        let [s, rate, acceleration] = smooth_step(tau);
        let [h, h1, h2] = bump(tau);
        let (sin, cos) = libm::sincos(TAU * tau);
        let pitch = PITCH * h * sin;
        let pitch_rate = PITCH * (h1 * sin + TAU * h * cos) / SWING_S;
        let yaw = heading + s * (next - heading);
        let yaw_rate = rate * (next - heading) / SWING_S;
        let ahead = |factor: f64| [(b[0] - a[0]) * factor, (b[1] - a[1]) * factor];
        let [along, speed, change] =
            [ahead(s), ahead(rate / SWING_S), ahead(acceleration / SWING_S.powi(2))];
        Pose {
            position_m: [a[0] + along[0], a[1] + along[1], LIFT_M * h],
            velocity_mps: [speed[0], speed[1], LIFT_M * h1 / SWING_S],
            acceleration_mps2: [change[0], change[1], LIFT_M * h2 / SWING_S.powi(2)],
            attitude: Attitude::from_rotation_vector([0.0, 0.0, yaw])
                .turned(Attitude::from_rotation_vector([0.0, pitch, 0.0])),
            angular_rate_radps: [-yaw_rate * libm::sin(pitch), pitch_rate, yaw_rate * pitch.cos()],
        }
    }

    fn duration(&self) -> f64 {
        2.0 * REST_S + (SWING_S + STANCE_S) * (self.prints.len() - 1) as f64
    }
}

/// 64 τ³ (1 − τ)³, from 0 to 1 and back, and its first two derivatives in τ, which are 0 at both ends.
fn bump(tau: f64) -> [f64; 3] {
    let product = tau * (1.0 - tau);
    let slope = 1.0 - 2.0 * tau;
    [
        64.0 * product.powi(3),
        192.0 * product.powi(2) * slope,
        384.0 * product * (slope * slope - product),
    ]
}

/// Standard deviations of what a calibration leaves: biases, m/s² and rad/s (0.3 deg/s), and elements of the matrices.
const FORCE_BIAS: f64 = 0.03;
const RATE_BIAS: f64 = 0.005;
const FORCE_MATRIX: f64 = 0.003;
const RATE_MATRIX: f64 = 0.005;
/// Noise densities, m/s²/√Hz and rad/s/√Hz: 90 µg/√Hz and 5 mdps/√Hz (consumer six-axis units at 16 g).
const FORCE_NOISE: f64 = 9e-4;
const RATE_NOISE: f64 = 9e-5;

/// What a calibrated six-axis unit measures of a motion, with the truth.
pub fn sensed(motion: &dyn Motion, rate_hz: f64, seed: u64) -> Imu {
    let mut random = Random::new(seed, 21);
    let mut vector = |sd: f64| [(); 3].map(|()| sd * random.gaussian());
    let [force_bias, rate_bias] = [vector(FORCE_BIAS), vector(RATE_BIAS)];
    let force_matrix = [(); 3].map(|()| vector(FORCE_MATRIX));
    let rate_matrix = [(); 3].map(|()| vector(RATE_MATRIX));
    let root_hz = (0.5 * rate_hz).sqrt();
    let mut measured = |truth: [f64; 3], matrix: &[[f64; 3]; 3], bias: [f64; 3], noise: f64| {
        let noise = vector(noise * root_hz);
        let row = |axis: usize| (0..3).map(|k| matrix[axis][k] * truth[k]).sum::<f64>();
        [0, 1, 2].map(|axis| truth[axis] + row(axis) + bias[axis] + noise[axis])
    };
    let mut recording = Imu::default();
    for k in 0..(motion.duration() * rate_hz) as usize {
        let time_s = k as f64 / rate_hz;
        let pose = motion.pose(time_s);
        let mut force = pose.acceleration_mps2;
        force[2] += STANDARD_GRAVITY_MPS2;
        let force = pose.attitude.to_body(force);
        let force = measured(force, &force_matrix, force_bias, FORCE_NOISE);
        let rate = measured(pose.angular_rate_radps, &rate_matrix, rate_bias, RATE_NOISE);
        let sample =
            Sample { force_mps2: force.into(), rate_rad_s: Some(rate.into()), ..Sample::default() };
        let time = Ns::from_s(time_s);
        recording.push(time, sample);
        let (position, quaternion) = (pose.position_m.into(), pose.attitude.quaternion().into());
        recording.reference.position_m.push(time, position, Flags::NONE);
        recording.reference.quaternion.push(time, quaternion, Flags::NONE);
    }
    recording
}

/// Position fixes of a motion at an interval, s, with a standard deviation of each component, m.
pub fn fixes(motion: &dyn Motion, interval_s: f64, deviation_m: f64, seed: u64) -> Aids {
    let mut random = Random::new(seed, 22);
    let fix = |k: usize| {
        let time_s = k as f64 * interval_s;
        let position_m = motion.pose(time_s).position_m;
        let measured_m = position_m.map(|p| p + deviation_m * random.gaussian());
        Aid::of(&POSITION, time_s, &measured_m, deviation_m)
    };
    let count = (motion.duration() / interval_s) as usize;
    Aids { aids: (0..count).map(fix).collect(), ..Aids::default() }
}
