//! Simulated sensor output with a fixed seed.

use core::f32::consts::TAU;

use wimu_model::Counts;

/// A 12-bit sensor at rest, left-justified, ±2 g, with 1.5 digits of noise.
pub fn rest<const N: usize>() -> [Counts; N] {
    let mut noise = Noise(1);
    core::array::from_fn(|_| {
        Counts([30.0, -55.0, 1024.0].map(|mean| (round(mean + 1.5 * noise.normal())) * 16))
    })
}

/// A 16-bit sensor in a moving hand, ±4 g, 100 Hz: sines up to 8 Hz, and 12 LSB of noise.
pub fn motion<const N: usize>() -> [Counts; N] {
    let mut noise = Noise(2);
    let tones: [[f32; 4]; 24] = core::array::from_fn(|tone| {
        let phase = [0; 3].map(|_| noise.uniform());
        [0.3 + tone as f32 / 3.0, phase[0], phase[1], phase[2]]
    });
    core::array::from_fn(|k| {
        let t = k as f32 / 100.0;
        Counts(core::array::from_fn(|axis| {
            let motion: f32 = tones
                .iter()
                .map(|tone| libm::sinf(TAU * (tone[0] * t + tone[axis + 1])) / (1.0 + tone[0]))
                .sum();
            round([0.0, 0.0, 8192.0][axis] + 4500.0 * motion + 12.0 * noise.normal())
        }))
    })
}

fn round(value: f32) -> i16 {
    libm::roundf(value) as i16
}

/// SplitMix64.
struct Noise(u64);

impl Noise {
    /// 0 to 1.
    fn uniform(&mut self) -> f32 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((z ^ (z >> 31)) >> 40) as f32 / (1_u32 << 24) as f32
    }

    /// Mean 0, standard deviation 1: twelve uniform numbers.
    fn normal(&mut self) -> f32 {
        (0..12).map(|_| self.uniform()).sum::<f32>() - 6.0
    }
}
