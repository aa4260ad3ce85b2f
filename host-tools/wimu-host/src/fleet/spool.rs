//! Messages that wait for the broker: a little in memory, the rest in bounded files; the oldest are dropped first.

use std::collections::VecDeque;
use std::fs::{self, File};
use std::io::{self, Write};
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use crate::{Code, Problem, Result};

/// Bytes held in memory before files are used: what a killed gateway may lose beside what is under way.
const MEMORY: u64 = 1 << 20;
/// A file is closed at this size, and dropped as a whole.
const SEGMENT: u64 = 1 << 20;
/// Number of the first file: smaller ones are for messages that precede it.
const FIRST: u64 = 1 << 32;
/// No file has this number or a greater one.
const LAST: u64 = 1 << 48;

/// A message to publish.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Message {
    pub topic: String,
    pub payload: Vec<u8>,
}

impl Message {
    pub fn bytes(&self) -> u64 {
        (self.topic.len() + self.payload.len()) as u64
    }

    fn crc(&self) -> u32 {
        let mut crc = crc32fast::Hasher::new();
        crc.update(self.topic.as_bytes());
        crc.update(&self.payload);
        crc.finalize()
    }

    fn encode(&self) -> Vec<u8> {
        postcard::to_stdvec(&(self.crc(), self)).unwrap_or_default()
    }

    /// Removes a message from the front of `bytes`; `None` at their end, or where they are damaged.
    fn decode(bytes: &mut &[u8]) -> Option<Self> {
        let ((crc, message), rest) = postcard::take_from_bytes::<(u32, Self)>(bytes).ok()?;
        *bytes = rest;
        (crc == message.crc()).then_some(message)
    }
}

/// Messages in order. Those in memory are older than those in files.
pub struct Spool {
    memory: VecDeque<Message>,
    memory_bytes: u64,
    folder: PathBuf,
    /// Held while the folder is used.
    _lock: File,
    /// Most bytes in files.
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
    /// A spool of at most `limit` bytes in files of `folder`, with what an earlier one has left there.
    ///
    /// # Errors
    /// `link_busy` when another gateway uses the folder; those of the folder.
    pub fn open(folder: &Path, limit: u64) -> Result<Self> {
        let name = folder.display().to_string();
        let failed = |error| Problem::file(&name, "open", &error);
        fs::create_dir_all(folder).map_err(failed)?;
        let path = folder.join("lock");
        let lock = open_lock(&path);
        let lock = lock.map_err(|e| Problem::file(&path.display().to_string(), "open", &e))?;
        if lock.try_lock().is_err() {
            let remedy = "stop it, or give this one a `gateway` name of its own";
            let error = Code::LinkBusy.error("another gateway uses this spool", remedy);
            return Err(error.at(name));
        }
        let mut spool = Self {
            memory: VecDeque::new(),
            memory_bytes: 0,
            folder: folder.to_owned(),
            _lock: lock,
            limit: limit.max(2 * SEGMENT),
            segments: VecDeque::new(),
            writer: None,
            dropped: 0,
        };
        for entry in fs::read_dir(folder).map_err(failed)? {
            let entry = entry.map_err(failed)?;
            let Some(number) = number_of(&entry) else {
                continue;
            };
            let (messages, bytes) = spool.read(number).map_err(failed)?;
            let messages = messages.len() as u64;
            spool.segments.push_back(Segment { number, messages, bytes });
        }
        let segments = spool.segments.make_contiguous();
        segments.sort_by_key(|segment| segment.number);
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
        if self.segments.is_empty() && fits {
            self.memory_bytes += message.bytes();
            self.memory.push_back(message);
        } else if self.append(&message.encode()).is_err() {
            // The disk is full: room is made once at the cost of the oldest.
            self.writer = None;
            self.drop_oldest();
            self.dropped += u64::from(self.append(&message.encode()).is_err());
        }
    }

    /// Puts a message back that precedes all others.
    pub fn put_back(&mut self, message: Message) {
        self.memory_bytes += message.bytes();
        self.memory.push_front(message);
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
        let message = self.memory.pop_front()?;
        self.memory_bytes -= message.bytes();
        Some(message)
    }

    /// Writes what is in memory to a file, before the program ends.
    ///
    /// # Errors
    /// Those of the file.
    pub fn save(&mut self) -> io::Result<()> {
        if self.memory.is_empty() {
            return Ok(());
        }
        let next = self.segments.front().map_or(FIRST, |next| next.number);
        let bytes: Vec<u8> = self.memory.iter().flat_map(Message::encode).collect();
        let (_, mut file) = self.create((0..next).rev())?;
        file.write_all(&bytes)
    }

    fn append(&mut self, bytes: &[u8]) -> io::Result<()> {
        let is_full = self.segments.back().is_some_and(|last| last.bytes >= SEGMENT);
        if self.writer.is_none() || is_full {
            let next = self.segments.back().map_or(FIRST, |last| last.number + 1);
            let (number, file) = self.create(next..)?;
            self.writer = Some(file);
            self.segments.push_back(Segment { number, messages: 0, bytes: 0 });
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
        let bytes = fs::read(self.file(number))?;
        let mut rest = &bytes[..];
        let messages = std::iter::from_fn(|| Message::decode(&mut rest)).collect();
        Ok((messages, bytes.len() as u64))
    }

    fn remove(&self, number: u64) {
        let _ = fs::remove_file(self.file(number));
    }

    /// Creates the file with the first number whose name is free.
    fn create(&self, numbers: impl IntoIterator<Item = u64>) -> io::Result<(u64, File)> {
        for number in numbers {
            match File::options().create_new(true).append(true).open(self.file(number)) {
                Err(error) if error.kind() == io::ErrorKind::AlreadyExists => {}
                created => return created.map(|file| (number, file)),
            }
        }
        Err(io::ErrorKind::AlreadyExists.into())
    }

    fn file(&self, number: u64) -> PathBuf {
        self.folder.join(format!("{number:016x}.spool"))
    }
}

/// Number of a file as [`Spool::file`] names them; `None` for anything else in the folder.
fn number_of(entry: &fs::DirEntry) -> Option<u64> {
    let name = entry.file_name().into_string().ok()?;
    let number = u64::from_str_radix(name.strip_suffix(".spool")?, 16).ok()?;
    let is_ours = name == format!("{number:016x}.spool") && entry.file_type().ok()?.is_file();
    (is_ours && number < LAST).then_some(number)
}

/// Opens the lock, which is never written. A link to another file is refused.
fn open_lock(path: &Path) -> io::Result<File> {
    match File::options().write(true).create_new(true).open(path) {
        Err(error) if error.kind() == io::ErrorKind::AlreadyExists => {}
        created => return created,
    }
    if !fs::symlink_metadata(path)?.is_file() {
        return Err(io::ErrorKind::AlreadyExists.into());
    }
    File::options().write(true).open(path)
}
