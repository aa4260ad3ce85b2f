//! A nine-parameter fit of 38 poses with covariance and leave-one-out, against the fit alone of
//! `imu-calib` 0.3.1, the two in turns in one run:
//!
//!     cargo run --release -p wimu-calib --example speed
//!
//! Prints the median time of each, their ratio, and how well each recovers the truth.

#[path = "../tests/common/mod.rs"]
mod common;

use std::hint::black_box;
use std::time::Instant;

use common::{DrawModel as _, Random, pose, twelve};
use imu_calib::estimate::{AccelParametrization, StaticPose, estimate_accel_intrinsics};
use wimu_calib::{
    Gravity, Model, MultiPosition, Pose, multi_position, multi_position_f32, multi_position_with,
};
use wimu_testkit::figure;

const G: f64 = 9.80665;
const ROUNDS: usize = 2000;

fn main() {
    let mut random = Random::new(1);
    let truth = random.model(true);
    let mut ups = twelve().to_vec();
    ups.extend((0..26).map(|_| random.direction()));
    let poses: Vec<Pose> = ups
        .into_iter()
        .map(|up| {
            let mut pose = pose(&truth, G, up);
            for y in &mut pose.mean_mps2 {
                *y += random.normal() * 0.003;
            }
            pose
        })
        .collect();
    assert_eq!(poses.len(), 38);
    let theirs: Vec<StaticPose> = poses
        .iter()
        .map(|pose| StaticPose {
            accel_mean: pose.mean_mps2,
            gyro_mean: [0.0; 3],
            accel_std: [0.0; 3],
            gyro_std: [0.0; 3],
            samples: 1,
            start_time: 0.0,
            end_time: 1.0,
        })
        .collect();

    let gravity = Gravity::new(G, 0.0).expect("gravity");
    let robust = MultiPosition {
        reject: true,
        ..MultiPosition::default()
    };
    let mut ours = || {
        multi_position(black_box(&poses), gravity, Model::Full9)
            .expect("an answer")
            .rms_mps2
    };
    let mut ours_robust = || {
        multi_position_with(black_box(&poses), gravity, robust)
            .expect("an answer")
            .rms_mps2
    };
    let mut ours_f32 = || {
        multi_position_f32(black_box(&poses), gravity, Model::Full9)
            .expect("an answer")
            .rms_mps2
    };
    let mut other = || {
        estimate_accel_intrinsics(
            black_box(&theirs),
            G,
            AccelParametrization::ScaleMisalignmentBias,
        )
        .expect("an answer")
        .rms_residual
    };
    let work: [(&str, &mut dyn FnMut() -> f64); 4] = [
        ("wimu-calib: fit, covariance, leave-one-out", &mut ours),
        ("the same, bad poses looked for", &mut ours_robust),
        ("the same as the first in f32", &mut ours_f32),
        ("imu-calib 0.3.1: fit alone", &mut other),
    ];
    let mut times = [const { Vec::new() }; 4];
    let mut work = work;
    let mut rms = [0.0; 4];
    for _ in 0..ROUNDS {
        for (k, (_, run)) in work.iter_mut().enumerate() {
            let begin = Instant::now();
            rms[k] = run();
            times[k].push(begin.elapsed().as_nanos());
        }
    }
    let median = times.map(|mut times| {
        times.sort_unstable();
        times[ROUNDS / 2] as f64 / 1e3
    });
    for (k, (name, _)) in work.iter().enumerate() {
        println!("{name}: {:.1} µs, rms {:.6} mm/s²", median[k], rms[k] * 1e3);
        let (is_first, ratio) = (k == 0, median[k] / median[3]);
        let target = if is_first { "below 1" } else { "–" };
        let claim = format!("{name}: time over imu-calib's fit");
        figure(
            &claim,
            format!("{ratio:.2}"),
            target,
            !is_first || ratio < 1.0,
        );
    }
    assert!(median[0] < median[3], "slower than imu-calib");
}
