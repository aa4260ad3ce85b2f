//! Splitting lines into fields.

use crate::error::{ErrorCode, Result};

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
