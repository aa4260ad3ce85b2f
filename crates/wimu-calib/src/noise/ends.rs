//! Whether the output ends where the sensor's range does, and not where the noise does.

/// Fewer samples at the very end are no sign.
const FEWEST: u64 = 10;
/// A tail of noise falls towards its end: so many times as many samples there as next to it are no chance, nor are so
/// many standard deviations more,
const PER_NEXT: u64 = 3;
const DEVIATIONS: u64 = 5;
/// where the noise is so many steps of the output or more.
const LEAST_STEPS: f64 = 1.0;

/// Whether an output stops at its limit: `at_end` samples at rest are at the highest or lowest value that there is,
/// `next` at the one beside it, and the noise is `noise_steps` steps of the output, 1 σ. Of coarser
/// outputs this tells nothing: false.
///
/// ```
/// // 40 of the samples read 32767, two 32766; the noise is 20 counts.
/// assert!(wimu_calib::stops_at_limit(40, 2, 20.0));
/// assert!(!wimu_calib::stops_at_limit(1, 2, 20.0));
/// ```
pub fn stops_at_limit(at_end: u64, next: u64, noise_steps: f64) -> bool {
    let more = at_end.saturating_sub(next);
    let chance = DEVIATIONS * DEVIATIONS * at_end.saturating_add(next);
    let is_no_chance = at_end / PER_NEXT >= next || more.saturating_mul(more) > chance;
    at_end >= FEWEST && is_no_chance && noise_steps > LEAST_STEPS
}

/// The highest and the lowest output, negated, of X, Y, Z.
#[derive(Clone, Debug)]
pub(super) struct Ends([[End; 2]; 3]);

/// The end value and the one next to it, and how often each came.
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
        let end = End {
            at: none,
            samples: 0,
            next: none,
            next_samples: 0,
        };
        Self([[end; 2]; 3])
    }

    pub(super) fn take(&mut self, output: [f64; 3]) {
        for ([high, low], value) in self.0.iter_mut().zip(output) {
            high.take(value);
            low.take(0.0 - value);
        }
    }

    /// Samples at the ends of an axis that no noise, of so many steps of the output, puts there.
    pub(super) fn clipped(&self, axis: usize, noise_steps: f64) -> u64 {
        let ends = self.0.get(axis).into_iter().flatten();
        ends.filter(|end| stops_at_limit(end.samples, end.next_samples, noise_steps))
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
