//! Quantiles of durations in fixed memory.

use serde::Serialize;

/// Bins per factor of e: quantiles are exact to 1 %.
const BINS_PER_E: f64 = 50.0;
/// Upper end of the first bin, ns.
const LEAST_NS: f64 = 1_000.0;
/// Up to 11 days.
const BINS: usize = 1385;

/// Histogram of durations.
#[derive(Clone, Debug)]
pub(super) struct Durations {
    bins: Vec<u64>,
    count: u64,
    max_ns: i64,
}

/// Quantiles of durations, ms.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Quantiles {
    /// Median.
    pub median_ms: f64,
    /// 95 % quantile.
    pub p95_ms: f64,
    /// 99 % quantile.
    pub p99_ms: f64,
    /// Maximum.
    pub max_ms: f64,
}

impl Default for Durations {
    fn default() -> Self {
        Self { bins: vec![0; BINS], count: 0, max_ns: 0 }
    }
}

impl Durations {
    /// Adds a duration; a negative one, which is an error of the clock, counts as the shortest.
    pub fn push(&mut self, ns: i64) {
        let place = (ns.max(1) as f64 / LEAST_NS).ln().max(0.0) * BINS_PER_E;
        self.bins[(place as usize).min(BINS - 1)] += 1;
        self.count += 1;
        self.max_ns = self.max_ns.max(ns);
    }

    pub fn count(&self) -> u64 {
        self.count
    }

    /// The duration below which the fraction `share` of all are, ns.
    pub fn quantile_ns(&self, share: f64) -> f64 {
        let wanted = (share * self.count as f64).ceil().max(1.0) as u64;
        let mut below = 0;
        for (bin, count) in self.bins.iter().enumerate() {
            below += count;
            if below >= wanted {
                let middle = LEAST_NS * ((bin as f64 + 0.5) / BINS_PER_E).exp();
                return middle.min(self.max_ns as f64);
            }
        }
        0.0
    }

    pub fn summary(&self) -> Quantiles {
        Quantiles {
            median_ms: self.quantile_ns(0.5) * 1e-6,
            p95_ms: self.quantile_ns(0.95) * 1e-6,
            p99_ms: self.quantile_ns(0.99) * 1e-6,
            max_ms: self.max_ns as f64 * 1e-6,
        }
    }
}
