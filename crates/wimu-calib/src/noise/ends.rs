//! Detection of clipped output.

/// Smallest number of samples at an extreme value.
const FEWEST: u64 = 10;
/// Clipping thresholds: ratio of the number of samples at the extreme value to that at the next
/// one, or their difference in standard deviations.
const PER_NEXT: u64 = 3;
const DEVIATIONS: u64 = 5;
/// Smallest noise for the test, quantisation steps.
const LEAST_STEPS: f64 = 1.0;

/// Whether an output is clipped: `at_end` samples at rest have the highest or lowest value, `next`
/// the adjacent one, and the noise is `noise_steps` quantisation steps, 1 σ. False for coarser
/// outputs, where the test does not apply.
///
/// ```
/// // 40 of the samples read 32767, two 32766; the noise is 20 counts.
/// assert!(wimu_calib::is_clipped(40, 2, 20.0));
/// assert!(!wimu_calib::is_clipped(1, 2, 20.0));
/// ```
pub fn is_clipped(at_end: u64, next: u64, noise_steps: f64) -> bool {
    let more = at_end.saturating_sub(next);
    let chance = DEVIATIONS * DEVIATIONS * at_end.saturating_add(next);
    let is_no_chance = at_end / PER_NEXT >= next || more.saturating_mul(more) > chance;
    at_end >= FEWEST && is_no_chance && noise_steps > LEAST_STEPS
}

/// The highest value, and the negated lowest, of X, Y, Z.
#[derive(Clone, Debug)]
pub(super) struct Ends([[End; 2]; 3]);

/// The extreme value and the adjacent one, with their numbers of samples.
#[derive(Clone, Copy, Debug)]
struct End {
    at: f64,
    samples: u64,
    next: f64,
    next_samples: u64,
}

impl Ends {
    pub(super) fn new() -> Self {
        let none = f64::NEG_INFINITY;
        let end = End { at: none, samples: 0, next: none, next_samples: 0 };
        Self([[end; 2]; 3])
    }

    pub(super) fn take(&mut self, output: [f64; 3]) {
        for ([high, low], value) in self.0.iter_mut().zip(output) {
            high.take(value);
            low.take(0.0 - value);
        }
    }

    /// Number of clipped samples of an axis, for noise in quantisation steps.
    pub(super) fn clipped(&self, axis: usize, noise_steps: f64) -> u64 {
        let ends = self.0.get(axis).into_iter().flatten();
        ends.filter(|end| is_clipped(end.samples, end.next_samples, noise_steps))
            .map(|end| end.samples)
            .sum()
    }
}

impl End {
    fn take(&mut self, value: f64) {
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
}
