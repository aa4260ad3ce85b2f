//! Batches: what a board sent, with the gateway's times of arrival, as one MQTT message.

use std::fmt;

/// Version of the format.
const VERSION: u8 = 1;
/// Bytes before the pieces.
const HEAD: usize = 1 + 8 + 4 + 8;
/// Most bytes of a batch that is accepted: 16 times the most that a gateway sends.
pub const MAX_BATCH: usize = 1 << 20;

/// Bytes of one board in the order of arrival, cut after a frame.
///
/// | offset | size | field (little-endian) |
/// |---|---|---|
/// | 0 | 1 | version, 1 |
/// | 1 | 8 | session: the gateway's connection to its boards; later sessions have greater numbers |
/// | 9 | 4 | number of the batch in its session, from 0 |
/// | 13 | 8 | UTC of the first piece, ns since 1970, on a clock that never jumps within a session |
/// | 21 | – | time from the first piece to the end of the batch, µs, as a varint |
/// | – | – | pieces: µs since the piece before, length in bytes (varints), bytes as received in one read |
///
/// A varint has seven bits a byte, the least significant first; the high bit is set in all bytes but the last.
///
/// ```
/// use wimu_host::fleet::Batch;
///
/// let mut batch = Batch::new(7, 3);
/// batch.push(1_000_000_000, b"\x02ab\0");
/// batch.push(1_000_160_000, b"\x01\0");
/// let bytes = batch.encode(1_000_900_000);
/// assert_eq!(Batch::decode(&bytes)?, batch);
/// # Ok::<(), wimu_host::fleet::batch::BatchError>(())
/// ```
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Batch {
    /// Session of the gateway.
    pub session: u64,
    /// Number in the session.
    pub number: u32,
    /// UTC at the end of the batch, ns; whole µs after the first piece.
    pub end_ns: u64,
    /// UTC of arrival, ns (whole µs after the first), and bytes as received.
    pub pieces: Vec<(u64, Vec<u8>)>,
}

/// Why a message is no batch.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum BatchError {
    /// It has another version.
    Version(u8),
    /// It is longer than [`MAX_BATCH`].
    TooLong(usize),
    /// It ends within a field, or a number is too large.
    Damaged,
}

impl fmt::Display for BatchError {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Version(version) => write!(
                out,
                "a batch of version {version}; this wimu reads {VERSION}"
            ),
            Self::TooLong(length) => write!(out, "{length} bytes; a batch has at most {MAX_BATCH}"),
            Self::Damaged => out.write_str("not a batch of frames"),
        }
    }
}

impl std::error::Error for BatchError {}

impl Batch {
    /// An empty batch.
    pub fn new(session: u64, number: u32) -> Self {
        Self {
            session,
            number,
            end_ns: 0,
            pieces: Vec::new(),
        }
    }

    /// Adds bytes received at a UTC in ns, which is rounded to whole µs after the first piece.
    pub fn push(&mut self, utc_ns: u64, bytes: &[u8]) {
        let first = self.pieces.first().map_or(utc_ns, |(first, _)| *first);
        let at = first + utc_ns.saturating_sub(first) / 1000 * 1000;
        let at = self.pieces.last().map_or(at, |(last, _)| at.max(*last));
        self.end_ns = at;
        self.pieces.push((at, bytes.to_vec()));
    }

    /// Number of bytes in the pieces.
    pub fn bytes(&self) -> usize {
        self.pieces.iter().map(|(_, bytes)| bytes.len()).sum()
    }

    /// The message, of a batch that ends at a UTC in ns.
    pub fn encode(&mut self, end_ns: u64) -> Vec<u8> {
        let first = self.pieces.first().map_or(end_ns, |(first, _)| *first);
        let last = self.pieces.last().map_or(first, |(last, _)| *last);
        self.end_ns = (first + end_ns.saturating_sub(first) / 1000 * 1000).max(last);
        let mut out = Vec::with_capacity(HEAD + 4 + self.bytes() + 6 * self.pieces.len());
        out.push(VERSION);
        out.extend(self.session.to_le_bytes());
        out.extend(self.number.to_le_bytes());
        out.extend(first.to_le_bytes());
        put(&mut out, (self.end_ns - first) / 1000);
        let mut before = first;
        for (at, bytes) in &self.pieces {
            put(&mut out, (at - before) / 1000);
            put(&mut out, bytes.len() as u64);
            out.extend(bytes);
            before = *at;
        }
        out
    }

    /// Reads a message.
    ///
    /// # Errors
    /// [`BatchError`]; any bytes are accepted.
    pub fn decode(bytes: &[u8]) -> Result<Self, BatchError> {
        if bytes.len() > MAX_BATCH {
            return Err(BatchError::TooLong(bytes.len()));
        }
        let (head, mut rest) = bytes
            .split_first_chunk::<HEAD>()
            .ok_or(BatchError::Damaged)?;
        if head[0] != VERSION {
            return Err(BatchError::Version(head[0]));
        }
        let number = |from: usize, to: usize| {
            head[from..to]
                .iter()
                .rev()
                .fold(0, |sum, byte| sum << 8 | u64::from(*byte))
        };
        let mut at = number(13, 21);
        let later = |at: u64, us: u64| {
            us.checked_mul(1000)
                .and_then(|ns| at.checked_add(ns))
                .ok_or(BatchError::Damaged)
        };
        let mut batch = Self::new(number(1, 9), number(9, 13) as u32);
        batch.end_ns = later(at, take(&mut rest)?)?;
        while !rest.is_empty() {
            at = later(at, take(&mut rest)?)?;
            let length = usize::try_from(take(&mut rest)?).map_err(|_| BatchError::Damaged)?;
            let (piece, after) = rest.split_at_checked(length).ok_or(BatchError::Damaged)?;
            batch.pieces.push((at, piece.to_vec()));
            rest = after;
        }
        Ok(batch)
    }
}

fn put(out: &mut Vec<u8>, mut value: u64) {
    while value >= 0x80 {
        out.push(value as u8 | 0x80);
        value >>= 7;
    }
    out.push(value as u8);
}

fn take(bytes: &mut &[u8]) -> Result<u64, BatchError> {
    let mut value = 0;
    for shift in (0..63).step_by(7) {
        let (&byte, rest) = bytes.split_first().ok_or(BatchError::Damaged)?;
        *bytes = rest;
        value |= u64::from(byte & 0x7f) << shift;
        if byte < 0x80 {
            return Ok(value);
        }
    }
    Err(BatchError::Damaged)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_golden_batch_is_as_documented() {
        let mut batch = Batch::new(0x0102_0304_0506_0708, 0x0a0b_0c0d);
        batch.push(1_000_000_123, &[0x02, 0x55, 0x00]);
        batch.push(1_000_300_999, &[0x01, 0x00]);
        let bytes = batch.encode(1_001_000_123);
        let golden = "01 0807060504030201 0d0c0b0a 7bca9a3b00000000 e807 00 03 025500 ac02 02 0100";
        let hex: String = bytes.iter().map(|byte| format!("{byte:02x}")).collect();
        assert_eq!(hex, golden.replace(' ', ""));
        assert_eq!(Batch::decode(&bytes), Ok(batch));
    }

    #[test]
    fn a_cut_batch_and_any_other_bytes_are_refused_or_read_without_a_panic() {
        let mut batch = Batch::new(1, 2);
        batch.push(5, b"abc\0");
        let bytes = batch.encode(9);
        for end in 0..bytes.len() {
            let cut = Batch::decode(&bytes[..end]);
            assert!(
                cut.is_err() || cut.is_ok_and(|cut| cut.pieces.is_empty()),
                "{end}"
            );
        }
        assert_eq!(Batch::decode(&[9; 40]), Err(BatchError::Version(9)));
        assert_eq!(
            Batch::decode(&vec![1; MAX_BATCH + 1]),
            Err(BatchError::TooLong(MAX_BATCH + 1))
        );
        let mut state = 1u32;
        for length in 0..2000 {
            let random = (0..length % 97).map(|_| {
                state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                (state >> 24) as u8
            });
            let _ = Batch::decode(&std::iter::once(1).chain(random).collect::<Vec<_>>());
        }
    }
}
