//! Decoding of FIFO words (DS12140 §6.5 and §9, FIFO_DATA_OUT_TAG).

use wimu_model::Counts;

/// Bytes of a FIFO word: a tag and six bytes of data.
pub(super) const WORD: usize = 7;

/// TAG_SENSOR.
const GYROSCOPE: u8 = 0x01;
const ACCELEROMETER: u8 = 0x02;

/// Counts of x, y, z, low byte first.
pub(super) fn axes([x0, x1, y0, y1, z0, z1]: [u8; 6]) -> Counts {
    Counts([[x0, x1], [y0, y1], [z0, z1]].map(i16::from_le_bytes))
}

/// Why words of the FIFO could not be used.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Fault {
    /// An accelerometer word came without the gyroscope word of its sample.
    GyroscopeMissing,
    /// Another word is missing, whole samples are, or a bit was changed on the bus.
    Other,
}

/// Joins the two words of a sample, which carry the same tag counter and follow each other in
/// either order.
///
/// The counter has two bits, so a gap of a multiple of four samples is invisible: the driver resets
/// the pairing wherever words may have been lost without a trace.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Pairing {
    /// The first word of a sample.
    half: Option<Half>,
    /// Tag counter of the sample before.
    last: Option<u8>,
}

#[derive(Clone, Copy, Debug)]
struct Half {
    sensor: u8,
    counter: u8,
    axes: Counts,
}

impl Pairing {
    /// Takes the next word; returns the sample that it completes, accelerometer and gyroscope.
    ///
    /// # Errors
    /// [`Fault`]. Samples that are completed later do not follow those before without a gap.
    pub(super) fn take(&mut self, word: [u8; WORD]) -> Result<Option<(Counts, Counts)>, Fault> {
        let [tag, data @ ..] = word;
        let sensor = tag >> 3;
        let has_parity = tag.count_ones().is_multiple_of(2);
        if !has_parity || !matches!(sensor, GYROSCOPE | ACCELEROMETER) {
            *self = Self::default();
            return Err(Fault::Other);
        }
        self.join(Half { sensor, counter: tag >> 1 & 0b11, axes: axes(data) })
    }

    fn join(&mut self, new: Half) -> Result<Option<(Counts, Counts)>, Fault> {
        let Some(first) = self.half.take() else {
            self.half = Some(new);
            return match self.last.take() {
                Some(last) if (last + 1) & 0b11 != new.counter => Err(Fault::Other),
                _ => Ok(None),
            };
        };
        if first.counter == new.counter && first.sensor != new.sensor {
            self.last = Some(new.counter);
            return Ok(Some(match new.sensor {
                ACCELEROMETER => (new.axes, first.axes),
                _ => (first.axes, new.axes),
            }));
        }
        self.half = Some(new);
        self.last = None;
        Err(match first.sensor {
            ACCELEROMETER => Fault::GyroscopeMissing,
            _ => Fault::Other,
        })
    }
}
