//! What the tests share: a rigid body that turns, and repeatable noise.
#![allow(dead_code)]

pub use wimu_testkit::Random;

pub mod consistency;
pub mod drive;
pub mod navigated;
pub mod states;
pub mod travel;

use wimu_nav::array::{Axis, Geometry};

/// Triads at these positions in a unit of length, m, with noise, m/s².
pub fn triads(positions: &[[f64; 3]], unit_m: f64, noise_mps2: f64) -> Geometry {
    let triads = positions.iter().map(|p| Axis::triad(p.map(|c| c * unit_m), noise_mps2));
    Geometry::new(triads.flatten(), 3).unwrap()
}

/// Eight triads on both sides of a board, as on a MIMU4444: pairs at its corners, 2 cm from its axes, in turn above and below.
pub fn board(half_thickness_m: f64, noise_mps2: f64) -> Geometry {
    let corners = [[-1.0, 1.0], [-1.0, -1.0], [1.0, 1.0], [1.0, -1.0]];
    let side = |z: f64| move |[x, y]: [f64; 2]| [0.02 * x, 0.02 * y, z * half_thickness_m];
    let pairs = corners.map(|corner| [side(1.0)(corner), side(-1.0)(corner)]);
    triads(&pairs.concat(), 1.0, noise_mps2)
}

/// Outputs of a geometry's axes on a body that turns: equation (70).
pub fn outputs(
    geometry: &Geometry,
    rate: [f64; 3],
    angular_acceleration: [f64; 3],
    force: [f64; 3],
) -> Vec<f64> {
    let output = |axis: &Axis| {
        let r = axis.position_m;
        let inner = cross(rate, r);
        let a = cross(angular_acceleration, r);
        let b = cross(rate, inner);
        (0..3).map(|i| axis.direction[i] * (force[i] + a[i] + b[i])).sum()
    };
    geometry.axes().iter().map(output).collect()
}

/// Outputs with noise.
pub fn noisy(outputs: &[f64], sd: f64, random: &mut Random) -> Vec<f64> {
    outputs.iter().map(|y| y + sd * random.normal()).collect()
}

pub fn cross(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

pub fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

pub fn norm(a: [f64; 3]) -> f64 {
    dot(a, a).sqrt()
}

pub fn minus(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}
