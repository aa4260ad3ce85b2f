//! A received batch.

use core::fmt;

use wimu_model::{Counts, SpecificForceQ16, WideCounts};

use super::sample::{Sealed, Stream};
use super::unpacking::decode_axes;
use super::{
    CORRECTED_BIT, DECIMATED_BIT, HEADER, MAX_BATCH, MAX_SENSOR, SHIFT_BIT, SIX_AXES_BIT, WIDE_BIT,
};
use crate::bits::{BitReader, Remainder};
use crate::frame::Kind;

/// A decoded batch of samples.
#[derive(Clone, Copy, Debug)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Batch {
    stream: Stream,
    sensor: u8,
    has_gyroscope: bool,
    is_wide: bool,
    length: usize,
    every: u8,
    sequence_low: u16,
    time_low: u32,
    /// The accelerometer's; from `length` on the gyroscope's, if there is one; the others are zero.
    samples: [[i32; 3]; MAX_BATCH],
}

impl Batch {
    /// Unpacks the body of a frame of kind [`Kind::Batch`] or [`Kind::Inertial`].
    ///
    /// # Errors
    /// [`BatchError`] when the body is not what [`encode_with`](super::encode_with) makes, or the kind is
    /// another one.
    pub fn decode(kind: Kind, body: &[u8]) -> Result<Self, BatchError> {
        let (extension, body) = match kind {
            Kind::Batch => (0, body),
            Kind::Inertial => match body.split_first() {
                Some((&extension, body)) => (extension, body),
                None => return Err(BatchError::TooShort),
            },
            _ => return Err(BatchError::Kind),
        };
        let (header, bits) = body.split_first_chunk::<HEADER>().ok_or(BatchError::TooShort)?;
        let [first, sequence_0, sequence_1, time_0, time_1, time_2] = *header;
        let (every, bits) = if first & DECIMATED_BIT == 0 {
            (1, bits)
        } else {
            match bits.split_first().ok_or(BatchError::TooShort)? {
                (0 | 1, _) => return Err(BatchError::Decimation),
                (&every, bits) => (every, bits),
            }
        };
        let batch = Self {
            stream: if first & CORRECTED_BIT == 0 { Stream::Raw } else { Stream::Corrected },
            sensor: extension & MAX_SENSOR,
            has_gyroscope: extension & SIX_AXES_BIT != 0,
            is_wide: extension & WIDE_BIT != 0,
            length: usize::from(first & 31) + 1,
            every,
            sequence_low: u16::from_le_bytes([sequence_0, sequence_1]),
            time_low: u32::from_le_bytes([time_0, time_1, time_2, 0]),
            samples: [[0; 3]; MAX_BATCH],
        };
        let unknown = extension & !(MAX_SENSOR | SIX_AXES_BIT | WIDE_BIT);
        if unknown != 0 || batch.is_wide && batch.stream == Stream::Corrected {
            return Err(BatchError::Extension);
        }
        let has_shifts = first & SHIFT_BIT != 0;
        // One instance for each width, with its constants.
        match (batch.stream, batch.is_wide) {
            (Stream::Raw, false) => batch.with_samples::<Counts>(has_shifts, bits),
            (Stream::Raw, true) => batch.with_samples::<WideCounts>(has_shifts, bits),
            (Stream::Corrected, _) => batch.with_samples::<SpecificForceQ16>(has_shifts, bits),
        }
    }

    fn with_samples<S: Sealed>(
        mut self,
        has_shifts: bool,
        bits: &[u8],
    ) -> Result<Self, BatchError> {
        let (forces, rates) =
            self.samples.split_at_mut_checked(self.length).ok_or(BatchError::Length)?;
        let rates = if self.has_gyroscope {
            rates.get_mut(..self.length).ok_or(BatchError::Length)?
        } else {
            &mut []
        };
        let mut reader = BitReader::new(bits);
        let mut shift = |is_given: bool| if is_given { reader.pull(S::WIDTH.field()) } else { 0 };
        let shifts = [shift(has_shifts), shift(has_shifts && self.has_gyroscope)];
        let mut latest_k = None;
        for (samples, shift) in [forces, rates].into_iter().zip(shifts) {
            if !samples.is_empty() {
                decode_axes::<S>(samples, shift, &mut latest_k, &mut reader)?;
            }
        }
        reader.finish().map_err(|remainder| match remainder {
            Remainder::Missing => BatchError::TooShort,
            Remainder::Left => BatchError::TooLong,
        })?;
        Ok(self)
    }

    /// What the samples are.
    pub fn stream(&self) -> Stream {
        self.stream
    }

    /// Index of the sensor, 0..=[`MAX_SENSOR`].
    pub fn sensor(&self) -> u8 {
        self.sensor
    }

    /// Whether these are counts of 20 bits.
    pub fn is_wide(&self) -> bool {
        self.is_wide
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

    /// Low 16 bits of the first sample's sequence number: for [`extend_sequence`](super::extend_sequence).
    pub fn sequence_low(&self) -> u16 {
        self.sequence_low
    }

    /// Low 24 bits of the first sample's device time, µs: for [`extend_time`](super::extend_time).
    pub fn time_low(&self) -> u32 {
        self.time_low
    }

    /// The accelerometer's samples, X, Y, Z: LSB in sensor axes, or 2⁻¹⁶ m/s² in body axes.
    pub fn samples(&self) -> &[[i32; 3]] {
        self.samples.get(..self.length).unwrap_or_default()
    }

    /// The gyroscope's samples, X, Y, Z, one for each of [`samples`](Self::samples): LSB in sensor axes, or
    /// 2⁻²⁰ rad/s in body axes. Empty without a gyroscope.
    pub fn angular_rates(&self) -> &[[i32; 3]] {
        let rates = self.length..2 * self.length;
        if self.has_gyroscope { self.samples.get(rates).unwrap_or_default() } else { &[] }
    }

    /// The accelerometer's samples of a raw batch of 16 bits; none of another.
    pub fn counts(&self) -> impl Iterator<Item = Counts> + '_ {
        self.of(Stream::Raw, false).iter().map(|axes| Counts(axes.map(|value| value as i16)))
    }

    /// The accelerometer's samples of a corrected batch; none of a raw one.
    pub fn specific_forces(&self) -> impl Iterator<Item = SpecificForceQ16> + '_ {
        self.of(Stream::Corrected, false).iter().map(|&axes| SpecificForceQ16(axes))
    }

    fn of(&self, stream: Stream, is_wide: bool) -> &[[i32; 3]] {
        if (self.stream, self.is_wide) == (stream, is_wide) { self.samples() } else { &[] }
    }
}

/// Why a body is not a batch. The frame's CRC was valid, so this is a fault of the sender.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum BatchError {
    /// The frame is not of a kind that holds samples.
    Kind,
    /// The body ends before its samples do.
    TooShort,
    /// The body is longer than its samples.
    TooLong,
    /// It is marked as decimated, but by 0 or 1.
    Decimation,
    /// More samples of six axes than a batch holds.
    Length,
    /// Unknown bits before the batch, or corrected samples marked as counts of 20 bits.
    Extension,
    /// An invalid coding, shift, Rice parameter, length or residual.
    Value,
}

impl fmt::Display for BatchError {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        out.write_str("a batch of samples cannot be read: ")?;
        out.write_str(match self {
            Self::Kind => "its frame is of another kind",
            Self::TooShort => "it ends before its samples do",
            Self::TooLong => "it is longer than its samples",
            Self::Decimation => "it is marked as decimated, but by 0 or 1",
            Self::Length => "it has more than 16 samples of six axes",
            Self::Extension => "it is marked as a type of samples that is unknown",
            Self::Value => "it holds an invalid coding or residual",
        })?;
        out.write_str("; update host and device to the same wire version")
    }
}

impl core::error::Error for BatchError {}
