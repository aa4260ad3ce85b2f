//! Items of the log: how one is laid out, written and read.
//!
//! An item is a header (check sum of the data, length of the data, check sum of the length) and the
//! data (key, generation, record), each padded to whole words.

use embedded_storage_async::nor_flash::NorFlash;

use super::directory::Entry;
use super::recovery::Rank;
use super::{FlashStore, WORD};
use crate::store::{MAX_RECORD, StoreFault};

/// Length of a header without padding, bytes.
pub(super) const HEADER: usize = 8;
/// Length of an item's key and generation, which precede its record, bytes.
pub(super) const HEAD: usize = 1 + 4;

/// The data of one item, in whole words. Some flash drivers need it aligned.
#[repr(align(4))]
pub(super) struct Buffer(pub(super) [u8; (HEAD + MAX_RECORD).next_multiple_of(WORD)]);

/// Room for one word of the widest flash.
#[repr(align(4))]
pub(super) struct Word(pub(super) [u8; WORD]);

impl<F: NorFlash> FlashStore<F> {
    /// End of the last byte of a range that is not erased, rounded up to a whole word; the range's start
    /// if all are erased.
    pub(super) async fn written_end(
        &mut self,
        range: core::ops::Range<u32>,
    ) -> Result<u32, StoreFault> {
        let mut end = range.end;
        while end > range.start {
            let mut part = Word([0xFF; WORD]);
            let begin = end.saturating_sub(WORD as u32).max(range.start);
            let bytes = part.0.get_mut(..(end - begin) as usize);
            Self::read(&mut self.flash, begin, bytes.unwrap_or_default()).await?;
            if let Some(last) = part.0.iter().rposition(|&byte| byte != 0xFF) {
                return Ok(begin + (last as u32 + 1).next_multiple_of(Self::UNIT as u32));
            }
            end = begin;
        }
        Ok(range.start)
    }

    pub(super) async fn read(flash: &mut F, at: u32, bytes: &mut [u8]) -> Result<(), StoreFault> {
        flash.read(at, bytes).await.map_err(|_| StoreFault)
    }

    /// The item at `at` if it is valid; its data is in the buffer afterwards.
    pub(super) async fn item(&mut self, at: u32) -> Result<Option<Entry>, StoreFault> {
        let mut header = Word([0xFF; WORD]);
        let data_at = at + Self::HEADER as u32;
        let Some(room) = Self::limit(at).checked_sub(data_at) else {
            return Ok(None);
        };
        let bytes = header.0.get_mut(..Self::HEADER).unwrap_or_default();
        Self::read(&mut self.flash, at, bytes).await?;
        let [a, b, c, d, low, high, e, f, ..] = header.0;
        let length = u16::from_le_bytes([low, high]);
        let padded = usize::from(length).next_multiple_of(Self::UNIT);
        let data = self.buffer.0.get_mut(..padded);
        let Some(data) =
            data.filter(|_| length_check([low, high]) == [e, f] && padded <= room as usize)
        else {
            return Ok(None);
        };
        Self::read(&mut self.flash, data_at, data).await?;
        let data = data.get(..length.into()).unwrap_or_default();
        match *data {
            [key, g, h, i, j, ..] if data_check(data) == [a, b, c, d] => Ok(Some(Entry {
                key,
                exists: length as usize > HEAD,
                generation: u32::from_le_bytes([g, h, i, j]),
                at,
                length: length - HEAD as u16,
                rank: Rank::None,
            })),
            _ => Ok(None),
        }
    }

    /// The next valid item in `at..end`, and where it ends. Damaged words are skipped one by one.
    pub(super) async fn next_item(
        &mut self,
        at: u32,
        end: u32,
    ) -> Result<Option<(Entry, u32)>, StoreFault> {
        for at in (at..end).step_by(Self::UNIT) {
            if let Some(item) = self.item(at).await? {
                return Ok(Some((item, at + Self::footprint(item.length) as u32)));
            }
        }
        Ok(None)
    }

    /// Erases a page and verifies it.
    pub(super) async fn erase(&mut self, page: u32) -> Result<(), StoreFault> {
        let end = page + Self::PAGE;
        let erased = self.flash.erase(page, end).await;
        erased.map_err(|_| StoreFault)?;
        match self.written_end(page..end).await? {
            written if written == page => Ok(()),
            _ => Err(StoreFault),
        }
    }

    /// Writes whole words and verifies them.
    pub(super) async fn write(flash: &mut F, at: u32, bytes: &[u8]) -> Result<(), StoreFault> {
        flash.write(at, bytes).await.map_err(|_| StoreFault)?;
        let mut found = Word([0; WORD]);
        for (written, at) in bytes.chunks(WORD).zip((at..).step_by(WORD)) {
            let found = found.0.get_mut(..written.len()).unwrap_or_default();
            Self::read(flash, at, found).await?;
            if found != written {
                return Err(StoreFault);
            }
        }
        Ok(())
    }

    /// Appends an item with the first `length` bytes of the buffer as its data.
    pub(super) async fn append(&mut self, length: usize) -> Result<(), StoreFault> {
        let at = self.end;
        let padded = length.next_multiple_of(Self::UNIT);
        let data_at = at + Self::HEADER as u32;
        let data = self.buffer.0.get_mut(..padded).ok_or(StoreFault)?;
        let (data, padding) = data.split_at_mut_checked(length).ok_or(StoreFault)?;
        padding.fill(0);
        let [low, high] = (length as u16).to_le_bytes();
        let [a, b, c, d] = data_check(data);
        let [e, f] = length_check([low, high]);
        let mut header = Word([0xFF; WORD]);
        if let Some(bytes) = header.0.first_chunk_mut() {
            *bytes = [a, b, c, d, low, high, e, f];
        }
        self.end = data_at + padded as u32;
        let header = header.0.get(..Self::HEADER).unwrap_or_default();
        Self::write(&mut self.flash, at, header).await?;
        let data = self.buffer.0.get(..padded).unwrap_or_default();
        Self::write(&mut self.flash, data_at, data).await
    }

    pub(super) async fn append_record(
        &mut self,
        key: u8,
        generation: u32,
        record: &[u8],
    ) -> Result<(), StoreFault> {
        let length = HEAD + record.len();
        let [a, b, c, d] = generation.to_le_bytes();
        let data = self.buffer.0.get_mut(..length).ok_or(StoreFault)?;
        let (head, body) = data.split_at_mut_checked(HEAD).ok_or(StoreFault)?;
        head.copy_from_slice(&[key, a, b, c, d]);
        body.copy_from_slice(record);
        self.append(length).await
    }
}

/// CRC-16F/4.2 (Koopman), reflected, of an item's length; never that of erased flash.
fn length_check(length: [u8; 2]) -> [u8; 2] {
    let check =
        length.iter().fold(0xFFFF, |check, &byte| crc_steps(check ^ u32::from(byte), 0x1A2E, 8));
    match !check as u16 {
        0xFFFF => 0xFFFE_u16.to_le_bytes(),
        check => check.to_le_bytes(),
    }
}

/// CRC-32C of an item's data, reflected, with the initial value 0xEEEEEEEE; its first byte is neither 0
/// nor 0xFF.
fn data_check(data: &[u8]) -> [u8; 4] {
    const NIBBLES: [u32; 16] = {
        let mut nibbles = [0; 16];
        let mut index = 0;
        while index < nibbles.len() {
            nibbles[index] = crc_steps(index as u32, 0x82F6_3B78, 4);
            index += 1;
        }
        nibbles
    };
    let check = data.iter().fold(0xEEEE_EEEE, |check: u32, &byte| {
        let nibble = |check: u32| check >> 4 ^ NIBBLES[check as usize % 16];
        nibble(nibble(check ^ u32::from(byte)))
    });
    match (!check).to_le_bytes() {
        [first @ (0 | 0xFF), b, c, d] => [first ^ 1, b, c, d],
        check => check,
    }
}

/// Shifts a reflected CRC by `bits` bits.
const fn crc_steps(mut check: u32, polynomial: u32, mut bits: u32) -> u32 {
    while bits > 0 {
        check = check >> 1 ^ if check & 1 == 1 { polynomial } else { 0 };
        bits -= 1;
    }
    check
}
