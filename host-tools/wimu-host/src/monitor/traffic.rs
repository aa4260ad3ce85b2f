//! Rate, loss and latency of a link.

use std::collections::VecDeque;

use serde::Serialize;
use wimu_model::DeviceTimeUs;

use crate::clock::ClockModel;
use crate::decode::{Arrival, Event};
use crate::live::LinkUpdate;

/// Span of rates and latencies, ns.
const SPAN_NS: u64 = 5_000_000_000;
/// Largest error of a clock model by half a round trip, ms. Chosen.
const CLOCK_ERROR_MS: f64 = 10.0;
/// Most samples of a link whose latency is kept.
const LATENCIES: usize = 4096;

/// A link of the board.
#[derive(Clone, Debug, Default, Serialize)]
pub struct LinkHealth {
    /// Its role.
    pub name: String,
    /// Why it is lost at present.
    pub lost: Option<String>,
    /// The warning that its data are not authentic.
    pub unverified: Option<String>,
    /// Samples received per second.
    pub rate_hz: f64,
    /// Fraction of the samples that did not arrive.
    pub loss: f64,
    /// Median and largest latency of the latest samples, ms; `None` before the clock is known.
    pub latency_ms: Option<[f64; 2]>,
    /// Data rate, kB/s.
    pub kilobytes_s: f64,
    /// Damaged frames since the start.
    pub frames_damaged: u64,
}

/// Traffic of a link within [`SPAN_NS`].
#[derive(Debug, Default)]
pub struct Traffic {
    clock: Option<ClockModel>,
    /// Host time, ns, samples and bytes since the last entry.
    received: VecDeque<(u64, u64, u64)>,
    before: (u64, u64),
    /// Host time, ns, and latency, ms.
    latencies: VecDeque<(u64, f64)>,
    lost: Option<String>,
    unverified: Option<String>,
    frames_damaged: u64,
    /// Samples received and missing since the start.
    counted: (u64, u64),
}

impl Traffic {
    /// Takes what the link has received.
    pub fn take(&mut self, heard: &LinkUpdate) {
        self.clock = heard.clock.clone().or(self.clock.take());
        for arrival in &heard.arrivals {
            self.note(arrival);
        }
        let raw = heard.statistics.raw;
        let of_stream = if raw.received > 0 { raw } else { heard.statistics.corrected };
        if let Some(last) = heard.arrivals.last() {
            self.count(last.host_ns, of_stream.received, heard.statistics.bytes);
        }
        self.lost = heard.lost.as_ref().map(|error| error.text.clone());
        self.unverified = heard.authentication.findings().last().map(|found| found.to_string());
        self.frames_damaged = heard.statistics.frames_damaged;
        self.counted = (of_stream.received, of_stream.missing);
    }

    /// Latency of samples.
    fn note(&mut self, arrival: &Arrival) {
        if let (Event::Samples(samples), Some(clock)) = (&arrival.event, &self.clock)
            && let Some(last) = samples.iter().last()
        {
            let ms = clock.delay_ns(DeviceTimeUs(last.time.0), arrival.host_ns) as f64 * 1e-6;
            self.latencies.push_back((arrival.host_ns, ms));
        }
        // The device's clock begins again.
        if matches!(arrival.event, Event::Restart { .. }) {
            self.clock = None;
            self.latencies.clear();
        }
        let is_old = |(at, _): &(u64, f64)| at + SPAN_NS < arrival.host_ns;
        while self.latencies.len() > LATENCIES || self.latencies.front().is_some_and(is_old) {
            self.latencies.pop_front();
        }
    }

    /// Takes the samples and bytes received so far.
    fn count(&mut self, host_ns: u64, samples: u64, bytes: u64) {
        let before = std::mem::replace(&mut self.before, (samples, bytes));
        let since = |now: u64, before: u64| now.saturating_sub(before);
        self.received.push_back((host_ns, since(samples, before.0), since(bytes, before.1)));
        while self.received.front().is_some_and(|(at, ..)| at + SPAN_NS < host_ns) {
            self.received.pop_front();
        }
    }

    /// Brings a link up to date.
    pub fn show(&self, link: &mut LinkHealth) {
        link.lost = self.lost.clone();
        link.unverified = self.unverified.clone();
        link.frames_damaged = self.frames_damaged;
        let (received, missing) = self.counted;
        link.loss = missing as f64 / (received + missing).max(1) as f64;
        if let (Some((first, ..)), Some((last, ..))) = (self.received.front(), self.received.back())
        {
            let span_s = last.saturating_sub(*first).max(1) as f64 * 1e-9;
            // What the first entry counts arrived before the span.
            let sums = self.received.iter().skip(1);
            let (samples, bytes) =
                sums.fold((0, 0), |sum, entry| (sum.0 + entry.1, sum.1 + entry.2));
            link.rate_hz = samples as f64 / span_s;
            link.kilobytes_s = bytes as f64 / span_s / 1e3;
        }
        let mut sorted: Vec<f64> = self.latencies.iter().map(|(_, ms)| *ms).collect();
        sorted.sort_by(f64::total_cmp);
        let latency = sorted.last().map(|most| [sorted[sorted.len() / 2], *most]);
        // A clock model that gives negative latencies does not hold.
        link.latency_ms = latency.filter(|[median, _]| *median > -CLOCK_ERROR_MS);
    }
}
