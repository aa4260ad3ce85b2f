//! Rows of a JSON document: each object of an array becomes a line of its own.

use std::io::{self, BufRead, Read};

/// Brackets around rows, at most: deeper ones are not counted.
const MAX_AROUND: usize = 64;

/// Whether a text that starts so is one JSON document with rows in an array, and not one object a line.
pub fn is_document(start: &str) -> bool {
    let start = start.trim_start();
    let first = start.lines().next().unwrap_or_default();
    let is_row = serde_json::from_str::<serde::de::IgnoredAny>(first).is_ok();
    if start.starts_with('{') && is_row && first.len() < start.trim_end().len() {
        return false;
    }
    let mut rows = Rows::new(start.as_bytes());
    start.starts_with(['{', '[']) && rows.read(&mut [0]).is_ok_and(|count| count > 0)
}

/// Reads the objects that are elements of an array, one a line, and leaves out what is around the array. Objects within a
/// row stay in it.
pub struct Rows<R> {
    inner: R,
    /// Brackets that are open around rows.
    around: Vec<u8>,
    /// Brackets that are open in a row; 0 outside of rows.
    depth: usize,
    is_string: bool,
    is_escaped: bool,
    out: Vec<u8>,
    /// Bytes of `out` that were handed on.
    used: usize,
}

impl<R: BufRead> Rows<R> {
    pub fn new(inner: R) -> Self {
        Self {
            inner,
            around: Vec::new(),
            depth: 0,
            is_string: false,
            is_escaped: false,
            out: Vec::new(),
            used: 0,
        }
    }

    fn take(&mut self, byte: u8) {
        let was_in_row = self.depth > 0;
        if self.is_string {
            self.is_string = byte != b'"' || self.is_escaped;
            self.is_escaped = byte == b'\\' && !self.is_escaped;
        } else {
            match byte {
                b'"' => self.is_string = true,
                b'{' | b'[' if was_in_row => self.depth += 1,
                b'{' if self.around.last() == Some(&b'[') => self.depth = 1,
                b'{' | b'[' if self.around.len() < MAX_AROUND => self.around.push(byte),
                b'}' | b']' if was_in_row => self.depth -= 1,
                b'}' | b']' => drop(self.around.pop()),
                _ => {}
            }
        }
        if was_in_row || self.depth > 0 {
            self.out.push(if matches!(byte, b'\r' | b'\n') { b' ' } else { byte });
        }
        if was_in_row && self.depth == 0 {
            self.out.push(b'\n');
        }
    }
}

impl<R: BufRead> Read for Rows<R> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        while self.used == self.out.len() {
            self.out.clear();
            self.used = 0;
            let bytes = self.inner.fill_buf()?.to_vec();
            if bytes.is_empty() {
                return Ok(0);
            }
            self.inner.consume(bytes.len());
            bytes.iter().for_each(|byte| self.take(*byte));
        }
        let count = buffer.len().min(self.out.len() - self.used);
        buffer[..count].copy_from_slice(&self.out[self.used..self.used + count]);
        self.used += count;
        Ok(count)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_object_of_an_array_is_a_line() {
        for (document, lines) in [
            (r#"[{"a":1},{"a":2}]"#, "{\"a\":1}\n{\"a\":2}\n"),
            ("[\n {\n \"a\": [1, 2]\n }\n]", "{  \"a\": [1, 2]  }\n"),
            (
                r#"{"n":"x","rows":[{"b":{"c":1}},{"b":"}]{\""}]}"#,
                "{\"b\":{\"c\":1}}\n{\"b\":\"}]{\\\"\"}\n",
            ),
            ("[[1, 2], [3, 4]]", ""),
            ("]]}}{", ""),
        ] {
            let mut read = String::new();
            Rows::new(document.as_bytes()).read_to_string(&mut read).unwrap();
            assert_eq!(read, lines, "{document}");
            assert_eq!(is_document(document), !lines.is_empty(), "{document}");
        }
        assert!(!is_document("{\"a\":[{\"b\":1}]}\n{\"a\":[{\"b\":2}]}\n"));
    }
}
