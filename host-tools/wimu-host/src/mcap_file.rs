//! Recordings: what each link received, byte for byte, with the host's time.
//!
//! An MCAP file of profile `ros2` with the topics `/wireless/bytes` and `/cable/bytes`
//! (`std_msgs/msg/UInt8MultiArray`, `cdr`); beside them `/wireless/sent` and `/cable/sent`, what the
//! host sent, by which clocks are told, and `/wireless/link` and `/cable/link`
//! (`std_msgs/msg/String`), where a link was lost and came back. Messages are logged in UTC; a metadata record `wimu`
//! holds the one anchor between UTC and the host's monotonic clock, so that the reader gives the
//! monotonic times back exactly. Whole chunks with a CRC are appended and flushed every second: a
//! file cut off at any byte reads up to the last whole chunk.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{BufReader, BufWriter, Read, Seek, Write};
use std::path::Path;
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use mcap::records::{Metadata, Record};
use mcap::sans_io::{LinearReadEvent, LinearReader, linear_reader::LinearReaderOptions};
use wimu_link::LinkRole;

use crate::error::{ErrorCode, HostError, Result};

/// What a topic carries.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Content {
    Received,
    Sent,
    /// Whether the link is there.
    State,
}

/// Topics, and the metadata keys of their channels' ids.
const TOPICS: [(LinkRole, Content, &str, &str); 6] = [
    (
        LinkRole::Wireless,
        Content::Received,
        "/wireless/bytes",
        "channel_wireless",
    ),
    (
        LinkRole::Cable,
        Content::Received,
        "/cable/bytes",
        "channel_cable",
    ),
    (
        LinkRole::Wireless,
        Content::Sent,
        "/wireless/sent",
        "channel_wireless_sent",
    ),
    (
        LinkRole::Cable,
        Content::Sent,
        "/cable/sent",
        "channel_cable_sent",
    ),
    (
        LinkRole::Wireless,
        Content::State,
        "/wireless/link",
        "channel_wireless_link",
    ),
    (
        LinkRole::Cable,
        Content::State,
        "/cable/link",
        "channel_cable_link",
    ),
];
const CONNECTED: &str = "connected";
const LOST: &str = "lost: ";
const TEXT_SCHEMA_NAME: &str = "std_msgs/msg/String";
const TEXT_SCHEMA: &str = "string data\n";
const SCHEMA_NAME: &str = "std_msgs/msg/UInt8MultiArray";
const SCHEMA: &str = "\
# Bytes as received; the layout is empty.
MultiArrayLayout layout
uint8[] data
================================================================================
MSG: std_msgs/MultiArrayLayout
MultiArrayDimension[] dim
uint32 data_offset
================================================================================
MSG: std_msgs/MultiArrayDimension
string label
uint32 size
uint32 stride
";
const METADATA: &str = "wimu";
/// A chunk is closed at this size or after [`FLUSH_NS`], whichever comes first.
const CHUNK_BYTES: u64 = 256 * 1024;
const FLUSH_NS: u64 = 1_000_000_000;
/// No record of a recording comes near this; a length beyond it is damage.
const MAX_RECORD_BYTES: usize = 64 * 1024 * 1024;

/// One moment on the host's monotonic clock and in UTC.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ClockAnchor {
    /// ns on the host's monotonic clock.
    pub monotonic_ns: u64,
    /// ns since 1970-01-01 00:00 UTC.
    pub utc_ns: u64,
}

impl ClockAnchor {
    /// Anchors the monotonic clock that shows `monotonic` to UTC, now.
    pub fn now(monotonic: Duration) -> Self {
        let utc = SystemTime::now()
            .duration_since(UNIX_EPOCH)
            .unwrap_or_default();
        let ns = |time: Duration| u64::try_from(time.as_nanos()).unwrap_or(u64::MAX);
        Self {
            monotonic_ns: ns(monotonic),
            utc_ns: ns(utc),
        }
    }

    /// A monotonic time in UTC, ns since 1970.
    pub fn to_utc_ns(self, monotonic_ns: u64) -> u64 {
        shift(monotonic_ns, self.monotonic_ns, self.utc_ns)
    }

    fn to_monotonic_ns(self, utc_ns: u64) -> u64 {
        shift(utc_ns, self.utc_ns, self.monotonic_ns)
    }
}

/// Wraps, so that it can be undone whatever a file claims.
fn shift(time: u64, from: u64, to: u64) -> u64 {
    time.wrapping_sub(from).wrapping_add(to)
}

/// What one link received at one time.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Received {
    /// Which link.
    pub role: LinkRole,
    /// ns on the host's monotonic clock.
    pub host_ns: u64,
    /// As received.
    pub bytes: Vec<u8>,
}

/// One entry of a recording.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Recorded {
    /// Bytes from the board.
    Received(Received),
    /// Bytes to the board.
    Sent {
        /// Over which link.
        role: LinkRole,
        /// Before they were written, ns on the host's monotonic clock.
        host_ns: u64,
        /// As sent.
        bytes: Vec<u8>,
    },
    /// A link was lost: what it brings next does not follow what it brought before.
    Lost {
        /// Which link.
        role: LinkRole,
        /// When, ns on the host's monotonic clock.
        host_ns: u64,
        /// Why.
        reason: String,
    },
    /// A lost link is back.
    Connected {
        /// Which link.
        role: LinkRole,
        /// When, ns on the host's monotonic clock.
        host_ns: u64,
    },
}

impl Recorded {
    /// When, ns on the host's monotonic clock.
    pub fn host_ns(&self) -> u64 {
        match self {
            Self::Received(received) => received.host_ns,
            Self::Sent { host_ns, .. }
            | Self::Lost { host_ns, .. }
            | Self::Connected { host_ns, .. } => *host_ns,
        }
    }

    /// Of which link.
    pub fn role(&self) -> LinkRole {
        match self {
            Self::Received(received) => received.role,
            Self::Sent { role, .. } | Self::Lost { role, .. } | Self::Connected { role, .. } => {
                *role
            }
        }
    }
}

/// A further topic of a [`RecordingWriter`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Topic(u16);

/// Writes a recording while it happens.
///
/// Dropping it closes the file as well; [`RecordingWriter::finish`] also tells whether that worked.
pub struct RecordingWriter<W: Write + Seek> {
    name: String,
    writer: mcap::Writer<W>,
    anchor: ClockAnchor,
    /// Channel and messages so far, in the order of [`TOPICS`].
    channels: [(u16, u32); TOPICS.len()],
    last_flush_ns: Option<u64>,
    message: Vec<u8>,
}

impl RecordingWriter<BufWriter<File>> {
    /// Creates a file; one that exists is left alone.
    ///
    /// # Errors
    /// `file_exists`, `file_unreadable`, `file_failed`.
    pub fn create(path: &Path, anchor: ClockAnchor) -> Result<Self> {
        let name = path.display().to_string();
        let file = File::create_new(path).map_err(|e| HostError::file(&name, "create", &e))?;
        Self::new(BufWriter::new(file), &name, anchor)
    }
}

impl<W: Write + Seek> RecordingWriter<W> {
    /// Starts a recording in `sink`, which errors call `name`.
    ///
    /// # Errors
    /// `file_failed`.
    pub fn new(sink: W, name: &str, anchor: ClockAnchor) -> Result<Self> {
        let failed = |error| write_error(name, error);
        let mut writer = mcap::WriteOptions::new()
            .profile("ros2")
            .library(concat!("wimu ", env!("CARGO_PKG_VERSION")))
            .compression(None)
            .chunk_size(Some(CHUNK_BYTES))
            // Buffers a chunk and appends it whole, instead of going back to write its header.
            .disable_seeking(true)
            .create(sink)
            .map_err(failed)?;
        let schema = writer
            .add_schema(SCHEMA_NAME, "ros2msg", SCHEMA.as_bytes())
            .map_err(failed)?;
        let text = writer
            .add_schema(TEXT_SCHEMA_NAME, "ros2msg", TEXT_SCHEMA.as_bytes())
            .map_err(failed)?;
        let mut metadata = vec![
            ("version", env!("CARGO_PKG_VERSION").to_owned()),
            ("anchor_monotonic_ns", anchor.monotonic_ns.to_string()),
            ("anchor_utc_ns", anchor.utc_ns.to_string()),
        ];
        let mut channels = [(0, 0); TOPICS.len()];
        for (channel, (_, content, topic, key)) in channels.iter_mut().zip(TOPICS) {
            let schema = match content {
                Content::Received | Content::Sent => schema,
                Content::State => text,
            };
            channel.0 = writer
                .add_channel(schema, topic, "cdr", &BTreeMap::new())
                .map_err(failed)?;
            // The channels stand in the first chunk alone: damage there must not lose the rest.
            metadata.push((key, channel.0.to_string()));
        }
        writer
            .write_metadata(&Metadata {
                name: METADATA.to_owned(),
                metadata: metadata
                    .into_iter()
                    .map(|(key, value)| (key.to_owned(), value))
                    .collect(),
            })
            .map_err(failed)?;
        writer.flush().map_err(failed)?;
        Ok(Self {
            name: name.to_owned(),
            writer,
            anchor,
            channels,
            last_flush_ns: None,
            message: Vec::new(),
        })
    }

    /// Appends what the link of `role` received at `host_ns`, ns on the anchored monotonic clock.
    /// Flushes what is a second old.
    ///
    /// # Errors
    /// `file_failed`.
    pub fn append(&mut self, role: LinkRole, host_ns: u64, bytes: &[u8]) -> Result<()> {
        let mut message = std::mem::take(&mut self.message);
        encode(bytes, &mut message);
        let written = self.write(role, Content::Received, host_ns, &message);
        self.message = message;
        written
    }

    /// Appends an entry, as [`append`](Self::append) does.
    ///
    /// # Errors
    /// `file_failed`.
    pub fn record(&mut self, entry: &Recorded) -> Result<()> {
        let mut message = Vec::new();
        match entry {
            Recorded::Received(received) => {
                self.append(received.role, received.host_ns, &received.bytes)
            }
            Recorded::Sent {
                role,
                host_ns,
                bytes,
            } => {
                encode(bytes, &mut message);
                self.write(*role, Content::Sent, *host_ns, &message)
            }
            Recorded::Lost {
                role,
                host_ns,
                reason,
            } => {
                encode_text(&format!("{LOST}{reason}"), &mut message);
                self.write(*role, Content::State, *host_ns, &message)
            }
            Recorded::Connected { role, host_ns } => {
                encode_text(CONNECTED, &mut message);
                self.write(*role, Content::State, *host_ns, &message)
            }
        }
    }

    fn write(
        &mut self,
        role: LinkRole,
        content: Content,
        host_ns: u64,
        message: &[u8],
    ) -> Result<()> {
        let wanted =
            |topic: &(LinkRole, Content, &str, &str)| (topic.0, topic.1) == (role, content);
        let index = TOPICS.iter().position(wanted).unwrap_or(0);
        let (channel_id, sequence) = self.channels[index];
        self.channels[index].1 = sequence.wrapping_add(1);
        let log_time = self.anchor.to_utc_ns(host_ns);
        let header = mcap::records::MessageHeader {
            channel_id,
            sequence,
            log_time,
            publish_time: log_time,
        };
        self.writer
            .write_to_known_channel(&header, message)
            .map_err(|error| write_error(&self.name, error))?;
        self.tick(host_ns)
    }

    /// A further topic, of ROS messages in CDR.
    ///
    /// # Errors
    /// `file_failed`.
    pub fn topic(&mut self, name: &str, schema_name: &str, schema: &str) -> Result<Topic> {
        let failed = |error| write_error(&self.name, error);
        let schema = self
            .writer
            .add_schema(schema_name, "ros2msg", schema.as_bytes())
            .map_err(failed)?;
        let channel = self
            .writer
            .add_channel(schema, name, "cdr", &BTreeMap::new())
            .map_err(|error| write_error(&self.name, error))?;
        Ok(Topic(channel))
    }

    /// Appends a message on a further topic that arrived at `host_ns`, on the anchored monotonic
    /// clock, and tells of `stamp_utc_ns`.
    ///
    /// # Errors
    /// `file_failed`.
    pub fn publish(
        &mut self,
        topic: Topic,
        host_ns: u64,
        stamp_utc_ns: u64,
        message: &[u8],
    ) -> Result<()> {
        let header = mcap::records::MessageHeader {
            channel_id: topic.0,
            sequence: 0,
            log_time: self.anchor.to_utc_ns(host_ns),
            publish_time: stamp_utc_ns,
        };
        self.writer
            .write_to_known_channel(&header, message)
            .map_err(|error| write_error(&self.name, error))
    }

    /// Host's monotonic clock to UTC.
    pub fn anchor(&self) -> ClockAnchor {
        self.anchor
    }

    /// Flushes if a second has passed: for the times when nothing is received.
    ///
    /// # Errors
    /// `file_failed`.
    pub fn tick(&mut self, host_ns: u64) -> Result<()> {
        let last = *self.last_flush_ns.get_or_insert(host_ns);
        if host_ns.saturating_sub(last) >= FLUSH_NS {
            self.last_flush_ns = Some(host_ns);
            self.flush()?;
        }
        Ok(())
    }

    /// Hands everything to the operating system.
    ///
    /// # Errors
    /// `file_failed`.
    pub fn flush(&mut self) -> Result<()> {
        self.writer
            .flush()
            .map_err(|error| write_error(&self.name, error))
    }

    /// Closes the recording with its index.
    ///
    /// # Errors
    /// `file_failed`.
    pub fn finish(mut self) -> Result<W> {
        self.writer
            .finish()
            .map_err(|error| write_error(&self.name, error))?;
        let mut sink = self.writer.into_inner();
        sink.flush()
            .map_err(|error| HostError::file(&self.name, "write", &error))?;
        Ok(sink)
    }
}

fn write_error(name: &str, error: mcap::McapError) -> HostError {
    match error {
        mcap::McapError::Io(error) => HostError::file(name, "write", &error),
        other => HostError::new(
            ErrorCode::FileFailed,
            format!("the recording cannot be written: {other}"),
            "start a new recording",
        )
        .at(name),
    }
}

/// `std_msgs/msg/UInt8MultiArray` in little-endian CDR: encapsulation, no dimensions, offset 0,
/// length, bytes.
fn encode(bytes: &[u8], message: &mut Vec<u8>) {
    message.clear();
    message.extend_from_slice(&PREFIX);
    message.extend_from_slice(&u32::try_from(bytes.len()).unwrap_or(u32::MAX).to_le_bytes());
    message.extend_from_slice(bytes);
}

fn decode(message: &[u8]) -> Option<&[u8]> {
    let (length, bytes) = message.strip_prefix(&PREFIX)?.split_first_chunk::<4>()?;
    bytes.get(..u32::from_le_bytes(*length) as usize)
}

/// `std_msgs/msg/String`.
fn encode_text(text: &str, message: &mut Vec<u8>) {
    message.extend_from_slice(&[0, 1, 0, 0]);
    message.extend_from_slice(&(text.len() as u32 + 1).to_le_bytes());
    message.extend_from_slice(text.as_bytes());
    message.push(0);
}

fn decode_text(message: &[u8]) -> Option<String> {
    let text = message.get(8..)?.strip_suffix(&[0])?;
    Some(String::from_utf8_lossy(text).into_owned())
}

const PREFIX: [u8; 12] = [0, 1, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0];

/// How whole a recording is, known once it has been read to its end.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize)]
pub struct Wholeness {
    /// The file does not end as a closed recording does: it was cut off, is still being written,
    /// or is damaged beyond what was read.
    pub truncated: bool,
    /// Chunks left out because their CRC does not match.
    pub damaged_chunks: u32,
}

/// Reads a recording from its start; memory does not grow with the file.
pub struct RecordingReader<R> {
    name: String,
    source: R,
    records: LinearReader,
    anchor: Option<ClockAnchor>,
    /// Channels of the topics above.
    channels: BTreeMap<u16, (LinkRole, Content)>,
    /// Messages of the chunk being read, last first.
    pending: Vec<Recorded>,
    wholeness: Wholeness,
    /// Whether the start is that of an MCAP file.
    started: bool,
    done: bool,
}

impl RecordingReader<BufReader<File>> {
    /// Opens a recording and reads its first records.
    ///
    /// # Errors
    /// `file_unreadable`, `bad_recording` when it is no MCAP file or was cut off before anything
    /// was recorded.
    pub fn open(path: &Path) -> Result<Self> {
        let name = path.display().to_string();
        let file = File::open(path).map_err(|error| HostError::file(&name, "open", &error))?;
        Self::new(BufReader::new(file), &name)
    }
}

impl<R: Read> RecordingReader<R> {
    /// Reads from `source`, which errors call `name`.
    ///
    /// # Errors
    /// `bad_recording`, `file_failed`.
    pub fn new(source: R, name: &str) -> Result<Self> {
        let options = LinearReaderOptions::default()
            .with_emit_chunks(true)
            .with_record_length_limit(MAX_RECORD_BYTES);
        let mut reader = Self {
            name: name.to_owned(),
            source,
            records: LinearReader::new_with_options(options),
            anchor: None,
            channels: BTreeMap::new(),
            pending: Vec::new(),
            wholeness: Wholeness::default(),
            started: false,
            done: false,
        };
        // The header is the first record: with it the file is an MCAP file.
        reader.step()?;
        if !reader.started {
            return Err(bad_recording("it was cut off before anything was recorded").at(name));
        }
        Ok(reader)
    }

    /// The anchor of the times; `None` if another program has written the file without one: then
    /// times are the file's own.
    pub fn anchor(&mut self) -> Result<Option<ClockAnchor>> {
        while self.anchor.is_none() && self.pending.is_empty() && !self.done {
            self.step()?;
        }
        Ok(self.anchor)
    }

    /// The next bytes received, in the order in which they were recorded; `None` at the end or
    /// where the file is cut off.
    ///
    /// # Errors
    /// Those of [`next_entry`](Self::next_entry).
    pub fn next_received(&mut self) -> Result<Option<Received>> {
        loop {
            match self.next_entry()? {
                Some(Recorded::Received(received)) => return Ok(Some(received)),
                Some(_) => {}
                None => return Ok(None),
            }
        }
    }

    /// The next entry of any kind; `None` at the end or where the file is cut off.
    ///
    /// # Errors
    /// `bad_recording`, `no_wimu_topics` at the end of a file without them, `file_failed`.
    pub fn next_entry(&mut self) -> Result<Option<Recorded>> {
        loop {
            if let Some(entry) = self.pending.pop() {
                return Ok(Some(entry));
            }
            if self.done {
                if self.channels.is_empty() {
                    return Err(HostError::new(
                        ErrorCode::NoWimuTopics,
                        "the file has neither `/wireless/bytes` nor `/cable/bytes`",
                        "give a file written by `wimu record`",
                    )
                    .at(&self.name));
                }
                return Ok(None);
            }
            self.step()?;
        }
    }

    /// How whole the file is; final once [`RecordingReader::next_received`] has given `None`.
    pub fn wholeness(&self) -> Wholeness {
        self.wholeness
    }

    /// Reads one record.
    fn step(&mut self) -> Result<()> {
        loop {
            let event = match self.records.next_event() {
                None => {
                    self.done = true;
                    return Ok(());
                }
                Some(Ok(LinearReadEvent::ReadRequest(wanted))) => {
                    // A damaged length may ask for more than there is.
                    let buffer = self.records.insert(wanted.clamp(1, 1 << 16));
                    let count = match self.source.read(buffer) {
                        Ok(count) => count,
                        Err(error) if error.kind() == std::io::ErrorKind::Interrupted => continue,
                        Err(error) => {
                            self.done = true;
                            return Err(HostError::file(&self.name, "read", &error));
                        }
                    };
                    self.records.notify_read(count);
                    continue;
                }
                Some(Ok(LinearReadEvent::Record { data, opcode })) => {
                    mcap::parse_record(opcode, data).map(Record::into_owned)
                }
                Some(Err(error)) => Err(error),
            };
            return match event {
                Ok(record) => {
                    self.started = true;
                    self.take(record)
                }
                Err(mcap::McapError::BadMagic) if !self.started => {
                    self.done = true;
                    Err(bad_recording("it does not start as an MCAP file does").at(&self.name))
                }
                // The file ends in the middle of a record, or the record's length is damaged and
                // nothing behind it can be found.
                Err(_) => {
                    self.done = true;
                    self.wholeness.truncated = true;
                    Ok(())
                }
            };
        }
    }

    fn take(&mut self, record: Record<'static>) -> Result<()> {
        match record {
            Record::Metadata(metadata) if metadata.name == METADATA && self.anchor.is_none() => {
                for (role, content, _, key) in TOPICS {
                    let id = metadata.metadata.get(key).and_then(|id| id.parse().ok());
                    if let Some(id) = id {
                        self.channels.entry(id).or_insert((role, content));
                    }
                }
                let number = |key| metadata.metadata.get(key)?.parse().ok();
                self.anchor = number("anchor_monotonic_ns")
                    .zip(number("anchor_utc_ns"))
                    .map(|(monotonic_ns, utc_ns)| ClockAnchor {
                        monotonic_ns,
                        utc_ns,
                    });
                Ok(())
            }
            Record::Chunk { header, data } => {
                if !header.compression.is_empty() {
                    self.done = true;
                    return Err(HostError::new(
                        ErrorCode::BadRecording,
                        format!(
                            "it is compressed with {}, which wimu leaves out",
                            header.compression
                        ),
                        "decompress it with `mcap decompress`",
                    )
                    .at(&self.name));
                }
                // Only a whole, undamaged chunk counts: half of one is no loss, it is a second.
                let records = mcap::read::LinearReader::sans_magic(&data);
                let intact = header.uncompressed_crc == 0
                    || crc32fast::hash(&data) == header.uncompressed_crc;
                let parsed: Result<Vec<_>, _> = records.collect();
                match parsed {
                    Ok(records) if intact => {
                        for record in records {
                            self.take_message(record)?;
                        }
                        self.pending.reverse();
                    }
                    _ => self.wholeness.damaged_chunks += 1,
                }
                Ok(())
            }
            record => self.take_message(record),
        }
    }

    /// A record that may stand inside a chunk or outside.
    fn take_message(&mut self, record: Record<'_>) -> Result<()> {
        match record {
            Record::Channel(channel) => {
                let known = TOPICS.iter().find(|topic| topic.2 == channel.topic);
                if let Some((role, content, ..)) = known {
                    self.channels.insert(channel.id, (*role, *content));
                }
            }
            Record::Message { header, data } => {
                let Some(&(role, content)) = self.channels.get(&header.channel_id) else {
                    return Ok(());
                };
                let bad = || {
                    bad_recording("a message on its topic is not of the topic's type").at(format!(
                        "{}, message {} of {role:?}",
                        self.name, header.sequence
                    ))
                };
                let host_ns = self.anchor.map_or(header.log_time, |anchor| {
                    anchor.to_monotonic_ns(header.log_time)
                });
                let bytes = || Ok(decode(&data).ok_or_else(bad)?.to_vec());
                let entry = match content {
                    Content::Received => Recorded::Received(Received {
                        role,
                        host_ns,
                        bytes: bytes()?,
                    }),
                    Content::Sent => Recorded::Sent {
                        role,
                        host_ns,
                        bytes: bytes()?,
                    },
                    Content::State => {
                        let text = decode_text(&data).ok_or_else(bad)?;
                        match text.strip_prefix(LOST) {
                            Some(reason) => Recorded::Lost {
                                role,
                                host_ns,
                                reason: reason.to_owned(),
                            },
                            None => Recorded::Connected { role, host_ns },
                        }
                    }
                };
                self.pending.push(entry);
            }
            _ => {}
        }
        Ok(())
    }
}

impl<R: Read> Iterator for RecordingReader<R> {
    type Item = Result<Received>;

    fn next(&mut self) -> Option<Result<Received>> {
        self.next_received().transpose()
    }
}

fn bad_recording(message: &str) -> HostError {
    HostError::new(
        ErrorCode::BadRecording,
        format!("this is no recording that can be read: {message}"),
        "give a file written by `wimu record`",
    )
}

#[cfg(test)]
mod tests;
