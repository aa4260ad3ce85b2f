//! Position fixes beside an inertial unit: a cart on a circle for two minutes, with a fix every 2 s, and without.
//! `cargo run --release -p wimu-nav --example fixes`

use std::f64::consts::TAU;

use wimu_nav::filter::Gate;
use wimu_nav::nalgebra::Vector3;
use wimu_nav::navigator::{Navigator, Profile, Sample, Settings, Start};
use wimu_nav::sensor::Position;

const STEP_S: f64 = 0.02;
const STEPS: usize = 6000;
/// Radius of the circle, m; mean angular rate, rad/s; interval of a stop, s; rest at the start, s.
const RADIUS_M: f64 = 10.0;
const RATE: f64 = 0.1;
const STOP_S: f64 = 30.0;
const REST_S: f64 = 2.0;
/// Interval of the fixes, steps; their standard deviation, m; one in twenty is 20 m off.
const EVERY: usize = 100;
const FIX_M: f64 = 0.3;

/// Angle on the circle, rad, and its first two derivatives. The cart begins at rest, and stops for a moment each time.
fn angle(t: f64) -> [f64; 3] {
    let (t, omega) = ((t - REST_S).max(0.0), TAU / STOP_S);
    let (sin, cos) = (omega * t).sin_cos();
    [RATE * (t - sin / omega), RATE * (1.0 - cos), RATE * omega * sin]
}

fn position_m(t: f64) -> Vector3<f64> {
    let (sin, cos) = angle(t)[0].sin_cos();
    Vector3::new(RADIUS_M * sin, RADIUS_M * (1.0 - cos), 0.0)
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut random = wimu_testkit::Random::new(1);
    let mut vector = |deviation| Vector3::from(random.normals(deviation));
    let [force_bias, rate_bias] = [vector(0.03), vector(0.003)];
    let samples: Vec<Sample> = (0..STEPS)
        .map(|k| {
            let [_, rate, acceleration] = angle(k as f64 * STEP_S);
            let level = Vector3::new(acceleration, rate * rate, 0.0) * RADIUS_M;
            let force = level + Vector3::z() * wimu_nav::GRAVITY_MPS2;
            Sample {
                step_s: STEP_S,
                force_mps2: force + force_bias + vector(0.03),
                rate_rad_s: Some(Vector3::z() * rate + rate_bias + vector(0.001)),
                field_ut: None,
            }
        })
        .collect();
    let start = Start::align(&samples[..100], true).ok_or("no specific force")?;
    let mut rms_m = |aided: bool| -> Result<(f64, usize), Box<dyn std::error::Error>> {
        let mut navigator = Navigator::new(Settings::of(Profile::Vehicle), &start);
        let (mut squares, mut rejected) = (0.0, 0);
        for (k, sample) in samples.iter().enumerate() {
            let t = k as f64 * STEP_S;
            navigator.push(sample, t < REST_S)?;
            if aided && k % EVERY == EVERY - 1 {
                let wrong = if k / EVERY % 20 == 19 { 20.0 } else { 0.0 };
                let fix = Position {
                    position_m: position_m(t) + vector(FIX_M) + Vector3::x() * wrong,
                    deviation_m: Vector3::repeat(FIX_M),
                    lever_arm_m: Vector3::zeros(),
                };
                // A fix that contradicts the path is not used.
                rejected += usize::from(!navigator.update(&fix, Gate::ChiSquare).accepted);
            }
            let error = Vector3::from(navigator.solution().position_m) - position_m(t);
            squares += error.norm_squared() / STEPS as f64;
        }
        Ok((squares.sqrt(), rejected))
    };
    let ((with, rejected), (without, _)) = (rms_m(true)?, rms_m(false)?);
    println!(
        "RMS error of the position: {with:.3} m with fixes, {without:.1} m without; {rejected} wrong fixes rejected"
    );
    assert!(with < 1.0 && without > 10.0 * with && rejected == 3);
    Ok(())
}
