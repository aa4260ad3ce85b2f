//! Whether the output ends where the sensor's range does, and not where the noise does.

use crate::Scalar;

/// Fewer samples at the very end are no sign.
const FEWEST: u64 = 20;
/// A tail of noise falls: more samples at the very end than next to it are no chance beyond so many standard
/// deviations of both.
const DEVIATIONS: u64 = 5;

/// The highest and the lowest output, negated, of X, Y, Z.
#[derive(Clone, Debug)]
pub(super) struct Ends<R>([[End<R>; 2]; 3]);

/// The end value and the one next to it, and how often each came.
#[derive(Clone, Copy, Debug)]
struct End<R> {
    at: R,
    samples: u64,
    next: R,
    next_samples: u64,
}

impl<R: Scalar> Ends<R> {
    pub(super) fn new() -> Self {
        let none = R::of(f64::NEG_INFINITY);
        let end = End {
            at: none,
            samples: 0,
            next: none,
            next_samples: 0,
        };
        Self([[end; 2]; 3])
    }

    pub(super) fn take(&mut self, output: [R; 3]) {
        for ([high, low], value) in self.0.iter_mut().zip(output) {
            high.take(value);
            low.take(R::default() - value);
        }
    }

    /// Samples at the ends of an axis that no noise puts there.
    pub(super) fn clipped(&self, axis: usize) -> u64 {
        let ends = self.0.get(axis).into_iter().flatten();
        ends.map(End::clipped).sum()
    }
}

impl<R: Scalar> End<R> {
    fn take(&mut self, value: R) {
        if value > self.at {
            (self.next, self.next_samples) = (self.at, self.samples);
            (self.at, self.samples) = (value, 1);
        } else if value == self.at {
            self.samples += 1;
        } else if value > self.next {
            (self.next, self.next_samples) = (value, 1);
        } else if value == self.next {
            self.next_samples += 1;
        }
    }

    fn clipped(&self) -> u64 {
        let more = self.samples.saturating_sub(self.next_samples);
        let chance = DEVIATIONS * DEVIATIONS * (self.samples + self.next_samples);
        let is_no_chance = more.saturating_mul(more) > chance;
        if self.samples >= FEWEST && is_no_chance {
            self.samples
        } else {
            0
        }
    }
}
