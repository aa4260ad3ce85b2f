//! What following an array's angular rate claims.

use crate::common;

use common::{Random, dot, minus, norm, outputs};
use wimu_nav::array::{ArraySolver, Geometry, Observation, Step, track};

/// A body that is shaken about all axes: its rate at a time, and the derivative.
fn motion(t: f64) -> ([f64; 3], [f64; 3]) {
    let tones = [[12.0, 9.0, 0.3], [9.0, 7.0, 1.1], [10.0, 11.0, 2.0]];
    (tones.map(|[a, w, p]| a * (w * t + p).sin()), tones.map(|[a, w, p]| a * w * (w * t + p).cos()))
}

#[test]
fn the_sign_is_found_and_the_rate_lies_within_its_covariance() {
    let noise = 0.05;
    let board = Geometry::<24>::eight_triads_board(0.01, 0.002, noise).unwrap();
    let solver = ArraySolver::<f64, 24>::new(&board).unwrap();
    let mut random = Random::new(1);
    let dt = 0.005;
    let mut observations = Vec::new();
    for k in 0..1200 {
        let (rate, turn) = motion(f64::from(k) * dt);
        let clean = outputs(&board, rate, turn, [3.0, 1.0, 9.0]);
        let y = clean.map(|v| v + noise * random.normal());
        let linear = solver.reduce(&y);
        // A stretch where a sensor was at its limit.
        let lost = (600..605).contains(&k);
        observations.push(Observation {
            step_s: dt,
            linear: (!lost).then_some(linear),
            excess: solver.excess(&y, &linear).unwrap(),
        });
    }
    let mean = observations.iter().map(|o| o.excess).sum::<f64>() / 1200.0;
    assert!((mean - 1.0).abs() < 0.02, "the excess of plain noise is 1: {mean}");
    let mut steps = vec![Step::default(); observations.len()];
    let found = track(&solver, noise * noise, &observations, &mut steps).unwrap();
    let (mut wrong, mut squares, mut inside) = (0, 0.0, 0);
    for (k, step) in steps.iter().enumerate() {
        let (rate, _) = motion(k as f64 * dt);
        let error = minus(step.rate_rad_s, rate);
        wrong += usize::from(dot(step.rate_rad_s, rate) < 0.0 && norm(rate) > 1.0);
        squares += dot(error, error) / 3.0;
        let p = nalgebra::Matrix3::from_fn(|r, c| step.covariance[r][c]);
        let e = nalgebra::Vector3::from(error);
        inside += usize::from(e.dot(&(p.try_inverse().unwrap() * e)) < 7.81);
    }
    let rms = (squares / 1200.0).sqrt();
    println!(
        "rms {rms:.3} rad/s, {wrong} wrong signs, {inside} of 1200 within 95 %, NIS {:.2}",
        found.nis
    );
    assert!(rms < 0.5 && wrong == 0 && inside > 1000);
}

#[test]
fn a_geometry_without_a_rate_and_an_empty_recording_give_none() {
    let cube = Geometry::<6>::chen_cube(0.1, 0.01).unwrap();
    let solver = ArraySolver::<f64, 6>::new(&cube).unwrap();
    let mut steps = [Step::default(); 4];
    assert!(track(&solver, 1e-4, &[Observation::default(); 4], &mut steps).is_none());
    let four = Geometry::<12>::four_triads(0.05, 0.01).unwrap();
    let solver = ArraySolver::<f64, 12>::new(&four).unwrap();
    assert!(track(&solver, 1e-4, &[], &mut steps).is_none());
    assert!(track(&solver, 1e-4, &[Observation::default(); 4], &mut steps).is_none());
}
