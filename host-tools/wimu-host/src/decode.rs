//! The bytes of one link become typed events: frames assembled, short numbers completed, losses
//! counted.

use std::cmp::Ordering;
use std::collections::VecDeque;

use wimu_link::batch;
use wimu_link::message::{Environment, Epoch, Navigation};
use wimu_link::{Batch, Deframer, FrameError, Hello, Kind, Reply, Telemetry};
use wimu_model::{DeviceTimeUs, PeriodNs};

mod event;
mod gaps;
mod order;
mod repeats;

pub use event::{Arrival, Event, LinkStatistics, Samples, StreamStatistics, TimedSample};

use gaps::Gaps;
use order::{Moment, Order, Place, Verdict};
use repeats::Repeats;

/// Batches kept until an epoch tells where they belong: more than arrive in the second between
/// two epochs.
const MAX_UNPLACED: usize = 512;
/// How far a batch's time may be from what its sequence number says: a part of the time between,
/// for a sensor whose rate is off by 20 %, and some jitter, µs.
const PLACE_TOLERANCE_US: u64 = 250_000;
/// By how much an epoch may be ahead of a greeting that follows it: its first sample is expected, µs.
const EXPECTED_US: u64 = 1_000_000;
/// By how much a device time may be ahead of the latest one and the host time since, µs: the longest
/// stall of a link that loses what it held. Chosen: a Bluetooth link is given up after 30 s at most.
const MAX_AHEAD_US: u64 = 120_000_000;
/// Shortest sample period that is believed, ns: twice the rate of the fastest supported sensor
/// (LSM303AGR, 5376 Hz).
const MIN_PERIOD_NS: u32 = 93_000;

/// Order of two sequence numbers that are less than 2³¹ samples apart: they wrap at 2³².
pub(crate) fn sequence_order(a: u32, b: u32) -> Ordering {
    (a.wrapping_sub(b) as i32).cmp(&0)
}

/// Where a link's samples are: what completes short numbers.
#[derive(Clone, Copy, Debug)]
struct Anchor {
    sequence: u32,
    time: DeviceTimeUs,
    period: PeriodNs,
    /// When it arrived, ns of the host.
    host_ns: u64,
}

impl Anchor {
    /// Sequence number and time of a batch, if they agree.
    fn place(&self, batch: &Batch) -> Option<(u32, DeviceTimeUs)> {
        let sequence = batch::extend_sequence(batch.sequence_low(), self.sequence);
        let time = batch::extend_time(batch.time_low(), self.time);
        let samples = i64::from(sequence.wrapping_sub(self.sequence) as i32);
        let foretold_us = samples * i64::from(self.period.0) / 1000;
        let passed_us = time.0.wrapping_sub(self.time.0) as i64;
        let tolerance = PLACE_TOLERANCE_US + foretold_us.unsigned_abs() / 4;
        (foretold_us.abs_diff(passed_us) <= tolerance).then_some((sequence, time))
    }

    /// The latest device time that can arrive at `host_ns`, µs.
    fn latest_us(&self, host_ns: u64) -> u64 {
        let passed_us = host_ns.saturating_sub(self.host_ns) / 1000;
        let ahead_us = passed_us.saturating_add(MAX_AHEAD_US);
        self.time.0.saturating_add(ahead_us)
    }

    /// Whether the device can have taken a sample of this number by the device time `by_us`, at a
    /// rate that is up to 25 % off.
    fn reaches(&self, sequence: u32, by_us: u64) -> bool {
        let samples = sequence.wrapping_sub(self.sequence) as i32;
        let period_ns = self.period.0.max(MIN_PERIOD_NS);
        let foretold_us = u64::from(samples.unsigned_abs()) * u64::from(period_ns) / 1000;
        let passed_us = by_us.saturating_sub(self.time.0);
        foretold_us <= passed_us.saturating_add(passed_us / 4)
    }

    /// Whether the device can have sent `next` after this. Back in time, it may have started anew.
    fn leads_to(&self, next: &Self) -> bool {
        let period = PeriodNs(self.period.0.min(next.period.0));
        let by_us = next.time.0.saturating_add(MAX_AHEAD_US);
        let is_reached = Self { period, ..*self }.reaches(next.sequence, by_us);
        next.time <= self.time || (is_reached && next.time.0 <= self.latest_us(next.host_ns))
    }
}

/// When a frame's last and first bytes arrived.
#[derive(Clone, Copy, Debug)]
struct Received {
    host_ns: u64,
    began_ns: u64,
}

impl Received {
    fn at(self, time: DeviceTimeUs) -> Moment {
        Moment {
            host_ns: self.host_ns,
            time_us: time.0.min(i64::MAX as u64),
        }
    }

    fn with(self, event: Event) -> Arrival {
        Arrival {
            host_ns: self.host_ns,
            began_ns: self.began_ns,
            event,
        }
    }
}

/// Turns the bytes of one link into events.
///
/// Sample numbers and times are short on the wire; epochs complete them. Batches before the first
/// epoch, or after a silence that makes them ambiguous, wait for one.
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
#[derive(Debug)]
pub struct Decoder {
    deframer: Deframer,
    statistics: LinkStatistics,
    /// The latest and the one before: epochs may overtake samples.
    anchors: [Option<Anchor>; 2],
    /// The latest epoch, if it jumped: believed once the next goes on from it.
    jumped: Option<Anchor>,
    unplaced: VecDeque<(Received, Batch)>,
    /// Whether a frame has been read since listening began.
    listening: bool,
    /// When the frame under way began to arrive.
    began_ns: Option<u64>,
    /// The latest sequence number of raw and corrected samples, and the decimation.
    latest: [Option<(u32, u8)>; 2],
    /// The samples of each that are missing, as far as they may still come.
    gaps: [Gaps; 2],
    /// Whether what came before the next samples of each is unknown.
    skipped: [bool; 2],
    order: Order<(Received, Held)>,
    /// What has been handed on, of this start and those before.
    repeats: Repeats,
    /// Who the device is and which start this is, and what it was in the start before.
    identity: Option<(u64, u32)>,
    identity_before: Option<(u64, u32)>,
    last_epoch_time: Option<DeviceTimeUs>,
    last_epoch_number: Option<u8>,
    /// Time of the latest magnetic field and temperature, number of the latest position.
    last_environment: Option<u64>,
    last_navigation: Option<u32>,
    foreign_version: Option<u8>,
}

impl Default for Decoder {
    fn default() -> Self {
        Self::new()
    }
}

impl Decoder {
    /// A decoder at the start of a stream, or anywhere in it.
    pub fn new() -> Self {
        Self {
            deframer: Deframer::new(),
            statistics: LinkStatistics::default(),
            anchors: [None; 2],
            jumped: None,
            unplaced: VecDeque::new(),
            listening: false,
            began_ns: None,
            latest: [None; 2],
            gaps: Default::default(),
            skipped: [false; 2],
            order: Order::new(),
            repeats: Repeats::default(),
            identity: None,
            identity_before: None,
            last_epoch_time: None,
            last_epoch_number: None,
            last_environment: None,
            last_navigation: None,
            foreign_version: None,
        }
    }

    /// Takes bytes that arrived at `host_ns`, ns on the host's monotonic clock; calls `each` for
    /// every event that they complete. No bytes make it panic.
    pub fn push(&mut self, host_ns: u64, bytes: &[u8], mut each: impl FnMut(Arrival)) {
        self.statistics.bytes += bytes.len() as u64;
        let mut rest = bytes;
        while let Some(result) = self.deframer.next(&mut rest) {
            let received = Received {
                host_ns,
                began_ns: self.began_ns.take().unwrap_or(host_ns),
            };
            let event = match result {
                // By far the most frequent: not moved about as a message.
                Ok(frame) if frame.kind == Kind::Batch => {
                    self.statistics.frames += 1;
                    self.listening = true;
                    match Batch::decode(frame.body) {
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
                    match read(frame.kind, frame.body) {
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
                Message::Hello(hello) => self.take_hello(received, hello, &mut each),
                Message::Epoch(epoch) => self.take_epoch(received, epoch, &mut each),
                Message::Event(event) if self.order.holds() && event.is_of_a_start() => {
                    self.order.hold((received, Held::Event(Box::new(event))));
                }
                Message::Event(event) => self.take_event(received, event, &mut each),
            }
        }
        if bytes.last().is_some_and(|&byte| byte != 0) {
            self.began_ns.get_or_insert(host_ns);
        }
    }

    /// The link was lost: what comes next does not follow what came before.
    pub fn interrupt(&mut self) {
        self.deframer = Deframer::new();
        self.listening = false;
        self.began_ns = None;
        // A link that was opened anew repeats nothing of before.
        self.repeats = Repeats::default();
        self.statistics.interruptions += 1;
    }

    /// A part of what the link brought is not known here: what it held is not counted as missing or
    /// damaged.
    pub fn skip(&mut self) {
        self.deframer = Deframer::new();
        self.listening = false;
        self.began_ns = None;
        self.skipped = [true; 2];
    }

    /// What the link carried and lost so far.
    pub fn statistics(&self) -> LinkStatistics {
        let held = self.order.held().iter();
        let held = held.filter(|(_, held)| matches!(held, Held::Batch(_)));
        let waiting = self.unplaced.len() + held.count();
        LinkStatistics {
            batches_unplaced: self.statistics.batches_unplaced + waiting as u64,
            ..self.statistics
        }
    }

    /// Whether the device may have started anew: what arrives is held until it is known. A greeting
    /// tells at once.
    pub fn is_in_doubt(&self) -> bool {
        self.order.is_in_doubt()
    }

    /// The wire version of the latest undamaged frame that is of another version than ours.
    pub fn foreign_version(&self) -> Option<u8> {
        self.foreign_version
    }

    /// The device has started anew before what is held. Where its greeting tells how long ago, what
    /// is older is late.
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
        let mut held = self.order.release();
        let older: Vec<_> = held.extract_if(.., is_older).collect();
        for (received, held) in older {
            if let Held::Batch(batch) = held {
                self.take_late(received, &batch, each);
            }
        }
        self.repeats.restart();
        self.statistics.batches_unplaced += self.unplaced.len() as u64;
        self.unplaced.clear();
        self.anchors = [None; 2];
        self.jumped = None;
        self.latest = [None; 2];
        self.skipped = [false; 2];
        self.gaps = Default::default();
        self.order = Order::new();
        self.last_epoch_time = None;
        self.last_epoch_number = None;
        self.last_environment = None;
        self.last_navigation = None;
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

    /// What was held was late, and the start goes on.
    fn go_on(&mut self, each: &mut impl FnMut(Arrival)) {
        for (received, held) in self.order.release() {
            match held {
                // What it told has been told by a later one.
                Held::Epoch(_) => {}
                Held::Batch(batch) => self.take_late(received, &batch, each),
                Held::Event(event) => self.take_event(received, *event, each),
            }
        }
    }

    /// Hands on an event, a reading once and none that the device cannot have sent yet.
    fn take_event(&mut self, received: Received, event: Event, each: &mut impl FnMut(Arrival)) {
        let possible = self.anchors[0].is_none_or(|anchor| {
            let by_us = anchor.latest_us(received.host_ns);
            match &event {
                Event::Environment(reading) => reading.time_us <= by_us,
                Event::Navigation(reading) => anchor.reaches(reading.sequence, by_us),
                _ => true,
            }
        });
        if !possible {
            self.statistics.frames_rejected += 1;
            return;
        }
        let is_new = match &event {
            Event::Environment(Environment { time_us, .. }) => {
                is_later(&mut self.last_environment, *time_us, |a, b| a.cmp(&b))
            }
            Event::Navigation(Navigation { sequence, .. }) => {
                is_later(&mut self.last_navigation, *sequence, sequence_order)
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
            // A start that nobody greeted: whether it is this one, its time tells.
            None => {
                let latest_us = self.order.latest_us();
                latest_us.is_some_and(|latest| hello.uptime_us.saturating_add(EXPECTED_US) < latest)
            }
        };
        if is_new {
            self.identity_before = self.identity;
            self.identity = Some(identity);
            self.restart(received, Some(&hello), each);
        }
        let goes_on = self.order.latest_us() <= Some(hello.uptime_us);
        if goes_on && self.order.is_in_doubt() && self.identity == Some(identity) {
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
        let goes_on = self.anchors[0].is_none_or(|before| before.leads_to(&anchor));
        let jumped = self.jumped.take();
        if !goes_on && jumped.is_none_or(|jumped| time <= jumped.time || !jumped.leads_to(&anchor))
        {
            self.jumped = Some(anchor);
            self.statistics.frames_rejected += 1;
            return;
        }
        let place = match self.last_epoch_time {
            Some(last) if time < last => Place::Back,
            _ => Place::Ahead,
        };
        match self.order.judge(received.at(time), place) {
            Verdict::InOrder => {}
            Verdict::Late => return,
            Verdict::Hold => {
                let held = Held::Epoch(Box::new(epoch));
                return self.order.hold((received, held));
            }
            Verdict::HeldWasLate => self.go_on(each),
            Verdict::NewStart => {
                self.restart_unannounced(received, each);
                return self.take_epoch(received, epoch, each);
            }
        }
        self.last_epoch_time = Some(time);
        self.anchor(anchor);
        // No reading is that far ahead of an epoch: the latest was none of the device's.
        let ahead_us = time.0.saturating_add(EXPECTED_US);
        self.last_environment.take_if(|latest| *latest > ahead_us);
        self.last_navigation.take_if(|latest| {
            sequence_order(*latest, epoch.sequence).is_gt() && !anchor.reaches(*latest, ahead_us)
        });
        for (received, batch) in std::mem::take(&mut self.unplaced) {
            self.take_batch(received, &batch, each);
        }
        // One that was sent for a new listener has the number of the one before.
        let last = self.last_epoch_number.replace(epoch.number);
        let after_loss = last.is_some_and(|last| epoch.number.wrapping_sub(last) > 1);
        each(received.with(Event::Epoch { epoch, after_loss }));
    }

    /// The device has started anew, and its greeting has not arrived.
    fn restart_unannounced(&mut self, received: Received, each: &mut impl FnMut(Arrival)) {
        self.identity_before = self.identity.take();
        self.restart(received, None, each);
    }

    fn anchor(&mut self, anchor: Anchor) {
        self.anchors = [Some(anchor), self.anchors[0]];
    }

    /// First number, first time and period of a batch, if the epochs so far tell.
    fn place(&self, batch: &Batch) -> Option<Anchor> {
        self.anchors.iter().flatten().find_map(|anchor| {
            let (sequence, time) = anchor.place(batch)?;
            Some(Anchor {
                sequence,
                time,
                ..*anchor
            })
        })
    }

    fn take_batch(&mut self, received: Received, batch: &Batch, each: &mut impl FnMut(Arrival)) {
        if self.repeats.is_of_a_start_before(batch, received.host_ns) {
            self.statistics.stream(batch.stream()).duplicated += batch.len() as u64;
            return;
        }
        let Some(first) = self.place(batch) else {
            if self.order.holds() {
                return self.order.hold((received, Held::Batch(Box::new(*batch))));
            }
            self.unplaced.push_back((received, *batch));
            if self.unplaced.len() > MAX_UNPLACED {
                self.unplaced.pop_front();
                self.statistics.batches_unplaced += 1;
            }
            return;
        };
        let Anchor {
            sequence,
            time,
            period,
            ..
        } = first;
        let every = u32::from(batch.every());
        let index = batch.stream() as usize;
        let before_last = (batch.len() as u32).saturating_sub(1) * every;
        let last = sequence.wrapping_add(before_last);
        let latest = self.latest[index];
        let place = latest.map_or(Place::Ahead, |(latest, _)| {
            // How many samples the sensor took from the latest to these.
            let ahead = |number: u32| number.wrapping_sub(latest) as i32;
            match (ahead(sequence), ahead(last)) {
                (_, ..=0) => Place::Back,
                (..=0, _) => Place::Ahead,
                (first, _) if first.unsigned_abs() <= every => Place::Next,
                _ => Place::Ahead,
            }
        });
        let last_us = u64::from(before_last) * u64::from(period.0) / 1000;
        let moment = received.at(DeviceTimeUs(time.0.saturating_add(last_us)));
        match self.order.judge(moment, place) {
            Verdict::InOrder => {}
            Verdict::Late => return self.take_late(received, batch, each),
            Verdict::Hold => {
                return self.order.hold((received, Held::Batch(Box::new(*batch))));
            }
            Verdict::HeldWasLate => self.go_on(each),
            Verdict::NewStart => {
                self.restart_unannounced(received, each);
                return self.take_batch(received, batch, each);
            }
        }
        // Follows the samples, so that the place is known even if an epoch is lost.
        if let Some(latest) = &mut self.anchors[0]
            && time > latest.time
        {
            latest.sequence = sequence;
            latest.time = time;
            latest.host_ns = received.host_ns;
        }
        let statistics = self.statistics.stream(batch.stream());
        let mut samples = Samples {
            stream: batch.stream(),
            first_sequence: sequence,
            first_time: time,
            period,
            every: batch.every(),
            values: batch.samples().to_vec(),
        };
        let skipped = std::mem::take(&mut self.skipped[index]);
        if let Some((latest, every_before)) = latest {
            let ahead = sequence.wrapping_sub(latest) as i32;
            if ahead > 0 && skipped {
                // What was left out is not known to be missing.
            } else if ahead > 0 {
                // Where the decimation changes, fewer than its larger one are left out.
                let missing = (ahead as u32 - 1) / every.max(every_before.into());
                statistics.missing += u64::from(missing);
                if missing > 0 {
                    self.gaps[index].add(latest.wrapping_add(1), sequence);
                }
            } else {
                let known = (ahead.unsigned_abs() / every + 1) as usize;
                for late in self.gaps[index].take(&samples, known, statistics) {
                    each(received.with(Event::Late(late)));
                }
                let first = samples.iter().nth(known);
                samples.values.drain(..known.min(samples.values.len()));
                if let Some(first) = first {
                    samples.first_sequence = first.sequence;
                    samples.first_time = first.time;
                }
            }
        }
        statistics.received += samples.values.len() as u64;
        self.latest[index] = Some((last, samples.every));
        self.repeats.add(batch, received.host_ns);
        // Built where it goes: events are large.
        each(Arrival {
            host_ns: received.host_ns,
            began_ns: received.began_ns,
            event: Event::Samples(samples),
        });
    }

    /// Takes a batch of which nothing is new but what is missing.
    fn take_late(&mut self, received: Received, batch: &Batch, each: &mut impl FnMut(Arrival)) {
        let Some(first) = self.place(batch) else {
            self.statistics.batches_unplaced += 1;
            return;
        };
        let samples = Samples {
            stream: batch.stream(),
            first_sequence: first.sequence,
            first_time: first.time,
            period: first.period,
            every: batch.every(),
            values: batch.samples().to_vec(),
        };
        let gaps = &mut self.gaps[batch.stream() as usize];
        let statistics = self.statistics.stream(batch.stream());
        let late = gaps.take(&samples, usize::MAX, statistics);
        if !late.is_empty() {
            self.repeats.add(batch, received.host_ns);
        }
        for late in late {
            each(received.with(Event::Late(late)));
        }
    }
}

/// What is held until it is known of which start it is.
#[derive(Debug)]
enum Held {
    Epoch(Box<Epoch>),
    Batch(Box<Batch>),
    Event(Box<Event>),
}

/// Whether `now` is behind `latest`, which it then becomes.
fn is_later<T: Copy>(latest: &mut Option<T>, now: T, order: fn(T, T) -> Ordering) -> bool {
    let is_later = latest.is_none_or(|latest| order(now, latest).is_gt());
    if is_later {
        *latest = Some(now);
    }
    is_later
}

/// A frame's content, before the decoder has made an event of it.
#[allow(clippy::large_enum_variant, reason = "lives for one frame")]
enum Message {
    Hello(Hello),
    Epoch(Epoch),
    Event(Event),
}

fn read(kind: Kind, body: &[u8]) -> Result<Message, String> {
    let text = |error: &dyn std::error::Error| error.to_string();
    Ok(Message::Event(match kind {
        Kind::Hello => {
            return Hello::decode(body)
                .map(Message::Hello)
                .map_err(|e| text(&e));
        }
        Kind::Reply => Event::Reply {
            reply: Reply::decode(body).map_err(|e| text(&e))?,
            body: body.to_vec(),
        },
        Kind::Telemetry => match Telemetry::decode(body).map_err(|e| text(&e))? {
            Telemetry::Epoch(epoch) => return Ok(Message::Epoch(epoch)),
            Telemetry::Environment(environment) => Event::Environment(environment),
            Telemetry::Navigation(navigation) => Event::Navigation(navigation),
            Telemetry::Parameters(parameters) => Event::Parameters(parameters),
            Telemetry::Settings(settings) => Event::Settings(settings),
            Telemetry::Status(status) => Event::Status(status),
            Telemetry::Event { time_us, event } => Event::Device {
                time: DeviceTimeUs(time_us),
                event,
            },
        },
        // What a host sends, looped back.
        Kind::WhoAreYou | Kind::Request => return Err("a host's own frame came back".to_owned()),
        other => return Err(format!("frames of kind {other:?} are not known here")),
    }))
}

#[cfg(test)]
mod tests;
