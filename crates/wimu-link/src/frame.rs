//! Frames: delimit messages in a stream of bytes and detect damage.
//!
//! A frame is `COBS( kind/version byte, body, CRC-32C ) 0x00`. The first byte holds the [`Kind`] in
//! its low four bits and the wire version in its high four; the CRC-32C (CRC-32/ISCSI) covers that
//! byte and the body and is sent low byte first. COBS leaves no zero inside, so a receiver
//! resynchronises at the next zero.
//!
//! ```
//! use wimu_link::frame::{self, Deframer, Kind};
//!
//! let mut line = [0; frame::MAX_FRAME];
//! let length = frame::encode(Kind::Telemetry, b"a body", &mut line)?;
//!
//! let mut deframer = Deframer::new();
//! let mut bodies = 0;
//! for byte in &line[..length] {
//!     if let Some(Ok(frame)) = deframer.push(*byte) {
//!         assert_eq!((frame.kind, frame.body), (Kind::Telemetry, &b"a body"[..]));
//!         bodies += 1;
//!     }
//! }
//! assert_eq!(bodies, 1);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

use core::fmt;

use cobs::{CobsEncoder, DecodeResult, DecoderState};
use heapless::VecView;

use crate::message::SetBytes;
use wimu_model::checksum::{Digest, crc_32c};

/// The version of the wire protocol, independent of the crate's version.
pub const WIRE_VERSION: u8 = 3;

/// The longest body, bytes: the longest epoch has 743.
pub const MAX_BODY: usize = 752;

/// The longest frame, bytes, with its closing zero.
pub const MAX_FRAME: usize = frame_of(MAX_BODY);

/// Kind byte, body, CRC.
const MAX_PLAIN: usize = 1 + MAX_BODY + CRC_BYTES;

/// The longest frame of a body of `body` bytes.
const fn frame_of(body: usize) -> usize {
    cobs::max_encoding_length(1 + body + CRC_BYTES) + 1
}
const CRC_BYTES: usize = 4;

/// The kind of a frame's body.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum Kind {
    /// [`Hello`](crate::Hello), device to host; readable in every version.
    Hello = 1,
    /// [`WhoAreYou`](crate::WhoAreYou), host to device; readable in every version.
    WhoAreYou = 2,
    /// A [`Batch`](crate::Batch) of samples of the first accelerometer, device to host.
    Batch = 3,
    /// [`Telemetry`](crate::Telemetry), device to host.
    Telemetry = 4,
    /// [`Request`](crate::Request), host to device.
    Request = 5,
    /// [`Reply`](crate::Reply), device to host.
    Reply = 6,
    /// A [`Batch`](crate::Batch) of samples of any sensor, device to host.
    Inertial = 7,
}

impl Kind {
    fn from_number(number: u8) -> Option<Self> {
        Some(match number {
            1 => Self::Hello,
            2 => Self::WhoAreYou,
            3 => Self::Batch,
            4 => Self::Telemetry,
            5 => Self::Request,
            6 => Self::Reply,
            7 => Self::Inertial,
            _ => return None,
        })
    }

    /// Whether this kind holds samples: [`Batch::decode`](crate::Batch::decode) reads it.
    pub fn is_batch(self) -> bool {
        matches!(self, Self::Batch | Self::Inertial)
    }

    /// Whether this crate reads this kind in `version`.
    fn is_readable_in(self, version: u8) -> bool {
        matches!(self, Self::Hello | Self::WhoAreYou) || version == WIRE_VERSION
    }
}

/// Puts a frame of `kind` around `body` into `frame`; returns the frame's length, bytes, with its
/// closing zero. [`MAX_FRAME`] bytes of room are always enough.
///
/// # Errors
/// [`EncodeError`] when `body` exceeds [`MAX_BODY`] or the frame does not fit `frame`.
pub fn encode(kind: Kind, body: &[u8], frame: &mut [u8]) -> Result<usize, EncodeError> {
    build(kind, frame, &mut |writer| writer.push(body))
}

/// Builds a frame whose body `write` pushes piece by piece, so that a message needs no buffer of
/// its own; returns the frame's length, bytes.
pub(crate) fn build(
    kind: Kind,
    frame: &mut [u8],
    write: &mut dyn FnMut(&mut BodyWriter) -> Result<(), EncodeError>,
) -> Result<usize, EncodeError> {
    let mut writer =
        BodyWriter { cobs: CobsEncoder::new(frame), digest: Digest::new(), left: MAX_BODY };
    writer.code(&[(WIRE_VERSION << 4) | kind as u8])?;
    write(&mut writer)?;
    let BodyWriter { mut cobs, digest, .. } = writer;
    cobs.push(&digest.finalize().to_le_bytes()).map_err(|_| EncodeError::NoRoom)?;
    let coded = cobs.finalize();
    *frame.get_mut(coded).ok_or(EncodeError::NoRoom)? = 0;
    Ok(coded + 1)
}

/// Writes the body of a frame being built.
pub(crate) struct BodyWriter<'a> {
    cobs: CobsEncoder<'a>,
    digest: Digest,
    /// Bytes that may follow.
    left: usize,
}

impl BodyWriter<'_> {
    pub(crate) fn push(&mut self, bytes: &[u8]) -> Result<(), EncodeError> {
        // The encoder counts an empty push after a full run of 254 bytes as one byte more.
        if bytes.is_empty() {
            return Ok(());
        }
        self.left = (self.left.checked_sub(bytes.len())).ok_or(EncodeError::BodyTooLong)?;
        self.code(bytes)
    }

    fn code(&mut self, bytes: &[u8]) -> Result<(), EncodeError> {
        self.digest.update(bytes);
        self.cobs.push(bytes).map_err(|_| EncodeError::NoRoom)
    }
}

/// Puts the frame that `encode` writes into `kept`, or nothing if it does not fit.
pub(crate) fn fill(
    kept: &mut VecView<u8>,
    encode: impl FnOnce(&mut [u8]) -> Result<usize, EncodeError>,
) {
    let _ = kept.resize_default(kept.capacity());
    let length = encode(kept).unwrap_or(0);
    kept.truncate(length);
}

/// An undamaged frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Frame<'a> {
    /// The sender's wire version, 0..=15: this crate's own, or any on the kinds that every version reads.
    pub version: u8,
    /// The kind of the body.
    pub kind: Kind,
    /// The body, at most [`MAX_BODY`] bytes.
    pub body: &'a [u8],
}

/// Finds frames in a stream of bytes. Its only state is one frame of up to `PLAIN` bytes, so reading can
/// pause after any byte.
#[derive(Debug)]
pub struct Deframer<const PLAIN: usize = MAX_PLAIN> {
    cobs: DecoderState,
    length: usize,
    plain: [u8; PLAIN],
}

/// A [`Deframer`] with room for the longest request, for devices. Any longer frame is
/// [`FrameError::TooLong`].
pub type RequestDeframer = Deframer<{ 1 + MAX_REQUEST + CRC_BYTES }>;

/// Longest body of a request, bytes: session, id, signature, and a parameter set with its variant and length.
const MAX_REQUEST: usize = 5 + 5 + (1 + 8) + (1 + 2 + SetBytes::MAX);

impl Deframer {
    /// A deframer for a stream. In the middle of a stream, the bytes before the first zero are reported as
    /// one damaged frame.
    pub const fn new() -> Self {
        Self::empty()
    }
}

impl<const PLAIN: usize> Deframer<PLAIN> {
    const fn empty() -> Self {
        Self { cobs: DecoderState::Idle, length: 0, plain: [0; PLAIN] }
    }

    /// Takes the next byte; returns a frame or an error when the byte ends one.
    ///
    /// Zeros between frames are ignored.
    ///
    /// # Errors
    /// [`FrameError`], once per damaged or unreadable frame, at its closing zero.
    #[inline]
    pub fn push(&mut self, byte: u8) -> Option<Result<Frame<'_>, FrameError>> {
        let received = self.feed(byte)?;
        Some(self.checked(received))
    }

    /// Removes bytes from the front of `bytes` up to the end of a frame; returns the frame or an error, or
    /// `None` when all bytes are taken and no frame has ended. Equivalent to [`push`](Self::push) of each
    /// byte, but several times as fast.
    ///
    /// ```
    /// use wimu_link::frame::{self, Deframer, Kind};
    ///
    /// let mut line = [0; 2 * frame::MAX_FRAME];
    /// let first = frame::encode(Kind::Telemetry, b"one", &mut line)?;
    /// let second = frame::encode(Kind::Telemetry, b"two", &mut line[first..])?;
    ///
    /// let mut rest = &line[..first + second];
    /// let mut deframer = Deframer::new();
    /// let mut bodies = Vec::new();
    /// while let Some(frame) = deframer.next(&mut rest) {
    ///     bodies.push(frame?.body.to_vec());
    /// }
    /// assert_eq!(bodies, [b"one", b"two"]);
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    ///
    /// # Errors
    /// Those of [`push`](Self::push).
    pub fn next(&mut self, bytes: &mut &[u8]) -> Option<Result<Frame<'_>, FrameError>> {
        if matches!(self.cobs, DecoderState::Idle) {
            while let [0, rest @ ..] = bytes {
                *bytes = rest;
            }
            // Fast path: the whole frame is in `bytes`.
            if let Some((coded, [_, rest @ ..])) = find_zero(bytes).map(|end| bytes.split_at(end)) {
                *bytes = rest;
                let received = self.decode(coded);
                return Some(self.checked(received));
            }
        }
        while let Some((&byte, rest)) = bytes.split_first() {
            *bytes = rest;
            if let Some(received) = self.feed(byte) {
                return Some(self.checked(received));
            }
        }
        None
    }

    fn checked(&self, received: Result<usize, FrameError>) -> Result<Frame<'_>, FrameError> {
        check(self.plain.get(..received?).ok_or(FrameError::TooLong)?)
    }

    /// Decodes the COBS data between two zeros; returns its length.
    fn decode(&mut self, mut coded: &[u8]) -> Result<usize, FrameError> {
        let mut length = 0;
        while let Some((&code, rest)) = coded.split_first() {
            let run = usize::from(code).saturating_sub(1);
            let Some((run, rest)) = rest.split_at_checked(run) else {
                return Err(if length + rest.len() > PLAIN {
                    FrameError::TooLong
                } else {
                    FrameError::Cobs
                });
            };
            if let Some(place) = self.plain.get_mut(length..length + run.len()) {
                place.copy_from_slice(run);
            }
            length += run.len();
            if code < u8::MAX && !rest.is_empty() {
                if let Some(place) = self.plain.get_mut(length) {
                    *place = 0;
                }
                length += 1;
            }
            coded = rest;
        }
        Ok(length)
    }

    /// Takes the next byte; returns the length of the decoded frame when the byte ends it.
    #[inline]
    fn feed(&mut self, byte: u8) -> Option<Result<usize, FrameError>> {
        match self.cobs.feed(byte) {
            Ok(DecodeResult::NoData) => None,
            Ok(DecodeResult::DataStart) => {
                self.length = 0;
                None
            }
            Ok(DecodeResult::DataContinue(data)) => {
                if let Some(place) = self.plain.get_mut(self.length) {
                    *place = data;
                }
                // `PLAIN + 1` marks a frame that is too long.
                self.length = (self.length + 1).min(PLAIN + 1);
                None
            }
            Ok(DecodeResult::DataComplete) => Some(Ok(self.length)),
            Err(_) => {
                Some(Err(if self.length > PLAIN { FrameError::TooLong } else { FrameError::Cobs }))
            }
        }
    }
}

impl<const PLAIN: usize> Default for Deframer<PLAIN> {
    fn default() -> Self {
        Self::empty()
    }
}

/// Decodes a stored frame in place, with or without its closing zero; returns the length of its first
/// byte and its body. The first byte holds the wire version, which may be an earlier one.
///
/// # Errors
/// [`FrameError`] when `bytes` are not one frame. Their content is undefined then.
pub fn open(bytes: &mut [u8]) -> Result<usize, FrameError> {
    let length = cobs::decode_in_place(bytes).map_err(|_| FrameError::Cobs)?;
    let (first, body) = undamaged(bytes.get(..length).unwrap_or_default())?;
    let (version, kind) = (first >> 4, first & 15);
    match Kind::from_number(kind) {
        _ if version > WIRE_VERSION => Err(FrameError::UnknownVersion { version, kind }),
        Some(_) => Ok(1 + body.len()),
        None => Err(FrameError::UnknownKind { version, kind }),
    }
}

/// The position of the first zero.
fn find_zero(bytes: &[u8]) -> Option<usize> {
    const ONES: u64 = u64::from_ne_bytes([1; 8]);
    let (words, rest) = bytes.as_chunks::<8>();
    for (index, word) in words.iter().enumerate() {
        let word = u64::from_le_bytes(*word);
        // The lowest bit set is the highest bit of the first zero byte.
        let zeros = word.wrapping_sub(ONES) & !word & (ONES << 7);
        if zeros != 0 {
            return Some(8 * index + zeros.trailing_zeros() as usize / 8);
        }
    }
    let in_rest = rest.iter().position(|&byte| byte == 0)?;
    Some(8 * words.len() + in_rest)
}

/// The first byte and the body of an undamaged frame.
fn undamaged(plain: &[u8]) -> Result<(u8, &[u8]), FrameError> {
    let (covered, crc) = plain.split_last_chunk::<CRC_BYTES>().ok_or(FrameError::TooShort)?;
    let (&first, body) = covered.split_first().ok_or(FrameError::TooShort)?;
    if crc_32c(covered) == u32::from_le_bytes(*crc) {
        Ok((first, body))
    } else {
        Err(FrameError::Crc)
    }
}

fn check(plain: &[u8]) -> Result<Frame<'_>, FrameError> {
    let (first, body) = undamaged(plain)?;
    let (version, number) = (first >> 4, first & 15);
    match Kind::from_number(number) {
        Some(kind) if kind.is_readable_in(version) => Ok(Frame { version, kind, body }),
        _ if version != WIRE_VERSION => Err(FrameError::UnknownVersion { version, kind: number }),
        _ => Err(FrameError::UnknownKind { version, kind: number }),
    }
}

/// Why bytes between two zeros are not a readable frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum FrameError {
    /// The COBS code is invalid: bytes were lost or changed.
    Cobs,
    /// Fewer than the five bytes of kind and CRC.
    TooShort,
    /// More than [`MAX_FRAME`] bytes: the zero between two frames was lost.
    TooLong,
    /// The CRC does not match: bytes were lost or changed.
    Crc,
    /// An undamaged frame of an unsupported wire version.
    UnknownVersion {
        /// The sender's version.
        version: u8,
        /// Its kind, as a number.
        kind: u8,
    },
    /// An undamaged frame of an unknown kind.
    UnknownKind {
        /// The sender's version.
        version: u8,
        /// Its kind, as a number.
        kind: u8,
    },
}

impl FrameError {
    /// Whether the frame was damaged in transit, rather than of an unknown version or kind.
    pub fn is_damage(self) -> bool {
        matches!(self, Self::Cobs | Self::TooShort | Self::TooLong | Self::Crc)
    }
}

impl fmt::Display for FrameError {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Cobs => damaged(out, "its COBS code is invalid"),
            Self::TooShort => damaged(out, "it is shorter than 5 bytes"),
            Self::TooLong => write!(
                out,
                "a frame was damaged on the link, or the other end is not a wimu device: more than {MAX_FRAME} bytes without a zero"
            ),
            Self::Crc => damaged(out, "its CRC does not match"),
            Self::UnknownVersion { version, kind } => write!(
                out,
                "the other end uses wire version {version} (frame kind {kind}), this end version {WIRE_VERSION}; update {}",
                if *version < WIRE_VERSION { "the other end" } else { "this end" }
            ),
            Self::UnknownKind { version, kind } => write!(
                out,
                "frame kind {kind} is unknown in wire version {version}; update this end"
            ),
        }
    }
}

fn damaged(out: &mut fmt::Formatter<'_>, reason: &str) -> fmt::Result {
    write!(
        out,
        "a frame was damaged on the link: {reason}; check baud rate and wiring if this persists"
    )
}

impl core::error::Error for FrameError {}

/// Why a frame was not encoded.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum EncodeError {
    /// The body exceeds [`MAX_BODY`].
    BodyTooLong,
    /// The given buffer is too small.
    NoRoom,
    /// A batch without samples, or with too many.
    BatchLength {
        /// Most samples in a batch.
        most: usize,
    },
    /// A sensor's index that is too large.
    Sensor {
        /// The largest index.
        most: u8,
    },
}

impl fmt::Display for EncodeError {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::BodyTooLong => write!(out, "a frame's body is longer than {MAX_BODY} bytes"),
            Self::NoRoom => {
                write!(out, "the frame does not fit the given buffer; {MAX_FRAME} bytes always do")
            }
            Self::BatchLength { most } => write!(out, "a batch holds 1 to {most} samples"),
            Self::Sensor { most } => write!(out, "a sensor's index is at most {most}"),
        }
    }
}

impl core::error::Error for EncodeError {}
