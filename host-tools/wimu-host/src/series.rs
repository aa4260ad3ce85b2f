//! Samples of a sensor between its own times.

use crate::stats::median;

/// Four samples that are farther apart than this many periods have a gap between them.
const GAP_PERIODS: f64 = 5.0;

/// Keeps every second item, the first one too.
pub(crate) fn thin_out<T>(items: &mut Vec<T>) {
    let mut kept = [true, false].into_iter().cycle();
    items.retain(|_| kept.next() == Some(true));
}

/// Median time between samples, s.
pub(crate) fn period_s(times_s: &[f64]) -> f64 {
    let steps = times_s.windows(2).map(|w| w[1] - w[0]);
    median(steps).unwrap_or(1.0).max(1e-6)
}

/// One sensor's samples at its own times.
#[derive(Clone, Debug)]
pub(crate) struct Series {
    pub times_s: Vec<f64>,
    pub values: Vec<[f64; 3]>,
    /// Whether an axis was at its limit.
    pub saturated: Vec<bool>,
    pub period_s: f64,
}

impl Series {
    /// [`between`](Self::between) at times in ascending order.
    pub fn sampled(&self, times_s: &[f64]) -> impl Iterator<Item = ([f64; 3], f64, bool)> {
        let mut at = 0;
        times_s.iter().map(move |time| {
            while at + 1 < self.times_s.len() && self.times_s[at + 1] <= *time {
                at += 1;
            }
            self.between(at, *time)
        })
    }

    /// The value at `time`, which lies between samples `at` and `at + 1`: cubic through the four
    /// around; by how much the parabolas through three of them differ; and whether one was at its
    /// limit. Not a number next to a gap and at the ends.
    fn between(&self, at: usize, time: f64) -> ([f64; 3], f64, bool) {
        let nothing = ([f64::NAN; 3], 0.0, false);
        if self.times_s.get(at).is_some_and(|t| *t == time) {
            return (self.values[at], 0.0, self.saturated[at]);
        }
        let (Some(from), to) = (at.checked_sub(1), at + 3) else {
            return nothing;
        };
        let Some(times) = self.times_s.get(from..to) else {
            return nothing;
        };
        if time < times[1] || time > times[2] || times[3] - times[0] > GAP_PERIODS * self.period_s {
            return nothing;
        }
        let weights = |used: &[usize]| {
            let mut weights = [0.0; 4];
            for i in used {
                weights[*i] = used
                    .iter()
                    .filter(|j| *j != i)
                    .map(|j| (time - times[*j]) / (times[*i] - times[*j]))
                    .product();
            }
            weights
        };
        let values = &self.values[from..to];
        let sum = |weights: [f64; 4], axis: usize| -> f64 {
            weights.iter().zip(values).map(|(w, v)| w * v[axis]).sum()
        };
        let (all, left, right) = (weights(&[0, 1, 2, 3]), weights(&[0, 1, 2]), weights(&[1, 2, 3]));
        let doubt = (0..3).map(|a| (sum(left, a) - sum(right, a)).abs()).fold(0.0, f64::max);
        (
            std::array::from_fn(|axis| sum(all, axis)),
            doubt / 2.0,
            self.saturated[from..to].contains(&true),
        )
    }
}
