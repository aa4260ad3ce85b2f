//! Bags of ROS 1 and ROS 2: what their containers have in common.
//!
//! Imu messages give specific force, angular rate and attitude; magnetic fields, temperatures and poses are read
//! beside them. Times are header stamps, or log times where a topic's stamps cannot be used.

pub(super) mod bag;
mod chunk;
pub(super) mod db3;
pub(super) mod mcap;

use std::borrow::Cow;

use super::{ReadOptions, Source};
use crate::plural::counted;
use crate::recording::{Origin, Quantity, Sink, Stamped, TrackId, TrackInfo, Unit};
use crate::ros::message::{Encoding, IMU, Layout};
use crate::{Code, Problem, Result};

/// Messages of a topic by which its clock is chosen.
const FIRST_MESSAGES: usize = 32;
/// Largest difference between two topics' offsets from the log time, ns, that delays may cause.
const MAX_CLOCK_DIFFERENCE_NS: i64 = 60_000_000_000;
/// First bytes of data compressed by zstd. CDR begins with 0.
const ZSTD: [u8; 4] = [0x28, 0xb5, 0x2f, 0xfd];
/// Longest message of a type that is read, decompressed, bytes: far above their 1 kB.
const MAX_MESSAGE: u64 = 64 * 1024;
/// Topics that a refusal names, and damaged parts that a message names.
const NAMED_TOPICS: usize = 10;
const NAMED_DAMAGE: usize = 3;

/// Receives the messages of a bag in its order and hands their quantities to a sink.
struct Messages<'a> {
    bag: &'a str,
    options: &'a ReadOptions,
    sink: &'a mut dyn Sink,
    topics: Vec<Topic>,
    damage: Damage,
}

/// Parts of a bag that cannot be read: the first ones, and their number.
#[derive(Default)]
struct Damage {
    first: Vec<String>,
    count: usize,
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
    layout: Option<Layout>,
    messages: usize,
    /// Messages without the layout of their type.
    undecoded: usize,
    /// Set by the first message that is read.
    sensor: Option<u8>,
    /// Of the layout's quantities.
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
        let chosen = self.options.topic.as_deref();
        let left_out = message == IMU && chosen.is_some_and(|chosen| chosen != name);
        let layout = Layout::of(&message).filter(|_| encoding.is_some() && !left_out);
        self.topics.push(Topic {
            name: name.to_owned(),
            message,
            encoding,
            layout,
            ..Topic::default()
        });
        self.topics.len() - 1
    }

    /// A message of a topic.
    fn message(&mut self, index: usize, log_ns: i64, data: &[u8]) {
        let kind = &self.topics[index].message;
        let read = |topic: &&Topic| topic.sensor.is_some() && topic.message == *kind;
        let next_sensor = u8::try_from(self.topics.iter().filter(read).count());
        let topic = &mut self.topics[index];
        topic.messages += 1;
        let (Some(layout), Some(encoding), Ok(next_sensor)) =
            (&topic.layout, topic.encoding, next_sensor)
        else {
            return;
        };
        let data = if data.starts_with(&ZSTD) {
            // Each message is compressed. One that does not decompress has not its layout.
            chunk::decompress(b"zstd", data, MAX_MESSAGE, true).unwrap_or_default()
        } else {
            Cow::Borrowed(data)
        };
        let Some((stamp_ns, numbers)) = layout.decode(encoding, &data) else {
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

    /// The end of the bag: its findings, or the refusal of a bag without Imu messages.
    fn finish(mut self) -> Result<()> {
        for topic in &mut self.topics {
            topic.choose_clock(self.sink);
        }
        let damage = self.damage.text();
        let serves = if self.sink.takes_any() && self.options.topic.is_none() {
            self.topics.iter().any(|topic| topic.sensor.is_some())
        } else {
            self.imu_topics().any(Topic::is_inertial)
        };
        if !serves {
            return Err(self.refusal(damage));
        }
        if let Some(damage) = damage {
            self.sink.finding(Code::Truncated.warning(damage).remedy("the rest is read"));
        }
        self.report_topics();
        self.report_clocks();
        Ok(())
    }

    fn imu_topics(&self) -> impl Iterator<Item = &Topic> {
        let is_imu = |topic: &&Topic| topic.message == IMU && topic.messages > 0;
        self.topics.iter().filter(is_imu)
    }

    fn report_topics(&mut self) {
        let imu: Vec<String> = self.imu_topics().map(Topic::describe).collect();
        if imu.len() > 1 {
            let text = format!("{} topics of {IMU}: {}", imu.len(), imu.join(", "));
            let remedy = match &self.options.topic {
                Some(topic) => format!("only {topic} is read"),
                None => "each is a sensor of its own; select one by `--topic`".to_owned(),
            };
            self.sink.finding(Code::TrackChosen.note(text).remedy(remedy));
        }
        for topic in self.topics.iter().filter(|topic| topic.undecoded > 0) {
            let text = format!(
                "{}: {} of {} messages do not have the layout of {}",
                topic.name, topic.undecoded, topic.messages, topic.message
            );
            self.sink.finding(Code::RowsMasked.warning(text).remedy("they are left out"));
        }
    }

    fn report_clocks(&mut self) {
        let read = self.topics.iter().filter_map(|topic| Some((topic.offset_ns?, topic)));
        let by_log = read.clone().filter(|(_, topic)| topic.by_log == Some(true));
        let logged: Vec<&str> = by_log.map(|(_, topic)| topic.name.as_str()).collect();
        if !logged.is_empty() {
            let text = format!("header stamps are zero or do not increase: {}", logged.join(", "));
            let remedy = "the log times are used, which include the delays of transport";
            self.sink.finding(Code::Clock.warning(text).remedy(remedy));
        }
        let first = read.clone().min_by_key(|(offset, _)| *offset);
        let last = read.max_by_key(|(offset, _)| *offset);
        let (Some((first_ns, first)), Some((last_ns, last))) = (first, last) else {
            return;
        };
        let difference_ns = last_ns.saturating_sub(first_ns);
        if difference_ns > MAX_CLOCK_DIFFERENCE_NS {
            let seconds = difference_ns as f64 * 1e-9;
            let text =
                format!("the clocks of {} and {} differ by {seconds:.0} s", first.name, last.name);
            let remedy = "do not combine them, or record them with one clock";
            self.sink.finding(Code::Clock.warning(text).remedy(remedy));
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
    fn add(&mut self, text: String) {
        self.count += 1;
        if self.first.len() < NAMED_DAMAGE {
            self.first.push(text);
        }
    }

    /// Records that are left out.
    fn gap(&mut self, at: u64, bytes: u64) {
        self.add(format!("{bytes} bytes of damaged records are left out at byte {at}"));
    }

    /// Messages of the index that are not read, or whose topic is not known.
    fn missing(&mut self, messages: u64) {
        if messages > 0 {
            let count = counted(usize::try_from(messages).unwrap_or(usize::MAX), "message");
            self.add(format!("{count} of the index cannot be read or assigned to a topic"));
        }
    }

    /// A file that cannot be read beyond a byte.
    fn cut(&mut self, file: &str, at: u64) {
        self.add(format!("{file} is cut off or damaged from byte {at} on"));
    }

    /// What is wrong; `None` if nothing is.
    fn text(&self) -> Option<String> {
        let mut text = self.first.join("; ");
        if self.count > self.first.len() {
            text += &format!("; and {} more", self.count - self.first.len());
        }
        (self.count > 0).then_some(text)
    }
}

impl Topic {
    /// Name, type and number of messages.
    fn describe(&self) -> String {
        let count = counted(self.messages, "message");
        match self.encoding {
            Some(_) => format!("{} ({}, {count})", self.name, self.message),
            None => format!("{} ({}, not serialised by ROS, {count})", self.name, self.message),
        }
    }

    /// Whether a message had a specific force or an angular rate.
    fn is_inertial(&self) -> bool {
        let tracks = self.layout.iter().flat_map(|layout| &layout.parts).zip(&self.tracks);
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
        let (Some(layout), Some(sensor)) = (&self.layout, self.sensor) else {
            return;
        };
        for (index, part) in layout.parts.iter().enumerate() {
            let Some(values) = part.values(&message.numbers) else {
                continue;
            };
            let first = self.tracks.iter().flatten().next().copied();
            let id = *self.tracks[index].get_or_insert_with(|| {
                let origin = match part.quantity {
                    Quantity::Attitude | Quantity::Position => Origin::Estimate,
                    _ => Origin::Sensor,
                };
                let mut info = TrackInfo::new(self.name.clone(), part.quantity, Unit::Si);
                info.stamps = Some(first.map_or(Stamped::By(None), Stamped::Like));
                sink.track(info.of_sensor(sensor).made_by(origin))
            });
            let offset_ns = time_ns.saturating_sub(message.log_ns);
            self.offset_ns.get_or_insert(offset_ns);
            sink.row(id, time_ns, &values[..part.quantity.width()]);
        }
    }
}
