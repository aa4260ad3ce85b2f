//! Splitting lines into fields.

use std::io::BufRead;

use crate::error::{ErrorCode, HostError, Result};

/// Splits a source into lines of fields, and counts lines as an editor does.
pub struct Lines<R> {
    source: R,
    bytes: Vec<u8>,
    /// Separator of the fields; known from the first line on.
    separator: Option<char>,
    /// Number of the line last read, from 1.
    pub number: u64,
}

impl<R: BufRead> Lines<R> {
    pub fn new(source: R) -> Self {
        Self {
            source,
            bytes: Vec::new(),
            separator: None,
            number: 0,
        }
    }

    /// Separator of the fields.
    pub fn separator(&self) -> char {
        self.separator.unwrap_or(',')
    }

    /// The fields of the next line that is not blank and does not begin with `#`, trimmed; `None` at the end. Errors have
    /// no location yet.
    pub fn next_fields(&mut self, fields: &mut Vec<String>) -> Result<Option<()>> {
        loop {
            self.bytes.clear();
            let read = self
                .source
                .read_until(b'\n', &mut self.bytes)
                .map_err(|error| HostError::file("", "read", &error))?;
            if read == 0 {
                return Ok(None);
            }
            self.number += 1;
            let text = std::str::from_utf8(&self.bytes).map_err(|_| {
                ErrorCode::CsvNotUtf8
                    .error("the text is not UTF-8", "save the file with UTF-8 encoding")
            })?;
            let text = text
                .strip_prefix('\u{feff}')
                .filter(|_| self.number == 1)
                .unwrap_or(text);
            if !text.trim().is_empty() && !text.starts_with('#') {
                let line = text.trim_end_matches(['\r', '\n']);
                let separator = *self.separator.get_or_insert_with(|| separator(line));
                split(line, separator, fields)?;
                return Ok(Some(()));
            }
        }
    }
}

/// A comma; where there is none outside quotes, a semicolon or a tab.
fn separator(line: &str) -> char {
    let bare: String = line.split('"').step_by(2).collect();
    [',', ';', '\t']
        .into_iter()
        .find(|separator| bare.contains(*separator))
        .unwrap_or(',')
}

pub fn split(line: &str, separator: char, fields: &mut Vec<String>) -> Result<()> {
    fields.clear();
    let mut rest = line;
    loop {
        let start = rest.trim_start_matches(' ');
        let field;
        if let Some(quoted) = start.strip_prefix('"') {
            (field, rest) = unquote(quoted, separator).ok_or_else(|| {
                ErrorCode::CsvFieldCount.error(
                    "a quoted field does not end on its line, or is followed by text",
                    "double a quote inside quotes, and put a separator after the closing one",
                )
            })?;
        } else {
            let end = rest.find(separator).unwrap_or(rest.len());
            field = rest[..end].trim().to_owned();
            rest = &rest[end..];
        }
        fields.push(field);
        match rest.strip_prefix(separator) {
            Some(next) => rest = next,
            None => return Ok(()),
        }
    }
}

/// The field after an opening quote, and the rest: a separator or nothing.
fn unquote(text: &str, separator: char) -> Option<(String, &str)> {
    let mut field = String::new();
    let mut rest = text;
    loop {
        let (before, after) = rest.split_once('"')?;
        field.push_str(before);
        rest = match after.strip_prefix('"') {
            Some(more) => {
                field.push('"');
                more
            }
            None => {
                let after = after.trim_start_matches(' ');
                return (after.trim().is_empty() || after.starts_with(separator))
                    .then_some((field, after));
            }
        };
    }
}

/// One line of `fields` with its line end, quoted where needed.
pub fn join(fields: &[String]) -> String {
    let mut line = String::new();
    for (index, field) in fields.iter().enumerate() {
        if index > 0 {
            line.push(',');
        }
        // A single empty field would read as a blank line.
        let alone = fields.len() == 1 && field.is_empty();
        if alone || field.contains([',', '"', '\n', '\r']) || field.trim() != field {
            // A line end inside a field would break the rule of one row per line.
            let text = field.replace('"', "\"\"").replace(['\n', '\r'], " ");
            line.push_str(&format!("\"{text}\""));
        } else {
            line.push_str(field);
        }
    }
    line.push('\n');
    line
}
