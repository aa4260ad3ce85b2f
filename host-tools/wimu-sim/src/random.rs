//! Random numbers that are the same on every platform, in every run.

use std::f64::consts::TAU;

/// SplitMix64 (Steele, Lea, Flood 2014): the n-th number is a hash of n, so that noise can be
/// asked for by sample number, in any order.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Random {
    key: u64,
    drawn: u64,
}

impl Random {
    /// The generator number `stream` of `seed`; each is independent of the others.
    pub(crate) fn new(seed: u64, stream: u64) -> Self {
        Self { key: mix(mix(seed).wrapping_add(stream)), drawn: 0 }
    }

    /// The next number, uniform in `low..=high`.
    pub(crate) fn uniform(&mut self, low: f64, high: f64) -> f64 {
        let unit = self.unit(self.drawn);
        self.drawn += 1;
        low + (high - low) * unit
    }

    /// +1 or −1.
    pub(crate) fn sign(&mut self) -> f64 {
        if self.uniform(0.0, 1.0) < 0.5 { -1.0 } else { 1.0 }
    }

    /// The next number of the standard normal distribution.
    pub(crate) fn gaussian(&mut self) -> f64 {
        // An even start, so that no draw is shared with a gaussian before or after.
        let pair = self.drawn.div_ceil(2);
        self.drawn = 2 * (pair + 1);
        self.gaussian_at(pair)
    }

    /// Number `n` of the standard normal distribution, by Box and Muller's transform, whatever was
    /// drawn before.
    pub(crate) fn gaussian_at(&self, n: u64) -> f64 {
        let radius = libm::sqrt(-2.0 * libm::log(self.unit(n.wrapping_mul(2))));
        radius * libm::cos(TAU * self.unit(n.wrapping_mul(2).wrapping_add(1)))
    }

    /// Number `n`, uniform in (0, 1].
    pub(crate) fn unit(&self, n: u64) -> f64 {
        let steps = n.wrapping_add(1).wrapping_mul(0x9E37_79B9_7F4A_7C15);
        let bits = mix(self.key.wrapping_add(steps));
        ((bits >> 11) + 1) as f64 / (1_u64 << 53) as f64
    }
}

fn mix(mut z: u64) -> u64 {
    z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
    z ^ (z >> 31)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn normal_numbers_have_mean_0_variance_1_and_kurtosis_3() {
        let random = Random::new(7, 1);
        let n = 200_000;
        let moment = |power: i32| {
            let sum: f64 = (0..n).map(|i| random.gaussian_at(i).powi(power)).sum();
            sum / n as f64
        };
        assert!(moment(1).abs() < 0.01);
        assert!((moment(2) - 1.0).abs() < 0.02);
        assert!((moment(4) - 3.0).abs() < 0.1);
    }

    #[test]
    fn streams_of_one_seed_are_uncorrelated() {
        let (a, b) = (Random::new(7, 1), Random::new(7, 2));
        let n = 100_000;
        let product: f64 = (0..n).map(|i| a.gaussian_at(i) * b.gaussian_at(i)).sum();
        assert!((product / n as f64).abs() < 0.02);
    }

    #[test]
    fn the_numbers_never_change() {
        let mut random = Random::new(1, 2);
        assert_eq!(random.uniform(0.0, 1.0), 0.39654996185185254);
        assert_eq!(random.gaussian(), -0.5625359873757512);
    }
}
