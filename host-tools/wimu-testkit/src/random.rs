//! Seeded random numbers and evenly spread directions.

use std::f64::consts::{PI, TAU};
use std::sync::LazyLock;

use rand_core::{Rng, SeedableRng};
use rand_xoshiro::SplitMix64;

/// SplitMix64 (Steele, Lea, Flood 2014): the same numbers on every machine, in every run.
#[derive(Clone)]
pub struct Random(SplitMix64);

impl Random {
    /// The generator of a seed. A campaign's own seed (environment variable `WIMU_SEED`, 0 without it)
    /// turns it into another sequence.
    pub fn new(seed: u64) -> Self {
        static CAMPAIGN: LazyLock<u64> = LazyLock::new(|| {
            let seed = std::env::var("WIMU_SEED").ok();
            seed.map_or(0, |seed| seed.parse().expect("WIMU_SEED is a number"))
        });
        // An odd factor: different seeds of a campaign are far apart.
        let other = CAMPAIGN.wrapping_mul(0x9e37_79b9_7f4a_7c15).rotate_left(32);
        Self(SplitMix64::seed_from_u64(seed ^ other))
    }

    /// The next 64 bits.
    pub fn bits(&mut self) -> u64 {
        self.0.next_u64()
    }

    /// Uniform in 0..1.
    pub fn uniform(&mut self) -> f64 {
        (self.bits() >> 11) as f64 / (1_u64 << 53) as f64
    }

    /// Uniform within ± `limit`.
    pub fn within(&mut self, limit: f64) -> f64 {
        (2.0 * self.uniform() - 1.0) * limit
    }

    /// Uniform in 0..`limit`; 0 for a limit of 0.
    pub fn below(&mut self, limit: usize) -> usize {
        (self.bits() % limit.max(1) as u64) as usize
    }

    /// Normal, mean 0, standard deviation 1 (Box and Muller).
    pub fn normal(&mut self) -> f64 {
        let radius = (-2.0 * (1.0 - self.uniform()).ln()).sqrt();
        radius * (TAU * self.uniform()).cos()
    }

    /// Three independent normal numbers of standard deviation `sd`.
    pub fn normals(&mut self, sd: f64) -> [f64; 3] {
        [0; 3].map(|_| self.normal() * sd)
    }

    /// A direction, uniform on the unit sphere.
    pub fn direction(&mut self) -> [f64; 3] {
        loop {
            let v = self.normals(1.0);
            let norm = v.iter().map(|c| c * c).sum::<f64>().sqrt();
            if norm > 0.1 {
                return v.map(|c| c / norm);
            }
        }
    }

    /// `length` random bytes.
    pub fn bytes(&mut self, length: usize) -> Vec<u8> {
        (0..length).map(|_| self.bits() as u8).collect()
    }
}

/// `count` unit vectors spread evenly over the sphere (spherical Fibonacci lattice).
pub fn spread(count: u32) -> Vec<[f64; 3]> {
    let golden_angle = PI * (3.0 - 5.0_f64.sqrt());
    let direction = |k: u32| {
        let z = 1.0 - (2.0 * f64::from(k) + 1.0) / f64::from(count);
        let (sin, cos) = (golden_angle * f64::from(k)).sin_cos();
        let flat = (1.0 - z * z).sqrt();
        [flat * cos, flat * sin, z]
    };
    (0..count).map(direction).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_first_numbers_of_a_seed_are_those_of_the_published_generator() {
        // Vigna's splitmix64.c, seed 1234567.
        let mut random = Random::new(1_234_567);
        let first = [0; 3].map(|_| random.bits());
        assert_eq!(
            first,
            [6_457_827_717_110_365_317, 3_203_168_211_198_807_973, 9_817_491_932_198_370_423]
        );
    }

    #[test]
    fn normal_numbers_have_mean_0_variance_1_and_kurtosis_3() {
        let mut random = Random::new(7);
        let draws: Vec<f64> = (0..200_000).map(|_| random.normal()).collect();
        let moment = |power| draws.iter().map(|x| x.powi(power)).sum::<f64>() / draws.len() as f64;
        assert!(moment(1).abs() < 0.01);
        assert!((moment(2) - 1.0).abs() < 0.02);
        assert!((moment(4) - 3.0).abs() < 0.1);
    }
}
