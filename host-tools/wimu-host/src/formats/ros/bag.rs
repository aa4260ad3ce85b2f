//! ROS 1 bags of version 2.0: records of a header with named fields, and data.
//! Format: <http://wiki.ros.org/Bags/Format/2.0>.

use std::collections::BTreeMap;
use std::io::{self, SeekFrom};

use super::chunk::{self, fill, number, sized};
use super::message::Encoding;
use super::{Messages, ReadOptions, Source};
use crate::error::{ErrorCode, HostError, Result};
use crate::formats::source::ReadSeek;
use crate::recording::Sink;

const MAGIC: &[u8] = b"#ROSBAG V";
const VERSION: &[u8] = b"#ROSBAG V2.0\n";

/// The records' codes, in the field `op`.
mod op {
    pub(super) const MESSAGE: u8 = 2;
    pub(super) const CHUNK: u8 = 5;
    pub(super) const CHUNK_INFO: u8 = 6;
    pub(super) const CONNECTION: u8 = 7;
}

/// Bags of any version.
pub(in crate::formats) fn detect(source: &Source) -> bool {
    source.start().starts_with(MAGIC)
}

/// Hands the messages to the sink.
pub(in crate::formats) fn read(
    source: &Source,
    options: &ReadOptions,
    sink: &mut dyn Sink,
) -> Result<()> {
    if !source.start().starts_with(VERSION) {
        return Err(ErrorCode::UnknownFormat
            .error(
                "this is not a ROS 1 bag of version 2.0",
                "convert an older bag: `rosbag filter OLD.bag NEW.bag True`",
            )
            .at(source.name()));
    }
    let mut reader = Reader {
        messages: Messages::new(source, options, sink),
        topics: BTreeMap::new(),
    };
    let failed = |error| HostError::file(source.name(), "read", &error);
    if let Some(at) = reader.walk(&mut *source.reader()?).map_err(failed)? {
        reader.messages.cut(source.name(), at);
    }
    reader.messages.finish()
}

struct Reader<'a> {
    messages: Messages<'a>,
    /// Numbers of topics by connection.
    topics: BTreeMap<u32, usize>,
}

impl Reader<'_> {
    /// Reads all records; returns where the file ends early or cannot be followed.
    fn walk(&mut self, file: &mut dyn ReadSeek) -> io::Result<Option<u64>> {
        let end = file.seek(SeekFrom::End(0))?;
        let mut at = file.seek(SeekFrom::Start(VERSION.len() as u64))?;
        let (mut header, mut data) = (Vec::new(), Vec::new());
        // Follows the last chunk of a bag that was closed.
        let mut indexed = false;
        while at < end {
            let mut next = at + 8;
            let length = length(file)?.filter(|length| *length <= chunk::MAX_BYTES);
            if !fill(&mut *file, length.unwrap_or(0), &mut header)? || length.is_none() {
                return Ok(Some(at));
            }
            next += header.len() as u64;
            let Some(length) = self::length(file)? else {
                return Ok(Some(at));
            };
            next += length;
            let code = code(&header);
            match code {
                Some(op::MESSAGE | op::CHUNK | op::CONNECTION) if length <= chunk::MAX_BYTES => {
                    let whole = fill(&mut *file, length, &mut data)?;
                    self.record(&header, &data, !whole);
                }
                _ if next <= end => {
                    indexed |= code == Some(op::CHUNK_INFO);
                    file.seek(SeekFrom::Start(next))?;
                }
                _ => {}
            }
            if next > end {
                return Ok(Some(at));
            }
            at = next;
        }
        Ok((!indexed).then_some(at))
    }

    /// A record; one that is `cut` off is used if it is a chunk.
    fn record(&mut self, header: &[u8], data: &[u8], cut: bool) {
        let _ = match code(header) {
            Some(op::CHUNK) => self.chunk(header, data, cut),
            Some(op::CONNECTION) if !cut => self.connection(header, data),
            Some(op::MESSAGE) if !cut => self.message(header, data),
            _ => None,
        };
    }

    fn chunk(&mut self, header: &[u8], data: &[u8], cut: bool) -> Option<()> {
        let size = field(header, b"size").and_then(|mut size| number(&mut size));
        let size = u64::from(size.map_or(u32::MAX, u32::from_le_bytes));
        let compression = field(header, b"compression").unwrap_or_default();
        let records = match chunk::decompress(compression, data, size, cut) {
            Ok(records) => records,
            Err(reason) => {
                self.messages.damaged_chunk(reason);
                return None;
            }
        };
        let mut records: &[u8] = &records;
        while !records.is_empty() {
            let (header, data) = sized(&mut records).zip(sized(&mut records))?;
            if code(header) != Some(op::CHUNK) {
                self.record(header, data, false);
            }
        }
        Some(())
    }

    fn connection(&mut self, header: &[u8], data: &[u8]) -> Option<()> {
        let id = u32::from_le_bytes(number(&mut field(header, b"conn")?)?);
        let topic = String::from_utf8_lossy(field(header, b"topic")?);
        let message = String::from_utf8_lossy(field(data, b"type")?);
        let index = (self.messages).topic(&topic, &message, Some(Encoding::Ros1));
        self.topics.insert(id, index);
        Some(())
    }

    fn message(&mut self, header: &[u8], data: &[u8]) -> Option<()> {
        let id = u32::from_le_bytes(number(&mut field(header, b"conn")?)?);
        let mut time = field(header, b"time")?;
        let seconds = i64::from(u32::from_le_bytes(number(&mut time)?));
        let ns = i64::from(u32::from_le_bytes(number(&mut time)?));
        let topic = *self.topics.get(&id)?;
        self.messages
            .message(topic, seconds * 1_000_000_000 + ns, data);
        Some(())
    }
}

/// The length in the next four bytes; `None` at the end.
fn length(file: &mut dyn ReadSeek) -> io::Result<Option<u64>> {
    let mut bytes = Vec::new();
    fill(file, 4, &mut bytes)?;
    let bytes = bytes.first_chunk::<4>();
    Ok(bytes.map(|bytes| u64::from(u32::from_le_bytes(*bytes))))
}

/// The code of a record.
fn code(header: &[u8]) -> Option<u8> {
    field(header, b"op")?.first().copied()
}

/// The value of a field of a header.
fn field<'a>(mut header: &'a [u8], name: &[u8]) -> Option<&'a [u8]> {
    while let Some(field) = sized(&mut header) {
        let value = field.strip_prefix(name);
        if let Some(value) = value.and_then(|value| value.strip_prefix(b"=")) {
            return Some(value);
        }
    }
    None
}
