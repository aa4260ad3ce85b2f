//! Verification of tags: which intervals of a link arrived as the device sent them.

use std::collections::HashSet;

use wimu_link::auth::{DeviceKey, KeyId};
use wimu_link::tag::{Tag, TagKey};
use wimu_link::{Frame, Hello, LinkRole, MAX_FRAME, frame};

/// Most bytes kept of an interval: of more, it cannot be verified. 921,600 baud carry 92 kB in a second.
const MAX_BYTES: usize = 1 << 20;

/// An interval of a link, that a [tag](wimu_link::tag) ends.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Interval {
    /// Number of the interval on its link, as in the tag.
    pub number: u32,
    /// Arrival of its first frame, ns on the host's monotonic clock.
    pub began_ns: u64,
    /// What the tag shows.
    pub authenticity: Authenticity,
}

/// What a tag shows about the frames before it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum Authenticity {
    /// They are those that the device sent.
    Verified,
    /// Frames of the interval did not arrive: the others cannot be verified.
    Incomplete,
    /// As many frames arrived as the device sent, or more, but not the same.
    Forged,
    /// The tag is of an earlier interval or of an earlier start of the device.
    Replayed,
    /// The tag was made with a key that is not known here.
    UnknownKey(KeyId),
}

/// Verifies the tags of one link. Keeps the frames of an interval, if there are keys.
#[derive(Debug, Default)]
pub(super) struct Verifier {
    /// `None` until it is known which there are: tags are not judged then.
    keys: Option<Vec<DeviceKey>>,
    /// The device and its link, by its latest greeting.
    device: Option<(u64, LinkRole)>,
    frames: Vec<Arrived>,
    /// Length of `frames`, bytes.
    length: usize,
    /// The latest interval, unless frames after it are unknown.
    latest: Option<Latest>,
    /// Key, start and number of the latest verified tag.
    verified: Option<(KeyId, u32, u32)>,
}

#[derive(Debug)]
struct Arrived {
    host_ns: u64,
    is_batch: bool,
    /// As on the line.
    bytes: Vec<u8>,
}

#[derive(Debug)]
struct Latest {
    tag: Tag,
    ended_ns: u64,
    /// The codes of its batches: a radio may repeat some of them.
    batches: HashSet<u64>,
    /// The code that its only missing frame has: it may be late.
    missing: Option<u64>,
}

impl Verifier {
    /// Uses these keys from now on.
    pub fn set_keys(&mut self, keys: Vec<DeviceKey>) {
        self.keys = Some(keys);
        self.interrupt();
    }

    /// Which device this is.
    pub fn greet(&mut self, hello: &Hello) {
        self.device = Some((hello.device_id, hello.role));
    }

    /// What arrived since the latest tag, or between it and what follows, is unknown.
    pub fn interrupt(&mut self) {
        self.frames.clear();
        self.length = 0;
        self.latest = None;
    }

    /// Keeps a frame until the next tag.
    pub fn take(&mut self, host_ns: u64, frame: &Frame) {
        if self.keys.as_ref().is_none_or(Vec::is_empty) {
            return;
        }
        let mut line = [0; MAX_FRAME];
        let length = frame::encode(frame.kind, frame.body, &mut line).unwrap_or(0);
        self.length += length;
        if self.length > MAX_BYTES {
            self.interrupt();
        }
        self.frames.push(Arrived {
            host_ns,
            is_batch: frame.kind.is_batch(),
            bytes: line[..length].to_vec(),
        });
    }

    /// Judges the frames before a tag; `None` for the latest tag, repeated, and before keys are set.
    pub fn judge(&mut self, host_ns: u64, tag: &Tag) -> Option<Interval> {
        let keys = self.keys.as_ref()?;
        let interval =
            |began_ns, authenticity| Some(Interval { number: tag.number, began_ns, authenticity });
        if self.latest.as_ref().is_some_and(|latest| latest.tag == *tag) {
            return None;
        }
        if let Some((key, boot_count, number)) = self.verified
            && key == tag.key
            && (tag.boot_count, tag.number) <= (boot_count, number)
        {
            return interval(host_ns, Authenticity::Replayed);
        }
        let frames = std::mem::take(&mut self.frames);
        self.length = 0;
        let latest = self.latest.take();
        let ended_ns = latest.as_ref().map(|latest| latest.ended_ns);
        let began_ns = ended_ns.or(frames.first().map(|first| first.host_ns));
        let began_ns = began_ns.unwrap_or(host_ns);
        let Some(key) = keys.iter().find(|key| key.id() == tag.key) else {
            return interval(began_ns, Authenticity::UnknownKey(tag.key));
        };
        let Some((device, role)) = self.device else {
            return interval(began_ns, Authenticity::Incomplete);
        };
        let key = TagKey::new(key, role, device, tag.boot_count);
        let before = latest.filter(|latest| follows(tag, &latest.tag));
        let mut judged = Judged::new(tag, &key, &frames, before.as_ref());
        if before.is_none() {
            judged.keep_latest(tag.frames as usize);
        }
        let authenticity = judged.authenticity(tag.frames as usize, before.is_some());
        if authenticity == Authenticity::Verified {
            self.verified = Some((tag.key, tag.boot_count, tag.number));
        }
        let first_ns = judged.frames.first().map(|first| first.0.host_ns);
        let missing = tag.frames as usize == judged.frames.len() + 1;
        let batches = judged.frames.iter().filter(|(frame, _)| frame.is_batch);
        self.latest = Some(Latest {
            tag: *tag,
            ended_ns: host_ns,
            batches: batches.map(|(_, code)| *code).collect(),
            missing: missing.then(|| judged.sum.wrapping_sub(judged.total())),
        });
        let began_ns = match before {
            Some(_) => began_ns,
            None => first_ns.unwrap_or(began_ns),
        };
        interval(began_ns, authenticity)
    }
}

/// Whether an interval follows another one immediately.
fn follows(tag: &Tag, before: &Tag) -> bool {
    (tag.key, tag.boot_count) == (before.key, before.boot_count)
        && tag.number == before.number.wrapping_add(1)
}

/// The frames of an interval with their codes, without repetitions and without one of the interval before that was late.
struct Judged<'a> {
    /// The sum of the codes by the tag.
    sum: u64,
    frames: Vec<(&'a Arrived, u64)>,
}

impl<'a> Judged<'a> {
    fn new(tag: &Tag, key: &TagKey, frames: &'a [Arrived], before: Option<&Latest>) -> Self {
        let coded = frames.iter().map(|frame| (frame, key.of_frame(&frame.bytes)));
        let mut judged = Self { sum: tag.sum(key), frames: coded.collect() };
        // A device may send equal frames: leave out as few as possible.
        let is_right = |judged: &Self| {
            judged.authenticity(tag.frames as usize, true) == Authenticity::Verified
        };
        if is_right(&judged) {
            return judged;
        }
        let mut known = HashSet::new();
        judged.frames.retain(|(frame, code)| {
            let is_repeated = frame.is_batch && before.is_some_and(|b| b.batches.contains(code));
            known.insert(*code) && !is_repeated
        });
        if let Some(late) = before.and_then(|before| before.missing)
            && !is_right(&judged)
        {
            judged.frames.retain(|(_, code)| *code != late);
        }
        judged
    }

    /// Drops all frames but the latest `count`: those before it are of intervals whose tags are missing.
    fn keep_latest(&mut self, count: usize) {
        let others = self.frames.len().saturating_sub(count);
        self.frames.drain(..others);
    }

    fn total(&self) -> u64 {
        let codes = self.frames.iter().map(|(_, code)| *code);
        codes.fold(0, u64::wrapping_add)
    }

    /// `is_known`: no other frames than those of the interval can have arrived since the tag before.
    fn authenticity(&self, count: usize, is_known: bool) -> Authenticity {
        match self.frames.len() {
            arrived if arrived == count && self.total() == self.sum => Authenticity::Verified,
            arrived if arrived >= count && is_known => Authenticity::Forged,
            _ => Authenticity::Incomplete,
        }
    }
}
