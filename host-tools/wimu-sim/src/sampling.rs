//! A sensor's own sample clock.

/// The sensor's own sample clock, in phase with when the rate was set: equation (36).
#[derive(Clone, Copy, Debug)]
pub(crate) struct SampleClock {
    start_ns: u64,
    period_ns: f64,
    taken: u64,
}

impl SampleClock {
    /// Ticks at nominally `rate_hz` from `now` (µs) on, with a period longer by `error_ppm`.
    pub(crate) fn new(rate_hz: f64, now: u64, error_ppm: f64) -> Self {
        Self { start_ns: now * 1000, period_ns: 1e9 / rate_hz * (1.0 + error_ppm * 1e-6), taken: 0 }
    }

    fn next_ns(&self) -> u64 {
        self.start_ns + libm::round((self.taken + 1) as f64 * self.period_ns) as u64
    }

    /// The µs at which the next sample can be seen.
    pub(crate) fn next_us(&self) -> u64 {
        self.next_ns().div_ceil(1000)
    }

    /// The instant of the next sample, s, if it is due by `now` (µs); it counts as taken then.
    pub(crate) fn take_due(&mut self, now: u64) -> Option<f64> {
        if self.next_us() > now {
            return None;
        }
        let time_s = self.next_ns() as f64 * 1e-9;
        self.taken += 1;
        Some(time_s)
    }
}
