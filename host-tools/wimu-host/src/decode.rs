//! Decoding of one link's bytes into typed events: frames, complete sequence numbers, loss statistics.

use std::cmp::Ordering;

use wimu_link::auth::DeviceKey;
use wimu_link::batch;
use wimu_link::message::{Attitude, Environment, Epoch, Navigation};
use wimu_link::{Batch, Deframer, FrameError, Hello};
use wimu_model::{DeviceTimeUs, PeriodNs};

mod anchor;
mod batches;
mod event;
mod gaps;
mod message;
mod order;
mod repeats;
mod start;
mod tags;

pub use event::{Arrival, Event, LinkStatistics, Samples, StreamStatistics, TimedSample};
pub use tags::{Authenticity, Interval};

use anchor::Anchor;
use message::{Message, read};
use order::{Moment, Place, Verdict};
use repeats::Repeats;
use start::{Held, Start};
use tags::Verifier;

/// Largest lead of an epoch over a greeting after it, µs: its first sample is still to come.
const EXPECTED_US: u64 = 1_000_000;
/// Order of two sequence numbers that are less than 2³¹ samples apart: they wrap at 2³².
pub(crate) fn sequence_order(a: u32, b: u32) -> Ordering {
    (a.wrapping_sub(b) as i32).cmp(&0)
}

/// Times of arrival of a frame's last and first bytes.
#[derive(Clone, Copy, Debug)]
struct Received {
    host_ns: u64,
    began_ns: u64,
}

impl Received {
    fn at(self, time: DeviceTimeUs) -> Moment {
        Moment { host_ns: self.host_ns, time_us: time.0.min(i64::MAX as u64) }
    }

    fn with(self, event: Event) -> Arrival {
        Arrival { host_ns: self.host_ns, began_ns: self.began_ns, event }
    }
}

/// Decodes the bytes of one link into events.
///
/// Sample numbers and times are short on the wire; epochs complete them. Batches before the first
/// epoch, or after a gap that makes them ambiguous, wait for one.
///
/// ```
/// use wimu_host::decode::{Decoder, Event};
/// use wimu_link::hello::{Hello, LinkRole};
/// use wimu_link::MAX_FRAME;
///
/// let mut frame = [0; MAX_FRAME];
/// let length = Hello::new(LinkRole::Cable).encode(&mut frame)?;
///
/// let mut decoder = Decoder::new();
/// let mut seen = 0;
/// decoder.push(1_000, &frame[..length], |arrival| {
///     assert!(matches!(arrival.event, Event::Hello(hello) if hello.role == LinkRole::Cable));
///     seen += 1;
/// });
/// assert_eq!(seen, 1);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug, Default)]
pub struct Decoder {
    deframer: Deframer,
    statistics: LinkStatistics,
    start: Start,
    /// Whether an undamaged frame has arrived since reception began.
    listening: bool,
    /// When the current frame began to arrive.
    began_ns: Option<u64>,
    /// Batches handed on, of this start and the one before.
    repeats: Repeats,
    /// Device id and boot count, of this start and the one before.
    identity: Option<(u64, u32)>,
    identity_before: Option<(u64, u32)>,
    foreign_version: Option<u8>,
    latest_version: Option<u8>,
    verifier: Verifier,
}

impl Decoder {
    /// A decoder at any position in a stream.
    pub fn new() -> Self {
        Self::default()
    }

    /// Verifies tags with these keys, from the next one on.
    pub fn use_keys(&mut self, keys: Vec<DeviceKey>) {
        self.verifier.set_keys(keys);
    }

    /// Takes bytes that arrived at `host_ns`, ns on the host's monotonic clock; calls `each` for
    /// every completed event. Accepts any bytes.
    pub fn push(&mut self, host_ns: u64, bytes: &[u8], mut each: impl FnMut(Arrival)) {
        self.statistics.bytes += bytes.len() as u64;
        let mut rest = bytes;
        while let Some(result) = self.deframer.next(&mut rest) {
            let received = Received { host_ns, began_ns: self.began_ns.take().unwrap_or(host_ns) };
            let event = match result {
                // The most frequent kind: not moved as a message.
                Ok(frame) if frame.kind.is_batch() => {
                    self.statistics.frames += 1;
                    self.listening = true;
                    self.verifier.take(host_ns, &frame);
                    match Batch::decode(frame.kind, frame.body) {
                        Ok(batch) => {
                            self.take_batch(received, &batch, &mut each);
                            continue;
                        }
                        Err(why) => {
                            self.statistics.frames_unreadable += 1;
                            Message::Event(Event::Unreadable(why.to_string()))
                        }
                    }
                }
                Ok(frame) => {
                    self.statistics.frames += 1;
                    self.listening = true;
                    self.latest_version = Some(frame.version);
                    let message = read(&frame);
                    if !matches!(message, Ok(Message::Tag(_))) {
                        self.verifier.take(host_ns, &frame);
                    }
                    match message {
                        Ok(message) => message,
                        Err(why) => {
                            self.statistics.frames_unreadable += 1;
                            Message::Event(Event::Unreadable(why))
                        }
                    }
                }
                Err(error) => {
                    if let FrameError::UnknownVersion { version, .. } = error {
                        self.foreign_version = Some(version);
                    }
                    if !error.is_damage() {
                        self.statistics.frames_unreadable += 1;
                    } else if self.listening {
                        self.statistics.frames_damaged += 1;
                    }
                    Message::Event(Event::Damaged(error))
                }
            };
            match event {
                Message::Hello(hello) => {
                    self.verifier.greet(&hello);
                    self.take_hello(received, hello, &mut each);
                }
                Message::Tag(tag) => {
                    if let Some(interval) = self.verifier.judge(host_ns, &tag) {
                        each(received.with(Event::Tagged(interval)));
                    }
                }
                Message::Epoch(epoch) => self.take_epoch(received, epoch, &mut each),
                Message::Event(event) if self.start.order.holds() && event.is_of_a_start() => {
                    self.start.order.hold((received, Held::Event(Box::new(event))));
                }
                Message::Event(event) => self.take_event(received, event, &mut each),
            }
        }
        if bytes.last().is_some_and(|&byte| byte != 0) {
            self.began_ns.get_or_insert(host_ns);
        }
    }

    /// The link was lost: later data do not continue earlier ones.
    pub fn interrupt(&mut self) {
        self.deframer = Deframer::default();
        self.listening = false;
        self.began_ns = None;
        self.verifier.interrupt();
        // A reopened link does not repeat earlier data.
        self.repeats = Repeats::default();
        self.statistics.interruptions += 1;
    }

    /// A part of the link's data is unknown: it is not counted as missing or damaged.
    pub fn skip(&mut self) {
        self.deframer = Deframer::default();
        self.listening = false;
        self.began_ns = None;
        self.verifier.interrupt();
        for track in &mut self.start.tracks {
            track.skipped = [true; 2];
        }
    }

    /// Statistics of the link.
    pub fn statistics(&self) -> LinkStatistics {
        let held = self.start.order.held().iter();
        let held = held.filter(|(_, held)| matches!(held, Held::Batch(_)));
        let waiting = self.start.unplaced() + held.count();
        LinkStatistics {
            batches_unplaced: self.statistics.batches_unplaced + waiting as u64,
            ..self.statistics
        }
    }

    /// Whether the device may have restarted: arrivals are held until it is decided. A greeting
    /// decides at once.
    pub fn is_in_doubt(&self) -> bool {
        self.start.order.is_in_doubt()
    }

    /// The wire version of the latest undamaged frame that is of another version than ours.
    pub fn foreign_version(&self) -> Option<u8> {
        self.foreign_version
    }

    /// The wire version of the latest readable frame other than batches: of recordings, 1 too.
    pub fn latest_version(&self) -> Option<u8> {
        self.latest_version
    }

    /// The device has restarted before the held data. If its greeting has the time of the restart, older
    /// data are treated as delayed.
    fn restart(
        &mut self,
        received: Received,
        greeting: Option<&Hello>,
        each: &mut impl FnMut(Arrival),
    ) {
        let boot_count = greeting.map(|hello| hello.boot_count);
        let uptime_us = greeting.map(|hello| hello.uptime_us);
        let is_older = |(_, held): &mut (Received, Held)| {
            let Some(uptime_us) = uptime_us else {
                return false;
            };
            let time_us = match held {
                Held::Epoch(epoch) => epoch.time_us,
                Held::Batch(batch) => {
                    batch::extend_time(batch.time_low(), DeviceTimeUs(uptime_us)).0
                }
                Held::Event(_) => return false,
            };
            time_us > uptime_us.saturating_add(EXPECTED_US)
        };
        let mut held = self.start.order.release();
        let older: Vec<_> = held.extract_if(.., is_older).collect();
        for (received, held) in older {
            if let Held::Batch(batch) = held {
                self.take_late(received, &batch, each);
            }
        }
        self.repeats.restart();
        self.statistics.batches_unplaced += self.start.unplaced() as u64;
        self.start = Start::default();
        let first = held.first().map_or(received, |(first, _)| *first);
        each(first.with(Event::Restart { boot_count }));
        for (received, held) in held {
            match held {
                Held::Epoch(epoch) => self.take_epoch(received, *epoch, each),
                Held::Batch(batch) => self.take_batch(received, &batch, each),
                Held::Event(event) => self.take_event(received, *event, each),
            }
        }
    }

    /// What is held was delayed, and the present start continues.
    fn go_on(&mut self, each: &mut impl FnMut(Arrival)) {
        for (received, held) in self.start.order.release() {
            match held {
                // A later epoch has replaced it.
                Held::Epoch(_) => {}
                Held::Batch(batch) => self.take_late(received, &batch, each),
                Held::Event(event) => self.take_event(received, *event, each),
            }
        }
    }

    /// Hands on an event: each reading once, and none that the device cannot have sent yet.
    fn take_event(&mut self, received: Received, event: Event, each: &mut impl FnMut(Arrival)) {
        let possible = self.start.tracks[0].anchors[0].is_none_or(|anchor| {
            let by_us = anchor.latest_us(received.host_ns);
            match &event {
                Event::Environment(reading) => reading.time_us <= by_us,
                Event::Navigation(reading) => anchor.reaches(reading.sequence, by_us),
                Event::Attitude(reading) => anchor.reaches(reading.sequence, by_us),
                _ => true,
            }
        });
        if !possible {
            self.statistics.frames_rejected += 1;
            return;
        }
        let is_new = match &event {
            Event::Environment(Environment { time_us, .. }) => {
                is_later(&mut self.start.last_environment, *time_us, |a, b| a.cmp(&b))
            }
            Event::Navigation(Navigation { sequence, .. }) => {
                is_later(&mut self.start.last_navigation, *sequence, sequence_order)
            }
            Event::Attitude(Attitude { sequence, .. }) => {
                is_later(&mut self.start.last_attitude, *sequence, sequence_order)
            }
            _ => true,
        };
        if is_new {
            each(received.with(event));
        } else {
            self.statistics.readings_repeated += 1;
        }
    }

    fn take_hello(&mut self, received: Received, hello: Hello, each: &mut impl FnMut(Arrival)) {
        let identity = (hello.device_id, hello.boot_count);
        let is_new = match self.identity {
            Some(known) => known != identity && self.identity_before != Some(identity),
            // The present start has not been greeted: its time decides whether this is it.
            None => {
                let latest_us = self.start.order.latest_us();
                latest_us.is_some_and(|latest| hello.uptime_us.saturating_add(EXPECTED_US) < latest)
            }
        };
        if is_new {
            self.identity_before = self.identity;
            self.identity = Some(identity);
            self.restart(received, Some(&hello), each);
        }
        let goes_on = self.start.order.latest_us() <= Some(hello.uptime_us);
        if goes_on && self.start.order.is_in_doubt() && self.identity == Some(identity) {
            self.go_on(each);
        }
        self.identity.get_or_insert(identity);
        each(received.with(Event::Hello(hello)));
    }

    fn take_epoch(&mut self, received: Received, epoch: Epoch, each: &mut impl FnMut(Arrival)) {
        let time = DeviceTimeUs(epoch.time_us);
        let anchor = Anchor {
            sequence: epoch.sequence,
            time,
            period: PeriodNs(epoch.period_ns),
            host_ns: received.host_ns,
        };
        let sensor = usize::from(epoch.sensor);
        let track = &mut self.start.tracks[sensor];
        let goes_on = track.anchors[0].is_none_or(|before| before.leads_to(&anchor));
        let jumped = track.jumped.take();
        if !goes_on && jumped.is_none_or(|jumped| time <= jumped.time || !jumped.leads_to(&anchor))
        {
            track.jumped = Some(anchor);
            self.statistics.frames_rejected += 1;
            return;
        }
        let place = match track.last_epoch_time {
            Some(last) if time < last => Place::Back,
            _ => Place::Ahead,
        };
        match self.start.order.judge(received.at(time), place) {
            Verdict::InOrder => {}
            Verdict::Late => return,
            Verdict::Hold => {
                let held = Held::Epoch(Box::new(epoch));
                return self.start.order.hold((received, held));
            }
            Verdict::HeldWasLate => self.go_on(each),
            Verdict::NewStart => {
                self.restart_unannounced(received, each);
                return self.take_epoch(received, epoch, each);
            }
        }
        if sensor == 0 {
            // No reading is that far ahead of an epoch: the latest one was invalid.
            let ahead_us = time.0.saturating_add(EXPECTED_US);
            let start = &mut self.start;
            start.last_environment.take_if(|latest| *latest > ahead_us);
            for last in [&mut start.last_navigation, &mut start.last_attitude] {
                last.take_if(|latest| {
                    sequence_order(*latest, epoch.sequence).is_gt()
                        && !anchor.reaches(*latest, ahead_us)
                });
            }
        }
        let track = &mut self.start.tracks[sensor];
        track.last_epoch_time = Some(time);
        track.anchors = [Some(anchor), track.anchors[0]];
        // An epoch repeated for a new listener has the number of the one before.
        let last = track.last_epoch_number.replace(epoch.number);
        let after_loss = last.is_some_and(|last| epoch.number.wrapping_sub(last) > 1);
        for (received, batch) in std::mem::take(&mut track.unplaced) {
            self.take_batch(received, &batch, each);
        }
        each(received.with(Event::Epoch { epoch, after_loss }));
    }

    /// The device has restarted, and its greeting has not arrived.
    fn restart_unannounced(&mut self, received: Received, each: &mut impl FnMut(Arrival)) {
        self.identity_before = self.identity.take();
        self.restart(received, None, each);
    }
}

/// Whether `now` is after `latest`; if so, replaces it.
fn is_later<T: Copy>(latest: &mut Option<T>, now: T, order: fn(T, T) -> Ordering) -> bool {
    let is_later = latest.is_none_or(|latest| order(now, latest).is_gt());
    if is_later {
        *latest = Some(now);
    }
    is_later
}
