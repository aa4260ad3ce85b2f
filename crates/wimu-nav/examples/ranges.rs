//! Position from ranges alone: a loop in a hall with six anchors, whose biases are found on the way.
//! `cargo run --release -p wimu-nav --example ranges`

use wimu_nav::filter::{Filter, Gate};
use wimu_nav::nalgebra::{Rotation3, Vector3};
use wimu_nav::process::ConstantVelocity;
use wimu_nav::sensor::{Anchor, CorrelatedErrors, NonLineOfSight, Range, RangeErrors};
use wimu_nav::state::{Layout, POSITION};

const STEP_S: f64 = 0.1;
/// m: east, north, up.
const ANCHORS: [[f64; 3]; 6] = [
    [0.0, 0.0, 0.2],
    [9.0, 0.0, 2.5],
    [9.0, 7.0, 0.3],
    [0.0, 7.0, 2.6],
    [4.5, 0.0, 1.4],
    [4.5, 7.0, 1.2],
];
/// True biases, m.
const BIASES: [f64; 6] = [0.1, -0.05, 0.0, 0.08, -0.1, 0.05];

fn path(t: f64) -> Vector3<f64> {
    let (east, north) = (4.5 + 3.0 * (0.25 * t).sin(), 3.5 + 2.4 * (0.17 * t).cos());
    Vector3::new(east, north, 1.2 + 0.7 * (0.31 * t).sin())
}

fn main() {
    let errors = RangeErrors::default();
    // Attitude, velocity and position, and two states for each anchor: bias and correlated error.
    let mut layout = Layout::new([0.0; 3], 1.0, 0.2);
    let mut anchors = Vec::new();
    for position_m in ANCHORS {
        anchors.push(Anchor::claim(&mut layout, position_m.into(), &errors));
    }
    let mut filter = Filter::new(&layout, Rotation3::identity());
    filter.state.set(POSITION, path(0.0));
    let mixture = NonLineOfSight { probability: 0.1, mean_m: 1.0 };
    let mut random = wimu_testkit::Random::new(1);
    let mut squares = 0.0;
    for k in 1..=600 {
        let truth = path(f64::from(k) * STEP_S);
        let motion = ConstantVelocity { density: Vector3::repeat(0.1), step_s: STEP_S };
        let slow = CorrelatedErrors { anchors: &anchors, errors: &errors, step_s: STEP_S };
        filter.predict(&(motion, slow));
        for (anchor, bias) in anchors.iter().zip(BIASES) {
            // One range in ten has no line of sight.
            let excess = if random.uniform() < 0.1 { 1.5 * random.uniform() } else { 0.0 };
            let distance = (truth - anchor.position_m).norm();
            let range = Range {
                anchor,
                range_m: distance + bias + excess + random.normal() * errors.noise_m,
                deviation_m: errors.noise_m,
                lever_arm_m: Vector3::zeros(),
                delay: None,
                age_s: 0.0,
            };
            let (weighted, _) = range.weighted(&filter, &mixture);
            filter.update(&weighted, Gate::Open);
        }
        if k > 300 {
            squares += (filter.state.get(POSITION) - truth).norm_squared() / 300.0;
        }
    }
    println!("RMS error of the position in the last 30 s: {:.3} m", squares.sqrt());
    for (anchor, truth) in anchors.iter().zip(BIASES) {
        let Some(block) = anchor.bias else { continue };
        let (bias, sigma) = (filter.state.get(block).x, filter.covariance(block).x.sqrt());
        println!("bias {bias:+.3} ± {sigma:.3} m, true {truth:+.3} m");
        assert!((bias - truth).abs() < 4.0 * sigma);
    }
    assert!(squares.sqrt() < 0.15);
}
