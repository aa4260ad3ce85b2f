//! A device's clock by the host's: equations (60) to (63).
//!
//! A transfer arrives late, never early. So the least delays, not the mean ones, show how the two
//! clocks differ: a line under them gives the rate. What it leaves open is how long the fastest
//! transfer took. Questions that the device answers with its own time bound that from both sides;
//! the middle is right if both directions take equally long, and no measurement over the link
//! alone can tell whether they do. So a [`ClockModel`] gives three things: the middle, the
//! standard deviation that delays leave it, and the bounds that hold whatever the directions take.

use std::collections::{HashMap, VecDeque};
use std::time::Duration;

use serde::Serialize;
use wimu_link::batch::Stream;
use wimu_link::message::{Answer, Payload, Request};
use wimu_link::{Deframer, Kind, LinkRole, MAX_FRAME, Reply};
use wimu_model::DeviceTimeUs;

use crate::decode::{Arrival, Event};

mod envelope;
mod pace;

use envelope::{Class, Folded, Transfer};

pub use pace::{Pace, Trip};

/// Device time of a block of transfers, s.
const BLOCK_S: f64 = 64.0;
/// Transfers of a block at most; a busier link has shorter blocks.
const BLOCK_TRANSFERS: usize = 16_384;
/// Blocks on either side of the one for which a line is fitted: oscillators wander.
const REACH: usize = 4;
/// Lines kept: three days of blocks. Beyond, every second is left out.
const MAX_LINES: usize = 4096;
/// No host tells when bytes came better than this, ns.
const HOST_SD_NS: f64 = 50_000.0;
/// Delays that look the same to this, ns, may drift by it over the time that they are looked at.
const LEAST_ERROR_NS: f64 = 20_000.0;
/// No question is answered sooner than it was asked, but for what the clocks drift meanwhile, ns.
const RESTART_NS: f64 = 0.5e9;
/// What arrives sooner behind what came before may have been held up by it, ns.
const BEHIND_NS: u64 = 3_000_000;
/// Questions that may wait for their answer.
const MAX_ASKED: usize = 256;
/// How much longer than its answer a question may be, or shorter, bytes.
const MAX_UNEQUAL_BYTES: usize = 6;
/// Below this span the rate is not estimated, s.
const MIN_SPAN_S: f64 = 5.0;
/// How far a clock may be off whose rate was not estimated, ppm.
const UNKNOWN_RATE_PPM: f64 = 10_000.0;
/// What links tell about a device's clock between one start of the device and the next: give it
/// one link for that link's own view, or both for the best. Memory does not grow with time.
#[derive(Clone, Debug, Default)]
pub struct ClockEstimator {
    /// Device time, µs, and host time, ns, of the first transfer.
    origin: Option<(u64, u64)>,
    open: Vec<Transfer>,
    closed: VecDeque<Folded>,
    lines: Vec<Line>,
    /// Index of the first block that has no line yet, among the closed ones.
    next_line: usize,
    /// The questions that wait for their answers, by session and number.
    asked: HashMap<(u32, u32), Asked>,
    /// When the latest was sent, by session.
    sent: HashMap<u32, u64>,
    /// When the latest of anything came, by link: to the host, and questions to the device; ns.
    latest: [Latest; envelope::LINKS],
    /// Host time less device time of the latest samples, ns.
    newest: Option<f64>,
    /// Length of the latest question on each link, and how often it has changed.
    question: [(usize, u32); envelope::LINKS],
    transfers: u64,
    exchanges: u64,
}

/// A question that waits for its answer.
#[derive(Clone, Copy, Debug)]
struct Asked {
    /// When it was sent, ns.
    at_ns: u64,
    /// Its length, bytes.
    length: usize,
    /// Whether it was sent right behind another.
    is_behind: bool,
}

/// When the latest of anything came over a link, ns.
#[derive(Clone, Copy, Debug, Default)]
struct Latest {
    /// To the host, its clock.
    heard_ns: Option<u64>,
    /// From when on the device can send something else that does not go with it, its clock.
    said_ns: Option<u64>,
    /// The least time from an answer's first byte to its last.
    answer_takes_ns: Option<u64>,
    /// Of the questions to the device, its clock.
    question_ns: Option<u64>,
}

/// Host time − device time around a moment.
#[derive(Clone, Copy, Debug)]
struct Line {
    /// The moment: device time since the origin, s.
    x: f64,
    /// Difference at the moment, ns.
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
    /// Knows nothing yet.
    pub fn new() -> Self {
        Self::default()
    }

    /// Takes what has arrived on the link of `role`: batches of samples, and answers to questions that
    /// [`asked`](Self::asked) knows: how long both took then.
    pub fn heard(&mut self, role: LinkRole, arrival: &Arrival) -> Option<Trip> {
        let link = usize::from(role != LinkRole::Cable);
        let before = self.latest[link].heard_ns.replace(arrival.host_ns);
        let heard_alone = alone_for(before, arrival.began_ns);
        let takes = arrival.host_ns.saturating_sub(arrival.began_ns);
        // How long it was alone, given when the device said it.
        let mut alone_at = |time: DeviceTimeUs| {
            let time_ns = time.0.saturating_mul(1000);
            let before = self.latest[link]
                .said_ns
                .replace(time_ns.saturating_add(takes));
            match before {
                Some(before) if time_ns < before.saturating_add(BEHIND_NS) => f64::NEG_INFINITY,
                _ => heard_alone,
            }
        };
        match &arrival.event {
            Event::Samples(samples) => {
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
                let Asked {
                    at_ns: asked_ns,
                    length,
                    is_behind,
                } = self.asked.remove(&(reply.session, reply.id))?;
                let answer_length = wire_length(reply);
                let longer = length.max(answer_length);
                // So many bytes take on the line, from the first on; more where the answer came in parts.
                let bytes_take = |bytes: usize| {
                    takes.saturating_mul(bytes as u64)
                        / answer_length.saturating_sub(1).max(1) as u64
                };
                let trip = Trip {
                    whole: Duration::from_nanos(arrival.host_ns.checked_sub(asked_ns)?),
                    on_line: (alone >= 0.0).then_some(Duration::from_nanos(bytes_take(longer))),
                };
                // Asked later than the device says that it answered, by all that came before: it has
                // started anew.
                let difference = self.difference(DeviceTimeUs(uptime_us), asked_ns);
                if self
                    .newest
                    .is_some_and(|newest| difference > newest + RESTART_NS)
                {
                    return Some(trip);
                }
                // Of unequal lengths, the directions take unequally long.
                if length.abs_diff(answer_length) > MAX_UNEQUAL_BYTES {
                    return Some(trip);
                }
                // The shorter one is taken as if it were as long as the other.
                let asked_ns = asked_ns.saturating_sub(bytes_take(longer - length));
                let answered_ns = arrival
                    .host_ns
                    .saturating_add(bytes_take(longer - answer_length));
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
                let question_alone = match is_behind {
                    true => f64::NEG_INFINITY,
                    false => alone_for(before, uptime_ns),
                };
                self.exchanges += 1;
                self.transfer(link, question, time, asked_ns, question_alone);
                // Where it took longer than others it came in parts, if not with the beginning of an
                // answer before it whose rest was lost: they look alike.
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

    /// Takes what the host sent at `host_ns`, whole frames, on any link. Questions count that are as
    /// long as their answers, filled up with zeros: they take as long on the line. Only the first of equal questions counts:
    /// the device heard none before it.
    pub fn asked(&mut self, host_ns: u64, bytes: &[u8]) {
        for question in requests(bytes) {
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

    /// Transfers taken so far.
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

    /// One transfer: what the device timed at `time` arrived, or for a question was sent, at
    /// `host_ns`. It could have come by so much earlier, ns, and would still have come by itself; if
    /// negative, later; −∞ if it was sent right behind another.
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
        let full = self
            .open
            .first()
            .is_some_and(|first| transfer.x - first.x >= BLOCK_S);
        if full || self.open.len() >= BLOCK_TRANSFERS {
            self.close();
        }
        self.transfers += 1;
        self.open.push(transfer);
    }

    fn close(&mut self) {
        self.closed
            .extend(Folded::new(&self.open).map(Folded::reduced));
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
            let mut even = false;
            self.lines.retain(|_| {
                even = !even;
                even
            });
        }
    }

    /// The clock as far as it is known; `None` before anything has arrived.
    pub fn model(&self) -> Option<ClockModel> {
        let origin = self.origin?;
        let open = Folded::new(&self.open);
        let blocks: Vec<_> = self.closed.iter().chain(&open).collect();
        let mut lines = self.lines.clone();
        // A few blocks are one line.
        let rest = if blocks.len() <= REACH + 1 && lines.is_empty() {
            0..1
        } else {
            self.next_line..blocks.len()
        };
        lines.extend(rest.filter_map(|index| line(&blocks, index)));
        if lines.is_empty() {
            return None;
        }
        Some(ClockModel {
            origin,
            lines,
            transfers: self.transfers,
            exchanges: self.exchanges,
        })
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
    // No oscillator runs off so far: the device's time is simulated, or there is too little of it.
    let known = span >= MIN_SPAN_S && free.rate.abs() < 0.99 * envelope::MAX_RATE;
    let fit = if known {
        free
    } else {
        envelope::fit(near, x, Some(0.0))?
    };
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

/// By how much earlier something could have come behind what came before, ns, and would not have
/// been held up by it.
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

/// The requests in what a host sends: session and number.
fn requests(bytes: &[u8]) -> Vec<(u32, u32)> {
    let mut deframer = Deframer::new();
    let mut found = Vec::new();
    for &byte in bytes {
        if let Some(Ok(frame)) = deframer.push(byte)
            && frame.kind == Kind::Request
            && let Ok(request) = Request::decode(frame.body)
        {
            found.push((request.session, request.id));
        }
    }
    found
}

/// Device time to host time, between one start of a device and the next.
#[derive(Clone, Debug)]
pub struct ClockModel {
    origin: (u64, u64),
    /// By time, at least one; between two, both count by nearness.
    lines: Vec<Line>,
    transfers: u64,
    exchanges: u64,
}

/// A clock in numbers.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct ClockSummary {
    /// How many ppm more host time passes than device time: positive for a slow device.
    pub rate_ppm: f64,
    /// Its standard deviation.
    pub rate_sd_ppm: f64,
    /// Standard deviation of device time in host time, if both directions take equally long, ms.
    pub offset_sd_ms: f64,
    /// Whatever the directions take, the offset is wrong by no more than this, ms; two standard
    /// deviations at least. Absent where no question was answered: then times are late by what the
    /// fastest transfer took.
    pub offset_bound_ms: Option<f64>,
    /// Transfers used.
    pub transfers: u64,
    /// Questions answered.
    pub exchanges: u64,
}

impl ClockModel {
    /// Host time of a device time, ns on the host's monotonic clock. Wraps for a device that ran
    /// before the host's clock began; [`ClockAnchor::to_utc_ns`](crate::mcap_file::ClockAnchor::to_utc_ns)
    /// undoes that.
    pub fn host_ns(&self, time: DeviceTimeUs) -> u64 {
        let (origin_us, origin_ns) = self.origin;
        let passed_us = time.0.wrapping_sub(origin_us) as i64;
        let difference = self.blend(time, Line::at).round() as i64;
        origin_ns
            .wrapping_add_signed(passed_us.wrapping_mul(1000))
            .wrapping_add_signed(difference)
    }

    /// How long after `time` something was at `host_ns`, ns; negative only by the model's error.
    pub fn delay_ns(&self, time: DeviceTimeUs, host_ns: u64) -> i64 {
        host_ns.wrapping_sub(self.host_ns(time)) as i64
    }

    /// Standard deviation of [`host_ns`](Self::host_ns), ns, if both directions take equally long.
    pub fn sd_ns(&self, time: DeviceTimeUs) -> f64 {
        self.blend(time, Line::sd_at)
    }

    /// How far the true host time may lie before and behind [`host_ns`](Self::host_ns), ns,
    /// whatever the directions take; `None` before, where no question was answered.
    pub fn bounds_ns(&self, time: DeviceTimeUs) -> (Option<f64>, f64) {
        let line = self.lines[self.place(time).0];
        (line.lower.map(|lower| line.y - lower), line.upper - line.y)
    }

    /// How many ppm more host time passes than device time, over all, and its standard deviation.
    pub fn rate_ppm(&self) -> (f64, f64) {
        match self.lines.as_slice() {
            [first, .., last] => {
                let span = last.x - first.x;
                let sd = first.y_sd.hypot(last.y_sd) / span;
                (
                    (last.y - first.y) / span * 1e-3,
                    sd.min(first.rate_sd) * 1e-3,
                )
            }
            [only] => (only.rate * 1e-3, only.rate_sd * 1e-3),
            [] => (0.0, UNKNOWN_RATE_PPM),
        }
    }

    /// The clock in numbers, uncertainties at its middle.
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

    /// Index of the line before a time, and how much the next one counts.
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

#[cfg(test)]
mod tests;
