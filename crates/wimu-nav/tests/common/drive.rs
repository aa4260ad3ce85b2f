//! A drive with turns on a plane: a unit mounted in any orientation, away from the axle, its clock and its antenna.

use nalgebra::{Rotation3, Vector3};
use wimu_nav::GRAVITY_MPS2;
use wimu_nav::filter::Gate;
use wimu_nav::navigator::{Navigator, Profile, Sample, Settings, Start, VehicleErrors};
use wimu_nav::sensor::Position;

use super::Random;

pub const STEP_S: f64 = 0.01;
pub const REST_S: f64 = 5.0;
/// Time stamps of samples minus those of fixes, s; unit from the axle in the vehicle, antenna from the unit in the body, m.
pub const CLOCK_S: f64 = 0.12;
pub const UNIT_M: [f64; 3] = [1.2, -0.3, 0.5];
pub const ANTENNA_M: [f64; 3] = [0.3, 0.2, -0.4];
const FIX_EVERY: usize = 25;
pub const FIX_M: f64 = 0.02;

/// Body to vehicle.
pub fn mounting() -> Rotation3<f64> {
    Rotation3::from_euler_angles(3.0, 0.12, 2.3)
}

/// Speed, m/s, and heading, rad, with their first two derivatives.
fn motion(t: f64) -> [[f64; 3]; 2] {
    let t = (t - REST_S).max(0.0);
    let of = |t: f64| {
        let begun = 1.0 - (-0.3 * t).exp() * (1.0 + 0.3 * t);
        let speed = begun * (9.0 + 3.0 * (0.21 * t).sin());
        [speed, 0.6 + begun * (1.4 * (0.11 * t).sin() + 0.5 * (0.31 * t).sin())]
    };
    let h = 1e-3;
    let [before, now, after] = [of((t - h).max(0.0)), of(t), of(t + h)];
    [0, 1].map(|k| {
        let first = (after[k] - before[k]) / (t + h - (t - h).max(0.0));
        let second = (after[k] - 2.0 * now[k] + before[k]) / (h * h);
        [now[k], first, if t > h { second } else { 0.0 }]
    })
}

/// What the vehicle did at a sample.
pub struct Moment {
    pub sample: Sample,
    pub attitude: Rotation3<f64>,
    pub position_m: Vector3<f64>,
    pub speed_mps: f64,
}

/// The drive. From `turned_s` on the unit is turned by 0.4 rad in its mount.
pub fn drive(lasts_s: f64, seed: u64, turned_s: f64) -> Vec<Moment> {
    let mut random = Random::new(seed);
    let biases = [0.05, 0.003].map(|sd| Vector3::from(random.normals(sd)));
    let arm = Vector3::from(UNIT_M);
    let mut axle = Vector3::zeros();
    (0..(lasts_s / STEP_S) as usize)
        .map(|k| {
            let t = k as f64 * STEP_S;
            let [[speed, speeding, _], [heading, rate, turning]] = motion(t);
            let level = Rotation3::from_axis_angle(&Vector3::z_axis(), heading);
            let [[middle, ..], [direction, ..]] = motion(t - 0.5 * STEP_S);
            if k > 0 {
                axle += Vector3::new(direction.cos(), direction.sin(), 0.0) * middle * STEP_S;
            }
            let [w, turn] = [rate, turning].map(|z| Vector3::z() * z);
            let force = Vector3::new(speeding, speed * rate, GRAVITY_MPS2)
                + turn.cross(&arm)
                + w.cross(&w.cross(&arm));
            let turned = if t < turned_s { 0.0 } else { 0.4 };
            let mount = Rotation3::from_axis_angle(&Vector3::z_axis(), turned) * mounting();
            // The rotation in the mount takes one sample.
            let jerk = if t >= turned_s && t < turned_s + STEP_S { 0.4 / STEP_S } else { 0.0 };
            let noise = [0.1, 0.005].map(|sd| Vector3::from(random.normals(sd)));
            Moment {
                sample: Sample {
                    step_s: STEP_S,
                    force_mps2: mount.inverse() * force + biases[0] + noise[0],
                    rate_rad_s: Some(
                        mount.inverse() * (w + Vector3::z() * jerk) + biases[1] + noise[1],
                    ),
                    field_ut: None,
                },
                attitude: level * mount,
                position_m: axle + level * arm,
                speed_mps: speed,
            }
        })
        .collect()
}

/// A navigator at the start of a drive, with the model of a vehicle or without.
pub fn begin(drive: &[Moment], vehicle: bool) -> Navigator {
    let mut settings = Settings::of(Profile::Vehicle);
    settings.vehicle = vehicle.then(VehicleErrors::default);
    let still: Vec<_> = drive[..300].iter().map(|m| m.sample).collect();
    let start = Start::align(&still, true).unwrap();
    let mut navigator = Navigator::new(settings, &start);
    let forward = drive[0].attitude * Vector3::x();
    navigator.set_heading(forward.y.atan2(forward.x));
    navigator.set_position(drive[0].position_m);
    navigator
}

/// Takes a sample, and the fix at it if there is one: its time stamp is that of the sample, so it was measured `CLOCK_S`
/// after the sample.
pub fn push(
    navigator: &mut Navigator,
    drive: &[Moment],
    k: usize,
    aided: bool,
    random: &mut Random,
) {
    let t = k as f64 * STEP_S;
    navigator.push(&drive[k].sample, t < REST_S).unwrap();
    let at = k + (CLOCK_S / STEP_S) as usize;
    if aided && k.is_multiple_of(FIX_EVERY) && at < drive.len() {
        let antenna = drive[at].position_m + drive[at].attitude * Vector3::from(ANTENNA_M);
        let fix = Position {
            position_m: antenna + Vector3::from(random.normals(FIX_M)),
            deviation_m: Vector3::repeat(FIX_M),
            lever_arm_m: Vector3::zeros(),
        };
        navigator.fix(fix, [0.0; 2], Gate::ChiSquare);
    }
}
