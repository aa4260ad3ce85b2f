//! Records of a ULog file (PX4 Guide, "ULog File Format").

use std::collections::HashMap;

use super::super::Source;
use super::super::window::{Damage, Number, Window, bytes_at};
use crate::{Code, Result};

/// First bytes of a file; then follow its version and its start time, 9 bytes.
pub(super) const MAGIC: [u8; 7] = *b"ULog\x01\x12\x35";
const HEADER_BYTES: usize = 16;
/// Length and kind before each message.
const MESSAGE_HEADER_BYTES: usize = 3;
/// Deepest nesting of formats; PX4 has two.
const MAX_DEPTH: usize = 8;

/// Most formats, subscriptions and fields of a format that are kept; PX4 has fewer than 300.
const MAX_KEPT: usize = 1024;

/// A field of a message.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Field {
    offset: usize,
    number: Number,
}

impl Field {
    /// An element.
    pub(super) fn read(&self, payload: &[u8], element: usize) -> Option<f64> {
        self.number.read(payload, self.offset + element * self.number.bytes())
    }
}

/// Fields of a message and their positions.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Layout {
    fields: HashMap<String, Field>,
    /// Length with and without the padding at its end, which is not written.
    bytes: usize,
    bytes_written: usize,
}

impl Layout {
    /// A field by its name.
    pub(super) fn field(&self, name: &str) -> Option<&Field> {
        self.fields.get(name)
    }

    /// That of a format whose text is `type name;type[n] name;…`.
    fn parse(formats: &HashMap<String, String>, name: &str, depth: usize) -> Option<Self> {
        let mut layout = Self::default();
        let fields = formats.get(name)?.split(';').map(str::trim);
        for field in fields.filter(|field| !field.is_empty()) {
            let (kind, name) = field.split_once(' ')?;
            let (kind, count) = match kind.split_once('[') {
                Some((kind, count)) => (kind, count.strip_suffix(']')?.parse().ok()?),
                None => (kind, 1_usize),
            };
            let number = match kind {
                "uint8_t" | "bool" | "char" => Some(Number::Unsigned(1)),
                "int8_t" => Some(Number::Signed(1)),
                "uint16_t" => Some(Number::Unsigned(2)),
                "int16_t" => Some(Number::Signed(2)),
                "uint32_t" => Some(Number::Unsigned(4)),
                "int32_t" => Some(Number::Signed(4)),
                "uint64_t" => Some(Number::Unsigned(8)),
                "int64_t" => Some(Number::Signed(8)),
                "float" => Some(Number::Float(4)),
                "double" => Some(Number::Float(8)),
                _ => None,
            };
            let bytes = match number {
                Some(number) => {
                    let field = Field { offset: layout.bytes, number };
                    layout.fields.insert(name.to_owned(), field);
                    number.bytes()
                }
                None if depth < MAX_DEPTH => Self::parse(formats, kind, depth + 1)?.bytes,
                None => return None,
            };
            layout.bytes = bytes.checked_mul(count)?.checked_add(layout.bytes)?;
            if layout.bytes > usize::from(u16::MAX) || layout.fields.len() > MAX_KEPT {
                return None;
            }
            if !name.starts_with("_padding") {
                layout.bytes_written = layout.bytes;
            }
        }
        (layout.bytes > 0).then_some(layout)
    }
}

/// What the data messages of an id hold.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Subscription {
    /// Topic.
    pub(super) name: String,
    /// Instance of the topic.
    pub(super) instance: u8,
    /// `None` if the format is missing or damaged.
    pub(super) layout: Option<Layout>,
}

/// Reads a file and hands the values of topics to `each`; returns its damage and its length in bytes.
pub(super) fn walk(
    source: &Source,
    each: &mut dyn FnMut(&Subscription, &[u8]),
) -> Result<(Damage, u64)> {
    let mut window = Window::new(source, 0)?;
    if !window.peek(HEADER_BYTES)?.starts_with(&MAGIC) {
        return Err(Code::BadRecording
            .error("it does not start as a ULog file", "check the file")
            .at(source.name()));
    }
    window.skip(HEADER_BYTES);
    let mut state = State::default();
    let mut damage = Damage::default();
    loop {
        let ahead = window.peek(MESSAGE_HEADER_BYTES + 2)?;
        if ahead.is_empty() {
            return Ok((damage, window.position()));
        }
        let length = state.length(ahead);
        let ahead = window.peek(length.unwrap_or(0) + MESSAGE_HEADER_BYTES + 2)?;
        match length.filter(|length| state.is_whole(ahead, *length)) {
            Some(length) => {
                state.take(&ahead[2..length], &mut damage, each);
                window.skip(length);
            }
            None => {
                damage.add(window.position());
                window.skip(1);
            }
        }
    }
}

#[derive(Default)]
struct State {
    formats: HashMap<String, String>,
    subscriptions: HashMap<u16, Subscription>,
}

impl State {
    /// Length of the message that starts here, with its header, if it can be one.
    fn length(&self, ahead: &[u8]) -> Option<usize> {
        let size = usize::from(u16::from_le_bytes(bytes_at(ahead, 0)?));
        let kind = *ahead.get(2)?;
        let possible = match kind {
            b'D' => {
                let id = u16::from_le_bytes(bytes_at(ahead, MESSAGE_HEADER_BYTES)?);
                let layout = self.subscriptions.get(&id).map(|of| of.layout.as_ref());
                let fits = |layout: &Layout| {
                    (layout.bytes_written..=layout.bytes).contains(&size.saturating_sub(2))
                };
                size >= 2 && layout.flatten().is_none_or(fits)
            }
            b'B' => size == 40,
            b'S' => size == 8,
            b'R' | b'O' => size == 2,
            _ => size > 0 && b"FIMPQALC".contains(&kind),
        };
        possible.then_some(MESSAGE_HEADER_BYTES + size)
    }

    /// Whether a message ends where another one starts, or at the end of the source.
    fn is_whole(&self, ahead: &[u8], length: usize) -> bool {
        let Some(next) = ahead.get(length..) else {
            return false;
        };
        next.len() < MESSAGE_HEADER_BYTES + 2 || self.length(next).is_some()
    }

    /// Uses a message: its kind and its content.
    fn take(
        &mut self,
        message: &[u8],
        damage: &mut Damage,
        each: &mut dyn FnMut(&Subscription, &[u8]),
    ) {
        let (kind, content) = (message[0], &message[1..]);
        let text = |bytes| String::from_utf8_lossy(bytes).into_owned();
        match kind {
            b'F' if self.formats.len() < MAX_KEPT => {
                let format = text(content);
                if let Some((name, fields)) = format.split_once(':') {
                    self.formats.insert(name.to_owned(), fields.to_owned());
                }
            }
            b'A' if self.subscriptions.len() < MAX_KEPT => {
                if let (Some(&instance), Some(id)) = (content.first(), bytes_at(content, 1)) {
                    let name = text(content.get(3..).unwrap_or_default());
                    let layout = Layout::parse(&self.formats, &name, 0);
                    let subscription = Subscription { name, instance, layout };
                    let id = u16::from_le_bytes(id);
                    self.subscriptions.insert(id, subscription);
                }
            }
            b'D' => {
                let id = bytes_at(content, 0).map(u16::from_le_bytes);
                if let Some(subscription) = id.and_then(|id| self.subscriptions.get(&id)) {
                    each(subscription, &content[2..]);
                }
            }
            b'O' => {
                if let Some(duration_ms) = bytes_at(content, 0) {
                    damage.add_dropout(u16::from_le_bytes(duration_ms));
                }
            }
            _ => (),
        }
    }
}
