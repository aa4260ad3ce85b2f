//! A unit in a vehicle, mounted in any direction: position fixes for 90 s, then an outage of 30 s, with the motion along
//! the forward axis, with wheel speeds too, and with neither. `cargo run --release -p wimu-nav --example vehicle`

use wimu_nav::filter::Gate;
use wimu_nav::nalgebra::{Rotation3, Vector3};
use wimu_nav::navigator::{Navigator, Profile, Sample, Settings, Start, VehicleErrors};
use wimu_nav::sensor::Position;

const STEP_S: f64 = 0.01;
const REST_S: f64 = 5.0;
const OUTAGE_S: f64 = 90.0;
const END_S: f64 = 120.0;
/// Samples between fixes, and between wheel speeds; standard deviation of a fix, m; scale error of the wheels.
const FIX: usize = 25;
const WHEELS: usize = 10;
const FIX_M: f64 = 0.05;
const SCALE: f64 = 0.03;

/// Speed, m/s, and heading, rad.
fn motion(t: f64) -> [f64; 2] {
    let t = (t - REST_S).max(0.0);
    let begun = 1.0 - (-0.3 * t).exp() * (1.0 + 0.3 * t);
    [
        begun * (9.0 + 3.0 * (0.21 * t).sin()),
        begun * (1.4 * (0.11 * t).sin() + 0.5 * (0.31 * t).sin()),
    ]
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut random = wimu_testkit::Random::new(3);
    let mut vector = |deviation: f64| Vector3::from(random.normals(deviation));
    // Body to vehicle: nobody measured it.
    let mount = Rotation3::from_euler_angles(0.1, -0.2, 2.0);
    let biases = [vector(0.05), vector(0.003)];
    let (mut samples, mut positions, mut speeds) = (Vec::new(), Vec::new(), Vec::new());
    let mut position = Vector3::zeros();
    for k in 0..(END_S / STEP_S) as usize {
        let t = k as f64 * STEP_S;
        let ([before, now, after], h) = ([t - 1e-3, t, t + 1e-3].map(motion), 2e-3);
        let rate = (after[1] - before[1]) / h;
        let force = Vector3::new((after[0] - before[0]) / h, now[0] * rate, wimu_nav::GRAVITY_MPS2);
        samples.push(Sample {
            step_s: STEP_S,
            force_mps2: mount.inverse() * force + biases[0] + vector(0.1),
            rate_rad_s: Some(mount.inverse() * Vector3::z() * rate + biases[1] + vector(0.005)),
            field_ut: None,
        });
        let [speed, heading] = motion(t - 0.5 * STEP_S);
        if k > 0 {
            position += Vector3::new(heading.cos(), heading.sin(), 0.0) * speed * STEP_S;
        }
        positions.push(position);
        speeds.push(now[0] / (1.0 + SCALE));
    }
    let start = Start::align(&samples[..300], true).ok_or("no specific force")?;
    let mut error_m = |vehicle: bool, wheels: bool| -> Result<f64, Box<dyn std::error::Error>> {
        let mut settings = Settings::of(Profile::Vehicle);
        settings.vehicle = vehicle.then(VehicleErrors::default);
        let mut navigator = Navigator::new(settings, &start);
        let forward = mount * Vector3::x();
        navigator.set_heading(forward.y.atan2(forward.x));
        for (k, sample) in samples.iter().enumerate() {
            let t = k as f64 * STEP_S;
            navigator.push(sample, t < REST_S)?;
            if t < OUTAGE_S && k.is_multiple_of(FIX) {
                let fix = Position {
                    position_m: positions[k] + vector(FIX_M),
                    deviation_m: Vector3::repeat(FIX_M),
                    lever_arm_m: Vector3::zeros(),
                };
                navigator.fix(fix, [0.0; 2], Gate::ChiSquare);
            }
            if wheels && k.is_multiple_of(WHEELS) {
                navigator.odometer(speeds[k]);
            }
        }
        Ok((Vector3::from(navigator.solution().position_m) - position).norm())
    };
    let without = error_m(false, false)?;
    let (along, wheels) = (error_m(true, false)?, error_m(true, true)?);
    println!(
        "error after {:.0} s without fixes: {without:.1} m; with motion along the forward axis {along:.1} m; with wheel speeds {wheels:.1} m",
        END_S - OUTAGE_S
    );
    assert!(along < without && wheels < along.max(2.0));
    Ok(())
}
