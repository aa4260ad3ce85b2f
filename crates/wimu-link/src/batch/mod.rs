//! Lossless batches of samples.
//!
//! Each batch is decoded independently of others. Every axis is predicted from its previous samples,
//! and the residuals are Rice-coded; an axis that this would not shorten is sent with a fixed width. All
//! arithmetic is in integers. Equations (20) to (24) of docs/reference/equations.
//!
//! Body of a frame of [`Kind::Batch`]: samples of the accelerometer of sensor 0, raw counts of 16 bits or
//! corrected:
//!
//! | offset | size | field |
//! |---|---|---|
//! | 0 | 1 | bits 0 to 4: number of samples minus one; bit 5: [`Stream`], 0 raw, 1 corrected; bit 6: shifts follow; bit 7: decimated, only every n-th sample is included |
//! | 1 | 2 | low 16 bits of the first sample's sequence number, low byte first |
//! | 3 | 3 | low 24 bits of the first sample's device time, µs, low byte first |
//! | 6 | 1 | only with bit 7: n, 2 to 255 |
//! | 6, 7 with bit 7 | – | bits, most significant first, zeros up to the next whole byte |
//!
//! In a frame of [`Kind::Inertial`] one byte precedes the same body. Its bits 0 to 2 are the sensor's index;
//! bit 3: an angular rate follows each specific force (six axes); bit 4: raw counts of 20 bits; the others are
//! zero.
//!
//! W is 16 in a raw batch, 20 in one of 20 bits, 32 in a corrected one; F is 4, 5 and 5. The bits:
//!
//! - if shifts follow: that of the accelerometer, F bits; then that of the gyroscope, F bits, if there are six
//!   axes. Values of that sensor below are shifted left by it.
//! - for each axis, X, Y, Z of the accelerometer, then of the gyroscope: the coding in two bits,
//!   - 0, fixed width: L in F bits, then each sample in L + 1 bits, two's complement;
//!   - 1 mean, 3 linear: the Rice parameter k; the first sample; the residual of every other sample,
//!   - 2 is not used.
//! - k of the first predicted axis: F bits. Of a later one, against the latest before it: `0` the
//!   same, `100` one more, `101` one less, `11` and F bits: k itself.
//! - the first sample v: the length L of m in F bits, where m is v, or −v − 1 if v is negative; a
//!   sign bit, 1 for negative; m without its highest bit, L − 1 bits, none if L = 0.
//! - a residual, folded to u: q = ⌊u / 2^k⌋ ones (at most 11), a zero, the low k bits of u. Twelve
//!   ones are an escape: u follows in W bits.

mod decoded;
mod packing;
mod predict;
mod sample;
mod unpacking;

use core::num::NonZeroU8;

use wimu_model::DeviceTimeUs;

use crate::frame::{self, EncodeError, Kind};

use packing::Unpacked;

pub use decoded::{Batch, BatchError};
pub use sample::{Sample, Stream};

/// Most samples of three axes in a batch; of six axes, half as many ([`Sample::MOST`]).
pub const MAX_BATCH: usize = 32;

/// The largest index of a sensor.
pub const MAX_SENSOR: u8 = 7;

const HEADER: usize = 6;
const CORRECTED_BIT: u8 = 1 << 5;
const SHIFT_BIT: u8 = 1 << 6;
const DECIMATED_BIT: u8 = 1 << 7;

/// Bits of the byte before a batch of [`Kind::Inertial`], above the sensor's index.
const SIX_AXES_BIT: u8 = 1 << 3;
const WIDE_BIT: u8 = 1 << 4;

/// Longest body of a batch, bytes: all values at full width, at most 52 bits for shifts, codings and lengths,
/// rounded up to whole words.
const MAX_BATCH_BODY: usize =
    1 + HEADER + 1 + (52_usize.div_ceil(8) + MAX_BATCH * 3 * 4).next_multiple_of(4);

/// Ones that make an escape code.
const ESCAPE: u32 = 12;

/// What a batch is of, besides its samples.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Layout {
    /// Index of the sensor, 0..=[`MAX_SENSOR`].
    pub sensor: u8,
    /// Decimation: difference of the sequence numbers of consecutive samples. There is no anti-aliasing
    /// filter: frequencies above half the decimated rate are aliased.
    pub every: NonZeroU8,
}

impl Default for Layout {
    /// Every sample of sensor 0.
    fn default() -> Self {
        Self { sensor: 0, every: NonZeroU8::MIN }
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
///     let frame = frame?;
///     let batch = Batch::decode(frame.kind, frame.body)?;
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
    encode_with(Layout::default(), first_sequence, first_time, samples, frame)
}

/// Packs samples as [`encode`] does, in the given layout.
///
/// # Errors
/// Those of [`encode`]; [`EncodeError::Sensor`] for an index above [`MAX_SENSOR`].
pub fn encode_with<S: Sample>(
    layout: Layout,
    first_sequence: u32,
    first_time: DeviceTimeUs,
    samples: &[S],
    frame: &mut [u8],
) -> Result<usize, EncodeError> {
    let count = samples.len();
    if count == 0 || count > S::MOST {
        return Err(EncodeError::BatchLength { most: S::MOST });
    }
    let mut room = [0; MAX_BATCH * 3];
    let values = room.get_mut(..S::AXES * count).unwrap_or_default();
    for (axis, values) in values.chunks_exact_mut(count).enumerate() {
        for (value, sample) in values.iter_mut().zip(samples) {
            *value = sample.axis(axis);
        }
    }
    let Layout { sensor, every } = layout;
    let (stream, width) = (S::STREAM, S::WIDTH);
    let batch = Unpacked { stream, width, count, every, first_sequence, first_time, values };
    pack(extension::<S>(sensor)?, batch, frame)
}

/// Packs a batch behind the byte `extension`.
fn pack(
    extension: Option<u8>,
    mut batch: Unpacked<'_>,
    frame: &mut [u8],
) -> Result<usize, EncodeError> {
    let mut room = [0; MAX_BATCH_BODY];
    let (before, body) =
        room.split_at_mut_checked(extension.is_some().into()).ok_or(EncodeError::NoRoom)?;
    let length = before.len() + batch.encode(body)?;
    let kind = match (before, extension) {
        ([before], Some(extension)) => {
            *before = extension;
            Kind::Inertial
        }
        _ => Kind::Batch,
    };
    frame::encode(kind, room.get(..length).ok_or(EncodeError::NoRoom)?, frame)
}

/// The byte before a batch; `None` where [`Kind::Batch`] says the same.
fn extension<S: Sample>(sensor: u8) -> Result<Option<u8>, EncodeError> {
    if sensor > MAX_SENSOR {
        return Err(EncodeError::Sensor { most: MAX_SENSOR });
    }
    let six_axes = if S::AXES == 6 { SIX_AXES_BIT } else { 0 };
    let wide = if S::WIDE { WIDE_BIT } else { 0 };
    let extension = sensor | six_axes | wide;
    Ok((extension != 0).then_some(extension))
}

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
