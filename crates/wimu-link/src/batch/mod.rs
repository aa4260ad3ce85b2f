//! Lossless batches of accelerometer samples.
//!
//! Each batch is decoded independently of others. Every axis is predicted from its previous samples,
//! and the residuals are Rice-coded; an axis that this would not shorten is sent with a fixed width. All
//! arithmetic is in integers. Equations (20) to (24) of docs/EQUATIONS.md.
//!
//! Body of a frame of kind 3:
//!
//! | offset | size | field |
//! |---|---|---|
//! | 0 | 1 | bits 0 to 4: number of samples minus one; bit 5: [`Stream`], 0 raw, 1 corrected; bit 6: a shift follows; bit 7: decimated, only every n-th sample is included |
//! | 1 | 2 | low 16 bits of the first sample's sequence number, low byte first |
//! | 3 | 3 | low 24 bits of the first sample's device time, µs, low byte first |
//! | 6 | 1 | only with bit 7: n, 2 to 255 |
//! | 6, 7 with bit 7 | – | bits, most significant first, zeros up to the next whole byte |
//!
//! In the bits, F is 4 and W is 16 in a raw batch; F is 5 and W is 32 in a corrected one:
//!
//! - if a shift follows: the shift, F bits. All values below are shifted left by it.
//! - for X, then Y, then Z: the coding in two bits,
//!   - 0, fixed width: L in F bits, then each sample in L + 1 bits, two's complement;
//!   - 1 mean, 3 linear: the Rice parameter k; the first sample; the residual of every other sample,
//!   - 2 is not used.
//! - k of the first predicted axis: F bits. Of a later one, against the latest before it: `0` the
//!   same, `100` one more, `101` one less, `11` and F bits: k itself.
//! - the first sample v: the length L of m in F bits, where m is v, or −v − 1 if v is negative; a
//!   sign bit, 1 for negative; m without its highest bit, L − 1 bits, none if L = 0.
//! - a residual, folded to u: q = ⌊u / 2^k⌋ ones (at most 11), a zero, the low k bits of u. Twelve
//!   ones are an escape: u follows in W bits.

mod packing;
mod predict;
mod unpacking;

use core::fmt;
use core::num::NonZeroU8;

use wimu_model::{Counts, DeviceTimeUs, SpecificForceQ16};

use crate::bits::{BitReader, Remainder};
use crate::frame::{self, EncodeError, Kind};

/// Most samples in a batch.
pub const MAX_BATCH: usize = 32;

const HEADER: usize = 6;
const CORRECTED_BIT: u8 = 1 << 5;
const SHIFT_BIT: u8 = 1 << 6;
const DECIMATED_BIT: u8 = 1 << 7;

/// Longest body of a batch, bytes: all axes at full width, 26 bits for shift, codings and lengths, rounded
/// up to whole words.
const MAX_BATCH_BODY: usize =
    HEADER + 1 + (26_usize.div_ceil(8) + MAX_BATCH * 3 * 4).next_multiple_of(4);

/// Ones that make an escape code.
const ESCAPE: u32 = 12;

/// The type of the samples of a batch.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Stream {
    /// [`Counts`]: LSB, sensor axes.
    Raw,
    /// [`SpecificForceQ16`]: 2⁻¹⁶ m/s², body axes.
    Corrected,
}

impl Stream {
    /// W: bits of values and residuals.
    const fn width(self) -> u32 {
        match self {
            Self::Raw => 16,
            Self::Corrected => 32,
        }
    }

    /// F: bits of a number below W.
    const fn field(self) -> u32 {
        match self {
            Self::Raw => 4,
            Self::Corrected => 5,
        }
    }

    /// The largest Rice parameter that the encoder uses: below W, and short enough that a code with the
    /// longest prefix has at most 32 bits.
    const fn largest_k(self) -> u32 {
        match self {
            Self::Raw => 15,
            Self::Corrected => 32 - ESCAPE,
        }
    }

    /// Adds a folded residual, which is not wrapped yet, to the sum of a batch.
    #[inline]
    const fn add(self, sum: u32, folded: u32) -> u32 {
        match self {
            // At most 31 · 2¹⁹.
            Self::Raw => sum + folded,
            Self::Corrected => sum.saturating_add(folded),
        }
    }

    /// Whether a folded residual of a batch with this sum may exceed W bits.
    const fn can_be_exceeded_in(self, sum: u32) -> bool {
        matches!(self, Self::Raw) && sum > u16::MAX as u32
    }

    /// `value` modulo 2^W, −2^(W−1) to 2^(W−1) − 1.
    #[inline]
    const fn wrap(self, value: i32) -> i32 {
        let spare = 32 - self.width();
        (value << spare) >> spare
    }
}

mod sealed {
    pub trait Sealed {}
    impl Sealed for wimu_model::Counts {}
    impl Sealed for wimu_model::SpecificForceQ16 {}
}

/// A sample of a batch: [`Counts`] or [`SpecificForceQ16`].
pub trait Sample: Copy + sealed::Sealed {
    /// The stream that such samples make.
    const STREAM: Stream;

    /// X, Y or Z by its index; indices above 2 give Z, which avoids a bounds check.
    fn axis(&self, axis: usize) -> i32;
}

impl Sample for Counts {
    const STREAM: Stream = Stream::Raw;

    #[inline]
    fn axis(&self, axis: usize) -> i32 {
        i32::from(self.0[axis.min(2)])
    }
}

impl Sample for SpecificForceQ16 {
    const STREAM: Stream = Stream::Corrected;

    #[inline]
    fn axis(&self, axis: usize) -> i32 {
        self.0[axis.min(2)]
    }
}

/// Packs 1 to [`MAX_BATCH`] consecutive samples into a frame; returns the frame's length, bytes.
///
/// `first_sequence` and `first_time` are those of the first sample; their low bits travel, and
/// [`extend_sequence`] and [`extend_time`] complete them. The bytes of `frame` beyond
/// the frame's length are undefined afterwards.
///
/// ```
/// use wimu_link::{Batch, Deframer, MAX_FRAME, batch};
/// use wimu_model::{Counts, DeviceTimeUs};
///
/// let samples = [Counts([16, -32, 16384]), Counts([0, -48, 16400]), Counts([16, -32, 16368])];
/// let mut line = [0; MAX_FRAME];
/// let length = batch::encode(70_000, DeviceTimeUs(7_000_000), &samples, &mut line)?;
///
/// let mut deframer = Deframer::new();
/// for byte in &line[..length] {
///     let Some(frame) = deframer.push(*byte) else { continue };
///     let batch = Batch::decode(frame?.body)?;
///     assert!(batch.counts().eq(samples));
///     // An earlier epoch gives an approximate sequence number.
///     assert_eq!(batch::extend_sequence(batch.sequence_low(), 69_950), 70_000);
/// }
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Errors
/// [`EncodeError::BatchLength`] for no samples or too many; [`EncodeError::NoRoom`] when the frame
/// does not fit, which [`MAX_FRAME`](frame::MAX_FRAME) bytes rule out.
pub fn encode<S: Sample>(
    first_sequence: u32,
    first_time: DeviceTimeUs,
    samples: &[S],
    frame: &mut [u8],
) -> Result<usize, EncodeError> {
    encode_every(NonZeroU8::MIN, first_sequence, first_time, samples, frame)
}

/// Packs samples as [`encode`] does, in a stream decimated by `every`. There is no anti-aliasing filter:
/// frequencies above half the decimated rate are aliased.
///
/// # Errors
/// Those of [`encode`].
pub fn encode_every<S: Sample>(
    every: NonZeroU8,
    first_sequence: u32,
    first_time: DeviceTimeUs,
    samples: &[S],
    frame: &mut [u8],
) -> Result<usize, EncodeError> {
    // The end of `frame` has room for the body of all but the longest batches of corrected samples.
    // Clearing a separate buffer would take an eighth of the time of packing.
    let body_room = HEADER + 9 + samples.len() * 3 * (S::STREAM.width() as usize / 8);
    let frame_room = frame::MAX_FRAME - frame::MAX_BODY + body_room;
    if let Some((frame, body)) = frame.split_at_mut_checked(frame.len().wrapping_sub(body_room))
        && frame.len() >= frame_room
    {
        return pack(every, first_sequence, first_time, samples, body, frame);
    }
    let mut body = [0; MAX_BATCH_BODY];
    pack(every, first_sequence, first_time, samples, &mut body, frame)
}

fn pack<S: Sample>(
    every: NonZeroU8,
    first_sequence: u32,
    first_time: DeviceTimeUs,
    samples: &[S],
    body: &mut [u8],
    frame: &mut [u8],
) -> Result<usize, EncodeError> {
    let length = packing::encode_body(every, first_sequence, first_time, samples, body)?;
    let body = body.get(..length).ok_or(EncodeError::NoRoom)?;
    frame::encode(Kind::Batch, body, frame)
}

/// A decoded batch of samples.
#[derive(Clone, Copy, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Batch {
    stream: Stream,
    length: usize,
    every: u8,
    sequence_low: u16,
    time_low: u32,
    /// Those at and after `length` are zero.
    samples: [[i32; 3]; MAX_BATCH],
}

impl Batch {
    /// Unpacks the body of a frame of kind [`Kind::Batch`].
    ///
    /// # Errors
    /// [`BatchError`] when the body is not what [`encode`] makes.
    pub fn decode(body: &[u8]) -> Result<Self, BatchError> {
        let (header, bits) = body
            .split_first_chunk::<HEADER>()
            .ok_or(BatchError::TooShort)?;
        let [first, sequence_0, sequence_1, time_0, time_1, time_2] = *header;
        let (every, bits) = if first & DECIMATED_BIT == 0 {
            (1, bits)
        } else {
            match bits.split_first().ok_or(BatchError::TooShort)? {
                (0 | 1, _) => return Err(BatchError::Decimation),
                (&every, bits) => (every, bits),
            }
        };
        let stream = if first & CORRECTED_BIT == 0 {
            Stream::Raw
        } else {
            Stream::Corrected
        };
        let mut batch = Self {
            stream,
            length: usize::from(first & 31) + 1,
            every,
            sequence_low: u16::from_le_bytes([sequence_0, sequence_1]),
            time_low: u32::from_le_bytes([time_0, time_1, time_2, 0]),
            samples: [[0; 3]; MAX_BATCH],
        };
        let mut reader = BitReader::new(bits);
        let shift = if first & SHIFT_BIT == 0 {
            0
        } else {
            reader.pull(stream.field())
        };
        let samples = batch.samples.get_mut(..batch.length).unwrap_or_default();
        // One instance for each stream, with its constants.
        match stream {
            Stream::Raw => unpacking::decode_axes::<Counts>(samples, shift, &mut reader)?,
            Stream::Corrected => {
                unpacking::decode_axes::<SpecificForceQ16>(samples, shift, &mut reader)?
            }
        }
        reader.finish().map_err(|remainder| match remainder {
            Remainder::Missing => BatchError::TooShort,
            Remainder::Left => BatchError::TooLong,
        })?;
        Ok(batch)
    }

    /// What the samples are.
    pub fn stream(&self) -> Stream {
        self.stream
    }

    /// How many samples there are, 1..=[`MAX_BATCH`].
    #[allow(clippy::len_without_is_empty, reason = "a batch is never empty")]
    pub fn len(&self) -> usize {
        self.length
    }

    /// Decimation: difference of the sequence numbers of consecutive samples, 1..=255.
    pub fn every(&self) -> u8 {
        self.every
    }

    /// Low 16 bits of the first sample's sequence number: for [`extend_sequence`].
    pub fn sequence_low(&self) -> u16 {
        self.sequence_low
    }

    /// Low 24 bits of the first sample's device time, µs: for [`extend_time`].
    pub fn time_low(&self) -> u32 {
        self.time_low
    }

    /// The samples, X, Y, Z, in the unit and axes of their [`Stream`].
    pub fn samples(&self) -> &[[i32; 3]] {
        self.samples.get(..self.length).unwrap_or_default()
    }

    /// The samples of a raw batch; none of a corrected one.
    pub fn counts(&self) -> impl Iterator<Item = Counts> + '_ {
        self.of(Stream::Raw)
            .iter()
            .map(|axes| Counts(axes.map(|value| value as i16)))
    }

    /// The samples of a corrected batch; none of a raw one.
    pub fn specific_forces(&self) -> impl Iterator<Item = SpecificForceQ16> + '_ {
        self.of(Stream::Corrected)
            .iter()
            .map(|&axes| SpecificForceQ16(axes))
    }

    fn of(&self, stream: Stream) -> &[[i32; 3]] {
        if self.stream == stream {
            self.samples()
        } else {
            &[]
        }
    }
}

/// Why a body is not a batch. The frame's CRC was valid, so this is a fault of the sender.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum BatchError {
    /// The body ends before its samples do.
    TooShort,
    /// The body is longer than its samples.
    TooLong,
    /// It is marked as decimated, but by 0 or 1.
    Decimation,
    /// An invalid coding, Rice parameter or residual.
    Value,
}

impl fmt::Display for BatchError {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        out.write_str("a batch of samples cannot be read: ")?;
        out.write_str(match self {
            Self::TooShort => "it ends before its samples do",
            Self::TooLong => "it is longer than its samples",
            Self::Decimation => "it is marked as decimated, but by 0 or 1",
            Self::Value => "it holds an invalid coding or residual",
        })?;
        out.write_str("; update host and device to the same wire version")
    }
}

impl core::error::Error for BatchError {}

/// The sequence number nearest to `near` whose low 16 bits are `low`: equation (24). Right as long
/// as `near` is less than 2¹⁵ samples away.
pub fn extend_sequence(low: u16, near: u32) -> u32 {
    let ahead = low.wrapping_sub(near as u16) as i16;
    near.wrapping_add_signed(i32::from(ahead))
}

/// The device time nearest to `near` whose low 24 bits are `low` (µs): equation (24). Right as
/// long as `near` is less than 2²³ µs (8.3 s) away.
pub fn extend_time(low: u32, near: DeviceTimeUs) -> DeviceTimeUs {
    let ahead = (low.wrapping_sub(near.0 as u32) << 8) as i32 >> 8;
    // A time before the device's start is not possible.
    DeviceTimeUs(
        near.0
            .checked_add_signed(i64::from(ahead))
            .unwrap_or_else(|| near.0.wrapping_add_signed(i64::from(ahead) + (1 << 24))),
    )
}
