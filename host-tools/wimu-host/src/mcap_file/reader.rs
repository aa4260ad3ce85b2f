//! Reader of recordings, complete or not.

use super::*;
use crate::progress::Watched;

/// Completeness of a recording, known once it has been read to its end.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize)]
pub struct Wholeness {
    /// The file does not end like a closed recording: it was cut off, is still being written,
    /// or is damaged beyond the last part read.
    pub truncated: bool,
    /// Chunks left out because their CRC does not match.
    pub damaged_chunks: u32,
}

impl Wholeness {
    /// What is wrong with the file; `None` if it is complete.
    pub fn finding(&self) -> Option<Finding> {
        let cut = "the file is cut off at the end, or damaged from there on".to_owned();
        let damaged = match self.damaged_chunks {
            1 => "1 damaged part of the file was left out".to_owned(),
            parts => format!("{parts} damaged parts of the file were left out"),
        };
        let text = match (self.truncated, self.damaged_chunks) {
            (false, 0) => return None,
            (true, 0) => cut,
            (false, _) => damaged,
            (true, _) => format!("{damaged}; {cut}"),
        };
        Some(FindingCode::Truncated.warning(text))
    }
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
    /// Links with data so far, and their latest host time, ns.
    heard: Vec<LinkRole>,
    latest_ns: u64,
    wholeness: Wholeness,
    /// Whether the start is that of an MCAP file.
    started: bool,
    done: bool,
}

impl RecordingReader<BufReader<Watched>> {
    /// Opens a recording and reads its first records.
    ///
    /// # Errors
    /// `file_unreadable`, `bad_recording` when it is no MCAP file or was cut off before anything
    /// was recorded.
    pub fn open(path: &Path) -> Result<Self> {
        let name = path.display().to_string();
        let file = Watched::open(path).map_err(|error| HostError::file(&name, "open", &error))?;
        Self::new(BufReader::new(file), &name)
    }
}

impl<R: Read> RecordingReader<R> {
    /// Reads from `source`; `name` is its name in errors.
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
            heard: Vec::new(),
            latest_ns: 0,
            wholeness: Wholeness::default(),
            started: false,
            done: false,
        };
        // The header is the first record and identifies an MCAP file.
        reader.step()?;
        if !reader.started {
            return Err(bad_recording("it was cut off before its first record").at(name));
        }
        Ok(reader)
    }

    /// The anchor of the times; `None` if the file has none because another program wrote it: then
    /// times are those of the file.
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
                    return Err(ErrorCode::NoWimuTopics
                        .error(
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

    /// Completeness of the file; final once [`RecordingReader::next_received`] has returned `None`.
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
                    // A damaged length may request more than exists.
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
                    Err(bad_recording("it does not begin like an MCAP file").at(&self.name))
                }
                // The file ends within a record, or the record's length is damaged, so that the next one
                // cannot be found.
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
                for topic in TOPICS {
                    let id = metadata.metadata.get(&channel_key(topic));
                    if let Some(id) = id.and_then(|id| id.parse().ok()) {
                        self.channels.entry(id).or_insert(topic);
                    }
                }
                let number = |key| metadata.metadata.get(key)?.parse().ok();
                self.anchor = number("anchor_monotonic_ns")
                    .zip(number("anchor_utc_ns"))
                    .map(|(monotonic_ns, utc_ns)| ClockAnchor { monotonic_ns, utc_ns });
                Ok(())
            }
            Record::Chunk { header, data } => {
                if !header.compression.is_empty() {
                    self.done = true;
                    return Err(ErrorCode::BadRecording
                        .error(
                            format!(
                                "it is compressed with {}, which wimu does not support",
                                header.compression
                            ),
                            "decompress it with `mcap decompress`",
                        )
                        .at(&self.name));
                }
                // A chunk is one second at most: it is used only if it is complete and undamaged.
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
                    _ => {
                        self.wholeness.damaged_chunks += 1;
                        let host_ns = self.latest_ns;
                        let damaged = |role: &LinkRole| Recorded::Damaged { role: *role, host_ns };
                        self.pending = self.heard.iter().map(damaged).collect();
                    }
                }
                Ok(())
            }
            record => self.take_message(record),
        }
    }

    /// A record inside or outside of a chunk.
    fn take_message(&mut self, record: Record<'_>) -> Result<()> {
        match record {
            Record::Channel(channel) => {
                let is_named = |(role, content): &(LinkRole, Content)| {
                    channel.topic == format!("/{role}/{}", content.name())
                };
                if let Some(topic) = TOPICS.into_iter().find(is_named) {
                    self.channels.insert(channel.id, topic);
                }
            }
            Record::Message { header, data } => {
                let Some(&(role, content)) = self.channels.get(&header.channel_id) else {
                    return Ok(());
                };
                let bad = || {
                    bad_recording("a message on its topic has another type")
                        .at(format!("{}, message {} of {role:?}", self.name, header.sequence))
                };
                let host_ns = self
                    .anchor
                    .map_or(header.log_time, |anchor| anchor.to_monotonic_ns(header.log_time));
                let bytes = || Ok(decode(&data).ok_or_else(bad)?.to_vec());
                let entry = match content {
                    Content::Received => {
                        Recorded::Received(Received { role, host_ns, bytes: bytes()? })
                    }
                    Content::Sent => Recorded::Sent { role, host_ns, bytes: bytes()? },
                    Content::State => {
                        let text = decode_text(&data).ok_or_else(bad)?;
                        match text.strip_prefix(LOST) {
                            Some(reason) => {
                                Recorded::Lost { role, host_ns, reason: reason.to_owned() }
                            }
                            None if text == DAMAGED => Recorded::Damaged { role, host_ns },
                            None => Recorded::Connected { role, host_ns },
                        }
                    }
                };
                if !self.heard.contains(&role) {
                    self.heard.push(role);
                }
                self.latest_ns = self.latest_ns.max(host_ns);
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
    ErrorCode::BadRecording.error(
        format!("this recording cannot be read: {message}"),
        "give a file written by `wimu record`",
    )
}
