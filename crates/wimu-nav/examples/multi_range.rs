//! A fine accelerometer of ±2 g calibrates a coarse one of ±16 g, which then measures an impact.
//! `cargo run --release -p wimu-nav --example multi_range`

use wimu_nav::nalgebra::{Matrix3, Vector3};
use wimu_nav::sensor::{Reading, Transfer};

/// Standard deviations of the noise, m/s²: LSM303AGR and ADXL345 at 400 Hz.
const NOISE: [f64; 2] = [0.03, 0.06];
/// ±2 g with a margin of 1 %, m/s².
const RAIL: f64 = 0.99 * 2.0 * wimu_nav::GRAVITY_MPS2;

fn main() {
    let mut random = wimu_testkit::Random::new(1);
    // What the coarse one has against the fine one.
    let bias = Vector3::new(0.6, -0.9, 1.1);
    let matrix = Matrix3::new(1.03, 0.02, 0.0, -0.01, 0.97, 0.01, 0.0, 0.02, 1.05);
    let mut transfer = Transfer::new(1.5, 0.05);
    let mut errors = [0.0_f64; 2];
    for k in 0..4100 {
        let t = f64::from(k) / 400.0;
        // Ten seconds of motion by hand, then a pulse of 100 m/s² in 0.1 s.
        let pulse = 100.0 * (std::f64::consts::PI * (t - 10.1) / 0.1).sin();
        let x = 8.0 * (5.0 * t).sin() + if (10.1..10.2).contains(&t) { pulse } else { 0.0 };
        let force = Vector3::new(x, 6.0 * (7.0 * t).sin(), 9.8 + 4.0 * (4.0 * t).sin());
        let fine = force + Vector3::from(random.normals(NOISE[0]));
        let coarse = bias + matrix * force + Vector3::from(random.normals(NOISE[1]));
        let variances = NOISE.map(|deviation| deviation * deviation);
        let readings = fine.map(|axis| Reading::new(axis, variances[0], RAIL));
        if fine.amax() < RAIL {
            transfer.push(&fine, &coarse, variances[0] + variances[1], variances[0]);
        }
        // From then on the calibration is good.
        if t < 5.0 {
            continue;
        }
        let model = transfer.model().expect("finite samples");
        let (by_coarse, variance) = model.to_fine(&coarse, variances[1]);
        let merged = readings[0].merge(Reading::Measured(by_coarse.x, variance.x));
        let Reading::Measured(value, variance) = merged else {
            continue;
        };
        let is_saturated = usize::from(fine.x.abs() >= RAIL);
        errors[is_saturated] = errors[is_saturated].max((value - x).abs() / variance.sqrt());
    }
    println!("largest error: {:.1} σ within ±2 g, {:.1} σ beyond", errors[0], errors[1]);
    assert!(errors.iter().all(|error| (1.0..6.0).contains(error)));
}
