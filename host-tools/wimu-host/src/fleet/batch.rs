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
