//! ROS 2 bags in MCAP: a file, or a folder with `metadata.yaml` and files in sequence.

use std::borrow::Cow;
use std::collections::BTreeMap;

use ::mcap::MAGIC;
use ::mcap::records::op;

use super::chunk;
use super::{Messages, ReadOptions, Source};
use crate::mcap_file::records::{Channel, Chunk, Message, each, fill, number, text};
use crate::recording::Sink;
use crate::ros::message::Encoding;
use crate::{Problem, Result};

/// Longest record that is passed over, bytes: above any file, and far below what may be sought.
const MAX_SKIPPED: u64 = 1 << 40;

/// Files of a bag that begin with `magic`, in the order of recording.
pub(super) fn files<'a>(source: &'a Source, magic: &[u8]) -> Vec<&'a Source> {
    let mut files = match source.members() {
        [] => vec![source],
        members => members.iter().collect(),
    };
    files.retain(|file| file.start().starts_with(magic));
    // Names end with a number without leading zeros.
    files.sort_by_key(|file| (file.name().len(), file.name().to_owned()));
    let mut members = source.members().iter();
    let bag = files.len() == 1 || members.any(|file| file.name().ends_with("metadata.yaml"));
    if bag { files } else { Vec::new() }
}

/// Any MCAP file but recordings of wimu without decoded messages.
pub(in crate::formats) fn detect(source: &Source) -> bool {
    !files(source, MAGIC).is_empty()
}

pub(in crate::formats) fn read(
    source: &Source,
    options: &ReadOptions,
    sink: &mut dyn Sink,
) -> Result<()> {
    let mut messages = Messages::new(source, options, sink);
    for file in files(source, MAGIC) {
        let mut reader = Reader {
            messages: &mut messages,
            schemas: BTreeMap::new(),
            channels: BTreeMap::new(),
            read: 0,
            orphans: 0,
            counted: 0,
        };
        let cut_at = walk(file, |code, record, at, cut| match code {
            op::CHUNK => reader.chunk(record, at, cut),
            op::STATISTICS => {
                let count = record.first_chunk().copied();
                reader.counted = count.map_or(0, u64::from_le_bytes);
            }
            _ if cut => {}
            _ => reader.record(code, record),
        })?;
        let missing = reader.counted.saturating_sub(reader.read);
        let missing = missing.max(reader.orphans);
        messages.damage.missing(missing);
        if let Some(at) = cut_at {
            messages.damage.cut(file.name(), at);
        }
    }
    messages.finish()
}

/// Hands code, bytes and position of the records on that may lead to messages or count them, and whether a record is
/// cut off. Returns where the file ends early or cannot be followed.
fn walk(file: &Source, mut see: impl FnMut(u8, &[u8], u64, bool)) -> Result<Option<u64>> {
    let failed = |error| Problem::file(file.name(), "read", &error);
    let mut reader = file.reader()?;
    let mut head = [0; 9];
    let mut record = Vec::new();
    let mut at = MAGIC.len() as u64;
    fill(&mut reader, at, &mut record).map_err(failed)?;
    loop {
        if !fill(&mut reader, head.len() as u64, &mut record).map_err(failed)? {
            return Ok(Some(at));
        }
        head.copy_from_slice(&record);
        let [code, length @ ..] = head;
        let length = u64::from_le_bytes(length);
        match code {
            op::FOOTER => return Ok(None),
            op::SCHEMA | op::CHANNEL | op::MESSAGE | op::CHUNK | op::STATISTICS
                if length <= chunk::MAX_BYTES =>
            {
                let whole = fill(&mut reader, length, &mut record).map_err(failed)?;
                see(code, &record, at, !whole);
            }
            op::SCHEMA | op::CHANNEL | op::MESSAGE | op::CHUNK => return Ok(Some(at)),
            _ if length > MAX_SKIPPED => return Ok(Some(at)),
            _ => reader.seek_relative(length as i64).map_err(failed)?,
        }
        at = at.saturating_add(head.len() as u64 + length);
    }
}

/// A chunk's records, at the end of the file also those before the end.
fn records<'a>(chunk: &Chunk<'a>, at_end: bool) -> Result<Cow<'a, [u8]>, String> {
    let cut = at_end && chunk.short;
    let records = chunk::decompress(chunk.compression, chunk.stored, chunk.size, cut)?;
    if !cut && !chunk.holds(&records) {
        return Err("its CRC does not match".to_owned());
    }
    Ok(records)
}

struct Reader<'a, 'b> {
    messages: &'a mut Messages<'b>,
    /// Names of types.
    schemas: BTreeMap<u16, String>,
    /// Numbers of topics.
    channels: BTreeMap<u16, usize>,
    /// Messages: read, not readable or without a channel, and counted by the statistics.
    read: u64,
    orphans: u64,
    counted: u64,
}

impl Reader<'_, '_> {
    fn chunk(&mut self, record: &[u8], at: u64, cut: bool) {
        let records = match Chunk::parse(record) {
            Some(chunk) => self::records(&chunk, cut),
            None if cut => return,
            None => Err("its header is damaged".to_owned()),
        };
        match records {
            Ok(records) => {
                let left = each(&records, |code, record| self.record(code, record));
                if left > 0 {
                    self.messages.damage.gap(at, left as u64);
                }
            }
            Err(reason) => self.messages.damage.add(format!("a chunk is left out: {reason}")),
        }
    }

    /// A record that is no chunk. Damaged ones outside chunks are left out: nothing refers to them then.
    fn record(&mut self, code: u8, record: &[u8]) {
        let _ = match code {
            op::SCHEMA => self.schema(record),
            op::CHANNEL => self.channel(record),
            op::MESSAGE => {
                let read = self.message(record).is_some();
                self.read += u64::from(read);
                self.orphans += u64::from(!read);
                None
            }
            _ => None,
        };
    }

    fn schema(&mut self, mut record: &[u8]) -> Option<()> {
        let id = u16::from_le_bytes(number(&mut record)?);
        self.schemas.insert(id, text(&mut record)?.into_owned());
        Some(())
    }

    fn channel(&mut self, record: &[u8]) -> Option<()> {
        let channel = Channel::parse(record)?;
        let schema = self.schemas.get(&channel.schema)?;
        let encoding = match channel.encoding {
            b"cdr" => Some(Encoding::Cdr),
            b"ros1" => Some(Encoding::Ros1),
            _ => None,
        };
        let index = self.messages.topic(&channel.topic, schema, encoding);
        self.channels.insert(channel.id, index);
        Some(())
    }

    fn message(&mut self, record: &[u8]) -> Option<()> {
        let message = Message::parse(record)?;
        let topic = *self.channels.get(&message.channel)?;
        self.messages.message(topic, message.log_ns as i64, message.data);
        Some(())
    }
}
