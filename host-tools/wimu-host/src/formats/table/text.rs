//! Lines and fields of a text: any encoding, any separator, bounded memory.

use std::borrow::Cow;
use std::io::{BufRead, BufReader, Read};

use encoding_rs_io::DecodeReaderBytesBuilder;
use serde_json::Value;

use super::json::{self, Rows};
use crate::csv::number;
use crate::formats::{Source, table::MOST_COLUMNS};
use crate::{Problem, Result};

/// Longest line, bytes. The rest of a longer one is skipped.
const MAX_LINE: u64 = 1 << 16;
/// What the serial monitor of Arduino writes between the time of day and a line.
const ARROW: &str = " -> ";

/// Lines of a source, numbered as in an editor.
pub struct Lines<'a> {
    source: &'a Source,
    /// In UTF-8, if a byte order mark says what it is.
    reader: BufReader<Box<dyn Read>>,
    bytes: Vec<u8>,
    /// Last byte of a line: that of a text without line feeds is a carriage return.
    end: u8,
    /// Names of the columns of a text whose rows name their values, which is read as a table with a header.
    names: Vec<String>,
    is_begun: bool,
    /// Number of the line last read, from 1; a header that is made of names is one, too.
    pub number: u64,
    /// Whether the line last read ends with a line end.
    pub is_ended: bool,
}

impl<'a> Lines<'a> {
    pub fn of(source: &'a Source) -> Result<Self> {
        let mut decoder = DecodeReaderBytesBuilder::new();
        decoder.utf8_passthru(true).strip_bom(true);
        let start = source.start();
        let text = String::from_utf8_lossy(start.strip_prefix(b"\xef\xbb\xbf").unwrap_or(start));
        let is_document = json::is_document(&text);
        let mut rows = String::new();
        if is_document {
            Rows::new(text.as_bytes()).read_to_string(&mut rows).unwrap_or_default();
        }
        let text = if is_document { &rows } else { &*text };
        let lines = text.split(['\r', '\n']).filter(|line| line.len() > 1);
        let first: Vec<&str> = lines.take(3).collect();
        let two = |pair: &[&str]| labelled(pair[0]).filter(|_| labelled(pair[1]).is_some());
        let labels = first.windows(2).find_map(two).unwrap_or_default();
        let has_cr_only = start.contains(&b'\r') && !start.contains(&b'\n') && !is_document;
        let decoded = decoder.build(source.reader()?);
        let reader: Box<dyn Read> = if is_document {
            Box::new(Rows::new(BufReader::with_capacity(1 << 16, decoded)))
        } else {
            Box::new(decoded)
        };
        Ok(Self {
            source,
            reader: BufReader::with_capacity(1 << 16, reader),
            bytes: Vec::new(),
            end: if has_cr_only { b'\r' } else { b'\n' },
            names: labels.into_iter().map(|(name, _)| name).collect(),
            is_begun: false,
            number: 0,
            is_ended: true,
        })
    }

    /// The next line without its end, read as Latin-1 if it is not UTF-8; `None` after the last one.
    pub fn next_line(&mut self) -> Result<Option<Cow<'_, str>>> {
        self.number += 1;
        if !self.names.is_empty() && !std::mem::replace(&mut self.is_begun, true) {
            return Ok(Some(Cow::Owned(self.names.join(","))));
        }
        self.bytes.clear();
        let failed = |error| Problem::file(self.source.name(), "read", &error);
        let mut part = (&mut self.reader).take(MAX_LINE);
        let read = part.read_until(self.end, &mut self.bytes).map_err(failed)?;
        if read == 0 {
            return Ok(None);
        }
        self.is_ended = self.bytes.ends_with(&[self.end]);
        if read as u64 == MAX_LINE && !self.is_ended {
            self.reader.skip_until(self.end).map_err(failed)?;
            self.is_ended = true;
        }
        while self.bytes.pop_if(|byte| matches!(byte, b'\r' | b'\n')).is_some() {}
        let text = match std::str::from_utf8(&self.bytes) {
            Ok(text) => Cow::Borrowed(text),
            Err(_) => Cow::Owned(self.bytes.iter().map(|byte| char::from(*byte)).collect()),
        };
        if self.names.is_empty() {
            return Ok(Some(text));
        }
        let Some(values) = labelled(&text) else {
            return Ok(Some(text));
        };
        let value = |name: &String| {
            let found = values.iter().find(|(other, _)| other == name);
            found.map_or(String::new(), |(_, value)| value.replace(',', " "))
        };
        Ok(Some(Cow::Owned(self.names.iter().map(value).collect::<Vec<_>>().join(","))))
    }
}

/// Names and values of a row that names at least three numbers: `ax:1,ay:2,az:3` or `AX = 1 AY = 2 …` as programs write to a
/// serial port, `{"acc":{"x":1,"y":2,"z":3}}`, or `a/g:` and six numbers.
fn labelled(line: &str) -> Option<Vec<(String, String)>> {
    let line = line.trim();
    if let Some((time, rest)) = line.split_once(ARROW).filter(|(time, _)| time.contains(':')) {
        let mut values = labelled(rest)?;
        values.insert(0, ("time".to_owned(), time.to_owned()));
        return Some(values);
    }
    let mut values = Vec::new();
    if line.starts_with('{') {
        let object: Value = serde_json::from_str(line.trim_end_matches(',')).ok()?;
        flatten("", &object, &mut values);
    } else if let Some(numbers) = line.strip_prefix("a/g:") {
        let names = ["ax", "ay", "az", "gx", "gy", "gz"].map(str::to_owned);
        let numbers = numbers.split_whitespace().map(str::to_owned);
        values.extend(names.into_iter().zip(numbers));
    } else {
        let joined =
            line.replace(" =", "=").replace("= ", "=").replace(" :", ":").replace(": ", ":");
        let fields = joined.split([',', ';', '|', '\t', ' ']).filter(|field| !field.is_empty());
        for field in fields {
            let (name, value) = field.split_once([':', '='])?;
            number::finite(value).filter(|_| name.starts_with(|c: char| c.is_alphabetic()))?;
            values.push((name.to_owned(), value.to_owned()));
        }
    }
    let numbers = values.iter().filter(|(_, value)| number::finite(value).is_some()).count();
    (3..=MOST_COLUMNS).contains(&numbers).then_some(values)
}

/// Names and values of what a JSON value holds: `acc.x`, and of three or four numbers `acc.x`, `acc.y`, `acc.z` or with `w`.
fn flatten(name: &str, value: &Value, values: &mut Vec<(String, String)>) {
    let of = |part: &str| if name.is_empty() { part.to_owned() } else { format!("{name}.{part}") };
    match value {
        Value::Object(parts) => {
            parts.iter().for_each(|(part, value)| flatten(&of(part), value, values))
        }
        Value::Array(parts) => {
            let axes = if parts.len() == 4 { ["w", "x", "y", "z"] } else { ["x", "y", "z", ""] };
            parts.iter().zip(axes).for_each(|(value, axis)| flatten(&of(axis), value, values));
        }
        Value::String(text) => values.push((name.to_owned(), text.clone())),
        Value::Number(number) => values.push((name.to_owned(), number.to_string())),
        Value::Null | Value::Bool(_) => {}
    }
}

/// The fields of a line, trimmed. A space stands for any white space. A time of day and an arrow before them, as the Arduino
/// serial monitor writes, are a field.
pub fn split(text: &str, separator: char) -> Vec<Cow<'_, str>> {
    if text.as_bytes().get(2) == Some(&b':')
        && let Some((stamp, rest)) = text.split_once(ARROW)
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
        // A space before a quote does not belong to the field.
        let text = text.replace(&format!("{separator} \""), &format!("{separator}\""));
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

/// The number in a field, not a number if it is empty or as programs write a missing value; `None` of a text. `comma` says that
/// the decimal mark is a comma.
pub fn field(text: &str, comma: bool) -> Option<f64> {
    let found = number::finite(&with_point(text, comma));
    found.or_else(|| number::is_none(text).then_some(f64::NAN))
}

/// Whether a field is neither a number nor empty.
pub fn is_text(text: &str, comma: bool) -> bool {
    field(text, comma).is_none()
}

/// A number with a decimal point.
pub fn with_point(text: &str, comma: bool) -> Cow<'_, str> {
    if comma && text.contains(',') {
        return Cow::Owned(text.replacen(',', ".", 1));
    }
    Cow::Borrowed(text)
}
