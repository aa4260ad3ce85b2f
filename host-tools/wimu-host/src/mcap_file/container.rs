//! The container: an MCAP file, written chunk by chunk.
//!
//! The writer of the `mcap` crate (0.26) keeps an index entry of every chunk until the file is closed:
//! of 24 h flushed every second it takes 21 MB, and 40 MB while it closes, where this one takes 2.7 MB,
//! as of an hour, because it reads the chunks' places back from the file. Size (211 MB), loss on `kill -9`
//! (less than 1 s) and time to close (0.2 s) are alike. What it writes is read with the `mcap` crate.

use std::io::BufReader;

use super::*;

/// The records' codes.
mod op {
    pub(super) const HEADER: u8 = 0x01;
    pub(super) const FOOTER: u8 = 0x02;
    pub(super) const SCHEMA: u8 = 0x03;
    pub(super) const CHANNEL: u8 = 0x04;
    pub(super) const MESSAGE: u8 = 0x05;
    pub(super) const CHUNK: u8 = 0x06;
    pub(super) const MESSAGE_INDEX: u8 = 0x07;
    pub(super) const CHUNK_INDEX: u8 = 0x08;
    pub(super) const STATISTICS: u8 = 0x0b;
    pub(super) const METADATA: u8 = 0x0c;
    pub(super) const METADATA_INDEX: u8 = 0x0d;
    pub(super) const SUMMARY_OFFSET: u8 = 0x0e;
    pub(super) const DATA_END: u8 = 0x0f;
}

/// Code and length.
const RECORD_HEAD: usize = 9;
/// A chunk's own fields, without compression, up to its records.
const CHUNK_HEAD: usize = 40;
/// A chunk is closed at this size, if it is not flushed before.
const CHUNK_BYTES: usize = 256 * 1024;
/// Size of the index held in memory while a file is closed, bytes.
const INDEX_BYTES: usize = 64 * 1024;

/// An MCAP file being written. Dropping it closes it, unless writing has failed.
pub(super) struct Container<W: Read + Write + Seek> {
    /// `None` once it is closed or given back.
    sink: Option<W>,
    /// Bytes written.
    position: u64,
    /// The open chunk: its header, to be filled in, and its records.
    chunk: Vec<u8>,
    /// Time and offset in the chunk of its messages, per channel.
    index: BTreeMap<u16, Vec<(u64, u64)>>,
    /// First and last time of the chunk's messages.
    chunk_times: Option<(u64, u64)>,
    /// Names and complete records, which the summary repeats. The first schema has number 1.
    schemas: Vec<(String, Vec<u8>)>,
    /// Complete records. The first channel has number 0.
    channels: Vec<Vec<u8>>,
    /// Complete index records.
    metadata: Vec<Vec<u8>>,
    chunks: u32,
    /// Messages per channel.
    messages: BTreeMap<u16, u64>,
    times: Option<(u64, u64)>,
}

impl<W: Read + Write + Seek> Container<W> {
    /// Begins a file in `sink`, which is empty.
    pub(super) fn new(sink: W, profile: &str, library: &str) -> io::Result<Self> {
        let mut container = Self {
            sink: Some(sink),
            position: 0,
            chunk: Vec::new(),
            index: BTreeMap::new(),
            chunk_times: None,
            schemas: Vec::new(),
            channels: Vec::new(),
            metadata: Vec::new(),
            chunks: 0,
            messages: BTreeMap::new(),
            times: None,
        };
        let mut start = mcap::MAGIC.to_vec();
        record(&mut start, op::HEADER, |header| {
            text(header, profile);
            text(header, library);
        });
        container.put(&start)?;
        Ok(container)
    }

    /// The number of a schema of ROS messages, added if it is new.
    pub(super) fn schema(&mut self, name: &str, definition: &str) -> u16 {
        let known = self.schemas.iter().position(|schema| schema.0 == name);
        let id = known.unwrap_or(self.schemas.len()) as u16 + 1;
        if known.is_none() {
            let mut schema = Vec::new();
            record(&mut schema, op::SCHEMA, |schema| {
                schema.extend(id.to_le_bytes());
                text(schema, name);
                text(schema, "ros2msg");
                text(schema, definition);
            });
            self.open_chunk().extend(&schema);
            self.schemas.push((name.to_owned(), schema));
        }
        id
    }

    /// The number of a new channel of messages in CDR.
    pub(super) fn channel(&mut self, schema: u16, topic: &str) -> u16 {
        let id = self.channels.len() as u16;
        let mut channel = Vec::new();
        record(&mut channel, op::CHANNEL, |channel| {
            channel.extend(id.to_le_bytes());
            channel.extend(schema.to_le_bytes());
            text(channel, topic);
            text(channel, "cdr");
            channel.extend(0_u32.to_le_bytes());
        });
        self.open_chunk().extend(&channel);
        self.channels.push(channel);
        id
    }

    /// Appends metadata, after the open chunk.
    pub(super) fn write_metadata(
        &mut self,
        name: &str,
        metadata: &[(&str, String)],
    ) -> io::Result<()> {
        self.close_chunk()?;
        let start = self.position;
        let mut bytes = Vec::new();
        record(&mut bytes, op::METADATA, |bytes| {
            text(bytes, name);
            sized(bytes, |bytes| {
                for (key, value) in metadata {
                    text(bytes, key);
                    text(bytes, value);
                }
            });
        });
        self.put(&bytes)?;
        let mut index = Vec::new();
        record(&mut index, op::METADATA_INDEX, |index| {
            index.extend(start.to_le_bytes());
            index.extend((bytes.len() as u64).to_le_bytes());
            text(index, name);
        });
        self.metadata.push(index);
        Ok(())
    }

    /// Appends a message.
    pub(super) fn write(&mut self, message: &Message<'_>) -> io::Result<()> {
        let &Message {
            channel,
            log_time,
            publish_time,
            sequence,
            data,
        } = message;
        let chunk = self.open_chunk();
        let place = (chunk.len() - RECORD_HEAD - CHUNK_HEAD) as u64;
        record(chunk, op::MESSAGE, |chunk| {
            chunk.extend(channel.to_le_bytes());
            chunk.extend(sequence.to_le_bytes());
            chunk.extend(log_time.to_le_bytes());
            chunk.extend(publish_time.to_le_bytes());
            chunk.extend(data);
        });
        self.index
            .entry(channel)
            .or_default()
            .push((log_time, place));
        for times in [&mut self.chunk_times, &mut self.times] {
            let (first, last) = times.unwrap_or((log_time, log_time));
            *times = Some((first.min(log_time), last.max(log_time)));
        }
        *self.messages.entry(channel).or_default() += 1;
        if self.chunk.len() >= CHUNK_BYTES {
            self.close_chunk()?;
        }
        Ok(())
    }

    /// Writes all buffered data to the file.
    pub(super) fn flush(&mut self) -> io::Result<()> {
        self.close_chunk()?;
        self.sink()?.flush()
    }

    /// Closes the file with its index; returns the sink.
    pub(super) fn finish(mut self) -> io::Result<W> {
        self.close()?;
        self.sink.take().ok_or_else(closed)
    }

    /// Returns the sink without closing the file.
    #[cfg(test)]
    pub(super) fn abandon(mut self) -> W {
        self.sink.take().unwrap()
    }

    /// The open chunk, to be appended to.
    fn open_chunk(&mut self) -> &mut Vec<u8> {
        if self.chunk.is_empty() {
            self.chunk.resize(RECORD_HEAD + CHUNK_HEAD, 0);
        }
        &mut self.chunk
    }

    /// Writes the open chunk and the index of its messages.
    fn close_chunk(&mut self) -> io::Result<()> {
        if self.chunk.is_empty() {
            return Ok(());
        }
        let mut chunk = std::mem::take(&mut self.chunk);
        let records = (chunk.len() - RECORD_HEAD - CHUNK_HEAD) as u64;
        let (first, last) = self.chunk_times.take().unwrap_or_default();
        let mut head = vec![op::CHUNK];
        head.extend((records + CHUNK_HEAD as u64).to_le_bytes());
        head.extend(first.to_le_bytes());
        head.extend(last.to_le_bytes());
        head.extend(records.to_le_bytes());
        head.extend(crc32fast::hash(&chunk[RECORD_HEAD + CHUNK_HEAD..]).to_le_bytes());
        text(&mut head, "");
        head.extend(records.to_le_bytes());
        chunk[..RECORD_HEAD + CHUNK_HEAD].copy_from_slice(&head);
        for (channel, messages) in std::mem::take(&mut self.index) {
            record(&mut chunk, op::MESSAGE_INDEX, |index| {
                index.extend(channel.to_le_bytes());
                sized(index, |index| {
                    for (time, place) in messages {
                        index.extend(time.to_le_bytes());
                        index.extend(place.to_le_bytes());
                    }
                });
            });
        }
        self.put(&chunk)?;
        self.chunks += 1;
        chunk.clear();
        self.chunk = chunk;
        Ok(())
    }

    fn sink(&mut self) -> io::Result<&mut W> {
        self.sink.as_mut().ok_or_else(closed)
    }

    fn put(&mut self, bytes: &[u8]) -> io::Result<()> {
        let written = self.sink()?.write_all(bytes);
        match written {
            Ok(()) => self.position += bytes.len() as u64,
            // A partial record may have been written: nothing after it could be read.
            Err(_) => self.sink = None,
        }
        written
    }

    fn close(&mut self) -> io::Result<()> {
        self.close_chunk()?;
        let data_end = self.position;
        let mut end = Vec::new();
        record(&mut end, op::DATA_END, |end| {
            // No CRC of all data: every chunk has its own.
            end.extend(0_u32.to_le_bytes());
        });
        self.put(&end)?;

        let summary_start = self.position;
        let mut summary = Summary::default();
        let schemas: Vec<u8> = (self.schemas.iter()).flat_map(|s| s.1.clone()).collect();
        self.put_group(&mut summary, op::SCHEMA, &schemas)?;
        self.put_group(&mut summary, op::CHANNEL, &self.channels.concat())?;
        let statistics = self.statistics();
        self.put_group(&mut summary, op::STATISTICS, &statistics)?;
        let start = self.position;
        self.put_chunk_index(&mut summary, data_end)?;
        summary.group(op::CHUNK_INDEX, start, self.position);
        self.put_group(&mut summary, op::METADATA_INDEX, &self.metadata.concat())?;

        let offsets_start = self.position;
        let mut footer = std::mem::take(&mut summary.offsets);
        footer.push(op::FOOTER);
        footer.extend(20_u64.to_le_bytes());
        footer.extend(summary_start.to_le_bytes());
        footer.extend(offsets_start.to_le_bytes());
        summary.crc.update(&footer);
        footer.extend(summary.crc.finalize().to_le_bytes());
        footer.extend(mcap::MAGIC);
        self.put(&footer)?;
        self.sink()?.flush()
    }

    /// Writes records of one kind to the summary.
    fn put_group(&mut self, summary: &mut Summary, code: u8, records: &[u8]) -> io::Result<()> {
        let start = self.position;
        summary.crc.update(records);
        self.put(records)?;
        summary.group(code, start, self.position);
        Ok(())
    }

    fn statistics(&self) -> Vec<u8> {
        let (first, last) = self.times.unwrap_or_default();
        let mut bytes = Vec::new();
        record(&mut bytes, op::STATISTICS, |bytes| {
            bytes.extend(self.messages.values().sum::<u64>().to_le_bytes());
            bytes.extend((self.schemas.len() as u16).to_le_bytes());
            bytes.extend((self.channels.len() as u32).to_le_bytes());
            // No attachments.
            bytes.extend(0_u32.to_le_bytes());
            bytes.extend((self.metadata.len() as u32).to_le_bytes());
            bytes.extend(self.chunks.to_le_bytes());
            bytes.extend(first.to_le_bytes());
            bytes.extend(last.to_le_bytes());
            sized(bytes, |bytes| {
                for (channel, messages) in &self.messages {
                    bytes.extend(channel.to_le_bytes());
                    bytes.extend(messages.to_le_bytes());
                }
            });
        });
        bytes
    }

    /// Writes an index record of every chunk, read back from the chunks before `data_end`.
    fn put_chunk_index(&mut self, summary: &mut Summary, data_end: u64) -> io::Result<()> {
        let mut at = mcap::MAGIC.len() as u64;
        while at < data_end {
            let mut entries = Vec::new();
            // Headers are far apart: the data between are skipped.
            let mut source = BufReader::with_capacity(512, self.sink()?);
            source.seek(io::SeekFrom::Start(at))?;
            let mut chunk: Option<ChunkPlace> = None;
            while at < data_end {
                let mut head = [0; RECORD_HEAD];
                source.read_exact(&mut head)?;
                let [code, length @ ..] = head;
                if code != op::MESSAGE_INDEX {
                    if let Some(chunk) = chunk.take() {
                        chunk.index(&mut entries);
                    }
                    if entries.len() >= INDEX_BYTES {
                        break;
                    }
                }
                let length = u64::from_le_bytes(length);
                let mut read = 0;
                if code == op::CHUNK {
                    let mut head = [0; CHUNK_HEAD];
                    source.read_exact(&mut head)?;
                    read = head.len() as u64;
                    chunk = Some(ChunkPlace::new(at, head));
                } else if let (op::MESSAGE_INDEX, Some(chunk)) = (code, &mut chunk) {
                    let mut channel = [0; 2];
                    source.read_exact(&mut channel)?;
                    read = channel.len() as u64;
                    chunk.messages.push((channel, at));
                }
                // The length is that of a record of this writer.
                let rest = length
                    .checked_sub(read)
                    .and_then(|rest| rest.try_into().ok());
                source.seek_relative(rest.ok_or_else(changed)?)?;
                at = (at + RECORD_HEAD as u64)
                    .checked_add(length)
                    .ok_or_else(changed)?;
                if let Some(chunk) = &mut chunk {
                    chunk.end = at;
                }
            }
            if let Some(chunk) = chunk {
                chunk.index(&mut entries);
            }
            let end = io::SeekFrom::Start(self.position);
            self.sink()?.seek(end)?;
            summary.crc.update(&entries);
            self.put(&entries)?;
        }
        Ok(())
    }
}

impl<W: Read + Write + Seek> Drop for Container<W> {
    fn drop(&mut self) {
        if self.sink.is_some() {
            let _ = self.close();
        }
    }
}

/// A message to write.
pub(super) struct Message<'a> {
    pub(super) channel: u16,
    pub(super) log_time: u64,
    pub(super) publish_time: u64,
    pub(super) sequence: u32,
    pub(super) data: &'a [u8],
}

/// Checksum and offsets of the summary.
#[derive(Default)]
struct Summary {
    crc: crc32fast::Hasher,
    /// Complete records.
    offsets: Vec<u8>,
}

impl Summary {
    /// Records of one kind were written.
    fn group(&mut self, code: u8, start: u64, end: u64) {
        if start < end {
            record(&mut self.offsets, op::SUMMARY_OFFSET, |offset| {
                offset.push(code);
                offset.extend(start.to_le_bytes());
                offset.extend((end - start).to_le_bytes());
            });
        }
    }
}

/// Offsets of a chunk and of the index of its messages.
struct ChunkPlace {
    start: u64,
    head: [u8; CHUNK_HEAD],
    /// Channels, as in the file, and the offset of their index.
    messages: Vec<([u8; 2], u64)>,
    /// End of the index of its messages.
    end: u64,
}

impl ChunkPlace {
    fn new(start: u64, head: [u8; CHUNK_HEAD]) -> Self {
        Self {
            start,
            head,
            messages: Vec::new(),
            end: 0,
        }
    }

    /// Appends its index record.
    fn index(&self, entries: &mut Vec<u8>) {
        // Both times, the size, the CRC, no compression, the size as stored.
        let [.., s0, s1, s2, s3, s4, s5, s6, s7] = self.head;
        let records = [s0, s1, s2, s3, s4, s5, s6, s7];
        let heads = (RECORD_HEAD + CHUNK_HEAD) as u64;
        let length = u64::from_le_bytes(records).saturating_add(heads);
        record(entries, op::CHUNK_INDEX, |entry| {
            entry.extend(&self.head[..16]);
            entry.extend(self.start.to_le_bytes());
            entry.extend(length.to_le_bytes());
            sized(entry, |entry| {
                for (channel, at) in &self.messages {
                    entry.extend(channel);
                    entry.extend(at.to_le_bytes());
                }
            });
            let index_length = self.end.saturating_sub(self.start.saturating_add(length));
            entry.extend(index_length.to_le_bytes());
            text(entry, "");
            entry.extend(records);
            entry.extend(records);
        });
    }
}

/// Appends a record.
fn record(bytes: &mut Vec<u8>, code: u8, content: impl FnOnce(&mut Vec<u8>)) {
    bytes.push(code);
    let start = bytes.len() + 8;
    bytes.extend([0; 8]);
    content(bytes);
    let length = (bytes.len() - start) as u64;
    bytes[start - 8..start].copy_from_slice(&length.to_le_bytes());
}

/// Appends content after its length in bytes.
fn sized(bytes: &mut Vec<u8>, content: impl FnOnce(&mut Vec<u8>)) {
    let start = bytes.len() + 4;
    bytes.extend([0; 4]);
    content(bytes);
    let length = (bytes.len() - start) as u32;
    bytes[start - 4..start].copy_from_slice(&length.to_le_bytes());
}

fn text(bytes: &mut Vec<u8>, text: &str) {
    sized(bytes, |bytes| bytes.extend(text.as_bytes()));
}

fn closed() -> io::Error {
    io::Error::other("writing has failed before")
}

fn changed() -> io::Error {
    io::Error::other("another program has changed it")
}
