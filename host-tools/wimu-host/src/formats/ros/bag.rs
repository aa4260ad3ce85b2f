//! ROS 1 bags of version 2.0: records of a header with named fields, and data.
//! Format: <http://wiki.ros.org/Bags/Format/2.0>.

use std::collections::BTreeMap;
use std::io::{self, SeekFrom};

use super::chunk;
use super::{Messages, ReadOptions, Source};
use crate::formats::source::ReadSeek;
use crate::mcap_file::records::{fill, number, sized};
use crate::recording::Sink;
use crate::ros::message::Encoding;
use crate::{Code, Problem, Result};

const MAGIC: &[u8] = b"#ROSBAG V";
const VERSION: &[u8] = b"#ROSBAG V2.0\n";
/// Longest header of a record, bytes: far above the names of topics in it.
const MAX_HEADER: u64 = 64 * 1024;
/// Most damaged parts of a file or chunk after which the next record is looked for.
const MAX_GAPS: usize = 1000;

/// The records' codes, in the field `op`.
mod op {
    pub(super) const MESSAGE: u8 = 2;
    pub(super) const BAG_HEADER: u8 = 3;
    pub(super) const INDEX_DATA: u8 = 4;
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
        return Err(Code::UnknownFormat
            .error(
                "this is not a ROS 1 bag of version 2.0",
                "convert an older bag: `rosbag filter OLD.bag NEW.bag True`",
            )
            .at(source.name()));
    }
    let mut reader = Reader {
        messages: Messages::new(source, options, sink),
        topics: BTreeMap::new(),
        orphans: 0,
        is_closed: false,
        chunk_at: None,
    };
    let failed = |error| Problem::file(source.name(), "read", &error);
    let mut file = source.reader()?;
    let end = file.seek(SeekFrom::End(0)).map_err(failed)?;
    let cut = reader.walk(&mut *file, VERSION.len() as u64, end).map_err(failed)?;
    // Chunk infos follow the last chunk of a bag that was closed.
    if let Some(at) = cut.or((!reader.is_closed).then_some(end)) {
        reader.messages.damage.cut("the file", at);
    }
    reader.messages.damage.missing(reader.orphans);
    reader.messages.finish()
}

struct Reader<'a> {
    messages: Messages<'a>,
    /// Numbers of topics by connection.
    topics: BTreeMap<u32, usize>,
    /// Messages without a connection.
    orphans: u64,
    is_closed: bool,
    /// Position of the chunk whose records are read.
    chunk_at: Option<u64>,
}

/// A record before its data.
struct Head {
    header: Vec<u8>,
    length: u64,
}

impl Reader<'_> {
    /// Reads the records from `at` to `end`, over damaged ones; returns from where on none is found.
    fn walk(&mut self, file: &mut dyn ReadSeek, at: u64, end: u64) -> io::Result<Option<u64>> {
        let (mut at, mut gaps, mut data) = (at, 0, Vec::new());
        let mut head = self::head(file, at)?;
        while at < end {
            // From where to look for the next record, if this one is damaged.
            let mut from = at + 1;
            if let Some(Head { header, length }) = &head {
                let (data_at, length) = (at + 8 + header.len() as u64, *length);
                let chunk = code(header) == Some(op::CHUNK);
                let next = data_at + length;
                let used = length <= chunk::MAX_BYTES && code(header) != Some(op::INDEX_DATA);
                if used {
                    seek(file, data_at)?;
                    fill(&mut *file, length.min(end - data_at.min(end)), &mut data)?;
                }
                let following = if next < end { self::head(file, next)? } else { None };
                let fits = next == end
                    || following.is_some()
                    || next < end && find(file, data_at, end)?.is_none_or(|found| found >= next);
                // The records of a chunk without compression are found in the file, too.
                let is_packed =
                    chunk && !matches!(field(header, b"compression"), Some(b"" | b"none"));
                if used && (fits || is_packed) {
                    self.record(header, &data, at, !fits)?;
                } else if fits && length > chunk::MAX_BYTES {
                    self.gap(at, next);
                }
                if fits {
                    (at, head) = (next, following);
                    continue;
                }
                from = data_at;
            }
            gaps += 1;
            match find(file, from, end)? {
                Some(found) if gaps <= MAX_GAPS => {
                    self.gap(at, found);
                    (at, head) = (found, self::head(file, found)?);
                }
                _ => return Ok(Some(at)),
            }
        }
        Ok(None)
    }

    /// Records between two positions that are left out.
    fn gap(&mut self, at: u64, end: u64) {
        self.messages.damage.gap(self.chunk_at.unwrap_or(at), end - at);
    }

    /// A record; of a chunk that is `cut` off or of a wrong length the first part.
    fn record(&mut self, header: &[u8], data: &[u8], at: u64, cut: bool) -> io::Result<()> {
        let read = match code(header) {
            Some(op::CHUNK) if self.chunk_at.is_none() => {
                return self.chunk(header, data, at, cut);
            }
            Some(op::CONNECTION) => self.connection(header, data),
            Some(op::MESSAGE) => {
                self.orphans += u64::from(self.message(header, data).is_none());
                Some(())
            }
            code => {
                self.is_closed |= code == Some(op::CHUNK_INFO);
                Some(())
            }
        };
        if read.is_none() {
            self.gap(at, at + 8 + (header.len() + data.len()) as u64);
        }
        Ok(())
    }

    fn chunk(&mut self, header: &[u8], data: &[u8], at: u64, cut: bool) -> io::Result<()> {
        let size = field(header, b"size").and_then(|mut size| number(&mut size));
        let size = u64::from(size.map_or(u32::MAX, u32::from_le_bytes));
        let compression = field(header, b"compression").unwrap_or_default();
        match chunk::decompress(compression, data, size, cut) {
            Ok(records) => {
                let end = records.len() as u64;
                self.chunk_at = Some(at);
                if let Some(from) = self.walk(&mut io::Cursor::new(&*records), 0, end)? {
                    self.gap(from, end);
                }
                self.chunk_at = None;
            }
            Err(reason) => self.messages.damage.add(format!("a chunk is left out: {reason}")),
        }
        Ok(())
    }

    fn connection(&mut self, header: &[u8], data: &[u8]) -> Option<()> {
        let id = u32::from_le_bytes(number(&mut field(header, b"conn")?)?);
        let topic = String::from_utf8_lossy(field(header, b"topic")?);
        let message = String::from_utf8_lossy(field(data, b"type")?);
        let index = (self.messages).topic(&topic, &message, Some(Encoding::Ros1));
        let first = *self.topics.entry(id).or_insert(index);
        if first == index {
            return Some(());
        }
        // One of both is damaged.
        if self.messages.topics[first].layout.is_none() {
            self.topics.insert(id, index);
        }
        None
    }

    fn message(&mut self, header: &[u8], data: &[u8]) -> Option<()> {
        let id = u32::from_le_bytes(number(&mut field(header, b"conn")?)?);
        let mut time = field(header, b"time")?;
        let seconds = i64::from(u32::from_le_bytes(number(&mut time)?));
        let ns = i64::from(u32::from_le_bytes(number(&mut time)?));
        let topic = *self.topics.get(&id)?;
        self.messages.message(topic, seconds * 1_000_000_000 + ns, data);
        Some(())
    }
}

/// Seeks, unless the position is the current one: that would discard a buffer.
fn seek(file: &mut dyn ReadSeek, at: u64) -> io::Result<()> {
    if file.stream_position()? != at {
        file.seek(SeekFrom::Start(at))?;
    }
    Ok(())
}

/// The record at a position; `None` if none begins there.
fn head(file: &mut dyn ReadSeek, at: u64) -> io::Result<Option<Head>> {
    seek(file, at)?;
    let mut header = Vec::new();
    let Some(bytes) = length(file)?.filter(|bytes| *bytes <= MAX_HEADER) else {
        return Ok(None);
    };
    if !fill(&mut *file, bytes, &mut header)? || !is_header(&header) {
        return Ok(None);
    }
    Ok(length(file)?.map(|length| Head { header, length }))
}

/// The first position from `at` on where a record begins.
fn find(file: &mut dyn ReadSeek, mut at: u64, end: u64) -> io::Result<Option<u64>> {
    let mut window = Vec::new();
    while at < end {
        seek(file, at)?;
        fill(&mut *file, (end - at).min(4 * MAX_HEADER), &mut window)?;
        // A header that begins in the last part of the window is whole in the next one.
        let last = at + window.len() as u64 >= end;
        let margin = if last { 0 } else { MAX_HEADER as usize + 4 };
        let starts = window.len().saturating_sub(margin);
        let begins = |start: &usize| {
            let header = sized(&mut &window[*start..]);
            header.is_some_and(|header| header.len() as u64 <= MAX_HEADER && is_header(header))
        };
        if let Some(start) = (0..starts).find(begins) {
            return Ok(Some(at + start as u64));
        }
        at += starts.max(1) as u64;
    }
    Ok(None)
}

/// The length in the next four bytes; `None` at the end.
fn length(file: &mut dyn ReadSeek) -> io::Result<Option<u64>> {
    let mut bytes = Vec::new();
    fill(file, 4, &mut bytes)?;
    let bytes = bytes.first_chunk::<4>();
    Ok(bytes.map(|bytes| u64::from(u32::from_le_bytes(*bytes))))
}

/// Whether a record has this header: nothing but fields, with those that its code requires.
fn is_header(header: &[u8]) -> bool {
    let required: [&[u8]; 2] = match code(header) {
        Some(op::MESSAGE) => [b"conn", b"time"],
        Some(op::BAG_HEADER) => [b"index_pos", b"chunk_count"],
        Some(op::INDEX_DATA) => [b"conn", b"count"],
        Some(op::CHUNK) => [b"compression", b"size"],
        Some(op::CHUNK_INFO) => [b"chunk_pos", b"count"],
        Some(op::CONNECTION) => [b"conn", b"topic"],
        _ => return false,
    };
    let mut rest = header;
    while sized(&mut rest).is_some_and(|field| field.contains(&b'=')) {}
    rest.is_empty() && required.iter().all(|name| field(header, name).is_some())
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
