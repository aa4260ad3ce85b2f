//! Missing samples that may still arrive.

use std::collections::VecDeque;

use super::event::{Samples, StreamStatistics};

/// Largest number of gaps of a stream kept for late samples.
const MAX_GAPS: usize = 256;

/// The latest gaps: first missing number, and first one after the gap.
#[derive(Debug, Default)]
pub(super) struct Gaps(VecDeque<(u32, u32)>);

impl Gaps {
    pub fn add(&mut self, from: u32, to: u32) {
        self.0.push_back((from, to));
        if self.0.len() > MAX_GAPS {
            self.0.pop_front();
        }
    }

    /// Counts the first `count` of `samples` as late or as duplicated; returns the late ones.
    pub fn take(
        &mut self,
        samples: &Samples,
        count: usize,
        statistics: &mut StreamStatistics,
    ) -> Vec<Samples> {
        let mut found: Vec<Samples> = Vec::new();
        let mut follows = false;
        for sample in samples.iter().take(count) {
            let number = sample.sequence;
            let gap = self
                .0
                .iter()
                .position(|(from, to)| number.wrapping_sub(*from) < to.wrapping_sub(*from));
            let Some(index) = gap else {
                statistics.duplicated += 1;
                follows = false;
                continue;
            };
            statistics.late += 1;
            statistics.missing = statistics.missing.saturating_sub(1);
            let (from, to) = self.0[index];
            self.0[index] = (number.wrapping_add(1), to);
            if from != number && self.0.len() < MAX_GAPS {
                self.0.insert(index, (from, number));
            }
            match found.last_mut().filter(|_| follows) {
                Some(run) => {
                    run.values.push(sample.value);
                    run.rates.extend(sample.rate);
                }
                None => found.push(Samples {
                    first_sequence: number,
                    first_time: sample.time,
                    values: vec![sample.value],
                    rates: sample.rate.into_iter().collect(),
                    ..*samples
                }),
            }
            follows = true;
        }
        found
    }
}
