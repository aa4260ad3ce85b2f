//! What the tests share: a rigid body that turns, and repeatable noise.
#![allow(dead_code)]

pub mod journeys;
pub mod motions;

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
        let r = axis.place_m;
        let inner = cross(rate, r);
        let a = cross(angular_acceleration, r);
        let b = cross(rate, inner);
        *value = (0..3)
            .map(|i| axis.direction[i] * (force[i] + a[i] + b[i]))
            .sum();
    }
    out
}

pub fn cross(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    ]
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

/// SplitMix64: the same numbers in every run.
pub struct Random(pub u64);

impl Random {
    pub fn unit(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((z ^ (z >> 31)) >> 11) as f64 / (1u64 << 53) as f64
    }

    pub fn normal(&mut self) -> f64 {
        let radius = (-2.0 * (1.0 - self.unit()).ln()).sqrt();
        radius * (std::f64::consts::TAU * self.unit()).cos()
    }

    pub fn normals(&mut self, sd: f64) -> [f64; 3] {
        [0; 3].map(|_| self.normal() * sd)
    }
}
