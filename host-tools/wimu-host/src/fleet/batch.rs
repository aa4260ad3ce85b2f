//! Batches: what a board sent, with the gateway's times of arrival, as one MQTT message.

/// Version of the format.
const VERSION: u8 = 1;
/// Most bytes of a batch that is accepted: 16 times the most that a gateway sends.
pub const MAX_BATCH: usize = 1 << 20;

/// Version, session, number, first time, duration in µs: fixed-size fields as bytes, so that postcard writes no varints.
type Head = (u8, [u8; 8], [u8; 4], [u8; 8], u64);

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
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum BatchError {
    /// It has another version.
    #[error("a batch of version {0}; this wimu reads {VERSION}")]
    Version(u8),
    /// It is longer than [`MAX_BATCH`].
    #[error("{0} bytes; a batch has at most {MAX_BATCH}")]
    TooLong(usize),
    /// It ends within a field, or a number is too large.
    #[error("not a batch of frames")]
    Damaged,
}

impl From<postcard::Error> for BatchError {
    fn from(_: postcard::Error) -> Self {
        Self::Damaged
    }
}

impl Batch {
    /// An empty batch.
    pub fn new(session: u64, number: u32) -> Self {
        Self { session, number, end_ns: 0, pieces: Vec::new() }
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
        let head: Head = (
            VERSION,
            self.session.to_le_bytes(),
            self.number.to_le_bytes(),
            first.to_le_bytes(),
            (self.end_ns - first) / 1000,
        );
        // Writing to a vector does not fail.
        let mut out = postcard::to_stdvec(&head).unwrap_or_default();
        let mut before = first;
        for (at, bytes) in &self.pieces {
            let piece = ((at - before) / 1000, bytes.len() as u64);
            out = postcard::to_extend(&piece, out).unwrap_or_default();
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
        match bytes {
            [] => return Err(BatchError::Damaged),
            [version, ..] if *version != VERSION => return Err(BatchError::Version(*version)),
            _ if bytes.len() > MAX_BATCH => return Err(BatchError::TooLong(bytes.len())),
            _ => {}
        }
        let (head, mut rest) = postcard::take_from_bytes::<Head>(bytes)?;
        let (_, session, number, first, duration_us) = head;
        let later = |at: u64, us: u64| {
            let ns = us.checked_mul(1000).ok_or(BatchError::Damaged)?;
            at.checked_add(ns).ok_or(BatchError::Damaged)
        };
        let mut at = u64::from_le_bytes(first);
        let mut batch = Self::new(u64::from_le_bytes(session), u32::from_le_bytes(number));
        batch.end_ns = later(at, duration_us)?;
        while !rest.is_empty() {
            let ((us, piece), after) = postcard::take_from_bytes::<(u64, &[u8])>(rest)?;
            at = later(at, us)?;
            batch.pieces.push((at, piece.to_vec()));
            rest = after;
        }
        Ok(batch)
    }
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
            assert!(cut.is_err() || cut.is_ok_and(|cut| cut.pieces.is_empty()), "{end}");
        }
        assert_eq!(Batch::decode(&[9; 40]), Err(BatchError::Version(9)));
        assert_eq!(Batch::decode(&vec![1; MAX_BATCH + 1]), Err(BatchError::TooLong(MAX_BATCH + 1)));
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
