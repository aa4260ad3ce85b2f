//! Bits in a slice of bytes, most significant first.

/// Writes bits; what does not fit is dropped and reported at the end.
pub(crate) struct BitWriter<'a> {
    bytes: &'a mut [u8],
    place: Place,
}

/// Where a writer stands.
#[derive(Clone, Copy)]
pub(crate) struct Place {
    /// Bytes written, four at a time.
    length: usize,
    /// Bits not written yet, at the top; zeros below.
    held: u32,
    /// How many zeros there are below: 1..=32.
    free: u32,
}

impl<'a> BitWriter<'a> {
    pub(crate) fn new(bytes: &'a mut [u8]) -> Self {
        Self {
            bytes,
            place: Place {
                length: 0,
                held: 0,
                free: 32,
            },
        }
    }

    /// Appends `count` (0..=32) bits: `value`, which has no more.
    #[inline]
    pub(crate) fn push(&mut self, value: u32, count: u32) {
        let Place { length, held, free } = self.place;
        if let Some(left) = free.checked_sub(count + 1) {
            // In two steps, here and below, because a shift by 32 is none.
            self.place.held = held | (value << 1 << left);
            self.place.free = left + 1;
        } else {
            let over = count - free;
            if let Some(place) = self.bytes.get_mut(length..length + 4) {
                place.copy_from_slice(&(held | (value >> over)).to_be_bytes());
            }
            self.place = Place {
                length: length + 4,
                held: value << 1 << (31 - over),
                free: 32 - over,
            };
        }
    }

    /// Where it stands, to [go back](Self::go_back) to.
    pub(crate) fn place(&self) -> Place {
        self.place
    }

    /// Bits pushed since it stood at `start`.
    pub(crate) fn bits_since(&self, start: &Place) -> u32 {
        let bits = |place: &Place| 8 * place.length as u32 + 32 - place.free;
        bits(&self.place) - bits(start)
    }

    /// Takes back what was pushed since it stood at `place`.
    pub(crate) fn go_back(&mut self, place: Place) {
        self.place = place;
    }

    /// Fills the last byte with zeros; returns the length in bytes, or `None` if it did not fit.
    pub(crate) fn finish(self) -> Option<usize> {
        let Place { length, held, free } = self.place;
        let left = (32 - free).div_ceil(8) as usize;
        let end = self.bytes.get_mut(length..length + left)?;
        for (place, byte) in end.iter_mut().zip(held.to_be_bytes()) {
            *place = byte;
        }
        Some(length + left)
    }
}

/// Reads bits; past the end it reads zeros, and [`BitReader::finish`] then fails.
pub(crate) struct BitReader<'a> {
    bytes: &'a [u8],
    /// Bytes taken in, those of zeros past the end included.
    taken: usize,
    /// The next `available` bits, at the top.
    held: u64,
    available: u32,
}

impl<'a> BitReader<'a> {
    pub(crate) fn new(bytes: &'a [u8]) -> Self {
        Self {
            bytes,
            taken: 0,
            held: 0,
            available: 0,
        }
    }

    /// Takes in bytes until at least 32 bits are held.
    #[inline]
    fn refill(&mut self) {
        while self.available <= 32 {
            let byte = self.bytes.get(self.taken).copied().unwrap_or(0);
            self.taken += 1;
            self.held |= u64::from(byte) << (56 - self.available);
            self.available += 8;
        }
    }

    #[inline]
    fn skip(&mut self, count: u32) {
        self.held <<= count;
        self.available -= count;
    }

    /// The next `count` (0..=32) bits.
    #[inline]
    pub(crate) fn pull(&mut self, count: u32) -> u32 {
        self.refill();
        // In two steps, because a shift by 64 is none.
        let value = (self.held >> 1 >> (63 - count)) as u32;
        self.skip(count);
        value
    }

    /// How many ones come next, at most `limit` (0..=31); takes the zero after fewer than `limit`.
    #[inline]
    pub(crate) fn pull_ones(&mut self, limit: u32) -> u32 {
        self.refill();
        let ones = self.held.leading_ones();
        if ones < limit {
            self.skip(ones + 1);
            ones
        } else {
            self.skip(limit);
            limit
        }
    }

    /// Whether exactly the whole slice was read, up to zeros in the last byte.
    pub(crate) fn finish(&self) -> Result<(), Remainder> {
        let used_bits = self.taken as u64 * 8 - u64::from(self.available);
        let used_bytes = used_bits.div_ceil(8);
        let length = self.bytes.len() as u64;
        if used_bytes > length {
            Err(Remainder::Missing)
        } else if used_bytes < length
            || self.held >> 1 >> (63 - (used_bits.wrapping_neg() & 7)) != 0
        {
            Err(Remainder::Left)
        } else {
            Ok(())
        }
    }
}

/// How a slice differs from what was read of it.
pub(crate) enum Remainder {
    Missing,
    Left,
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn what_is_written_is_read(fields in prop::collection::vec((any::<u32>(), 0..=32_u32), 0..60)) {
            let mut bytes = [0; 256];
            let mut writer = BitWriter::new(&mut bytes);
            let masked = |value: u32, count: u32| value & ((1_u64 << count) - 1) as u32;
            for &(value, count) in &fields {
                writer.push(masked(value, count), count);
            }
            let length = writer.finish().unwrap();
            let bits: u32 = fields.iter().map(|field| field.1).sum();
            prop_assert_eq!(length, bits.div_ceil(8) as usize);
            let mut reader = BitReader::new(&bytes[..length]);
            for &(value, count) in &fields {
                prop_assert_eq!(reader.pull(count), masked(value, count));
            }
            prop_assert!(reader.finish().is_ok());
            prop_assert!(BitReader::new(&[]).finish().is_ok());
        }
    }

    #[test]
    fn ones_are_counted_up_to_the_limit() {
        let bytes = [0b1101_1111, 0b1111_1110, 0b1000_0000];
        let mut reader = BitReader::new(&bytes);
        assert_eq!(reader.pull_ones(12), 2);
        assert_eq!(reader.pull_ones(12), 12);
        assert_eq!(reader.pull_ones(12), 0);
        assert_eq!(reader.pull(2), 0b10);
        assert!(reader.finish().is_ok());
    }

    #[test]
    fn missing_and_left_over_bits_are_told() {
        let mut reader = BitReader::new(&[0xff]);
        reader.pull(9);
        assert!(matches!(reader.finish(), Err(Remainder::Missing)));
        let mut reader = BitReader::new(&[0xf1]);
        reader.pull(4);
        assert!(matches!(reader.finish(), Err(Remainder::Left)));
        let mut reader = BitReader::new(&[0xf0, 0]);
        reader.pull(4);
        assert!(matches!(reader.finish(), Err(Remainder::Left)));
    }

    #[test]
    fn a_full_buffer_is_told() {
        let mut bytes = [0; 2];
        let mut writer = BitWriter::new(&mut bytes);
        writer.push(1, 17);
        assert_eq!(writer.finish(), None);
    }
}
