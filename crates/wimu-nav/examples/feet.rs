//! A six-axis unit on a shoe: 40 strides to the east, with the velocity zero in stances, and by integration alone.
//! `cargo run --release -p wimu-nav --example feet`

use std::f64::consts::TAU;

use wimu_nav::nalgebra::{Rotation3, Vector3};
use wimu_nav::navigator::{Navigator, Profile, Sample, Settings, Start};
use wimu_nav::stance::stances;
use wimu_nav::stationarity::{RestDetector, RestLimits};

const STEP_S: f64 = 0.005;
const STRIDES: usize = 40;
/// Rest at the start, swing, and whole stride, s.
const TIMES_S: [f64; 3] = [3.0, 0.6, 1.1];
/// Samples of the rest.
const REST: usize = 600;
/// Length and height of a stride, m, and its pitch, rad.
const STRIDE: [f64; 3] = [1.3, 0.1, 0.6];

/// Position, m, and pitch, rad. Both change as 1 − cos, or sin³, of the phase of the swing.
fn pose(t: f64) -> (Vector3<f64>, f64) {
    let [rest_s, swing_s, stride_s] = TIMES_S;
    let strides = ((t - rest_s) / stride_s).clamp(0.0, STRIDES as f64);
    let tau = (strides.fract() * stride_s / swing_s).min(1.0);
    let along = strides.floor() + tau - (TAU * tau).sin() / TAU;
    let up = (0.5 * TAU * tau).sin().powi(4);
    let pitch = STRIDE[2] * (TAU * tau).sin().powi(3);
    (Vector3::new(STRIDE[0] * along, 0.0, STRIDE[1] * up), pitch)
}

/// What the unit measures, with constant biases and noise.
fn samples() -> Vec<Sample> {
    let mut random = wimu_testkit::Random::new(1);
    let mut vector = |deviation| Vector3::from(random.normals(deviation));
    let [force_bias, rate_bias] = [vector(0.03), vector(0.003)];
    let count = ((TIMES_S[0] + (STRIDES + 1) as f64 * TIMES_S[2]) / STEP_S) as usize;
    let sample = |k: usize| {
        let [before, now, after] = [-1.0, 0.0, 1.0].map(|h| pose((k as f64 + h) * STEP_S));
        let acceleration = (before.0 - 2.0 * now.0 + after.0) / STEP_S.powi(2);
        let force = acceleration + Vector3::z() * wimu_nav::GRAVITY_MPS2;
        let body = Rotation3::from_axis_angle(&Vector3::y_axis(), -now.1);
        let rate = Vector3::y() * (after.1 - before.1) / (2.0 * STEP_S);
        Sample {
            step_s: STEP_S,
            force_mps2: body * force + force_bias + vector(0.02),
            rate_rad_s: Some(rate + rate_bias + vector(0.002)),
            field_ut: None,
        }
    };
    (0..count).map(sample).collect()
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let samples = samples();
    // The statistic of the window about each sample: the detector answers for its middle.
    let mut detector = RestDetector::new(RestLimits::foot());
    let lag = (detector.lag_s() / STEP_S).round() as usize;
    let mut statistic: Vec<f64> = (samples.iter())
        .map(|s| {
            detector.push(&s.force_mps2, s.rate_rad_s.as_ref(), s.step_s);
            detector.statistic().unwrap_or(f64::INFINITY)
        })
        .collect();
    statistic.rotate_left(lag);
    let mut deviations_mps = vec![None; samples.len()];
    stances(&statistic, 1.0 / STEP_S, &mut deviations_mps);

    let start = Start::align(&samples[..REST], true).ok_or("no specific force")?;
    let truth_m = pose(samples.len() as f64 * STEP_S).0;
    let end = |used: bool| -> Result<[f64; 2], Box<dyn std::error::Error>> {
        let mut navigator = Navigator::new(Settings::of(Profile::Foot), &start);
        for (k, sample) in samples.iter().enumerate() {
            // The rest at the start gives the biases of the gyroscope.
            navigator.push(sample, k < REST)?;
            if let Some(deviation_mps) = deviations_mps[k].filter(|_| used) {
                navigator.stance(deviation_mps);
            }
        }
        let solution = navigator.solution();
        let variance: f64 = (0..3).map(|k| solution.position_covariance[k][k]).sum();
        let error_m = (Vector3::from(solution.position_m) - truth_m).norm();
        Ok([error_m, variance.sqrt()])
    };
    let [[with, sigma], [alone, _]] = [end(true)?, end(false)?];
    println!(
        "error after {:.0} m: {with:.3} m ± {sigma:.3} m; by integration alone {alone:.0} m",
        truth_m.x
    );
    assert!(with < 3.0 * sigma && with < 0.5 && alone > 10.0 * with);
    Ok(())
}
