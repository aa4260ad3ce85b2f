//! Lines and fields of a text: any encoding, any separator, bounded memory.

use std::borrow::Cow;
use std::io::{BufRead, BufReader, Read};

use crate::csv::number;
use crate::error::{HostError, Result};
use crate::formats::source::ReadSeek;
use crate::formats::{Source, table::MOST_COLUMNS};

/// Longest line, bytes. The rest of a longer one is skipped.
const MAX_LINE: u64 = 1 << 16;

/// Encoding of a text, by its byte order mark.
#[derive(Clone, Copy, PartialEq)]
enum Encoding {
    /// UTF-8; a line that is not is read as Latin-1.
    Utf8,
    Utf16 {
        big_endian: bool,
    },
}

/// Lines of a source, numbered as in an editor.
pub struct Lines<'a> {
    source: &'a Source,
    reader: BufReader<Box<dyn ReadSeek>>,
    encoding: Encoding,
    bytes: Vec<u8>,
    /// Number of the line last read, from 1.
    pub number: u64,
    /// Whether the line last read ends with a line end.
    pub is_ended: bool,
}

impl<'a> Lines<'a> {
    pub fn of(source: &'a Source) -> Result<Self> {
        let encoding = match source.start() {
            [0xff, 0xfe, ..] => Encoding::Utf16 { big_endian: false },
            [0xfe, 0xff, ..] => Encoding::Utf16 { big_endian: true },
            _ => Encoding::Utf8,
        };
        Ok(Self {
            source,
            reader: BufReader::with_capacity(1 << 16, source.reader()?),
            encoding,
            bytes: Vec::new(),
            number: 0,
            is_ended: true,
        })
    }

    /// The next line without its end; `None` after the last one.
    pub fn next_line(&mut self) -> Result<Option<Cow<'_, str>>> {
        self.bytes.clear();
        let failed = |error| HostError::file(self.source.name(), "read", &error);
        let limit = MAX_LINE;
        let mut part = (&mut self.reader).take(limit);
        let read = part.read_until(b'\n', &mut self.bytes).map_err(failed)?;
        if read == 0 {
            return Ok(None);
        }
        self.number += 1;
        if self.encoding == (Encoding::Utf16 { big_endian: false }) {
            // The second byte of the line end.
            let mut zero = [0];
            let _ = self.reader.read(&mut zero).map_err(failed)?;
        }
        self.is_ended = self.bytes.ends_with(b"\n");
        if read as u64 == limit && !self.is_ended {
            self.reader.skip_until(b'\n').map_err(failed)?;
            self.is_ended = true;
        }
        let text = match self.encoding {
            Encoding::Utf16 { big_endian } => {
                let units = self.bytes.chunks(2).map(|pair| match *pair {
                    [high, low] if big_endian => u16::from_be_bytes([high, low]),
                    [low, high] => u16::from_le_bytes([low, high]),
                    _ => u16::from(b' '),
                });
                let text =
                    char::decode_utf16(units).map(|c| c.unwrap_or(char::REPLACEMENT_CHARACTER));
                Cow::Owned(text.collect::<String>())
            }
            Encoding::Utf8 => match std::str::from_utf8(&self.bytes) {
                Ok(text) => Cow::Borrowed(text),
                Err(_) => Cow::Owned(self.bytes.iter().map(|byte| char::from(*byte)).collect()),
            },
        };
        let trim = |text: &str| {
            let text = text.trim_start_matches('\u{feff}');
            text.trim_end_matches(['\r', '\n', '\0']).to_owned()
        };
        Ok(Some(match text {
            Cow::Borrowed(text) => {
                let text = text.trim_end_matches(['\r', '\n']);
                Cow::Borrowed(text.strip_prefix('\u{feff}').unwrap_or(text))
            }
            Cow::Owned(text) => Cow::Owned(trim(&text)),
        }))
    }
}

/// The fields of a line, trimmed. A space stands for any white space.
pub fn split(text: &str, separator: char) -> Vec<Cow<'_, str>> {
    if separator == ' ' {
        let fields = text.split_whitespace().map(Cow::Borrowed);
        return fields.take(MOST_COLUMNS).collect();
    }
    if text.contains('"') {
        let mut reader = csv::ReaderBuilder::new();
        (reader.has_headers(false).delimiter(separator as u8)).trim(csv::Trim::All);
        if let Some(Ok(row)) = reader.from_reader(text.as_bytes()).records().next() {
            let fields = row.iter().map(|field| Cow::Owned(field.to_owned()));
            return fields.take(MOST_COLUMNS).collect();
        }
    }
    let fields = text.split(separator).take(MOST_COLUMNS);
    fields.map(|field| Cow::Borrowed(field.trim())).collect()
}

/// Whether a line is a comment.
pub fn is_comment(text: &str) -> bool {
    text.starts_with('#') || text.starts_with("//") || text.starts_with('%')
}

/// A field of a row.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Field {
    /// Empty, or as programs write a missing value.
    Empty,
    Number(f64),
    Text,
}

/// Reads a field; `comma` says that the decimal mark is a comma.
pub fn field(text: &str, comma: bool) -> Field {
    let pointed = with_point(text, comma);
    match number::finite(&pointed) {
        Some(value) => Field::Number(value),
        None if number::is_none(text) => Field::Empty,
        None => Field::Text,
    }
}

/// A number with a decimal point.
pub fn with_point(text: &str, comma: bool) -> Cow<'_, str> {
    match comma && text.contains(',') {
        true => Cow::Owned(text.replacen(',', ".", 1)),
        false => Cow::Borrowed(text),
    }
}
