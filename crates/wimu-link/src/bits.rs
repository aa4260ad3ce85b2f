//! Bits in a slice of bytes, most significant first.

/// Writes bits, four bytes at a time; overflow is reported at the end.
pub(crate) struct BitWriter<'a> {
    words: &'a mut [[u8; 4]],
    place: Place,
}

/// A position of a writer.
#[derive(Clone, Copy)]
pub(crate) struct Place {
    /// Words written.
    words: usize,
    /// Bits not written yet, from the most significant one, inverted, so that ones need no operation.
    held: u32,
    /// Number of those bits, 0..=31.
    count: u32,
}

impl<'a> BitWriter<'a> {
    /// Writes to `bytes`, of which up to three at the end stay unused.
    pub(crate) fn new(bytes: &'a mut [u8]) -> Self {
        Self { words: bytes.as_chunks_mut().0, place: Place { words: 0, held: 0, count: 0 } }
    }

    /// Appends `count` (0..=32) bits: `value`, which has no more.
    pub(crate) fn push(&mut self, value: u32, count: u32) {
        let inverted = value ^ u32::MAX.unbounded_shr(32 - count);
        self.place.append(self.words, inverted, count);
    }

    /// Appends each of `numbers` u as q = ⌊u / 2^k⌋ ones, a zero, and the low k bits of u; one with
    /// q of `escape` or more as `escape` ones and all its `width` bits. k + `escape` is 32 at most.
    #[inline(never)]
    pub(crate) fn push_rice(&mut self, numbers: &[u32], k: u32, escape: u32, width: u32) {
        // A copy, so that the loop keeps it in registers.
        let mut place = self.place;
        let zero = 1 << k;
        let lowest = u32::MAX >> (31 - k);
        for &number in numbers {
            let ones = number >> k;
            if ones < escape {
                place.append(self.words, (zero | !number) & lowest, ones + 1 + k);
            } else {
                unlikely();
                place.append(self.words, 0, escape);
                place.append(self.words, number ^ (u32::MAX >> (32 - width)), width);
            }
        }
        self.place = place;
    }

    /// The present position, for [`go_back`](Self::go_back).
    pub(crate) fn place(&self) -> Place {
        self.place
    }

    /// Bits pushed since the position `start`.
    pub(crate) fn bits_since(&self, start: &Place) -> u32 {
        let bits = |place: &Place| 32 * place.words as u32 + place.count;
        bits(&self.place) - bits(start)
    }

    /// Discards everything pushed since the position `place`.
    pub(crate) fn go_back(&mut self, place: Place) {
        self.place = place;
    }

    /// Fills the last byte with zeros; returns the length in bytes, or `None` if it did not fit.
    pub(crate) fn finish(self) -> Option<usize> {
        let Place { words, held, count } = self.place;
        if count > 0 {
            let bits = !held & !(u32::MAX >> count);
            *self.words.get_mut(words)? = bits.to_be_bytes();
        }
        let fits = words <= self.words.len();
        fits.then_some(4 * words + count.div_ceil(8) as usize)
    }
}

impl Place {
    /// Appends the `count` bits of `inverted`. Always inlined, so that the position stays in registers.
    #[inline(always)]
    fn append(&mut self, words: &mut [[u8; 4]], inverted: u32, count: u32) {
        // Rotated by this, the last bit is at its position.
        let end = self.count + count;
        let rotated = inverted.rotate_right(end);
        if end < 32 {
            self.held |= rotated;
            self.count = end;
        } else {
            unlikely();
            self.count = end % 32;
            let now = u32::MAX >> self.count;
            if let Some(word) = words.get_mut(self.words) {
                *word = (!(self.held | (rotated & now))).to_be_bytes();
            }
            self.words += 1;
            self.held = rotated & !now;
        }
    }
}

/// Marks an unlikely branch for the compiler.
#[cold]
fn unlikely() {}

/// Reads bits; past the end it reads zeros, and [`BitReader::finish`] then fails.
#[derive(Clone, Copy)]
pub(crate) struct BitReader<'a> {
    bytes: &'a [u8],
    /// The last eight bytes, with zeros before them if there are fewer.
    last: u64,
    /// Bytes taken in, including zeros past the end.
    taken: usize,
    /// At least the next `available` bits, from the most significant one, inverted, so that a run of ones is
    /// counted with `leading_zeros`.
    held: u64,
    available: u32,
}

impl<'a> BitReader<'a> {
    pub(crate) fn new(bytes: &'a [u8]) -> Self {
        let last = match bytes.last_chunk::<8>() {
            Some(last) => u64::from_be_bytes(*last),
            None => bytes.iter().fold(0, |last, &byte| last << 8 | u64::from(byte)),
        };
        Self { bytes, last, taken: 0, held: 0, available: 0 }
    }

    /// Takes in bytes until at least 57 bits are held.
    #[inline(always)]
    pub(crate) fn refill(&mut self) {
        let rest = self.bytes.get(self.taken..);
        let word = match rest.and_then(|rest| rest.first_chunk()) {
            Some(word) => u64::from_be_bytes(*word),
            None => last_word(self.last, self.bytes.len().saturating_sub(self.taken)),
        };
        // Bits beyond a whole byte are read again with the next word.
        self.held |= !word >> self.available;
        self.taken += ((63 ^ self.available) >> 3) as usize;
        self.available |= 56;
    }

    #[inline(always)]
    fn skip(&mut self, count: u32) {
        self.held <<= count;
        self.available -= count;
    }

    /// The next `count` (0..=32) bits, without taking them.
    #[inline(always)]
    pub(crate) fn peek(&self, count: u32) -> u32 {
        // In two steps, because a shift by 64 overflows.
        (!self.held >> 1 >> (63 - count)) as u32
    }

    /// The next `count` (0..=32) bits. Call [`refill`](Self::refill) before; it provides 57
    /// bits.
    #[inline(always)]
    pub(crate) fn take(&mut self, count: u32) -> u32 {
        let value = self.peek(count);
        self.skip(count);
        value
    }

    /// Calls [`refill`](Self::refill) and takes the next `count` (0..=32) bits.
    #[inline(always)]
    pub(crate) fn pull(&mut self, count: u32) -> u32 {
        self.refill();
        self.take(count)
    }

    /// Reads a number written by [`BitWriter::push_rice`]; k is below `width`. The result may exceed `width`
    /// bits; the caller checks it. Call [`refill`](Self::refill) before; it provides 57 bits. A code without
    /// escape takes at most `escape` + k of them; an escape refills.
    #[inline(always)]
    pub(crate) fn take_rice(&mut self, k: u32, escape: u32, width: u32) -> u64 {
        let held = self.held;
        if held >> (64 - escape) != 0 {
            // First the state that the next number depends on.
            let highest = held.ilog2();
            let below = highest - k;
            self.held = held << (below.wrapping_neg() & 63);
            self.available = self.available.wrapping_add(below).wrapping_sub(64);
            // The inverted stop bit and k low bits r: the number is (q + 2) 2^k − 1 − r for q ones.
            let power = 1_u64 << k;
            (65 * power - 1) - u64::from(highest) * power - (held >> below)
        } else {
            unlikely();
            self.skip(escape);
            let number = self.pull(width);
            self.refill();
            number.into()
        }
    }

    /// Checks that the whole slice was read, except for zeros in the last byte.
    pub(crate) fn finish(&self) -> Result<(), Remainder> {
        let used_bits = 8 * self.taken - self.available as usize;
        let used_bytes = used_bits.div_ceil(8);
        if used_bytes > self.bytes.len() {
            Err(Remainder::Missing)
        } else if used_bytes < self.bytes.len() || self.peek(self.available & 7) != 0 {
            Err(Remainder::Left)
        } else {
            Ok(())
        }
    }
}

/// The last `left` (0..=7) bytes of `last`, followed by zeros.
#[cold]
fn last_word(last: u64, left: usize) -> u64 {
    last.unbounded_shl(64 - 8 * left as u32)
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
        fn written_bits_are_read(fields in prop::collection::vec((any::<u32>(), 0..=32_u32), 0..60)) {
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
        reader.refill();
        assert_eq!(reader.take_rice(0, 12, 0), 2);
        assert_eq!(reader.take_rice(0, 12, 1), 0);
        assert_eq!(reader.take_rice(1, 12, 1), 0b10);
        assert!(reader.finish().is_ok());
    }

    #[test]
    fn missing_and_left_over_bits_are_reported() {
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

    proptest! {
        #[test]
        fn rice_coded_numbers_come_back(
            before in 0..=32_u32,
            numbers in prop::collection::vec((any::<u32>(), 0..32_u32).prop_map(|(u, less)| u >> less), 0..31),
            k in 0..=20_u32,
        ) {
            let mut bytes = [0; 256];
            let mut writer = BitWriter::new(&mut bytes);
            writer.push(0, before);
            writer.push_rice(&numbers, k, 12, 32);
            let length = writer.finish().unwrap();
            let mut reader = BitReader::new(&bytes[..length]);
            reader.pull(before);
            for number in numbers {
                reader.refill();
                prop_assert_eq!(reader.take_rice(k, 12, 32), number.into());
            }
            prop_assert!(reader.finish().is_ok());
        }
    }

    #[test]
    fn discarded_bits_are_not_written() {
        let mut bytes = [0xff; 64];
        let mut writer = BitWriter::new(&mut bytes);
        writer.push(0b101, 3);
        let start = writer.place();
        // More than there is room for.
        writer.push_rice(&[0x1234_5678; 20], 3, 12, 32);
        assert_eq!(writer.bits_since(&start), 20 * 44);
        writer.go_back(start);
        writer.push(0b01, 2);
        assert_eq!(writer.finish(), Some(1));
        assert_eq!(bytes[0], 0b1010_1000);
    }

    #[test]
    fn a_full_buffer_is_reported() {
        let mut bytes = [0; 2];
        let mut writer = BitWriter::new(&mut bytes);
        writer.push(1, 17);
        assert_eq!(writer.finish(), None);
    }
}
