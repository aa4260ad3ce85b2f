//! Error of values that are assigned to their time of arrival.

use std::collections::VecDeque;

use nalgebra::Vector3;
use serde::Serialize;

use crate::series::{Flags, Interp, Ns, Series};

/// Error of resampling by the time of arrival, m/s² rms, equation (64); resampling by device time has none.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct ByArrival {
    /// As samples arrive.
    pub rms_mps2: f64,
    /// With the median latency until then subtracted: the effect of jitter alone.
    pub rms_without_latency_mps2: f64,
}

/// The values of one link resampled by the time of arrival, against the values at
/// the true times: equation (64).
#[derive(Debug, Default)]
pub(super) struct ArrivalUser {
    /// Values by time of arrival, from the one at or before the oldest true time on.
    points: Series<Vector3<f64>>,
    /// True times and values to compare.
    waiting: VecDeque<(Ns, Vector3<f64>)>,
    squares: f64,
    count: u64,
}

/// Largest number of values that wait: more than a link delays.
const MAX_HELD: usize = 1 << 16;
/// Number of values from which on old ones are forgotten.
const CHUNK: usize = 1 << 10;

impl ArrivalUser {
    /// Ends the sequence.
    pub fn restart(&mut self) {
        self.points = Series::default();
        self.waiting.clear();
    }

    /// Takes a sample of `value`, m/s², with its true time and the time of its arrival.
    pub fn take(&mut self, taken: Ns, arrived: Ns, value: [f64; 3]) {
        let value = Vector3::from(value);
        self.waiting.push_back((taken, value));
        // Times of arrival are made monotonic.
        let last = self.points.t.last().map_or(Ns(i64::MIN), |last| Ns(last.0 + 1));
        let now = arrived.max(last);
        self.points.push(now, value, Flags::NONE);
        while let Some(&(taken, truth)) = self.waiting.front()
            && taken <= now
        {
            self.waiting.pop_front();
            if let Some(at) = self.points.at(taken, Interp::Linear) {
                self.squares += (at.value - truth).norm_squared();
                self.count += 1;
            }
        }
        if self.points.len() > CHUNK {
            let oldest = self.waiting.front().map_or(now, |(taken, _)| *taken);
            let needed = self.points.latest(oldest).map_or(self.points.t[0], |k| self.points.t[k]);
            self.points.forget_before(needed, 2);
        }
        let old = self.waiting.len().saturating_sub(MAX_HELD);
        self.waiting.drain(..old);
    }

    /// RMS of the three axes together, m/s².
    pub fn rms_mps2(&self) -> f64 {
        (self.squares / self.count.max(1) as f64).sqrt()
    }
}
