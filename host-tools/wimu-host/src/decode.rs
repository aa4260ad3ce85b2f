//! The bytes of one link become typed events: frames assembled, short numbers completed, losses
//! counted.

use std::collections::VecDeque;

use wimu_link::batch::{self, Stream};
use wimu_link::message::{ActiveParameters, Environment, Epoch, Navigation, Status};
use wimu_link::{Batch, Deframer, FrameError, Hello, Kind, Reply, Settings, Telemetry};
use wimu_model::{DeviceTimeUs, PeriodNs};

/// Batches kept until an epoch tells where they belong: more than arrive in the second between
/// two epochs.
const MAX_UNPLACED: usize = 512;
/// How far a batch's time may be from what its sequence number says: a part of the time between,
/// for a sensor whose rate is off by 20 %, and some jitter, µs.
const PLACE_TOLERANCE_US: u64 = 250_000;

/// Something that a link brought.
#[derive(Clone, Debug)]
#[allow(
    clippy::large_enum_variant,
    reason = "events are handed on one at a time"
)]
pub enum Event {
    /// Who the device is.
    Hello(Hello),
    /// The device has started anew: sequence numbers and device times begin again.
    Restart,
    /// Consecutive samples.
    Samples(Samples),
    /// From here on samples can be replayed; may come before samples that precede it.
    Epoch {
        /// As sent.
        epoch: Epoch,
        /// Whether epochs before it have not arrived.
        after_loss: bool,
    },
    /// Magnetic field and temperature.
    Environment(Environment),
    /// Velocity and position.
    Navigation(Navigation),
    /// The parameters in use.
    Parameters(ActiveParameters),
    /// The settings in use.
    Settings(Settings),
    /// How the device is.
    Status(Status),
    /// Something happened on the device.
    Device {
        /// When.
        time: DeviceTimeUs,
        /// What.
        event: wimu_link::message::Event,
    },
    /// An answer to a request.
    Reply {
        /// What is known of it here.
        reply: Reply,
        /// The frame's body, which the signature holds for.
        body: Vec<u8>,
    },
    /// A damaged frame, or one of another version.
    Damaged(FrameError),
    /// An undamaged frame whose body makes no sense here.
    Unreadable(String),
}

/// Samples of one stream, of which none between the first and the last is missing, never the same
/// ones twice.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Samples {
    /// Raw counts or corrected specific force.
    pub stream: Stream,
    /// Sequence number of the first.
    pub first_sequence: u32,
    /// Device time of the first.
    pub first_time: DeviceTimeUs,
    /// Time from one sample that the sensor takes to the next.
    pub period: PeriodNs,
    /// From one sample's sequence number to the next one's: 1 unless the stream is decimated.
    pub every: u8,
    /// X, Y, Z in LSB or 2⁻¹⁶ m/s².
    pub values: Vec<[i32; 3]>,
}

impl Samples {
    /// The samples one by one.
    pub fn iter(&self) -> impl Iterator<Item = TimedSample> + '_ {
        self.values.iter().enumerate().map(|(index, value)| {
            let later = index as u32 * u32::from(self.every);
            let later_us = u64::from(later) * u64::from(self.period.0) / 1000;
            TimedSample {
                sequence: self.first_sequence.wrapping_add(later),
                time: DeviceTimeUs(self.first_time.0.wrapping_add(later_us)),
                value: *value,
            }
        })
    }
}

/// A sample with its number and time.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TimedSample {
    /// Counts every sample that the sensor took.
    pub sequence: u32,
    /// When it was taken.
    pub time: DeviceTimeUs,
    /// X, Y, Z in LSB or 2⁻¹⁶ m/s².
    pub value: [i32; 3],
}

/// An event and when the bytes that completed it arrived.
#[derive(Clone, Debug)]
pub struct Arrival {
    /// ns on the host's monotonic clock.
    pub host_ns: u64,
    /// The same for the first byte of its frame: independent of the frame's length.
    pub began_ns: u64,
    /// What arrived.
    pub event: Event,
}

/// What a link carried and lost.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize)]
pub struct LinkStatistics {
    /// Bytes received.
    pub bytes: u64,
    /// Undamaged frames.
    pub frames: u64,
    /// Damaged frames, but for those before the first whole one: listening may have begun within
    /// one.
    pub frames_damaged: u64,
    /// Undamaged frames of an unknown version or kind, or with a body that makes no sense.
    pub frames_unreadable: u64,
    /// The raw samples.
    pub raw: StreamStatistics,
    /// The corrected samples.
    pub corrected: StreamStatistics,
    /// Batches that no epoch has told the place of.
    pub batches_unplaced: u64,
    /// How often the link was lost and had to be opened again.
    pub interruptions: u64,
}

/// What of a stream of samples arrived.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize)]
pub struct StreamStatistics {
    /// Samples received.
    pub received: u64,
    /// Samples between the first and the last received that did not arrive: missed by the device
    /// or lost on the link.
    pub missing: u64,
    /// Samples that arrived again and were left out.
    pub duplicated: u64,
}

/// Where a link's samples are: what completes short numbers.
#[derive(Clone, Copy, Debug)]
struct Anchor {
    sequence: u32,
    time: DeviceTimeUs,
    period: PeriodNs,
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
}

/// When a frame's last and first bytes arrived.
#[derive(Clone, Copy, Debug)]
struct Received {
    host_ns: u64,
    began_ns: u64,
}

impl Received {
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
    unplaced: VecDeque<(Received, Batch)>,
    /// Whether a frame has been read since listening began.
    listening: bool,
    /// When the frame under way began to arrive.
    began_ns: Option<u64>,
    /// The latest sequence number of raw and corrected samples, and the decimation.
    latest: [Option<(u32, u8)>; 2],
    identity: Option<(u64, u32)>,
    last_epoch_time: Option<DeviceTimeUs>,
    last_epoch_number: Option<u8>,
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
            unplaced: VecDeque::new(),
            listening: false,
            began_ns: None,
            latest: [None; 2],
            identity: None,
            last_epoch_time: None,
            last_epoch_number: None,
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
            let mut emit = |event| each(received.with(event));
            match event {
                Message::Hello(hello) => {
                    let identity = (hello.device_id, hello.boot_count);
                    if self
                        .identity
                        .replace(identity)
                        .is_some_and(|i| i != identity)
                    {
                        self.restart();
                        emit(Event::Restart);
                    }
                    emit(Event::Hello(hello));
                }
                Message::Epoch(epoch) => self.take_epoch(received, epoch, &mut each),
                Message::Event(event) => emit(event),
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
        self.statistics.interruptions += 1;
    }

    /// What the link carried and lost so far.
    pub fn statistics(&self) -> LinkStatistics {
        LinkStatistics {
            batches_unplaced: self.statistics.batches_unplaced + self.unplaced.len() as u64,
            ..self.statistics
        }
    }

    /// The wire version of the latest undamaged frame that is of another version than ours.
    pub fn foreign_version(&self) -> Option<u8> {
        self.foreign_version
    }

    fn restart(&mut self) {
        self.statistics.batches_unplaced += self.unplaced.len() as u64;
        self.unplaced.clear();
        self.anchors = [None; 2];
        self.latest = [None; 2];
        self.last_epoch_time = None;
        self.last_epoch_number = None;
    }

    fn take_epoch(&mut self, received: Received, epoch: Epoch, each: &mut impl FnMut(Arrival)) {
        let time = DeviceTimeUs(epoch.time_us);
        // A device that starts anew without its greeting having arrived.
        if self.last_epoch_time.is_some_and(|last| time < last) {
            self.restart();
            // Its greeting, when it comes, tells of no other start.
            self.identity = None;
            each(received.with(Event::Restart));
        }
        self.last_epoch_time = Some(time);
        self.anchor(Anchor {
            sequence: epoch.sequence,
            time,
            period: PeriodNs(epoch.period_ns),
        });
        for (received, batch) in std::mem::take(&mut self.unplaced) {
            self.take_batch(received, &batch, each);
        }
        // One that was sent for a new listener has the number of the one before.
        let last = self.last_epoch_number.replace(epoch.number);
        let after_loss = last.is_some_and(|last| epoch.number.wrapping_sub(last) > 1);
        each(received.with(Event::Epoch { epoch, after_loss }));
    }

    fn anchor(&mut self, anchor: Anchor) {
        self.anchors = [Some(anchor), self.anchors[0]];
    }

    fn take_batch(&mut self, received: Received, batch: &Batch, each: &mut impl FnMut(Arrival)) {
        let found = self.anchors.iter().flatten().find_map(|anchor| {
            let (sequence, time) = anchor.place(batch)?;
            Some((sequence, time, anchor.period))
        });
        let Some((sequence, time, period)) = found else {
            self.unplaced.push_back((received, *batch));
            if self.unplaced.len() > MAX_UNPLACED {
                self.unplaced.pop_front();
                self.statistics.batches_unplaced += 1;
            }
            return;
        };
        // Follows the samples, so that the place is known even if an epoch is lost.
        if let Some(latest) = &mut self.anchors[0]
            && time > latest.time
        {
            latest.sequence = sequence;
            latest.time = time;
        }
        let (index, statistics) = match batch.stream() {
            Stream::Raw => (0, &mut self.statistics.raw),
            Stream::Corrected => (1, &mut self.statistics.corrected),
        };
        let mut samples = Samples {
            stream: batch.stream(),
            first_sequence: sequence,
            first_time: time,
            period,
            every: batch.every(),
            values: batch.samples().to_vec(),
        };
        let every = u32::from(samples.every);
        if let Some((latest, every_before)) = self.latest[index] {
            // How many samples the sensor took from the latest to this one.
            let ahead = sequence.wrapping_sub(latest) as i32;
            if ahead > 0 {
                // Where the decimation changes, fewer than its larger one are left out.
                let every = every.max(every_before.into());
                statistics.missing += u64::from((ahead as u32 - 1) / every);
            } else {
                let known = ahead.unsigned_abs() / every + 1;
                let known = (known as usize).min(samples.values.len());
                statistics.duplicated += known as u64;
                let first = samples.iter().nth(known);
                samples.values.drain(..known);
                match first {
                    Some(first) => {
                        samples.first_sequence = first.sequence;
                        samples.first_time = first.time;
                    }
                    None => return,
                }
            }
        }
        statistics.received += samples.values.len() as u64;
        let last = (samples.values.len() as u32).saturating_sub(1) * every;
        let last = samples.first_sequence.wrapping_add(last);
        self.latest[index] = Some((last, samples.every));
        // Built where it goes: events are large.
        each(Arrival {
            host_ns: received.host_ns,
            began_ns: received.began_ns,
            event: Event::Samples(samples),
        });
    }
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
