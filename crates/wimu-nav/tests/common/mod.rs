//! What the tests share: a rigid body that turns, and repeatable noise.
#![allow(dead_code)]

pub use wimu_testkit::Random;

pub mod consistency;
pub mod drive;
pub mod navigated;
pub mod states;
pub mod travel;

use wimu_nav::array::Geometry;

/// Outputs of a geometry's axes on a body that turns: equation (70).
pub fn outputs<const M: usize>(
    geometry: &Geometry<M>,
    rate: [f64; 3],
    angular_acceleration: [f64; 3],
    force: [f64; 3],
) -> [f64; M] {
    let mut out = [0.0; M];
    for (value, axis) in out.iter_mut().zip(geometry.axes()) {
        let r = axis.position_m;
        let inner = cross(rate, r);
        let a = cross(angular_acceleration, r);
        let b = cross(rate, inner);
        *value = (0..3).map(|i| axis.direction[i] * (force[i] + a[i] + b[i])).sum();
    }
    out
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
