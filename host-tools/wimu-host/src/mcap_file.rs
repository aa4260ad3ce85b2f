//! Recordings: what each link received, byte for byte, with the host's time.
//!
//! An MCAP file of profile `ros2` with the topics `/wireless/bytes` and `/cable/bytes`
//! (`std_msgs/msg/UInt8MultiArray`, `cdr`); beside them `/wireless/sent` and `/cable/sent`, what the
//! host sent, for the clock models, and `/wireless/link` and `/cable/link`
//! (`std_msgs/msg/String`), where a link was lost and came back. Messages are logged in UTC; a metadata record `wimu`
//! holds the one anchor between UTC and the host's monotonic clock, so that the reader gives the
//! monotonic times back exactly. Whole chunks with a CRC are appended and flushed every second: a
//! file cut off at any byte reads up to the last whole chunk.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{self, BufReader, Read, Seek, Write};
use std::path::Path;
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use mcap::records::op;
use wimu_link::LinkRole;

use crate::{Code, Problem, Result};

mod reader;
pub(crate) mod records;
mod writer;

pub use reader::{RecordingReader, Wholeness};
pub use writer::RecordingWriter;
pub(crate) use writer::RosFile;

/// What a topic carries.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Content {
    Received,
    Sent,
    /// Whether the link is connected.
    State,
}

impl Content {
    /// Last part of the topic.
    fn name(self) -> &'static str {
        match self {
            Self::Received => "bytes",
            Self::Sent => "sent",
            Self::State => "link",
        }
    }
}

/// What is recorded of each link.
const TOPICS: [(LinkRole, Content); 6] = [
    (LinkRole::Wireless, Content::Received),
    (LinkRole::Cable, Content::Received),
    (LinkRole::Wireless, Content::Sent),
    (LinkRole::Cable, Content::Sent),
    (LinkRole::Wireless, Content::State),
    (LinkRole::Cable, Content::State),
];

/// Key of the metadata that has the number of a topic's channel.
fn channel_key((role, content): (LinkRole, Content)) -> String {
    match content {
        Content::Received => format!("channel_{role}"),
        _ => format!("channel_{role}_{}", content.name()),
    }
}

const CONNECTED: &str = "connected";
const LOST: &str = "lost: ";
const DAMAGED: &str = "a part of the recording is missing";
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
/// Name of the metadata record with sources of parameters, by id: the text of a calibration file.
const CALIBRATION: &str = "wimu.calibration";
/// A chunk is closed after this time, or at this size.
const FLUSH_NS: u64 = 1_000_000_000;
const CHUNK_BYTES: u64 = 256 * 1024;

/// What wrote an MCAP file, from its first bytes; `None` if they are not those of one.
pub(crate) fn library(start: &[u8]) -> Option<&[u8]> {
    let mut header = start.strip_prefix(mcap::MAGIC)?.get(9..)?;
    // The profile.
    records::sized(&mut header)?;
    records::sized(&mut header)
}

/// Longest record, bytes: far above those of a recording, so that a greater length is damage.
const MAX_RECORD_BYTES: u64 = 64 * 1024 * 1024;

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
        let utc = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
        let ns = |time: Duration| u64::try_from(time.as_nanos()).unwrap_or(u64::MAX);
        Self { monotonic_ns: ns(monotonic), utc_ns: ns(utc) }
    }

    /// A monotonic time in UTC, ns since 1970.
    pub fn to_utc_ns(self, monotonic_ns: u64) -> u64 {
        shift(monotonic_ns, self.monotonic_ns, self.utc_ns)
    }

    fn to_monotonic_ns(self, utc_ns: u64) -> u64 {
        shift(utc_ns, self.utc_ns, self.monotonic_ns)
    }
}

/// Wraps, so that it is reversible for any times in a file.
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
    /// A link was lost: later data do not continue earlier ones.
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
    /// A part of the file is damaged and left out: the data of the link in it are unknown.
    Damaged {
        /// Which link.
        role: LinkRole,
        /// Since when, ns on the host's monotonic clock.
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
            | Self::Connected { host_ns, .. }
            | Self::Damaged { host_ns, .. } => *host_ns,
        }
    }

    /// Of which link.
    pub fn role(&self) -> LinkRole {
        match self {
            Self::Received(received) => received.role,
            Self::Sent { role, .. }
            | Self::Lost { role, .. }
            | Self::Connected { role, .. }
            | Self::Damaged { role, .. } => *role,
        }
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
