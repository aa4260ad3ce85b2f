//! Text header of a log: `H name:value` lines.

use std::collections::BTreeMap;

use super::super::window::Window;
use crate::Result;

/// First bytes of a log.
pub(super) const MARKER: &[u8] = b"H Product:Blackbox flight data recorder";
/// Longest line and longest header, bytes.
const MAX_LINE: usize = 8192;
const MAX_HEADER: u64 = 1 << 18;
/// Nothing but version 2 has been written since 2015.
const DATA_VERSION: &str = "2";

/// Lines of a header by their names.
#[derive(Clone, Debug, Default)]
pub(super) struct Header {
    lines: BTreeMap<String, String>,
}

impl Header {
    /// Reads it; the window is then at the first frame.
    pub(super) fn read(window: &mut Window) -> Result<Self> {
        let mut header = Self::default();
        let start = window.position();
        while window.position() - start < MAX_HEADER {
            let ahead = window.peek(MAX_LINE)?;
            let Some(end) = ahead.iter().position(|byte| *byte == b'\n') else {
                break;
            };
            let (line, rest) = (&ahead[..end], &ahead[end + 1..]);
            let printable = line.iter().all(|byte| matches!(byte, b' '..=b'~'));
            let is_header = line.starts_with(b"H ");
            let next_log = ahead.starts_with(MARKER) && !header.lines.is_empty();
            // A damaged line between two others is left out.
            if next_log || !(is_header || printable && rest.starts_with(b"H ")) {
                break;
            }
            let text = String::from_utf8_lossy(line);
            if let Some((name, value)) = text.get(2..).and_then(|text| text.split_once(':')) {
                header.lines.insert(name.to_owned(), value.trim().to_owned());
            }
            window.skip(end + 1);
        }
        Ok(header)
    }

    /// Whether its frames can be decoded.
    pub(super) fn is_known(&self) -> bool {
        self.text("Data version").is_none_or(|version| version == DATA_VERSION)
    }

    /// A value.
    pub(super) fn text(&self, name: &str) -> Option<&str> {
        self.lines.get(name).map(String::as_str)
    }

    /// A number: decimal, or the bits of a 32-bit float in hexadecimal.
    pub(super) fn number(&self, name: &str) -> Option<f64> {
        let text = self.text(name)?;
        match text.strip_prefix("0x") {
            Some(bits) => {
                let bits = u32::from_str_radix(bits, 16).ok()?;
                Some(f32::from_bits(bits).into())
            }
            None => text.parse().ok(),
        }
    }

    /// Names of the fields of a kind of frame.
    pub(super) fn names(&self, frame: char) -> Vec<&str> {
        let names = self.text(&format!("Field {frame} name")).unwrap_or_default();
        names.split(',').filter(|name| !name.is_empty()).collect()
    }

    /// Numbers of the fields of a kind of frame: `predictor` or `encoding`.
    pub(super) fn numbers(&self, frame: char, what: &str) -> Option<Vec<u8>> {
        let numbers = self.text(&format!("Field {frame} {what}"))?;
        let numbers = numbers.split(',').map(|number| number.trim().parse());
        numbers.collect::<std::result::Result<_, _>>().ok()
    }
}
