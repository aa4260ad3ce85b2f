//! A nine-parameter fit of 38 poses with the leave-one-out error, and with the search for bad poses, against the fit alone of `imu-calib` 0.3.1, all in turns in one run:
//!
//!     cargo run --release -p wimu-tests --features baselines --example fit_speed
//!
//! Prints the median time of each, their ratio, and how well each recovers the truth.

#[path = "../../crates/wimu-calib/tests/common/mod.rs"]
mod common;

use std::hint::black_box;
use std::time::Instant;

use common::{DrawModel as _, Random, pose, twelve};
use imu_calib::estimate::{AccelParametrization, StaticPose, estimate_accel_intrinsics};
use wimu_calib::{Gravity, MultiPosition, Pose, multi_position};
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
    let robust = MultiPosition { reject: true, ..MultiPosition::default() };
    let mut ours = || {
        multi_position(black_box(&poses), gravity, MultiPosition::default())
            .expect("an answer")
            .rms_mps2
    };
    let mut ours_robust =
        || multi_position(black_box(&poses), gravity, robust).expect("an answer").rms_mps2;
    let mut other = || {
        estimate_accel_intrinsics(
            black_box(&theirs),
            G,
            AccelParametrization::ScaleMisalignmentBias,
        )
        .expect("an answer")
        .rms_residual
    };
    // The last number is the largest time allowed, relative to imu-calib's.
    type Work<'a> = (&'a str, &'a mut dyn FnMut() -> f64, f64);
    let mut work: [Work; 3] = [
        ("wimu-calib: fit, leave-one-out", &mut ours, 1.0),
        ("the same, bad poses looked for", &mut ours_robust, 4.0),
        ("imu-calib 0.3.1: fit alone", &mut other, f64::INFINITY),
    ];
    let mut times = [const { Vec::new() }; 3];
    let mut rms = [0.0; 3];
    for _ in 0..ROUNDS {
        for (k, (_, run, _)) in work.iter_mut().enumerate() {
            let begin = Instant::now();
            rms[k] = run();
            times[k].push(begin.elapsed().as_nanos());
        }
    }
    let median = times.map(|mut times| {
        times.sort_unstable();
        times[ROUNDS / 2] as f64 / 1e3
    });
    for (k, (name, _, most)) in work.iter().enumerate() {
        println!("{name}: {:.1} µs, rms {:.6} mm/s²", median[k], rms[k] * 1e3);
        let ratio = median[k] / median[2];
        let target = if most.is_finite() { format!("at most {most}") } else { "–".into() };
        let claim = format!("{name}: time over imu-calib's fit");
        figure(&claim, format!("{ratio:.2}"), &target, ratio <= *most);
    }
    let within = |k: usize| median[k] <= work[k].2 * median[2];
    assert!((0..work.len()).all(within), "slower than allowed");
}
