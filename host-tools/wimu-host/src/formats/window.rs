//! Sequential reading of binary logs: bytes ahead of a position, and a count of damaged ones.

use std::io::{Read, Seek, SeekFrom};
use std::ops::Range;

use super::Source;
use super::source::ReadSeek;
use crate::plural::counted;
use crate::{Code, Problem, Result};

/// Bytes read at once.
const CHUNK: usize = 1 << 16;

/// A source from a position on; holds the bytes that were looked at, and one chunk.
pub(super) struct Window {
    name: String,
    reader: Box<dyn ReadSeek>,
    buffer: Vec<u8>,
    start: usize,
    position: u64,
}

impl Window {
    /// A source from byte `position` on.
    pub(super) fn new(source: &Source, position: u64) -> Result<Self> {
        let mut window = Self {
            name: source.name().to_owned(),
            reader: source.reader()?,
            buffer: Vec::new(),
            start: 0,
            position,
        };
        let sought = window.reader.seek(SeekFrom::Start(position));
        sought.map_err(|error| Problem::file(&window.name, "read", &error))?;
        Ok(window)
    }

    /// The next `count` bytes, or fewer at the end of the source.
    pub(super) fn peek(&mut self, count: usize) -> Result<&[u8]> {
        if self.buffer.len() - self.start < count {
            self.buffer.drain(..self.start);
            self.start = 0;
            let missing = (count - self.buffer.len()).max(CHUNK) as u64;
            let read = (&mut self.reader).take(missing).read_to_end(&mut self.buffer);
            read.map_err(|error| Problem::file(&self.name, "read", &error))?;
        }
        let ahead = &self.buffer[self.start..];
        Ok(&ahead[..count.min(ahead.len())])
    }

    /// Moves on by `count` bytes, which were looked at.
    pub(super) fn skip(&mut self, count: usize) {
        let count = count.min(self.buffer.len() - self.start);
        self.start += count;
        self.position += count as u64;
    }

    /// Position in the source of the next byte.
    pub(super) fn position(&self) -> u64 {
        self.position
    }
}

/// Bytes that belong to no readable record.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Damage {
    /// Number of connected pieces.
    places: usize,
    /// Their total length.
    bytes: u64,
    /// Position after the latest.
    end: u64,
    /// Number of times that the logger lost data, and their total length, ms.
    dropouts: (usize, u64),
}

impl Damage {
    /// Counts one byte.
    pub(super) fn add(&mut self, position: u64) {
        if self.places == 0 || position != self.end {
            self.places += 1;
        }
        self.bytes += 1;
        self.end = position + 1;
    }

    /// Counts a time in which the logger lost data.
    pub(super) fn add_dropout(&mut self, duration_ms: u16) {
        self.dropouts.0 += 1;
        self.dropouts.1 += u64::from(duration_ms);
    }

    /// What there is of it in a span of a source.
    pub(super) fn findings(&self, span: Range<u64>) -> Vec<Problem> {
        let mut findings = Vec::new();
        let (dropouts, lost_ms) = self.dropouts;
        if dropouts > 0 {
            let text =
                format!("{} of the logger, {lost_ms} ms in all", counted(dropouts, "dropout"));
            let remedy = "log fewer topics, or use a faster memory card";
            findings.push(Code::Rate.warning(text).remedy(remedy));
        }
        let is_last = self.end == span.end;
        let end = if is_last { ", the last at the end of the file" } else { "" };
        let evidence = format!(
            "{} of {} bytes belong to no readable record, in {}{end}",
            self.bytes,
            span.end - span.start,
            counted(self.places, "place"),
        );
        if self.places > 0 {
            findings.push(Code::Truncated.warning(evidence).remedy("they are left out"));
        }
        findings
    }

    /// Refuses a source of `length` bytes if more than half of it is damaged.
    pub(super) fn refuse_most(&self, source: &Source, length: u64) -> Result<()> {
        if self.bytes * 2 <= length {
            return Ok(());
        }
        let message = format!("{} of {length} bytes belong to no readable record", self.bytes);
        let remedy = "copy the file from the device again";
        Err(Code::BadRecording.error(message, remedy).at(source.name()))
    }
}

/// Type of a little-endian number of so many bytes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Number {
    Unsigned(usize),
    Signed(usize),
    Float(usize),
}

impl Number {
    pub(super) fn bytes(self) -> usize {
        match self {
            Self::Unsigned(bytes) | Self::Signed(bytes) | Self::Float(bytes) => bytes,
        }
    }

    /// The number at an offset; exact for integers below 2⁵³.
    pub(super) fn read(self, bytes: &[u8], offset: usize) -> Option<f64> {
        let bytes = bytes.get(offset..)?.get(..self.bytes())?;
        let mut wide = [0; 8];
        wide[..bytes.len()].copy_from_slice(bytes);
        let (value, unused) = (u64::from_le_bytes(wide), 64 - 8 * bytes.len());
        Some(match self {
            Self::Unsigned(_) => value as f64,
            Self::Signed(_) => ((value << unused) as i64 >> unused) as f64,
            Self::Float(4) => f32::from_bits(value as u32).into(),
            Self::Float(_) => f64::from_bits(value),
        })
    }
}

/// The little-endian number of `N` bytes at an offset, if they are there.
pub(super) fn bytes_at<const N: usize>(bytes: &[u8], offset: usize) -> Option<[u8; N]> {
    bytes.get(offset..)?.first_chunk().copied()
}

/// Refusal of a source without inertial data: `found` names what it has.
pub(super) fn no_inertial_data(source: &Source, wanted: &str, found: &[String]) -> Problem {
    const MOST: usize = 20;
    let mut names = found[..found.len().min(MOST)].join(", ");
    match found.len() {
        0 => names.push_str("no messages at all"),
        count if count > MOST => names.push_str(&format!(" and {} more", count - MOST)),
        _ => (),
    }
    Code::NoRows
        .error(format!("it has no inertial data, but {names}"), format!("record {wanted}"))
        .at(source.name())
}
