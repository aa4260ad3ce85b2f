//! Whether a single event explains the noise at long averaging times: warm-up, or a jump.

use crate::blocks::Blocks;

/// Largest number of blocks.
const BLOCKS: usize = 32;
/// Smallest number of differences between blocks.
const FEWEST: usize = 8;
/// Significance threshold times √J of the fraction of the sum of squares of J differences that one
/// event explains: exceeded by 1 % of random walks (0.64 for J = 15, 0.54 for 22, 0.46 for 31).
const CHANCE: f64 = 2.7;
/// Decay factors of an event from one difference to the next: 0 is a jump, 1 a linear drift.
const DECAYS: [f64; 14] =
    [0.0, 0.3, 0.4, 0.5, 0.55, 0.6, 0.65, 0.7, 0.75, 0.8, 0.85, 0.9, 0.95, 1.0];

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

    /// Whether a single event, a jump or a decaying drift that starts at any time, explains
    /// significantly more of the differences between block means than in a random walk. With
    /// `beside_ramp`, a linear drift is removed first.
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
                let own = if beside_ramp { square - sum * sum / n } else { square };
                // A linear drift was removed already.
                if own > 1e-6 * square {
                    share = share.max(product * product / own);
                }
            }
        }
        share > CHANCE / libm::sqrt(n) * squares
    }
}
