//! Messages of an ArduPilot DataFlash log (ArduPilot, `libraries/AP_Logger/LogStructure.h`).

use std::collections::HashMap;

use super::super::Source;
use super::super::window::{Damage, Number, Window, bytes_at};
use crate::{Code, Result};

/// First bytes of a message; then follows its type.
const MAGIC: [u8; 2] = [0xA3, 0x95];
/// Length of the magic bytes and the type.
const HEADER_BYTES: usize = 3;
/// Type and length of the message that defines the others.
const FMT: u8 = 128;
const FMT_BYTES: usize = 89;
/// Longest message.
const MAX_BYTES: usize = 255;
/// First bytes of a log.
pub(super) const START: [u8; 3] = [MAGIC[0], MAGIC[1], FMT];

/// A field of a message.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Field {
    offset: usize,
    number: Option<(Number, f64)>,
    /// Index among the message's fields.
    pub(super) index: usize,
}

impl Field {
    /// Its value in units of the field.
    pub(super) fn read(self, message: &[u8]) -> Option<f64> {
        let (number, scale) = self.number?;
        Some(number.read(message, self.offset)? * scale)
    }

    /// Whether the type implies a factor, which [`read`](Self::read) applies; the multiplier of
    /// the field repeats it.
    pub(super) fn is_scaled(self) -> bool {
        self.number.is_some_and(|(_, scale)| scale != 1.0)
    }
}

/// Type of a field, and the factor that it implies.
fn number(code: u8) -> Option<(Number, f64)> {
    use Number::{Float, Signed, Unsigned};
    Some(match code {
        b'b' => (Signed(1), 1.0),
        b'B' | b'M' => (Unsigned(1), 1.0),
        b'h' => (Signed(2), 1.0),
        b'H' => (Unsigned(2), 1.0),
        b'c' => (Signed(2), 0.01),
        b'C' => (Unsigned(2), 0.01),
        b'i' => (Signed(4), 1.0),
        b'I' => (Unsigned(4), 1.0),
        b'e' => (Signed(4), 0.01),
        b'E' => (Unsigned(4), 0.01),
        b'L' => (Signed(4), 1e-7),
        b'f' => (Float(4), 1.0),
        b'd' => (Float(8), 1.0),
        b'q' => (Signed(8), 1.0),
        b'Q' => (Unsigned(8), 1.0),
        _ => return None,
    })
}

/// Bytes of a field.
fn width(code: u8) -> Option<usize> {
    match code {
        b'g' => Some(2),
        b'n' => Some(4),
        b'N' => Some(16),
        b'a' | b'Z' => Some(64),
        _ => number(code).map(|(number, _)| number.bytes()),
    }
}

/// A kind of message.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Format {
    /// Its type.
    pub(super) id: u8,
    pub(super) name: String,
    length: usize,
    fields: Vec<(String, Field)>,
    /// Whether the fields add up to the length.
    confirmed: bool,
}

impl Format {
    /// That of a FMT message.
    fn parse(message: &[u8]) -> Option<Self> {
        let (id, length) = (message[3], usize::from(message[4]));
        let codes = message[9..25].iter().take_while(|code| **code != 0);
        let labels = text(&message[25..FMT_BYTES]);
        let mut labels = labels.split(',');
        let mut fields = Vec::new();
        let mut offset = HEADER_BYTES;
        let mut known = true;
        for (index, &code) in codes.enumerate() {
            let label = labels.next().unwrap_or_default().trim().to_owned();
            let field = Field { offset, number: number(code), index };
            fields.push((label, field));
            known &= width(code).is_some();
            offset += width(code).unwrap_or(0);
        }
        (length > HEADER_BYTES && id != FMT).then(|| Self {
            id,
            name: text(&message[5..9]),
            length,
            confirmed: known && offset == length,
            fields,
        })
    }

    /// A field by its name.
    pub(super) fn field(&self, name: &str) -> Option<Field> {
        let field = self.fields.iter().find(|(label, _)| label == name);
        field.filter(|_| self.confirmed).map(|(_, field)| *field)
    }
}

/// Text up to a zero.
fn text(bytes: &[u8]) -> String {
    let end = bytes.iter().position(|byte| *byte == 0);
    String::from_utf8_lossy(&bytes[..end.unwrap_or(bytes.len())]).into_owned()
}

/// Units and multipliers of fields, which newer logs name.
#[derive(Default)]
pub(super) struct Units {
    units: HashMap<u8, String>,
    multipliers: HashMap<u8, f64>,
    /// Unit and multiplier of each field of a type.
    fields: HashMap<u8, ([u8; 16], [u8; 16])>,
}

impl Units {
    /// Takes a message that names some.
    pub(super) fn take(&mut self, format: &Format, message: &[u8]) {
        const CONTENT: usize = HEADER_BYTES + 8;
        let Some((&id, rest)) = message.get(CONTENT..).and_then(<[u8]>::split_first) else {
            return;
        };
        match format.name.as_str() {
            "UNIT" => drop(self.units.insert(id, text(rest))),
            "MULT" => {
                if let Some(bytes) = bytes_at(rest, 0) {
                    self.multipliers.insert(id, f64::from_le_bytes(bytes));
                }
            }
            "FMTU" => {
                if let (Some(units), Some(multipliers)) = (bytes_at(rest, 0), bytes_at(rest, 16)) {
                    self.fields.insert(id, (units, multipliers));
                }
            }
            _ => (),
        }
    }

    /// Unit of a field of a type, and the factor to it from what [`Field::read`] returns.
    pub(super) fn of(&self, format: &Format, field: Field) -> Option<(&str, f64)> {
        let (units, multipliers) = self.fields.get(&format.id)?;
        let unit = self.units.get(units.get(field.index)?)?;
        let multiplier = self.multipliers.get(multipliers.get(field.index)?).copied();
        // Multiplier `-` is stored as 0: none.
        let multiplier = multiplier.filter(|value| value.is_normal() && !field.is_scaled());
        Some((unit, multiplier.unwrap_or(1.0)))
    }
}

/// Reads a log and hands its messages, with their headers, to `each`; returns its damage and its
/// length in bytes.
pub(super) fn walk(source: &Source, each: &mut dyn FnMut(&Format, &[u8])) -> Result<(Damage, u64)> {
    let mut window = Window::new(source, 0)?;
    if !window.peek(START.len())?.starts_with(&START) {
        return Err(Code::BadRecording
            .error("it does not start as a DataFlash log", "check the file")
            .at(source.name()));
    }
    let mut formats: HashMap<u8, Format> = HashMap::new();
    let mut damage = Damage::default();
    loop {
        let ahead = window.peek(HEADER_BYTES)?;
        if ahead.is_empty() {
            return Ok((damage, window.position()));
        }
        let id = ahead.get(2).filter(|_| ahead.starts_with(&MAGIC)).copied();
        let format = id.and_then(|id| formats.get(&id));
        let length = match (id, format) {
            (Some(FMT), _) => FMT_BYTES,
            (_, Some(format)) => format.length,
            _ => usize::MAX,
        };
        let ahead = window.peek(length.min(MAX_BYTES) + MAGIC.len())?;
        let next = ahead.get(length..);
        // Another message follows, or nothing.
        if next.is_some_and(|next| MAGIC.starts_with(&next[..next.len().min(2)])) {
            let message = &ahead[..length];
            match format {
                Some(format) => each(format, message),
                None => {
                    let format = Format::parse(message);
                    format.and_then(|format| formats.insert(format.id, format));
                }
            }
            window.skip(length);
        } else {
            damage.add(window.position());
            window.skip(1);
        }
    }
}
