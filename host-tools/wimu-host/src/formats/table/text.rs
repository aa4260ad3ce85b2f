//! Lines and fields of a text: any encoding, any separator, bounded memory.

use std::borrow::Cow;
use std::io::{BufRead, BufReader, Read};

use encoding_rs_io::{DecodeReaderBytes, DecodeReaderBytesBuilder};

use crate::csv::number;
use crate::formats::source::ReadSeek;
use crate::formats::{Source, table::MOST_COLUMNS};
use crate::{Problem, Result};

/// Longest line, bytes. The rest of a longer one is skipped.
const MAX_LINE: u64 = 1 << 16;

/// Lines of a source, numbered as in an editor.
pub struct Lines<'a> {
    source: &'a Source,
    /// In UTF-8, if a byte order mark says what it is.
    reader: BufReader<DecodeReaderBytes<Box<dyn ReadSeek>, Vec<u8>>>,
    bytes: Vec<u8>,
    /// Last byte of a line: that of a text without line feeds is a carriage return.
    end: u8,
    /// Names of the columns of a text whose rows name their values, which are read as a table with a header.
    labels: Option<String>,
    is_labelled: bool,
    /// Number of the line last read, from 1; a header that is made of labels is one, too.
    pub number: u64,
    /// Whether the line last read ends with a line end.
    pub is_ended: bool,
}

impl<'a> Lines<'a> {
    pub fn of(source: &'a Source) -> Result<Self> {
        let mut decoder = DecodeReaderBytesBuilder::new();
        decoder.utf8_passthru(true).strip_bom(true);
        let start = source.start();
        let first = start.split(|byte| matches!(byte, b'\r' | b'\n')).find(|line| !line.is_empty());
        let first = first.and_then(|line| std::str::from_utf8(line).ok());
        let labels = first.and_then(labelled).map(|(names, _)| names);
        let has_cr_only = start.contains(&b'\r') && !start.contains(&b'\n');
        Ok(Self {
            source,
            reader: BufReader::with_capacity(1 << 16, decoder.build(source.reader()?)),
            bytes: Vec::new(),
            end: if has_cr_only { b'\r' } else { b'\n' },
            is_labelled: labels.is_some(),
            labels,
            number: 0,
            is_ended: true,
        })
    }

    /// The next line without its end, read as Latin-1 if it is not UTF-8; `None` after the last one.
    pub fn next_line(&mut self) -> Result<Option<Cow<'_, str>>> {
        if let Some(names) = self.labels.take() {
            self.number += 1;
            return Ok(Some(Cow::Owned(names)));
        }
        self.bytes.clear();
        let failed = |error| Problem::file(self.source.name(), "read", &error);
        let mut part = (&mut self.reader).take(MAX_LINE);
        let read = part.read_until(self.end, &mut self.bytes).map_err(failed)?;
        if read == 0 {
            return Ok(None);
        }
        self.number += 1;
        self.is_ended = self.bytes.ends_with(&[self.end]);
        if read as u64 == MAX_LINE && !self.is_ended {
            self.reader.skip_until(self.end).map_err(failed)?;
            self.is_ended = true;
        }
        while self.bytes.pop_if(|byte| matches!(byte, b'\r' | b'\n')).is_some() {}
        Ok(Some(match std::str::from_utf8(&self.bytes) {
            Ok(text) if self.is_labelled => match labelled(text) {
                Some((_, values)) => Cow::Owned(values),
                None => Cow::Borrowed(text),
            },
            Ok(text) => Cow::Borrowed(text),
            Err(_) => Cow::Owned(self.bytes.iter().map(|byte| char::from(*byte)).collect()),
        }))
    }
}

/// Names and values, each with commas between, of a row that names its values: `ax:1,ay:2,az:3` as plotters of serial ports
/// write, `{"ax":1,"ay":2,"az":3}`, or `a/g:` and six numbers.
fn labelled(line: &str) -> Option<(String, String)> {
    let line = line.trim();
    if let Some(values) = line.strip_prefix("a/g:") {
        let values: Vec<&str> = values.split_whitespace().collect();
        let names = "ax,ay,az,gx,gy,gz".to_owned();
        return (values.len() == 6).then(|| (names, values.join(",")));
    }
    let inner = line.strip_prefix('{').and_then(|line| line.strip_suffix('}')).unwrap_or(line);
    let inner = inner.replace(": ", ":");
    let fields = inner.split([',', ';', '\t', ' ']).filter(|field| !field.is_empty());
    let (mut names, mut values) = (Vec::new(), Vec::new());
    for field in fields {
        let (name, value) = field.split_once(':')?;
        let name = name.trim_matches('"');
        let is_name = name.starts_with(|c: char| c.is_alphabetic());
        number::finite(value).filter(|_| is_name)?;
        names.push(name);
        values.push(value);
    }
    (names.len() >= 3).then(|| (names.join(","), values.join(",")))
}

/// The fields of a line, trimmed. A space stands for any white space. A time of day and an arrow before them, as the Arduino
/// serial monitor writes, are a field.
pub fn split(text: &str, separator: char) -> Vec<Cow<'_, str>> {
    if text.as_bytes().get(2) == Some(&b':')
        && let Some((stamp, rest)) = text.split_once(" -> ")
    {
        return std::iter::once(Cow::Borrowed(stamp)).chain(split(rest, separator)).collect();
    }
    // Rows of WISDM end with a semicolon.
    let text = if separator == ';' { text } else { text.strip_suffix(';').unwrap_or(text) };
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
