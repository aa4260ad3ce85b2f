//! Whether what looks like noise of long times is one event: a sensor that warms up, or a jump.

use crate::blocks::Blocks;

/// Most blocks; two become one when they are full.
const BLOCKS: usize = 32;
/// Fewest steps between blocks that tell a course.
const FEWEST: usize = 8;
/// The share of the squares of J steps that one course takes is above this per √J once in a hundred random
/// walks: 0.64 of 15 steps, 0.54 of 22, 0.46 of 31.
const CHANCE: f64 = 2.7;
/// A course falls from step to step by these: 0 is a jump, 1 a steady drift.
const DECAYS: [f64; 14] = [
    0.0, 0.3, 0.4, 0.5, 0.55, 0.6, 0.65, 0.7, 0.75, 0.8, 0.85, 0.9, 0.95, 1.0,
];

/// Block means over the whole recording.
#[derive(Clone, Debug)]
pub(super) struct Course(Blocks<[f64; 3], BLOCKS>);

impl Course {
    pub(super) fn new() -> Self {
        Self(Blocks::new())
    }

    pub(super) fn take(&mut self, off: [f64; 3]) {
        let merge = |a: &[f64; 3], b: &[f64; 3]| [0, 1, 2].map(|axis: usize| a[axis] + b[axis]);
        for (sum, off) in self.0.next(merge).into_iter().flatten().zip(off) {
            *sum += off;
        }
    }

    /// Whether the steps between the blocks' means are those of one course, more than chance makes of
    /// a random walk: a jump or a decaying drift from any time on. `beside_ramp`: besides a steady one.
    pub(super) fn is_one(&self, axis: usize, beside_ramp: bool) -> bool {
        let steps = self.0.complete().windows(2);
        let mut steps: heapless::Vec<f64, BLOCKS> =
            steps.map(|pair| pair[1][axis] - pair[0][axis]).collect();
        let count = steps.len();
        if count < FEWEST {
            return false;
        }
        let n = count as f64;
        if beside_ramp {
            let mean = steps.iter().sum::<f64>() / n;
            steps.iter_mut().for_each(|step| *step -= mean);
        }
        let squares: f64 = steps.iter().map(|step| step * step).sum();
        let mut share = 0.0_f64;
        for start in 0..count {
            for decay in DECAYS {
                let (mut size, mut product) = (1.0, 0.0);
                let (mut sum, mut square) = (0.0, 0.0);
                for step in steps.iter().skip(start) {
                    product += size * step;
                    sum += size;
                    square += size * size;
                    size *= decay;
                }
                let own = if beside_ramp {
                    square - sum * sum / n
                } else {
                    square
                };
                // A steady drift has nothing beside itself.
                if own > 1e-6 * square {
                    share = share.max(product * product / own);
                }
            }
        }
        share > CHANCE / libm::sqrt(n) * squares
    }
}
