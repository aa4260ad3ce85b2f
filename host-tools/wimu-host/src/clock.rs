//! Model of a device's clock relative to the host's: equations (60) to (63).
//!
//! Transfers are delayed, never early. Therefore the smallest delays, not their means, show the difference of the two
//! clocks: a line below them gives the rate. The duration of the fastest transfer remains unknown.
//! Time requests, which the device answers with its own time, bound it from both sides;
//! the middle is correct if both directions take equally long, which no measurement over the link
//! alone can verify. So a [`ClockModel`] contains three results: the middle, its
//! standard deviation because of the delays, and bounds for any asymmetry of the directions.

use std::collections::{HashMap, VecDeque};
use std::fmt;
use std::time::Duration;

use serde::Serialize;
use wimu_link::batch::Stream;
use wimu_link::message::{Answer, Payload};
use wimu_link::{LinkRole, MAX_FRAME, Reply};
use wimu_model::DeviceTimeUs;

use crate::client::requests_in;
use crate::decode::{Arrival, Event};
use crate::digits::{significant, with_sd};
use crate::series::thin_out;

mod envelope;
mod pace;

use envelope::{Class, Folded, Transfer};

pub use pace::{Pace, Trip};

/// Device time of a block of transfers, s.
const BLOCK_S: f64 = 64.0;
/// Transfers of a block at most; a busier link has shorter blocks.
const BLOCK_TRANSFERS: usize = 16_384;
/// Blocks on either side of the one for which a line is fitted: the rates of oscillators drift.
const REACH: usize = 4;
/// Largest number of lines: three days of blocks. Above, every second one is dropped.
const MAX_LINES: usize = 4096;
/// Smallest standard deviation of a time of arrival at a host, ns.
const HOST_SD_NS: f64 = 50_000.0;
/// Undetectable drift of the delays over the fitted span, ns.
const LEAST_ERROR_NS: f64 = 20_000.0;
/// A time request that appears to be answered this much before it was sent indicates a restart, ns: more than clock drift.
const RESTART_NS: f64 = 0.5e9;
/// Data that arrive within this after earlier data may have been delayed by them, ns.
const BEHIND_NS: u64 = 3_000_000;
/// Largest number of time requests that wait for their answer.
const MAX_ASKED: usize = 256;
/// Largest difference in length of a time request and its answer, bytes.
const MAX_UNEQUAL_BYTES: usize = 6;
/// Shortest span from which the rate is estimated, s.
const MIN_SPAN_S: f64 = 5.0;
/// Standard deviation of a rate that was not estimated, ppm.
const UNKNOWN_RATE_PPM: f64 = 10_000.0;

/// Estimator of a device's clock within one start of the device, from the data of one link or, for the best
/// estimate, of both. Memory does not grow with time.
#[derive(Clone, Debug, Default)]
pub struct ClockEstimator {
    /// Device time, µs, and host time, ns, of the first transfer.
    origin: Option<(u64, u64)>,
    open: Vec<Transfer>,
    closed: VecDeque<Folded>,
    lines: Vec<Line>,
    /// Index of the first block that has no line yet, among the closed ones.
    next_line: usize,
    /// Time requests that wait for their answers, by session and number.
    asked: HashMap<(u32, u32), Asked>,
    /// Time of the latest one, by session.
    sent: HashMap<u32, u64>,
    /// Times of the latest data, by link.
    latest: [Latest; envelope::LINKS],
    /// Host time less device time of the latest samples, ns.
    newest: Option<f64>,
    /// Length of the latest time request on each link, and how often it has changed.
    question: [(usize, u32); envelope::LINKS],
    transfers: u64,
    exchanges: u64,
}

/// A time request that waits for its answer.
#[derive(Clone, Copy, Debug)]
struct Asked {
    /// Time of sending, ns.
    at_ns: u64,
    /// Its length, bytes.
    length: usize,
    /// Whether it was sent immediately after another one.
    is_behind: bool,
}

/// Times of the latest data of a link, ns.
#[derive(Clone, Copy, Debug, Default)]
struct Latest {
    /// To the host, its clock.
    heard_ns: Option<u64>,
    /// Earliest time of later data that do not follow it immediately, device clock.
    said_ns: Option<u64>,
    /// Shortest time from an answer's first byte to its last.
    answer_takes_ns: Option<u64>,
    /// Time requests to the device, device clock.
    question_ns: Option<u64>,
}

/// Host time − device time around a point in time.
#[derive(Clone, Copy, Debug)]
struct Line {
    /// Point in time: device time since the origin, s.
    x: f64,
    /// Difference at that point, ns.
    y: f64,
    y_sd: f64,
    /// ns/s.
    rate: f64,
    rate_sd: f64,
    /// Of y and rate, ns²/s.
    covariance: f64,
    lower: Option<f64>,
    upper: f64,
}

impl Line {
    fn at(&self, x: f64) -> f64 {
        self.y + self.rate * (x - self.x)
    }

    fn sd_at(&self, x: f64) -> f64 {
        let away = x - self.x;
        let least = HOST_SD_NS * HOST_SD_NS;
        let both = 2.0 * self.covariance * away;
        let variance = self.y_sd.powi(2) + both + (self.rate_sd * away).powi(2);
        variance.max(least).sqrt()
    }
}

impl ClockEstimator {
    /// Before any data.
    pub fn new() -> Self {
        Self::default()
    }

    /// Takes an arrival on the link of `role`: batches of samples, and answers to time requests that were
    /// passed to [`asked`](Self::asked), for which it returns the duration of both.
    pub fn heard(&mut self, role: LinkRole, arrival: &Arrival) -> Option<Trip> {
        let link = usize::from(role != LinkRole::Cable);
        let before = self.latest[link].heard_ns.replace(arrival.host_ns);
        let heard_alone = alone_for(before, arrival.began_ns);
        let takes = arrival.host_ns.saturating_sub(arrival.began_ns);
        // Margin by which it was undelayed, given the device time of sending.
        let mut alone_at = |time: DeviceTimeUs| {
            let time_ns = time.0.saturating_mul(1000);
            let before = self.latest[link].said_ns.replace(time_ns.saturating_add(takes));
            match before {
                Some(before) if time_ns < before.saturating_add(BEHIND_NS) => f64::NEG_INFINITY,
                _ => heard_alone,
            }
        };
        match &arrival.event {
            Event::Samples(samples) if samples.sensor == 0 => {
                if let Some(last) = samples.iter().last() {
                    let class = match samples.stream {
                        Stream::Raw => Class::Raw,
                        Stream::Corrected => Class::Corrected,
                    };
                    let alone = alone_at(last.time);
                    self.newest = Some(self.difference(last.time, arrival.began_ns));
                    self.transfer(link, class, last.time, arrival.began_ns, alone);
                }
            }
            Event::Reply { reply, .. } => {
                let Answer::Accepted(Payload::Time { uptime_us }) = reply.answer else {
                    return None;
                };
                let alone = alone_at(DeviceTimeUs(uptime_us));
                let Asked { at_ns: asked_ns, length, is_behind } =
                    self.asked.remove(&(reply.session, reply.id))?;
                let answer_length = wire_length(reply);
                let longer = length.max(answer_length);
                // Time of that many bytes on the line; more where the answer arrived in parts.
                let bytes_take = |bytes: usize| {
                    takes.saturating_mul(bytes as u64)
                        / answer_length.saturating_sub(1).max(1) as u64
                };
                let trip = Trip {
                    whole: Duration::from_nanos(arrival.host_ns.checked_sub(asked_ns)?),
                    on_line: (alone >= 0.0).then_some(Duration::from_nanos(bytes_take(longer))),
                };
                // Sent later than it was answered, by the clock so far: the device has restarted.
                let difference = self.difference(DeviceTimeUs(uptime_us), asked_ns);
                if self.newest.is_some_and(|newest| difference > newest + RESTART_NS) {
                    return Some(trip);
                }
                // With unequal lengths the directions take unequally long.
                if length.abs_diff(answer_length) > MAX_UNEQUAL_BYTES {
                    return Some(trip);
                }
                // The shorter one is extended to the length of the other.
                let asked_ns = asked_ns.saturating_sub(bytes_take(longer - length));
                let answered_ns =
                    arrival.host_ns.saturating_add(bytes_take(longer - answer_length));
                let length = longer;
                let (known, changes) = &mut self.question[link];
                if *known != length {
                    *known = length;
                    *changes += 1;
                }
                let question = match *changes % 2 {
                    0 => Class::OtherQuestion,
                    _ => Class::Question,
                };
                let time = DeviceTimeUs(uptime_us);
                let uptime_ns = uptime_us.saturating_mul(1000);
                let before = self.latest[link].question_ns.replace(uptime_ns);
                let question_alone =
                    if is_behind { f64::NEG_INFINITY } else { alone_for(before, uptime_ns) };
                self.exchanges += 1;
                self.transfer(link, question, time, asked_ns, question_alone);
                // If it took longer than others, it arrived in parts, or began with a part of an
                // earlier answer whose rest was lost: both look alike.
                let least = &mut self.latest[link].answer_takes_ns;
                let takes_least = least.map_or(takes, |least| least.min(takes));
                *least = Some(takes_least);
                if takes <= takes_least + BEHIND_NS {
                    self.transfer(link, Class::AnswerBegins, time, arrival.began_ns, alone);
                }
                self.transfer(link, Class::Answer, time, answered_ns, alone);
                return Some(trip);
            }
            _ => {}
        }
        None
    }

    /// Takes complete frames that the host sent at `host_ns`, on any link. Time requests are used that are as
    /// long as their answers, padded with zeros, and take as long on the line. Only the first of equal requests is used:
    /// the device has received none before it.
    pub fn asked(&mut self, host_ns: u64, bytes: &[u8]) {
        for request in requests_in(bytes) {
            let question = (request.session, request.id);
            if self.asked.len() >= MAX_ASKED {
                self.asked.clear();
                self.sent.clear();
            }
            let before = self.sent.insert(question.0, host_ns);
            self.asked.entry(question).or_insert(Asked {
                at_ns: host_ns,
                length: bytes.len(),
                is_behind: before.is_some_and(|before| host_ns.abs_diff(before) < BEHIND_NS),
            });
        }
    }

    /// Number of transfers so far.
    pub fn transfers(&self) -> u64 {
        self.transfers
    }

    /// Host time less device time since the origin, ns; sets the origin if there is none.
    fn difference(&mut self, time: DeviceTimeUs, host_ns: u64) -> f64 {
        let (origin_us, origin_ns) = *self.origin.get_or_insert((time.0, host_ns));
        let device_us = time.0.wrapping_sub(origin_us) as i64;
        let host_ns = host_ns.wrapping_sub(origin_ns) as i64;
        host_ns.wrapping_sub(device_us.wrapping_mul(1000)) as f64
    }

    /// Adds a transfer of device time `time` that arrived, or for a time request was sent, at
    /// `host_ns`. `alone_ns` is the margin by which it could have been earlier without having been delayed by another
    /// transfer, ns; −∞ if it was sent immediately after another one.
    fn transfer(
        &mut self,
        link: usize,
        class: Class,
        time: DeviceTimeUs,
        host_ns: u64,
        alone_ns: f64,
    ) {
        let difference = self.difference(time, host_ns);
        let origin_us = self.origin.map_or(time.0, |(origin_us, _)| origin_us);
        let device_us = time.0.wrapping_sub(origin_us) as i64;
        let v = class.sign() * difference;
        let transfer = Transfer {
            link,
            class,
            x: device_us as f64 * 1e-6,
            v,
            free_from: v - alone_ns,
            index: 0,
        };
        let full = self.open.first().is_some_and(|first| transfer.x - first.x >= BLOCK_S);
        if full || self.open.len() >= BLOCK_TRANSFERS {
            self.close();
        }
        self.transfers += 1;
        self.open.push(transfer);
    }

    fn close(&mut self) {
        self.closed.extend(Folded::new(&self.open).map(Folded::reduced));
        self.open.clear();
        while self.closed.len() > self.next_line + REACH {
            let blocks: Vec<_> = self.closed.iter().collect();
            let line = line(&blocks, self.next_line);
            self.lines.extend(line);
            self.next_line += 1;
            if self.next_line > REACH {
                self.closed.pop_front();
                self.next_line -= 1;
            }
        }
        if self.lines.len() > MAX_LINES {
            thin_out(&mut self.lines);
        }
    }

    /// The model so far; `None` before any data.
    pub fn model(&self) -> Option<ClockModel> {
        let origin = self.origin?;
        let open = Folded::new(&self.open);
        let blocks: Vec<_> = self.closed.iter().chain(&open).collect();
        let mut lines = self.lines.clone();
        // Few blocks have one line in common.
        let rest = if blocks.len() <= REACH + 1 && lines.is_empty() {
            0..1
        } else {
            self.next_line..blocks.len()
        };
        lines.extend(rest.filter_map(|index| line(&blocks, index)));
        if lines.is_empty() {
            return None;
        }
        Some(ClockModel { origin, lines, transfers: self.transfers, exchanges: self.exchanges })
    }
}

/// The line for block `index`, from it and its neighbours.
fn line(blocks: &[&Folded], index: usize) -> Option<Line> {
    let near = &blocks[index.saturating_sub(REACH)..blocks.len().min(index + REACH + 1)];
    let (start, end) = if near.len() == blocks.len() {
        (blocks.first()?.span.0, blocks.last()?.span.1)
    } else {
        blocks[index].span
    };
    let x = 0.5 * (start + end);
    let span = near.last()?.span.1 - near.first()?.span.0;
    let free = envelope::fit(near, x, None)?;
    // No oscillator has this rate: the device time is simulated, or the span is too short.
    let known = span >= MIN_SPAN_S && free.rate.abs() < 0.99 * envelope::MAX_RATE;
    let fit = if known { free } else { envelope::fit(near, x, Some(0.0))? };
    let upper = fit.upper?;
    Some(Line {
        x,
        y: fit.middle,
        y_sd: fit.middle_variance.sqrt().hypot(HOST_SD_NS),
        rate: fit.rate,
        rate_sd: if known {
            fit.rate_variance.sqrt().hypot(LEAST_ERROR_NS / span)
        } else {
            UNKNOWN_RATE_PPM * 1e3
        },
        covariance: fit.covariance,
        lower: fit.lower,
        upper,
    })
}

/// By how much earlier data could have arrived without having been delayed by the data before them, ns; negative if
/// they may have been delayed.
fn alone_for(before_ns: Option<u64>, came_ns: u64) -> f64 {
    match before_ns {
        Some(before) => came_ns as f64 - before as f64 - BEHIND_NS as f64,
        None => f64::INFINITY,
    }
}

/// Length of a reply on the wire.
pub(crate) fn wire_length(reply: &Reply) -> usize {
    let mut frame = [0; MAX_FRAME];
    reply.encode(&mut frame).unwrap_or_default()
}

/// Conversion of device time to host time, within one start of a device.
#[derive(Clone, Debug)]
pub struct ClockModel {
    origin: (u64, u64),
    /// By time, at least one; between two lines, the result is interpolated.
    lines: Vec<Line>,
    transfers: u64,
    exchanges: u64,
}

/// Figures of a clock model.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct ClockSummary {
    /// Rate error, ppm: host time per device time less one; positive for a slow device clock.
    pub rate_ppm: f64,
    /// Its standard deviation.
    pub rate_sd_ppm: f64,
    /// Standard deviation of device time in host time, if both directions take equally long, ms.
    pub offset_sd_ms: f64,
    /// Bound of the offset error for any asymmetry of the directions, ms; at least two standard
    /// deviations. `None` without answered time requests: then times are delayed by the fastest transfer.
    pub offset_bound_ms: Option<f64>,
    /// Transfers used.
    pub transfers: u64,
    /// Answered time requests.
    pub exchanges: u64,
}

impl fmt::Display for ClockSummary {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let side = if self.rate_ppm > 0.0 { "slow" } else { "fast" };
        let rate = with_sd(self.rate_ppm.abs(), self.rate_sd_ppm);
        write!(out, "device clock {side} by {rate} ppm (1 σ); offset to host time ")?;
        let Some(bound) = self.offset_bound_ms else {
            return out.write_str("uncertain by the (unknown) minimum latency");
        };
        let sd = self.offset_sd_ms;
        write!(
            out,
            "± {} ms (1 σ) if both directions are equally fast, otherwise within {} ms",
            significant(sd, 2),
            significant(bound.max(2.0 * sd), 2)
        )
    }
}

impl ClockModel {
    /// Host time of a device time, ns on the host's monotonic clock. Wraps for a device that ran
    /// before the host's clock began; [`ClockAnchor::to_utc_ns`](crate::mcap_file::ClockAnchor::to_utc_ns)
    /// reverses that.
    pub fn host_ns(&self, time: DeviceTimeUs) -> u64 {
        let (origin_us, origin_ns) = self.origin;
        let passed_us = time.0.wrapping_sub(origin_us) as i64;
        let difference = self.blend(time, Line::at).round() as i64;
        origin_ns.wrapping_add_signed(passed_us.wrapping_mul(1000)).wrapping_add_signed(difference)
    }

    /// Delay from `time` to `host_ns`, ns; negative only by the model's error.
    pub fn delay_ns(&self, time: DeviceTimeUs, host_ns: u64) -> i64 {
        host_ns.wrapping_sub(self.host_ns(time)) as i64
    }

    /// Standard deviation of [`host_ns`](Self::host_ns), ns, if both directions take equally long.
    pub fn sd_ns(&self, time: DeviceTimeUs) -> f64 {
        self.blend(time, Line::sd_at)
    }

    /// Largest possible error of [`host_ns`](Self::host_ns) towards later and earlier times, ns, for any asymmetry of the
    /// directions; the first is `None` without answered time requests.
    pub fn bounds_ns(&self, time: DeviceTimeUs) -> (Option<f64>, f64) {
        let line = self.lines[self.place(time).0];
        (line.lower.map(|lower| line.y - lower), line.upper - line.y)
    }

    /// Mean rate error, ppm, as in [`ClockSummary::rate_ppm`], and its standard deviation.
    pub fn rate_ppm(&self) -> (f64, f64) {
        match self.lines.as_slice() {
            [first, .., last] => {
                let span = last.x - first.x;
                let sd = first.y_sd.hypot(last.y_sd) / span;
                ((last.y - first.y) / span * 1e-3, sd.min(first.rate_sd) * 1e-3)
            }
            [only] => (only.rate * 1e-3, only.rate_sd * 1e-3),
            [] => (0.0, UNKNOWN_RATE_PPM),
        }
    }

    /// Figures of the model; uncertainties are those at its middle.
    pub fn summary(&self) -> ClockSummary {
        let (rate_ppm, rate_sd_ppm) = self.rate_ppm();
        let middle = self.lines[self.lines.len() / 2];
        let least = 2.0 * middle.y_sd;
        ClockSummary {
            rate_ppm,
            rate_sd_ppm,
            offset_sd_ms: middle.y_sd * 1e-6,
            offset_bound_ms: middle
                .lower
                .map(|lower| (middle.y - lower).max(middle.upper - middle.y).max(least) * 1e-6),
            transfers: self.transfers,
            exchanges: self.exchanges,
        }
    }

    /// Index of the line before a time, and the weight of the next one.
    fn place(&self, time: DeviceTimeUs) -> (usize, f64) {
        let x = time.0.wrapping_sub(self.origin.0) as i64 as f64 * 1e-6;
        let next = self.lines.partition_point(|line| line.x <= x);
        match (next.checked_sub(1), self.lines.get(next)) {
            (Some(before), Some(line)) => {
                let from = self.lines[before].x;
                (before, (x - from) / (line.x - from))
            }
            (Some(last), None) => (last, 0.0),
            (None, _) => (0, 0.0),
        }
    }

    fn blend(&self, time: DeviceTimeUs, of: impl Fn(&Line, f64) -> f64) -> f64 {
        let x = time.0.wrapping_sub(self.origin.0) as i64 as f64 * 1e-6;
        let (before, share) = self.place(time);
        let value = of(&self.lines[before], x);
        match self.lines.get(before + 1) {
            Some(next) if share > 0.0 => (1.0 - share) * value + share * of(next, x),
            _ => value,
        }
    }
}
