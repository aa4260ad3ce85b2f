//! Bags of ROS 1 and ROS 2: what their containers have in common.
//!
//! Imu messages give specific force, angular rate and attitude; magnetic fields, temperatures and poses are read
//! beside them. Times are header stamps, or log times where a topic's stamps cannot be used.

pub(super) mod bag;
mod chunk;
pub(super) mod db3;
pub(super) mod mcap;
mod message;

use std::borrow::Cow;

use self::message::{Encoding, IMU, Kind};
use super::{ReadOptions, Source};
use crate::recording::{Origin, Quantity, Sink, TrackId, TrackInfo, Unit};
use crate::{Code, Problem, Result};

/// Messages of a topic by which its clock is chosen.
const FIRST_MESSAGES: usize = 32;
/// Largest difference between two topics' offsets from the log time, ns, that delays may cause.
const MAX_CLOCK_DIFFERENCE_NS: i64 = 60_000_000_000;
/// First bytes of data compressed by zstd. CDR begins with 0.
const ZSTD: [u8; 4] = [0x28, 0xb5, 0x2f, 0xfd];
/// Longest message of a type that is read, decompressed, bytes: far above their 1 kB.
const MAX_MESSAGE: u64 = 64 * 1024;
/// Topics that a refusal names.
const NAMED_TOPICS: usize = 10;

/// Receives the messages of a bag in its order and hands their quantities to a sink.
struct Messages<'a> {
    bag: &'a str,
    options: &'a ReadOptions,
    sink: &'a mut dyn Sink,
    topics: Vec<Topic>,
    damage: Damage,
}

/// Parts of a bag that cannot be read.
#[derive(Default)]
struct Damage {
    /// Chunks left out, and what is wrong with the first of them.
    chunks: Option<(u64, String)>,
    /// Bytes of damaged records, and where the first of them is.
    gaps: Option<(u64, u64)>,
    /// Messages that the index counts, or whose topic is unknown, and that are not read.
    missing: u64,
    /// Where a file ends early or a record's length is wrong.
    cut: Vec<String>,
}

/// A message kept until the clock of its topic is chosen.
struct Waiting {
    stamp_ns: i64,
    log_ns: i64,
    numbers: Vec<f64>,
}

#[derive(Default)]
struct Topic {
    name: String,
    /// Without `/msg`.
    message: String,
    /// Serialisation, if it is one that is read.
    encoding: Option<Encoding>,
    /// `None` for messages without a quantity that is read.
    kind: Option<&'static Kind>,
    messages: usize,
    /// Messages without the layout of their kind.
    undecoded: usize,
    /// Set by the first message that is read.
    sensor: Option<u8>,
    /// Of the kind's quantities.
    tracks: [Option<TrackId>; 3],
    waiting: Vec<Waiting>,
    /// Whether times are log times, once it is chosen.
    by_log: Option<bool>,
    /// Time of the first row less its log time, ns.
    offset_ns: Option<i64>,
}

impl<'a> Messages<'a> {
    fn new(source: &'a Source, options: &'a ReadOptions, sink: &'a mut dyn Sink) -> Self {
        Self { bag: source.name(), options, sink, topics: Vec::new(), damage: Damage::default() }
    }

    /// The number of a topic, the same in all files of a bag.
    fn topic(&mut self, name: &str, message: &str, encoding: Option<Encoding>) -> usize {
        let message = message.replace("/msg/", "/");
        let known = |topic: &Topic| {
            topic.name == name && topic.message == message && topic.encoding == encoding
        };
        if let Some(index) = self.topics.iter().position(known) {
            return index;
        }
        let kind = message::kind(&message).filter(|_| encoding.is_some());
        let chosen = self.options.topic.as_deref();
        let left_out = kind.is_some_and(|kind| kind.name == IMU)
            && chosen.is_some_and(|chosen| chosen != name);
        self.topics.push(Topic {
            name: name.to_owned(),
            message,
            encoding,
            kind: kind.filter(|_| !left_out),
            ..Topic::default()
        });
        self.topics.len() - 1
    }

    /// A message of a topic.
    fn message(&mut self, index: usize, log_ns: i64, data: &[u8]) {
        let same_kind = |topic: &Topic| topic.kind.map(|kind| kind.name);
        let kind = same_kind(&self.topics[index]);
        let read = |topic: &&Topic| topic.sensor.is_some() && same_kind(topic) == kind;
        let next_sensor = u8::try_from(self.topics.iter().filter(read).count());
        let topic = &mut self.topics[index];
        topic.messages += 1;
        let (Some(kind), Some(encoding), Ok(next_sensor)) =
            (topic.kind, topic.encoding, next_sensor)
        else {
            return;
        };
        let data = match data.starts_with(&ZSTD) {
            // Each message is compressed. One that does not decompress has not its layout.
            true => chunk::decompress(b"zstd", data, MAX_MESSAGE, true).unwrap_or_default(),
            false => Cow::Borrowed(data),
        };
        let Some((stamp_ns, numbers)) = message::decode(kind, encoding, &data) else {
            topic.undecoded += 1;
            return;
        };
        topic.sensor.get_or_insert(next_sensor);
        let message = Waiting { stamp_ns, log_ns, numbers };
        if topic.by_log.is_some() {
            topic.row(self.sink, &message);
            return;
        }
        topic.waiting.push(message);
        if topic.waiting.len() == FIRST_MESSAGES {
            topic.choose_clock(self.sink);
        }
    }

    /// A chunk that is left out.
    fn damaged_chunk(&mut self, reason: String) {
        self.damage.chunks.get_or_insert((0, reason)).0 += 1;
    }

    /// Damaged records that are left out.
    fn gap(&mut self, at: u64, bytes: u64) {
        self.damage.gaps.get_or_insert((0, at)).0 += bytes;
    }

    /// Messages of a file that are not read.
    fn missing(&mut self, count: u64) {
        self.damage.missing += count;
    }

    /// A file that cannot be read beyond a byte.
    fn cut(&mut self, file: &str, at: u64) {
        let file = match file == self.bag {
            true => "the file".to_owned(),
            false => file.to_owned(),
        };
        self.damage.cut.push(format!("{file} is cut off or damaged from byte {at} on"));
    }

    /// The end of the bag: its findings, or the refusal of a bag without Imu messages.
    fn finish(mut self) -> Result<()> {
        for topic in &mut self.topics {
            topic.choose_clock(self.sink);
        }
        let damage = self.damage.text();
        let serves = match self.sink.takes_any() && self.options.topic.is_none() {
            true => self.topics.iter().any(|topic| topic.sensor.is_some()),
            false => self.imu_topics().any(Topic::is_inertial),
        };
        if !serves {
            return Err(self.refusal(damage));
        }
        if let Some(damage) = damage {
            let remedy = match self.damage.cut.is_empty() {
                true => "the rest is read",
                false => "the part before is read",
            };
            self.report(Code::Truncated.warning(damage), remedy);
        }
        self.report_topics();
        self.report_clocks();
        Ok(())
    }

    fn imu_topics(&self) -> impl Iterator<Item = &Topic> {
        let is_imu = |topic: &&Topic| topic.message == IMU && topic.messages > 0;
        self.topics.iter().filter(is_imu)
    }

    fn report(&mut self, finding: Problem, remedy: impl Into<String>) {
        self.sink.finding(finding.remedy(remedy));
    }

    fn report_topics(&mut self) {
        let imu: Vec<String> = self.imu_topics().map(Topic::describe).collect();
        if imu.len() > 1 {
            let text = format!("{} topics of {IMU}: {}", imu.len(), imu.join(", "));
            let remedy = match &self.options.topic {
                Some(topic) => format!("only {topic} is read"),
                None => "each is a sensor of its own; select one by `--topic`".to_owned(),
            };
            self.report(Code::TrackChosen.note(text), remedy);
        }
        for topic in self.topics.iter().filter(|topic| topic.undecoded > 0) {
            let text = format!(
                "{}: {} of {} messages do not have the layout of {}",
                topic.name, topic.undecoded, topic.messages, topic.message
            );
            let finding = Code::RowsMasked.warning(text);
            self.sink.finding(finding.remedy("they are left out"));
        }
    }

    fn report_clocks(&mut self) {
        let read = |topic: &&Topic| topic.offset_ns.is_some();
        let by_log = |topic: &&Topic| topic.by_log == Some(true);
        let logged: Vec<&str> = (self.topics.iter().filter(read).filter(by_log))
            .map(|topic| topic.name.as_str())
            .collect();
        if !logged.is_empty() {
            let text = format!("header stamps are zero or do not increase: {}", logged.join(", "));
            let remedy = "the log times are used, which include the delays of transport";
            self.report(Code::Clock.warning(text), remedy);
        }
        let offsets = (self.topics.iter()).filter_map(|topic| Some((topic.offset_ns?, topic)));
        let first = offsets.clone().min_by_key(|(offset, _)| *offset);
        let last = offsets.max_by_key(|(offset, _)| *offset);
        let (Some(first), Some(last)) = (first, last) else {
            return;
        };
        let difference_ns = last.0.saturating_sub(first.0);
        if difference_ns > MAX_CLOCK_DIFFERENCE_NS {
            let text = format!(
                "the clocks of {} and {} differ by {:.0} s",
                first.1.name,
                last.1.name,
                difference_ns as f64 * 1e-9
            );
            let remedy = "do not combine them, or record them with one clock";
            self.report(Code::Clock.warning(text), remedy);
        }
    }

    /// A bag without readable Imu messages.
    fn refusal(&self, damage: Option<String>) -> Problem {
        let imu: Vec<String> = self.imu_topics().map(Topic::describe).collect();
        let mut topics: Vec<&Topic> = (self.topics.iter().filter(|t| t.messages > 0)).collect();
        topics.sort_by_key(|topic| std::cmp::Reverse(topic.messages));
        let mut named: Vec<String> =
            (topics.iter().take(NAMED_TOPICS)).map(|topic| topic.describe()).collect();
        if topics.len() > NAMED_TOPICS {
            named.push(format!("{} more", topics.len() - NAMED_TOPICS));
        }
        let damage = damage.map(|damage| format!("; {damage}"));
        let damage = damage.unwrap_or_default();
        let error = match &self.options.topic {
            Some(topic) if !imu.is_empty() => Code::Usage.error(
                format!("{topic} has no messages of {IMU} that can be read{damage}"),
                format!("choose one of {}", imu.join(", ")),
            ),
            _ if topics.is_empty() => Code::BadRecording
                .error(format!("no message can be read{damage}"), "give a bag with messages"),
            _ => Code::NoRows.error(
                format!("no inertial data in {IMU} can be read among {}{damage}", named.join(", ")),
                format!("give a bag with accelerations or angular velocities in {IMU}"),
            ),
        };
        error.at(self.bag)
    }
}

impl Damage {
    /// What is wrong; `None` if nothing is.
    fn text(&self) -> Option<String> {
        let chunks = self.chunks.as_ref().map(|(chunks, reason)| match chunks {
            1 => format!("1 chunk is left out: {reason}"),
            _ => format!("{chunks} chunks are left out, the first: {reason}"),
        });
        let gaps = self.gaps.map(|(bytes, at)| {
            format!("{bytes} bytes of damaged records are left out, the first at byte {at}")
        });
        let missing = usize::try_from(self.missing).unwrap_or(usize::MAX);
        let missing = (missing > 0).then(|| {
            let count = crate::plural::counted(missing, "message");
            format!("{count} of the index cannot be read or assigned to a topic")
        });
        let parts = chunks.into_iter().chain(gaps).chain(missing);
        let parts: Vec<String> = parts.chain(self.cut.clone()).collect();
        (!parts.is_empty()).then(|| parts.join("; "))
    }
}

impl Topic {
    /// Name, type and number of messages.
    fn describe(&self) -> String {
        let count = crate::plural::counted(self.messages, "message");
        match self.encoding {
            Some(_) => format!("{} ({}, {count})", self.name, self.message),
            None => format!("{} ({}, not serialised by ROS, {count})", self.name, self.message),
        }
    }

    /// Whether a message had a specific force or an angular rate.
    fn is_inertial(&self) -> bool {
        let tracks = self.kind.iter().flat_map(|kind| kind.parts).zip(&self.tracks);
        let mut read = tracks.filter(|(_, track)| track.is_some());
        read.any(|(part, _)| part.quantity != Quantity::Attitude)
    }

    /// Header stamps, unless they are all zero or most of them do not increase.
    fn choose_clock(&mut self, sink: &mut dyn Sink) {
        if self.by_log.is_some() {
            return;
        }
        let steps = || self.waiting.windows(2);
        let stuck = |pair: &&[Waiting]| pair[1].stamp_ns <= pair[0].stamp_ns;
        let zero = self.waiting.iter().all(|message| message.stamp_ns == 0);
        self.by_log = Some(zero || 2 * steps().filter(stuck).count() > steps().count());
        for message in std::mem::take(&mut self.waiting) {
            self.row(sink, &message);
        }
    }

    /// Hands the quantities of a message on that it does not mark as absent.
    fn row(&mut self, sink: &mut dyn Sink, message: &Waiting) {
        let time_ns = match self.by_log {
            Some(true) => message.log_ns,
            _ => message.stamp_ns,
        };
        let (Some(kind), Some(sensor)) = (self.kind, self.sensor) else {
            return;
        };
        for (part, track) in kind.parts.iter().zip(&mut self.tracks) {
            let Some(values) = part.values(&message.numbers) else {
                continue;
            };
            let id = *track.get_or_insert_with(|| {
                let origin = match part.quantity {
                    Quantity::Attitude | Quantity::Position => Origin::Estimate,
                    _ => Origin::Sensor,
                };
                let info = TrackInfo::new(self.name.clone(), part.quantity, Unit::Si);
                sink.track(info.of_sensor(sensor).made_by(origin))
            });
            let offset_ns = time_ns.saturating_sub(message.log_ns);
            self.offset_ns.get_or_insert(offset_ns);
            sink.row(id, time_ns, &values[..part.quantity.width()]);
        }
    }
}
