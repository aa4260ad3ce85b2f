//! Messages that wait for the broker: a little in memory, the rest in bounded files; the oldest are dropped first.

use std::collections::VecDeque;
use std::fs::{self, File};
use std::io::{self, Read, Write};
use std::path::{Path, PathBuf};

/// Bytes held in memory before files are used: what a killed gateway may lose beside what is under way.
const MEMORY: u64 = 1 << 20;
/// A file is closed at this size, and dropped as a whole.
const SEGMENT: u64 = 1 << 20;
/// Bytes before topic and payload: their lengths (2, 4) and the CRC-32 of both.
const HEAD: usize = 10;
/// Number of the first file: smaller ones are for messages that precede it.
const FIRST: u64 = 1 << 32;

/// A message to publish.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Message {
    pub topic: String,
    pub payload: Vec<u8>,
}

impl Message {
    fn bytes(&self) -> u64 {
        (self.topic.len() + self.payload.len()) as u64
    }

    fn encode(&self) -> Vec<u8> {
        let mut crc = crc32fast::Hasher::new();
        crc.update(self.topic.as_bytes());
        crc.update(&self.payload);
        let mut out = Vec::with_capacity(HEAD + self.topic.len() + self.payload.len());
        out.extend((self.topic.len() as u16).to_le_bytes());
        out.extend((self.payload.len() as u32).to_le_bytes());
        out.extend(crc.finalize().to_le_bytes());
        out.extend(self.topic.as_bytes());
        out.extend(&self.payload);
        out
    }

    /// Removes a message from the front of `bytes`; `None` at their end, or where they are damaged.
    fn decode(bytes: &mut &[u8]) -> Option<Self> {
        let (head, rest) = bytes.split_first_chunk::<HEAD>()?;
        let [a, b, c, d, e, f, crc @ ..] = *head;
        let (topic, rest) = rest.split_at_checked(u16::from_le_bytes([a, b]).into())?;
        let (payload, rest) = rest.split_at_checked(u32::from_le_bytes([c, d, e, f]) as usize)?;
        let mut found = crc32fast::Hasher::new();
        found.update(topic);
        found.update(payload);
        if found.finalize() != u32::from_le_bytes(crc) {
            return None;
        }
        *bytes = rest;
        Some(Self {
            topic: String::from_utf8(topic.to_vec()).ok()?,
            payload: payload.to_vec(),
        })
    }
}

/// Messages in order. Those in memory are older than those in files.
pub struct Spool {
    memory: VecDeque<Message>,
    memory_bytes: u64,
    folder: Option<PathBuf>,
    /// Most bytes in files; without a folder, in memory.
    limit: u64,
    segments: VecDeque<Segment>,
    /// The last segment, if it is being written.
    writer: Option<File>,
    /// Messages dropped: the limit was reached, the disk is full, or a file is damaged.
    pub dropped: u64,
}

struct Segment {
    number: u64,
    messages: u64,
    bytes: u64,
}

impl Spool {
    /// A spool of at most `limit` bytes in files of `folder`, with what an earlier one has left there; without a folder in
    /// memory.
    ///
    /// # Errors
    /// Those of the folder.
    pub fn open(folder: Option<&Path>, limit: u64) -> io::Result<Self> {
        let mut segments = Vec::new();
        if let Some(folder) = folder {
            fs::create_dir_all(folder)?;
            for entry in fs::read_dir(folder)? {
                let name = entry?.file_name();
                let number = name.to_str().and_then(|name| name.strip_suffix(".spool"));
                if let Some(number) = number.and_then(|hex| u64::from_str_radix(hex, 16).ok()) {
                    segments.push(Segment {
                        number,
                        messages: 0,
                        bytes: 0,
                    });
                }
            }
        }
        segments.sort_by_key(|segment| segment.number);
        let mut spool = Self {
            memory: VecDeque::new(),
            memory_bytes: 0,
            folder: folder.map(Path::to_owned),
            limit: limit.max(2 * SEGMENT),
            segments: segments.into(),
            writer: None,
            dropped: 0,
        };
        for index in 0..spool.segments.len() {
            let (messages, bytes) = spool.read(spool.segments[index].number)?;
            spool.segments[index].messages = messages.len() as u64;
            spool.segments[index].bytes = bytes;
        }
        Ok(spool)
    }

    /// Messages that wait.
    pub fn messages(&self) -> u64 {
        self.memory.len() as u64 + self.segments.iter().map(|s| s.messages).sum::<u64>()
    }

    /// Bytes in files.
    pub fn file_bytes(&self) -> u64 {
        self.segments.iter().map(|segment| segment.bytes).sum()
    }

    /// Appends a message.
    pub fn push(&mut self, message: Message) {
        let fits = self.memory_bytes + message.bytes() <= MEMORY;
        if self.segments.is_empty() && (fits || self.folder.is_none()) {
            self.memory_bytes += message.bytes();
            self.memory.push_back(message);
            while self.folder.is_none() && self.memory_bytes > self.limit {
                self.dropped += u64::from(self.take_memory().is_some());
            }
        } else if self.append(&message.encode()).is_err() {
            // The disk is full: room is made once at the cost of the oldest.
            self.writer = None;
            self.drop_oldest();
            self.dropped += u64::from(self.append(&message.encode()).is_err());
        }
    }

    /// Puts messages back that precede all others.
    pub fn put_back(&mut self, messages: impl DoubleEndedIterator<Item = Message>) {
        for message in messages.rev() {
            self.memory_bytes += message.bytes();
            self.memory.push_front(message);
        }
    }

    /// The oldest message.
    pub fn pop(&mut self) -> Option<Message> {
        if self.memory.is_empty() && !self.segments.is_empty() {
            // The segment stays until the next one is needed: a killed gateway repeats it, and receivers leave
            // repetitions out.
            self.writer = None;
            let segment = self.segments.pop_front()?;
            let (messages, _) = self.read(segment.number).unwrap_or_default();
            self.dropped += segment.messages.saturating_sub(messages.len() as u64);
            self.memory_bytes = messages.iter().map(Message::bytes).sum();
            self.memory = messages.into();
            self.remove(segment.number);
        }
        self.take_memory()
    }

    /// Writes what is in memory to a file, before the program ends.
    ///
    /// # Errors
    /// Those of the file.
    pub fn save(&mut self) -> io::Result<()> {
        let Some(folder) = self.folder.as_ref().filter(|_| !self.memory.is_empty()) else {
            return Ok(());
        };
        let number = self
            .segments
            .front()
            .map_or(FIRST, |segment| segment.number)
            - 1;
        let bytes: Vec<u8> = self.memory.iter().flat_map(Message::encode).collect();
        fs::write(file(folder, number), bytes)
    }

    fn take_memory(&mut self) -> Option<Message> {
        let message = self.memory.pop_front()?;
        self.memory_bytes -= message.bytes();
        Some(message)
    }

    fn append(&mut self, bytes: &[u8]) -> io::Result<()> {
        let folder = self.folder.as_ref().ok_or(io::ErrorKind::NotFound)?;
        let is_full = self
            .segments
            .back()
            .is_some_and(|last| last.bytes >= SEGMENT);
        if self.writer.is_none() || is_full {
            let number = self.segments.back().map_or(FIRST, |last| last.number + 1);
            self.writer = Some(
                File::options()
                    .create_new(true)
                    .append(true)
                    .open(file(folder, number))?,
            );
            self.segments.push_back(Segment {
                number,
                messages: 0,
                bytes: 0,
            });
        }
        if let (Some(writer), Some(last)) = (&mut self.writer, self.segments.back_mut()) {
            let written = writer.write_all(bytes);
            if written.is_err() {
                // A part of a message would hide those after it.
                writer.set_len(last.bytes)?;
            }
            written?;
            last.messages += 1;
            last.bytes += bytes.len() as u64;
        }
        while self.file_bytes() > self.limit {
            self.drop_oldest();
        }
        Ok(())
    }

    fn drop_oldest(&mut self) {
        if let Some(oldest) = self.segments.pop_front() {
            self.dropped += oldest.messages;
            self.remove(oldest.number);
        }
        if self.segments.is_empty() {
            self.writer = None;
        }
    }

    fn read(&self, number: u64) -> io::Result<(Vec<Message>, u64)> {
        let mut bytes = Vec::new();
        if let Some(folder) = &self.folder {
            File::open(file(folder, number))?.read_to_end(&mut bytes)?;
        }
        let mut rest = &bytes[..];
        let messages = std::iter::from_fn(|| Message::decode(&mut rest)).collect();
        Ok((messages, bytes.len() as u64))
    }

    fn remove(&self, number: u64) {
        if let Some(folder) = &self.folder {
            let _ = fs::remove_file(file(folder, number));
        }
    }
}

fn file(folder: &Path, number: u64) -> PathBuf {
    folder.join(format!("{number:016x}.spool"))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn message(number: u32) -> Message {
        let mut payload = vec![0; 10_000];
        payload[..4].copy_from_slice(&number.to_le_bytes());
        Message {
            topic: "wimu/f/b/up".to_owned(),
            payload,
        }
    }

    fn numbers(spool: &mut Spool) -> Vec<u32> {
        let number = |m: Message| u32::from_le_bytes(m.payload[..4].try_into().unwrap());
        std::iter::from_fn(|| spool.pop()).map(number).collect()
    }

    #[test]
    fn order_is_kept_across_memory_files_and_a_restart() {
        let folder = tempfile::tempdir().unwrap();
        let open = || Spool::open(Some(folder.path()), 64 << 20).unwrap();
        let mut spool = open();
        (0..500).for_each(|number| spool.push(message(number)));
        assert!(spool.file_bytes() > 3_000_000);
        let first: Vec<_> = (0..3).map(|_| spool.pop().unwrap()).collect();
        spool.put_back(first.into_iter());
        spool.save().unwrap();
        let mut spool = open();
        assert_eq!(spool.messages(), 500);
        spool.push(message(500));
        assert_eq!(numbers(&mut spool), Vec::from_iter(0..=500));
        assert_eq!(
            (spool.dropped, fs::read_dir(folder.path()).unwrap().count()),
            (0, 0)
        );
    }

    #[test]
    fn beyond_the_limit_the_oldest_are_dropped_and_counted() {
        let folder = tempfile::tempdir().unwrap();
        for folder in [Some(folder.path()), None] {
            let mut spool = Spool::open(folder, 2 << 20).unwrap();
            (0..1000).for_each(|number| spool.push(message(number)));
            let (dropped, kept) = (spool.dropped as usize, numbers(&mut spool));
            assert_eq!(dropped + kept.len(), 1000);
            assert_eq!(kept.last(), Some(&999));
            assert!(kept.is_sorted() && kept.len() < 330, "{}", kept.len());
        }
    }

    #[test]
    fn a_damaged_file_loses_what_follows_the_damage_and_no_other() {
        let folder = tempfile::tempdir().unwrap();
        let mut spool = Spool::open(Some(folder.path()), 64 << 20).unwrap();
        (0..400).for_each(|number| spool.push(message(number)));
        let mut files: Vec<_> = fs::read_dir(folder.path())
            .unwrap()
            .map(|e| e.unwrap().path())
            .collect();
        files.sort();
        let mut bytes = fs::read(&files[0]).unwrap();
        bytes[500_000] ^= 1;
        fs::write(&files[0], bytes).unwrap();
        let kept = numbers(&mut spool);
        assert_eq!(kept.len() as u64 + spool.dropped, 400);
        assert!(kept.is_sorted() && kept.len() > 300 && spool.dropped > 0);
    }
}
