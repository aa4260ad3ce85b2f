//! One direction of a link, with its faults.

use std::collections::VecDeque;

use super::truth::{Fate, FaultCounts, FrameTruth};
use super::values::ValueChanger;
use super::{DEFAULT_BUFFER, Jitter, LinkFaults, nanoseconds};
use crate::random::Random;

/// Largest number of bytes with the same jitter: a radio sends a packet when it is full or the line pauses.
const PACKET: u64 = 64;
const PAUSE_NS: u64 = 3_000_000;
/// Longest splice, bytes.
const LONGEST_SPLICE: u64 = 64;
/// Longest duplicate, bytes, and that of one in sixteen, as of an overrun ring buffer.
const LONGEST_DUPLICATE: u64 = 256;
const LONGEST_LAP: u64 = 4096;
/// Bytes remembered for both.
const HISTORY: usize = LONGEST_LAP as usize;

/// Stream numbers of the random generators.
const LOSSES: u64 = 64;
const FLIPS: u64 = 65;
const SPLICES: u64 = 66;
const DUPLICATES: u64 = 67;
const DELAYS: u64 = 68;
const VALUES: u64 = 69;

/// Carries bytes in one direction of a link with its faults. Times are ns since
/// the simulation's start and never decrease; bytes keep their order.
#[derive(Debug)]
pub struct Channel {
    faults: LinkFaults,
    values: Option<ValueChanger>,
    losses: Runs,
    flips: Events,
    splices: Events,
    duplicates: Events,
    delays: Random,
    packet: Packet,
    /// Number of bytes that entered so far.
    place: u64,
    /// The latest time at which a byte reaches the receiver.
    latest_ns: u64,
    /// When each byte reaches the receiver.
    under_way: VecDeque<(u64, u8)>,
    /// The latest bytes that left.
    history: VecDeque<u8>,
    /// Whether the last byte that left was a zero, or none has left.
    at_end_of_frame: bool,
    frame: FrameUnderWay,
    counts: FaultCounts,
    log: Option<Vec<FrameTruth>>,
}

/// A packet of the radio.
#[derive(Debug, Default)]
struct Packet {
    number: u64,
    bytes: u64,
    /// Time of its latest byte.
    latest_ns: u64,
    jitter_ns: u64,
}

/// The current frame of the sender.
#[derive(Debug, Default)]
struct FrameUnderWay {
    bytes: Vec<u8>,
    length: u64,
    delivered: u64,
    changed: bool,
    opened: bool,
    last_delivered_ns: Option<u64>,
}

impl Channel {
    /// A channel with these faults; the same seed has the same effect on the same bytes.
    pub fn new(faults: &LinkFaults, seed: u64) -> Self {
        Self {
            values: faults
                .values
                .map(|values| ValueChanger::new(values, Random::new(seed, VALUES))),
            losses: Runs::new(faults, Random::new(seed, LOSSES)),
            flips: Events::new(faults.bit_error_rate, Random::new(seed, FLIPS)),
            splices: Events::new(faults.splice_rate, Random::new(seed, SPLICES)),
            duplicates: Events::new(faults.duplicate_rate, Random::new(seed, DUPLICATES)),
            delays: Random::new(seed, DELAYS),
            packet: Packet::default(),
            place: 0,
            latest_ns: 0,
            under_way: VecDeque::new(),
            history: VecDeque::new(),
            at_end_of_frame: true,
            frame: FrameUnderWay::default(),
            counts: FaultCounts::default(),
            log: None,
            faults: faults.clone(),
        }
    }

    /// Does not change values: for the direction from host to device.
    #[must_use]
    pub fn without_values(mut self) -> Self {
        self.values = None;
        self
    }

    /// Keeps every frame until [`take_frames`](Self::take_frames).
    pub fn log_frames(&mut self) {
        self.log.get_or_insert_default();
    }

    /// The kept frames since the last call, in order.
    pub fn take_frames(&mut self) -> Vec<FrameTruth> {
        self.log.as_mut().map(std::mem::take).unwrap_or_default()
    }

    /// Its faults.
    pub fn faults(&self) -> &LinkFaults {
        &self.faults
    }

    /// Statistics of the faults.
    pub fn counts(&self) -> FaultCounts {
        self.counts
    }

    /// Free bytes of its buffer.
    pub fn room(&self) -> usize {
        let holds = self.faults.buffer.unwrap_or(DEFAULT_BUFFER);
        holds.saturating_sub(self.under_way.len())
    }

    /// Takes bytes that left the sender's line at `now_ns`.
    ///
    /// With changed values a frame is held until its last byte.
    pub fn push(&mut self, now_ns: u64, bytes: &[u8]) {
        let Some(mut values) = self.values.take() else {
            for &byte in bytes {
                self.push_byte(now_ns, byte);
            }
            return;
        };
        for &byte in bytes {
            for &byte in values.push(byte) {
                self.push_byte(now_ns, byte);
            }
        }
        self.values = Some(values);
    }

    /// The bytes that have arrived by `now_ns`, `most` at most.
    pub fn pull(&mut self, now_ns: u64, most: usize) -> Vec<u8> {
        let due = self.under_way.iter().take(most);
        let count = due.take_while(|(due_ns, _)| *due_ns <= now_ns).count();
        let due = self.under_way.drain(..count);
        due.map(|(_, byte)| byte).collect()
    }

    /// When the next byte arrives, ns.
    pub fn next_arrival_ns(&self) -> Option<u64> {
        self.under_way.front().map(|(due_ns, _)| *due_ns)
    }

    /// Number of lost connections by `now_ns`; `None` while there is none.
    pub fn connection(&self, now_ns: u64) -> Option<u64> {
        let mut lost = 0;
        for outage in &self.faults.disconnects {
            if outage.end_at(now_ns).is_some() {
                return None;
            }
            let [start, length] = [outage.start, outage.length].map(nanoseconds);
            lost += match outage.every.map(nanoseconds) {
                _ if now_ns < start + length => 0,
                None | Some(0) => 1,
                Some(every) => (now_ns - start) / every + 1,
            };
        }
        Some(lost)
    }

    /// Drops bytes under way: the sender has lost its power.
    pub fn clear(&mut self) {
        self.counts.bytes_delivered -= self.under_way.len() as u64;
        self.under_way.clear();
        self.frame = FrameUnderWay::default();
    }

    fn push_byte(&mut self, now_ns: u64, byte: u8) {
        let place = self.place;
        self.place += 1;
        self.counts.bytes_sent += 1;
        if let Some(draw) = self.splices.at(place) {
            let length = 1 + draw % LONGEST_SPLICE;
            let start = (draw >> 16) as usize % HISTORY;
            let piece: Vec<u8> = self.history.iter().skip(start).copied().collect();
            let length = piece.len().min(length as usize);
            self.counts.bytes_spliced += length as u64;
            self.insert(now_ns, &piece[..length]);
        }
        if self.frame.length == 0 {
            self.frame.opened = self.at_end_of_frame;
        }
        self.frame.length += 1;
        if self.log.is_some() {
            self.frame.bytes.push(byte);
        }
        self.frame.last_delivered_ns = None;
        if self.losses.at(place) {
            self.counts.bytes_lost += 1;
        } else {
            let mut received = byte;
            while let Some(bit) = self.flips.within(8 * place, 8) {
                received ^= 1 << bit;
                self.counts.bits_flipped += 1;
            }
            if let Some(due_ns) = self.deliver(now_ns, received) {
                self.frame.delivered += 1;
                self.frame.changed |= received != byte;
                self.frame.last_delivered_ns = Some(due_ns);
            }
        }
        if byte == 0 {
            self.end_frame(now_ns);
        }
        if let Some(draw) = self.duplicates.at(place) {
            let longest =
                if (draw >> 32).is_multiple_of(16) { LONGEST_LAP } else { LONGEST_DUPLICATE };
            let length = (1 + draw % longest) as usize;
            let skipped = self.history.len().saturating_sub(length);
            let piece: Vec<u8> = self.history.iter().skip(skipped).copied().collect();
            self.counts.bytes_duplicated += piece.len() as u64;
            self.insert(now_ns, &piece);
        }
    }

    /// Delivers bytes that the sender did not send here.
    fn insert(&mut self, now_ns: u64, piece: &[u8]) {
        for &byte in piece {
            self.deliver(now_ns, byte);
        }
        self.frame.changed |= !piece.is_empty() && self.frame.length > 0;
    }

    /// Delivers one byte; returns its time of arrival, or `None` if it is lost.
    fn deliver(&mut self, now_ns: u64, byte: u8) -> Option<u64> {
        if self.room() == 0 {
            self.counts.bytes_overflowed += 1;
            return None;
        }
        let jitter_ns = self.jitter_ns(now_ns);
        let delayed = now_ns + nanoseconds(self.faults.latency) + jitter_ns;
        let mut due_ns = delayed.max(self.latest_ns);
        // A stall may end in another one; endless sequences are given up.
        for _ in 0..1000 {
            let stalls = self.faults.stalls.iter();
            let Some(end_ns) = stalls.filter_map(|stall| stall.end_at(due_ns)).max() else {
                break;
            };
            due_ns = end_ns;
        }
        let cut = |outage: &super::Outage| {
            outage.at_or_after(now_ns).is_some_and(|(begin, _)| begin <= due_ns)
        };
        if self.faults.disconnects.iter().any(cut) {
            self.counts.bytes_disconnected += 1;
            return None;
        }
        self.latest_ns = due_ns;
        self.under_way.push_back((due_ns, byte));
        self.counts.bytes_delivered += 1;
        self.at_end_of_frame = byte == 0;
        if self.faults.splice_rate > 0.0 || self.faults.duplicate_rate > 0.0 {
            if self.history.len() == HISTORY {
                self.history.pop_front();
            }
            self.history.push_back(byte);
        }
        Some(due_ns)
    }

    fn jitter_ns(&mut self, now_ns: u64) -> u64 {
        let Packet { bytes, latest_ns, .. } = self.packet;
        if bytes == 0 || bytes == PACKET || now_ns > latest_ns + PAUSE_NS {
            self.packet.number += 1;
            self.packet.bytes = 0;
            self.packet.jitter_ns = self.draw_jitter_ns(self.packet.number);
        }
        self.packet.bytes += 1;
        self.packet.latest_ns = now_ns;
        self.packet.jitter_ns
    }

    fn draw_jitter_ns(&self, packet: u64) -> u64 {
        let draw = || self.delays.unit(packet);
        match self.faults.jitter {
            None => 0,
            Some(Jitter::Uniform(most)) => (draw() * nanoseconds(most) as f64) as u64,
            Some(Jitter::Exponential(mean)) => {
                (-libm::log(draw()) * nanoseconds(mean) as f64) as u64
            }
        }
    }

    fn end_frame(&mut self, now_ns: u64) {
        let frame = std::mem::take(&mut self.frame);
        // A zero alone only wakes the line.
        if frame.length < 2 {
            return;
        }
        let fate = match frame {
            FrameUnderWay { delivered: 0, .. } => Fate::Lost,
            _ if frame.delivered < frame.length || frame.changed => Fate::Damaged,
            _ if !frame.opened => Fate::Fused,
            _ => Fate::Intact,
        };
        let counts = &mut self.counts;
        *match fate {
            Fate::Intact => &mut counts.frames_intact,
            Fate::Fused => &mut counts.frames_fused,
            Fate::Damaged => &mut counts.frames_damaged,
            Fate::Lost => &mut counts.frames_lost,
        } += 1;
        if let Some(log) = &mut self.log {
            log.push(FrameTruth {
                bytes: frame.bytes,
                sent_ns: now_ns,
                delivered_ns: frame.last_delivered_ns,
                fate,
            });
        }
    }
}

/// Events at random positions with constant probability.
#[derive(Debug)]
struct Events {
    random: Random,
    rate: f64,
    next: Option<u64>,
    drawn: u64,
}

impl Events {
    fn new(rate: f64, random: Random) -> Self {
        let mut events = Self { random, rate, next: None, drawn: 0 };
        events.advance(0);
        events
    }

    fn draw(&mut self) -> f64 {
        self.drawn += 1;
        self.random.unit(self.drawn)
    }

    /// Draws the next position, from `start` on.
    fn advance(&mut self, start: u64) {
        self.next = (self.rate > 0.0).then(|| {
            let draw = self.draw();
            start.saturating_add(run_length(draw, self.rate) - 1)
        });
    }

    /// A random number for the kind of the event at `place`, if there is one. Positions are queried in order.
    fn at(&mut self, place: u64) -> Option<u64> {
        (self.next == Some(place)).then(|| {
            self.advance(place + 1);
            (self.draw() * 4e15) as u64
        })
    }

    /// Distance from `start` to the next event, if below `count`.
    fn within(&mut self, start: u64, count: u64) -> Option<u64> {
        // Skip events of lost bytes.
        while self.next.is_some_and(|next| next < start) {
            let next = self.next.unwrap_or(start);
            self.advance(next + 1);
        }
        let next = self.next.filter(|next| *next < start + count)?;
        self.advance(next + 1);
        Some(next - start)
    }
}

/// The two states of [`Loss`](super::Loss), in turn.
#[derive(Debug)]
struct Runs {
    random: Random,
    /// Probabilities per byte that the good state ends, and the bad one.
    ends: Option<[f64; 2]>,
    bad: bool,
    /// Position at which the state ends.
    until: u64,
    drawn: u64,
}

impl Runs {
    fn new(faults: &LinkFaults, random: Random) -> Self {
        let ends = faults.loss.filter(|loss| loss.fraction > 0.0).map(|loss| {
            let bad_ends = 1.0 / loss.mean_run;
            [bad_ends * loss.fraction / (1.0 - loss.fraction), bad_ends]
        });
        let mut runs = Self { random, ends, bad: true, until: 0, drawn: 0 };
        runs.turn();
        runs
    }

    fn turn(&mut self) {
        self.bad = !self.bad;
        let Some(ends) = self.ends else {
            self.until = u64::MAX;
            return;
        };
        self.drawn += 1;
        let draw = self.random.unit(self.drawn);
        let length = run_length(draw, ends[usize::from(self.bad)]);
        self.until = self.until.saturating_add(length);
    }

    /// Whether the byte at `place` is lost. Positions are queried in order, from 0.
    fn at(&mut self, place: u64) -> bool {
        while self.until <= place {
            self.turn();
        }
        self.bad
    }
}

/// Number of trials up to the first success of probability `p`, 0 < p ≤ 1, by a uniform draw from
/// (0, 1]: 1 or more.
fn run_length(draw: f64, p: f64) -> u64 {
    if p >= 1.0 {
        return 1;
    }
    // Saturates for a very small p.
    ((libm::log(draw) / libm::log1p(-p)) as u64).saturating_add(1)
}
