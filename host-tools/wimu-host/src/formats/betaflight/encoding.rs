//! Encodings of fields (Betaflight, `src/main/blackbox/blackbox_encoding.c`).

const SIGNED_VB: u8 = 0;
const UNSIGNED_VB: u8 = 1;
const NEG_14BIT: u8 = 3;
const TAG8_8SVB: u8 = 6;
const TAG2_3S32: u8 = 7;
const TAG8_4S16: u8 = 8;
const NULL: u8 = 9;
const TAG2_3SVARIABLE: u8 = 10;

/// Number of neighbouring fields that are encoded together, from the first of `encodings` on.
fn group(encodings: &[u8]) -> usize {
    match encodings[0] {
        TAG8_8SVB => {
            let same = encodings.iter().take_while(|of| **of == TAG8_8SVB);
            same.count().min(8)
        }
        TAG2_3S32 | TAG2_3SVARIABLE => 3,
        TAG8_4S16 => 4,
        _ => 1,
    }
}

/// Fewest bytes that fields can have.
pub(super) fn shortest(mut encodings: &[u8]) -> usize {
    let mut bytes = 0;
    while let Some(first) = encodings.first() {
        bytes += usize::from(*first != NULL);
        encodings = &encodings[group(encodings).min(encodings.len())..];
    }
    bytes
}

/// The lowest `bits` of a value, as a signed number.
fn sign_extended(value: u32, bits: u32) -> i64 {
    let unused = 32 - bits;
    i64::from((value << unused) as i32 >> unused)
}

/// Bytes of a frame.
pub(super) struct Cursor<'a> {
    bytes: &'a [u8],
    /// Index of the next byte.
    pub(super) at: usize,
}

impl<'a> Cursor<'a> {
    pub(super) fn new(bytes: &'a [u8], at: usize) -> Self {
        Self { bytes, at }
    }

    pub(super) fn byte(&mut self) -> Option<u32> {
        let byte = *self.bytes.get(self.at)?;
        self.at += 1;
        Some(byte.into())
    }

    /// A number of 7 bits a byte, the lowest first.
    pub(super) fn unsigned(&mut self) -> Option<u32> {
        let mut value = 0;
        for shift in (0..35).step_by(7) {
            let byte = self.byte()?;
            value |= (byte & 0x7F).wrapping_shl(shift);
            if byte < 0x80 {
                return Some(value);
            }
        }
        None
    }

    /// The same with the sign in the lowest bit.
    pub(super) fn signed(&mut self) -> Option<i64> {
        let value = self.unsigned()?;
        Some(((value >> 1) as i32 ^ -((value & 1) as i32)).into())
    }

    /// Bytes of a number, the lowest first.
    fn little_endian(&mut self, bytes: u32) -> Option<i64> {
        let mut value = 0;
        for index in 0..bytes {
            value |= self.byte()? << (8 * index);
        }
        Some(sign_extended(value, 8 * bytes))
    }

    /// Decodes fields into `values`; `None` at the end of the bytes or for an unknown encoding.
    pub(super) fn fields(&mut self, mut encodings: &[u8], values: &mut Vec<i64>) -> Option<()> {
        values.clear();
        while let Some(&encoding) = encodings.first() {
            let count = group(encodings).min(encodings.len());
            match encoding {
                SIGNED_VB => values.push(self.signed()?),
                UNSIGNED_VB => values.push(self.unsigned()?.into()),
                NEG_14BIT => values.push(-sign_extended(self.unsigned()?, 14)),
                TAG8_8SVB if count == 1 => values.push(self.signed()?),
                TAG8_8SVB => {
                    let present = self.byte()?;
                    for index in 0..count {
                        let is_present = present >> index & 1 == 1;
                        values.push(if is_present { self.signed()? } else { 0 });
                    }
                }
                TAG2_3S32 | TAG2_3SVARIABLE => {
                    let three = self.three(encoding == TAG2_3SVARIABLE)?;
                    values.extend(&three[..count]);
                }
                TAG8_4S16 => values.extend(&self.four()?[..count]),
                NULL => values.push(0),
                _ => return None,
            }
            encodings = &encodings[count..];
        }
        Some(())
    }

    /// Three numbers, whose width the first two bits say.
    fn three(&mut self, variable: bool) -> Option<[i64; 3]> {
        let first = self.byte()?;
        let fields = |value: u32, bits: [u32; 3]| {
            let shifts = [bits[1] + bits[2], bits[2], 0];
            std::array::from_fn(|k| sign_extended(value >> shifts[k], bits[k]))
        };
        Some(match (first >> 6, variable) {
            (0, _) => fields(first, [2, 2, 2]),
            (1, true) => fields(first << 8 | self.byte()?, [5, 5, 4]),
            (1, false) => fields(first << 8 | self.byte()?, [4, 4, 4]),
            (2, true) => fields(first << 16 | self.byte()? << 8 | self.byte()?, [8, 7, 7]),
            (2, false) => {
                let rest = [self.byte()?, self.byte()?];
                [first, rest[0], rest[1]].map(|byte| sign_extended(byte, 6))
            }
            _ => {
                let mut values = [0; 3];
                for (index, value) in values.iter_mut().enumerate() {
                    *value = self.little_endian((first >> (2 * index) & 3) + 1)?;
                }
                values
            }
        })
    }

    /// Four numbers of 0, 4, 8 or 16 bits, packed in half bytes, the highest first.
    fn four(&mut self) -> Option<[i64; 4]> {
        let widths = self.byte()?;
        let mut values = [0; 4];
        let (mut buffer, mut held) = (0_u64, 0);
        for (index, value) in values.iter_mut().enumerate() {
            let bits = [0, 4, 8, 16][(widths >> (2 * index) & 3) as usize];
            while held < bits {
                buffer = buffer << 8 | u64::from(self.byte()?);
                held += 8;
            }
            held -= bits;
            *value = match bits {
                0 => 0,
                bits => sign_extended((buffer >> held) as u32, bits),
            };
        }
        Some(values)
    }
}
