//! Error of values that are assigned to their time of arrival.

use std::collections::VecDeque;

use serde::Serialize;

/// Error of resampling by the time of arrival, m/s² rms, equation (64); resampling by device time has none.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct ByArrival {
    /// As samples arrive.
    pub rms_mps2: f64,
    /// With the median latency subtracted: the effect of jitter alone.
    pub rms_without_latency_mps2: f64,
}

/// The values of one link resampled by the time of arrival, against the values at
/// the true times: equation (64).
#[derive(Debug, Default)]
pub(super) struct ArrivalUser {
    /// Subtracted from the times of arrival, ns.
    latency_ns: f64,
    /// Values by time of arrival, from the one at or before the oldest true time on.
    points: VecDeque<(i64, [f64; 3])>,
    /// True times and values to compare.
    waiting: VecDeque<(i64, [f64; 3])>,
    squares: f64,
    count: u64,
}

/// Largest number of values held: more than a link delays.
const MAX_HELD: usize = 1 << 16;

impl ArrivalUser {
    pub fn new(latency_ns: f64) -> Self {
        Self { latency_ns, ..Self::default() }
    }

    /// Ends the sequence.
    pub fn restart(&mut self) {
        self.points.clear();
        self.waiting.clear();
    }

    /// Takes a sample of `value`, m/s², taken at `true_ns`, that arrived at `arrived_ns`.
    pub fn take(&mut self, true_ns: u64, arrived_ns: u64, value: [f64; 3]) {
        self.waiting.push_back((true_ns as i64, value));
        let time = (arrived_ns as i64).wrapping_sub(self.latency_ns as i64);
        // Times of arrival are made monotonic.
        let time = self.points.back().map_or(time, |(last, _)| time.max(*last));
        self.points.push_back((time, value));
        while let Some(&(true_ns, truth)) = self.waiting.front() {
            if true_ns > time {
                break;
            }
            self.waiting.pop_front();
            while self.points.get(1).is_some_and(|(next, _)| *next <= true_ns) {
                self.points.pop_front();
            }
            let (Some(&(before, from)), Some(&(next, to))) =
                (self.points.front(), self.points.get(1))
            else {
                continue;
            };
            if before > true_ns {
                continue;
            }
            let share = (true_ns - before) as f64 / (next - before) as f64;
            for axis in 0..3 {
                let seen = from[axis] + share * (to[axis] - from[axis]);
                self.squares += (seen - truth[axis]).powi(2);
            }
            self.count += 1;
        }
        while self.waiting.len() > MAX_HELD {
            self.waiting.pop_front();
        }
        while self.points.len() > MAX_HELD {
            self.points.pop_front();
        }
    }

    /// RMS of the three axes together, m/s².
    pub fn rms_mps2(&self) -> f64 {
        (self.squares / self.count.max(1) as f64).sqrt()
    }
}
