//! CRC-32C (CRC-32/ISCSI), of frames, parameter sets and what is stored.

// Each target uses one of the two.
#![cfg_attr(not(test), allow(dead_code))]

#[cfg(target_pointer_width = "64")]
pub use self::Fast as Digest;

#[cfg(not(target_pointer_width = "64"))]
pub use self::Small as Digest;

/// CRC-32C (CRC-32/ISCSI) of `bytes`.
pub fn crc_32c(bytes: &[u8]) -> u32 {
    Digest::of(bytes)
}

static TABLES: crc::Crc<u32, crc::Table<16>> =
    crc::Crc::<u32, crc::Table<16>>::new(&crc::CRC_32_ISCSI);

/// Bytes that the tables process in one step.
const BLOCK: usize = 16;

/// A running CRC-32C for hosts: 16 KiB of tables.
pub struct Fast(crc::Digest<'static, u32, crc::Table<16>>);

impl Fast {
    /// Of no bytes.
    #[allow(clippy::new_without_default, reason = "a digest is begun, not defaulted")]
    pub fn new() -> Self {
        Self(TABLES.digest())
    }

    /// CRC-32C of `bytes`; avoids the slow path for a remainder of up to 15 bytes.
    pub fn of(bytes: &[u8]) -> u32 {
        let odd = bytes.len() % BLOCK;
        let mut whole = Self::new();
        let mut rest = bytes;
        if let (4.., Some(first)) = (odd, bytes.first_chunk::<BLOCK>()) {
            // Leading zeros do not change a register of zeros, and the initial value of ones is equivalent
            // to inverting the first four bytes.
            let padded = (u128::from_le_bytes(*first) ^ 0xffff_ffff) << (8 * (BLOCK - odd));
            whole = Self(TABLES.digest_with_initial(0));
            whole.update(&padded.to_le_bytes());
            rest = bytes.get(odd..).unwrap_or_default();
        }
        whole.update(rest);
        whole.finalize()
    }

    /// Adds bytes.
    pub fn update(&mut self, bytes: &[u8]) {
        self.0.update(bytes);
    }

    /// The CRC.
    pub fn finalize(self) -> u32 {
        self.0.finalize()
    }
}

/// A running CRC-32C for a microcontroller: 64 bytes of table, half a byte at a time.
pub struct Small(u32);

impl Small {
    /// The CRC of each value of half a byte.
    const TABLE: [u32; 16] = {
        const POLYNOMIAL: u32 = 0x82F6_3B78;
        let mut table = [0; 16];
        let mut index = 0;
        while index < 16 {
            let mut crc = index as u32;
            let mut bit = 0;
            while bit < 4 {
                crc = (crc >> 1) ^ if crc & 1 == 1 { POLYNOMIAL } else { 0 };
                bit += 1;
            }
            table[index] = crc;
            index += 1;
        }
        table
    };

    /// CRC-32C of `bytes`.
    pub fn of(bytes: &[u8]) -> u32 {
        let mut digest = Self::new();
        digest.update(bytes);
        digest.finalize()
    }

    /// Of no bytes.
    #[allow(clippy::new_without_default, reason = "a digest is begun, not defaulted")]
    pub fn new() -> Self {
        Self(u32::MAX)
    }

    /// Adds bytes.
    pub fn update(&mut self, bytes: &[u8]) {
        let half = |crc: u32| (crc >> 4) ^ Self::TABLE[(crc & 15) as usize];
        for &byte in bytes {
            self.0 = half(half(self.0 ^ u32::from(byte)));
        }
    }

    /// The CRC.
    pub fn finalize(self) -> u32 {
        !self.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::vec::Vec;

    proptest! {
        #[test]
        fn both_implementations_agree_on_any_bytes_in_any_pieces(bytes: Vec<u8>, cut: prop::sample::Index) {
            let (first, second) = bytes.split_at(cut.index(bytes.len() + 1));
            let (mut fast, mut small) = (Fast::new(), Small::new());
            for piece in [first, second] {
                fast.update(piece);
                small.update(piece);
            }
            let crc = fast.finalize();
            prop_assert_eq!(small.finalize(), crc);
            prop_assert_eq!([Fast::of(&bytes), Small::of(&bytes)], [crc; 2]);
        }
    }
}
