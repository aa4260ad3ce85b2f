//! Decoding of FIFO words (DS12140 §6.5 and §9, FIFO_DATA_OUT_TAG).

use core::fmt;

/// Bytes of a FIFO word: a tag and six bytes of data.
pub(crate) const WORD: usize = 7;
/// Words that the FIFO holds: 3 kbyte of data.
pub(crate) const DEPTH: u16 = 512;

/// TAG_SENSOR.
const GYROSCOPE: u8 = 0x01;
const ACCELEROMETER: u8 = 0x02;

/// Counts of x, y, z, low byte first.
pub(crate) fn axes([x0, x1, y0, y1, z0, z1]: [u8; 6]) -> [i16; 3] {
    [[x0, x1], [y0, y1], [z0, z1]].map(i16::from_le_bytes)
}

/// One sample of both sensors, taken at the same instant, x, y, z in sensor axes. A count of ±full
/// scale ([`i16::MAX`], [`i16::MIN`]) is saturated.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Sample {
    /// Specific force, LSB of [`AccelerationRange::ug_per_lsb`](crate::AccelerationRange::ug_per_lsb).
    pub acceleration: [i16; 3],
    /// Angular rate, LSB of [`AngularRateRange::udps_per_lsb`](crate::AngularRateRange::udps_per_lsb).
    pub angular_rate: [i16; 3],
}

/// Words of a sample of the LSM6DS3TR-C: three axes of the gyroscope, then of the accelerometer.
pub(crate) const TR_C_WORDS: u16 = 6;
/// Words that its FIFO holds: 4 kbyte.
pub(crate) const TR_C_DEPTH: u16 = 2048;

/// A sample of its FIFO.
pub(crate) fn pair(bytes: [u8; 12]) -> Sample {
    let [gx, hx, gy, hy, gz, hz, acceleration @ ..] = bytes;
    Sample { acceleration: axes(acceleration), angular_rate: axes([gx, hx, gy, hy, gz, hz]) }
}

/// What [`Lsm6dso::read`](crate::Lsm6dso::read) found in the FIFO.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Batch {
    /// Samples that were written. They follow each other without a gap.
    pub count: usize,
    /// Whether samples are missing between those of the batch before and these, for any reason.
    pub gap: bool,
    /// Whether the FIFO was full and dropped words.
    pub overrun: bool,
    /// The last fault in the sequence of words, if there was one. Samples of the same burst that
    /// came before it were dropped.
    pub fault: Option<FifoFault>,
    /// Samples that the FIFO still held after the burst.
    pub samples_left: u16,
}

/// Why words of the FIFO could not be used.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum FifoFault {
    /// The parity of a tag is wrong: a bit was changed on the bus.
    Parity {
        /// The tag byte.
        tag: u8,
    },
    /// A tag of a sensor that is not batched: bits were changed on the bus, or the settings of the
    /// chip.
    UnknownTag {
        /// The tag byte.
        tag: u8,
    },
    /// An accelerometer word came without the gyroscope word of its sample.
    GyroscopeMissing,
    /// A gyroscope word came without the accelerometer word of its sample.
    AccelerometerMissing,
    /// The tag counter advanced by more than one: whole samples are missing.
    SamplesMissing,
}

impl fmt::Display for FifoFault {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Parity { tag } => write!(out, "the FIFO tag {tag:#04x} has a parity error"),
            Self::UnknownTag { tag } => write!(out, "the FIFO tag {tag:#04x} is not expected"),
            Self::GyroscopeMissing => out.write_str("gyroscope words are missing in the FIFO"),
            Self::AccelerometerMissing => {
                out.write_str("accelerometer words are missing in the FIFO")
            }
            Self::SamplesMissing => out.write_str("samples are missing in the FIFO"),
        }
    }
}

impl core::error::Error for FifoFault {}

/// Joins the two words of a sample, which carry the same tag counter and follow each other in
/// either order.
///
/// The counter has two bits, so a gap of a multiple of four samples is invisible: the driver resets
/// the pairing wherever words may have been lost without a trace.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Pairing {
    /// The first word of a sample.
    half: Option<Half>,
    /// Tag counter of the sample before.
    last: Option<u8>,
}

#[derive(Clone, Copy, Debug)]
struct Half {
    sensor: u8,
    counter: u8,
    axes: [i16; 3],
}

impl Pairing {
    /// Takes the next word; returns the sample that it completes.
    ///
    /// # Errors
    /// [`FifoFault`]. Samples that are completed later do not follow those before without a gap.
    pub(crate) fn take(&mut self, word: [u8; WORD]) -> Result<Option<Sample>, FifoFault> {
        let [tag, data @ ..] = word;
        if tag.count_ones() % 2 != 0 {
            *self = Self::default();
            return Err(FifoFault::Parity { tag });
        }
        match tag >> 3 {
            sensor @ (GYROSCOPE | ACCELEROMETER) => {
                self.join(Half { sensor, counter: tag >> 1 & 0b11, axes: axes(data) })
            }
            _ => {
                *self = Self::default();
                Err(FifoFault::UnknownTag { tag })
            }
        }
    }

    fn join(&mut self, new: Half) -> Result<Option<Sample>, FifoFault> {
        match self.half.take() {
            Some(first) if first.counter == new.counter && first.sensor != new.sensor => {
                self.last = Some(new.counter);
                let (acceleration, angular_rate) = match new.sensor {
                    ACCELEROMETER => (new.axes, first.axes),
                    _ => (first.axes, new.axes),
                };
                Ok(Some(Sample { acceleration, angular_rate }))
            }
            Some(first) => {
                self.half = Some(new);
                self.last = None;
                Err(match first.sensor {
                    ACCELEROMETER => FifoFault::GyroscopeMissing,
                    _ => FifoFault::AccelerometerMissing,
                })
            }
            None => {
                self.half = Some(new);
                match self.last.take() {
                    Some(last) if (last + 1) & 0b11 != new.counter => {
                        Err(FifoFault::SamplesMissing)
                    }
                    _ => Ok(None),
                }
            }
        }
    }
}
