//! Reader of recordings, complete or not.

use super::records::{self, Channel, Chunk, Message};
use super::*;
use crate::calibration::source;
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
    pub fn finding(&self) -> Option<Problem> {
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
        Some(Code::Truncated.warning(text))
    }
}

/// Reads a recording from its start; memory does not grow with the file.
pub struct RecordingReader<R> {
    name: String,
    source: R,
    anchor: Option<ClockAnchor>,
    /// Channels of the topics above.
    channels: BTreeMap<u16, (LinkRole, Content)>,
    /// Messages of the chunk being read, last first.
    pending: Vec<Recorded>,
    /// Links with data so far, and their latest host time, ns.
    heard: Vec<LinkRole>,
    latest_ns: u64,
    wholeness: Wholeness,
    done: bool,
}

impl RecordingReader<BufReader<Watched>> {
    /// Opens a recording and reads its first records.
    ///
    /// # Errors
    /// `file_unreadable`, `bad_recording` when it is no MCAP file or was cut off before anything
    /// was recorded.
    pub fn open(path: &Path) -> Result<Self> {
        let name = crate::untrusted::name(path);
        let file = Watched::open(path).map_err(|error| Problem::file(&name, "open", &error))?;
        Self::new(BufReader::new(file), &name)
    }
}

impl<R: Read> RecordingReader<R> {
    /// Reads from `source`; `name` is its name in errors.
    ///
    /// # Errors
    /// `bad_recording`, `file_failed`.
    pub fn new(source: R, name: &str) -> Result<Self> {
        let mut reader = Self {
            name: name.to_owned(),
            source,
            anchor: None,
            channels: BTreeMap::new(),
            pending: Vec::new(),
            heard: Vec::new(),
            latest_ns: 0,
            wholeness: Wholeness::default(),
            done: false,
        };
        let mut start = Vec::new();
        let read = records::fill(&mut reader.source, mcap::MAGIC.len() as u64, &mut start);
        if read.map_err(|error| Problem::file(name, "read", &error))? && start != mcap::MAGIC {
            return Err(bad_recording("it does not begin like an MCAP file").at(name));
        }
        // The header is the first record.
        reader.step()?;
        if reader.wholeness.truncated {
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
                    return Err(Code::NoWimuTopics
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
        let mut record = Vec::new();
        let read = self.read(&mut record);
        let Some(code) = read.map_err(|error| {
            self.done = true;
            Problem::file(&self.name, "read", &error)
        })?
        else {
            self.cut();
            return Ok(());
        };
        let taken = match code {
            op::FOOTER => {
                self.done = true;
                self.wholeness.truncated = record != mcap::MAGIC;
                return Ok(());
            }
            op::METADATA => self.metadata(&record),
            op::CHUNK => self.chunk(&record)?,
            _ => self.record(code, &record)?,
        };
        if taken.is_none() {
            self.cut();
        }
        Ok(())
    }

    /// Code and bytes of the next record; of the last one, the bytes after it. `None` where the file is cut off.
    fn read(&mut self, record: &mut Vec<u8>) -> io::Result<Option<u8>> {
        let code = records::next(&mut self.source, MAX_RECORD_BYTES, record)?;
        if code == Some(op::FOOTER) {
            records::fill(&mut self.source, mcap::MAGIC.len() as u64, record)?;
        }
        Ok(code)
    }

    /// The file ends within a record, or a length in it is damaged, so that the next one cannot be found.
    fn cut(&mut self) {
        self.done = true;
        self.wholeness.truncated = true;
    }

    fn metadata(&mut self, record: &[u8]) -> Option<()> {
        let records::Metadata { name, values } = records::Metadata::parse(record)?;
        if name == CALIBRATION {
            values.values().for_each(|text| source::learn_text(text));
        }
        if name != METADATA || self.anchor.is_some() {
            return Some(());
        }
        for topic in TOPICS {
            let id = values.get(channel_key(topic).as_str());
            if let Some(id) = id.and_then(|id| id.parse().ok()) {
                self.channels.entry(id).or_insert(topic);
            }
        }
        let number = |key| values.get(key)?.parse().ok();
        self.anchor = number("anchor_monotonic_ns")
            .zip(number("anchor_utc_ns"))
            .map(|(monotonic_ns, utc_ns)| ClockAnchor { monotonic_ns, utc_ns });
        Some(())
    }

    /// A chunk is one second at most: it is used only if it is complete and undamaged. `None` if its own fields are not.
    fn chunk(&mut self, record: &[u8]) -> Result<Option<()>> {
        let Some(chunk) = Chunk::parse(record).filter(|chunk| !chunk.short) else {
            return Ok(None);
        };
        if !chunk.compression.is_empty() {
            self.done = true;
            let compression = String::from_utf8_lossy(chunk.compression);
            return Err(Code::BadRecording
                .error(
                    format!("it is compressed with {compression}, which wimu does not support"),
                    "decompress it with `mcap decompress`",
                )
                .at(&self.name));
        }
        if !chunk.holds(chunk.stored) || records::each(chunk.stored, |_, _| {}) > 0 {
            self.wholeness.damaged_chunks += 1;
            let host_ns = self.latest_ns;
            let damaged = |role: &LinkRole| Recorded::Damaged { role: *role, host_ns };
            self.pending = self.heard.iter().map(damaged).collect();
            return Ok(Some(()));
        }
        let mut outcome = Ok(());
        records::each(chunk.stored, |code, record| {
            if outcome.is_ok() {
                outcome = self.record(code, record).map(drop);
            }
        });
        self.pending.reverse();
        outcome.map(Some)
    }

    /// A record inside or outside of a chunk; `None` if it is damaged.
    fn record(&mut self, code: u8, record: &[u8]) -> Result<Option<()>> {
        match code {
            op::CHANNEL => Ok(self.channel(record)),
            op::MESSAGE => {
                let message = Message::parse(record);
                message.map(|message| self.message(&message)).transpose()
            }
            _ => Ok(Some(())),
        }
    }

    fn channel(&mut self, record: &[u8]) -> Option<()> {
        let channel = Channel::parse(record)?;
        let is_named = |(role, content): &(LinkRole, Content)| {
            channel.topic == format!("/{role}/{}", content.name())
        };
        if let Some(topic) = TOPICS.into_iter().find(is_named) {
            self.channels.insert(channel.id, topic);
        }
        Some(())
    }

    fn message(&mut self, message: &Message) -> Result<()> {
        let Some(&(role, content)) = self.channels.get(&message.channel) else {
            return Ok(());
        };
        let bad = || {
            bad_recording("a message on its topic has another type")
                .at(format!("{}, message {} of {role:?}", self.name, message.sequence))
        };
        let host_ns =
            self.anchor.map_or(message.log_ns, |anchor| anchor.to_monotonic_ns(message.log_ns));
        let bytes = || Ok(decode(message.data).ok_or_else(bad)?.to_vec());
        let entry = match content {
            Content::Received => Recorded::Received(Received { role, host_ns, bytes: bytes()? }),
            Content::Sent => Recorded::Sent { role, host_ns, bytes: bytes()? },
            Content::State => {
                let text = decode_text(message.data).ok_or_else(bad)?;
                match text.strip_prefix(LOST) {
                    Some(reason) => Recorded::Lost { role, host_ns, reason: reason.to_owned() },
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
        Ok(())
    }
}

impl<R: Read> Iterator for RecordingReader<R> {
    type Item = Result<Received>;

    fn next(&mut self) -> Option<Result<Received>> {
        self.next_received().transpose()
    }
}

fn bad_recording(message: &str) -> Problem {
    Code::BadRecording.error(
        format!("this recording cannot be read: {message}"),
        "give a file written by `wimu record`",
    )
}
