//! A log of records in pages of NOR flash, laid out as `sequential-storage` 8 lays out a map.
//!
//! A page begins with a word that is cleared when the page is taken into use, and ends with one that is
//! cleared when it is full; between them stand items. Pages are used in turn, and the one after that in
//! use is always erased. An item is
//!
//! | bytes | what |
//! |---|---|
//! | 4 | CRC-32C of the data, begun with [`CRC_START`]; never 0, its first byte never 0 or 0xFF |
//! | 2 | length of the data |
//! | 2 | CRC-16F/4.2 of the length, never 0xFFFF |
//! | | up to a whole word |
//! | 1, 4, … | the data: key, generation, record |
//! | | up to a whole word |

use core::ops::Range;

use embedded_storage::nor_flash::NorFlash;

use crate::store::StoreFault;

/// Widest word of flash that is supported, bytes.
pub(crate) const WIDEST_WORD: usize = 32;
/// Bytes that are read and written at once.
const BLOCK: usize = 2 * WIDEST_WORD;
/// The number of an item's key and its generation stand before its record.
pub(crate) const BEFORE_RECORD: usize = 1 + 4;
/// CRC, length, and the length's CRC.
const HEAD: usize = 8;
const CRC_START: u32 = 0xEEEE_EEEE;
/// A page's mark stands when so many bits of its outer byte are cleared.
const MARKED_BITS: u32 = 4;
/// An item that cannot be written where it was to be is tried this often, each time elsewhere.
const ATTEMPTS: usize = 3;

/// Some flash wants what it writes aligned.
#[repr(align(4))]
struct Block([u8; BLOCK]);

/// An item whose head is whole.
#[derive(Clone, Copy, PartialEq)]
pub(crate) struct Item {
    at: u32,
    crc: u32,
    /// Of the data.
    length: usize,
    pub(crate) key: u8,
    pub(crate) generation: u32,
}

impl Item {
    /// Bytes of its record.
    pub(crate) fn record(&self) -> usize {
        self.length.saturating_sub(BEFORE_RECORD)
    }
}

/// What is in a page.
#[derive(Clone, Copy, PartialEq)]
enum Page {
    Blank,
    /// There may be room.
    Begun,
    Full,
    /// Power was lost while it was erased.
    HalfErased,
}

/// Where the next item is looked for: in the page that is the `page`th in use, the oldest first.
#[derive(Default)]
pub(crate) struct Cursor {
    page: u32,
    at: u32,
}

/// Items in whole pages of a flash.
pub(crate) struct FlashLog<F> {
    pub(crate) flash: F,
    range: Range<u32>,
}

impl<F: NorFlash> FlashLog<F> {
    const PAGE: u32 = F::ERASE_SIZE as u32;
    pub(crate) const WORD: u32 = if F::WRITE_SIZE > F::READ_SIZE {
        F::WRITE_SIZE as u32
    } else {
        F::READ_SIZE as u32
    };
    const HEAD: u32 = (HEAD as u32).next_multiple_of(Self::WORD);

    pub(crate) const fn new(flash: F, range: Range<u32>) -> Self {
        Self { flash, range }
    }

    /// Bytes of flash that an item takes.
    pub(crate) const fn footprint(data: usize) -> u32 {
        Self::HEAD + (data as u32).next_multiple_of(Self::WORD)
    }

    pub(crate) const fn pages(&self) -> u32 {
        (self.range.end - self.range.start) / Self::PAGE
    }

    /// The beginning of a page; pages are counted in a ring.
    fn page(&self, index: u32) -> u32 {
        self.range.start + index % self.pages() * Self::PAGE
    }

    fn read<'b>(
        &mut self,
        at: u32,
        length: u32,
        block: &'b mut Block,
    ) -> Result<&'b mut [u8], StoreFault> {
        let bytes = block.0.get_mut(..length as usize).ok_or(StoreFault)?;
        self.flash.read(at, bytes).map_err(|_| StoreFault)?;
        Ok(bytes)
    }

    /// Writes whole words and reads them back.
    fn write(&mut self, at: u32, bytes: &[u8]) -> Result<(), StoreFault> {
        self.flash.write(at, bytes).map_err(|_| StoreFault)?;
        let mut block = Block([0; _]);
        let found = self.read(at, bytes.len() as u32, &mut block)?;
        if found == bytes {
            Ok(())
        } else {
            Err(StoreFault)
        }
    }

    /// Whether bytes, whole words, are erased.
    fn is_blank(&mut self, mut at: u32, end: u32) -> Result<bool, StoreFault> {
        let mut block = Block([0; _]);
        while at < end {
            let length = (end - at).min(BLOCK as u32);
            if self
                .read(at, length, &mut block)?
                .iter()
                .any(|&b| b != 0xFF)
            {
                return Ok(false);
            }
            at += length;
        }
        Ok(true)
    }

    /// Whether more has been used than what the first records leave that power loss interrupted: a
    /// second page has been begun, or one has been filled.
    pub(crate) fn holds_more_than_a_beginning(&mut self) -> Result<bool, StoreFault> {
        let (mut begun, mut filled) = (0, 0);
        for index in 0..self.pages() {
            let page = self.page(index);
            let end = page + Self::PAGE;
            begun += u32::from(!self.is_blank(page, end)?);
            filled += u32::from(!self.is_blank(end - Self::WORD, end)?);
        }
        Ok(begun > 1 || filled > 0)
    }

    /// Erases a page and looks whether it is.
    fn erase(&mut self, page: u32) -> Result<(), StoreFault> {
        let end = page + Self::PAGE;
        self.flash.erase(page, end).map_err(|_| StoreFault)?;
        if self.is_blank(page, end)? {
            Ok(())
        } else {
            Err(StoreFault)
        }
    }

    pub(crate) fn erase_all(&mut self) -> Result<(), StoreFault> {
        (0..self.pages()).try_for_each(|index| self.erase(self.page(index)))
    }

    fn state(&mut self, page: u32) -> Result<Page, StoreFault> {
        let mut block = Block([0; _]);
        let begin = self.read(page, Self::WORD, &mut block)?;
        let is_begun = begin
            .first()
            .is_some_and(|byte| byte.count_zeros() >= MARKED_BITS);
        let end = self.read(page + Self::PAGE - Self::WORD, Self::WORD, &mut block)?;
        let is_full = end
            .last()
            .is_some_and(|byte| byte.count_zeros() >= MARKED_BITS);
        Ok(match (is_begun, is_full) {
            (false, false) => Page::Blank,
            (true, false) => Page::Begun,
            (true, true) => Page::Full,
            (false, true) => Page::HalfErased,
        })
    }

    /// The first page that is so.
    fn find(&mut self, state: Page) -> Result<Option<u32>, StoreFault> {
        for index in 0..self.pages() {
            if self.state(self.page(index))? == state {
                return Ok(Some(index));
            }
        }
        Ok(None)
    }

    /// Whether items can be appended: some page is in use, or free.
    pub(crate) fn is_usable(&mut self) -> Result<bool, StoreFault> {
        Ok(self.find(Page::Begun)?.is_some() || self.find(Page::Blank)?.is_some())
    }

    /// Clears the word at `at`.
    fn mark(&mut self, at: u32) -> Result<(), StoreFault> {
        let block = Block([0; _]);
        self.write(at, block.0.get(..Self::WORD as usize).ok_or(StoreFault)?)
    }

    fn close(&mut self, page: u32) -> Result<(), StoreFault> {
        self.mark(page + Self::PAGE - Self::WORD)
    }

    /// Takes the page that items are appended to for full. Damage may have cleared a part of it: what is
    /// written there uncovers what stands behind.
    pub(crate) fn turn_the_page(&mut self) -> Result<(), StoreFault> {
        while let Some(index) = self.find(Page::Begun)? {
            self.close(self.page(index))?;
        }
        Ok(())
    }

    /// The item at `at` or behind it in its page, and where to look for the next. What is no item is
    /// passed over word by word. Without one: where there is room.
    fn item_from(&mut self, mut at: u32) -> Result<(Option<Item>, u32), StoreFault> {
        let from_start = at - self.range.start;
        let end = at - from_start % Self::PAGE + Self::PAGE - Self::WORD;
        let mut block = Block([0; _]);
        while at + Self::HEAD <= end {
            let head = self.read(at, Self::HEAD, &mut block)?;
            if head.iter().all(|&byte| byte == 0xFF) {
                break;
            }
            if let [a, b, c, d, low, high, check @ ..] = head
                && let [low_check, high_check, ..] = check
            {
                let length = u16::from_le_bytes([*low, *high]);
                let next = at + Self::footprint(length.into());
                if u16::from_le_bytes([*low_check, *high_check]) == length_check(length)
                    && next <= end
                {
                    let mut item = Item {
                        at,
                        crc: u32::from_le_bytes([*a, *b, *c, *d]),
                        length: length.into(),
                        key: 0,
                        generation: 0,
                    };
                    if let [key, a, b, c, d, ..] = *self.data(&item, 0, &mut block)? {
                        item.key = key;
                        item.generation = u32::from_le_bytes([a, b, c, d]);
                        return Ok((Some(item), next));
                    }
                }
            }
            at += Self::WORD;
        }
        Ok((None, at))
    }

    /// The next item behind a cursor, through all pages from the oldest to that in use.
    pub(crate) fn next(&mut self, cursor: &mut Cursor) -> Result<Option<Item>, StoreFault> {
        let oldest = match self.find(Page::Begun)? {
            Some(begun) => begun + 1,
            None => self.find(Page::Blank)?.unwrap_or(0),
        };
        while cursor.page < self.pages() {
            let page = self.page(oldest + cursor.page);
            if matches!(self.state(page)?, Page::Begun | Page::Full) {
                let (item, at) = self.item_from(cursor.at.max(page + Self::WORD))?;
                if item.is_some() {
                    cursor.at = at;
                    return Ok(item);
                }
            }
            cursor.page += 1;
            cursor.at = 0;
        }
        Ok(None)
    }

    /// A block of an item's data, from offset `from` on.
    fn data<'b>(
        &mut self,
        item: &Item,
        from: usize,
        block: &'b mut Block,
    ) -> Result<&'b [u8], StoreFault> {
        let length = item.length.saturating_sub(from).min(BLOCK);
        let whole = (length as u32).next_multiple_of(Self::WORD);
        let bytes = self.read(item.at + Self::HEAD + from as u32, whole, block)?;
        bytes.get(..length).ok_or(StoreFault)
    }

    /// Whether an item's data are whole.
    pub(crate) fn is_whole(&mut self, item: &Item) -> Result<bool, StoreFault> {
        let mut block = Block([0; _]);
        let mut crc = CRC_START;
        for from in (0..item.length).step_by(BLOCK) {
            crc = crc_with(crc, self.data(item, from, &mut block)?);
        }
        Ok(crc_ended(crc) == item.crc)
    }

    /// The newest item of a key whose data are whole.
    pub(crate) fn newest(&mut self, key: u8) -> Result<Option<Item>, StoreFault> {
        let mut newest: Option<Item> = None;
        let mut cursor = Cursor::default();
        while let Some(item) = self.next(&mut cursor)? {
            if item.key == key
                && newest.is_none_or(|newest| newest.generation <= item.generation)
                && self.is_whole(&item)?
            {
                newest = Some(item);
            }
        }
        Ok(newest)
    }

    /// Copies an item's record to `place`, which is as long.
    pub(crate) fn copy(&mut self, item: &Item, place: &mut [u8]) -> Result<(), StoreFault> {
        let mut block = Block([0; _]);
        for from in (0..item.length).step_by(BLOCK) {
            for (index, &byte) in self.data(item, from, &mut block)?.iter().enumerate() {
                let offset = (from + index).checked_sub(BEFORE_RECORD);
                if let Some(place) = offset.and_then(|offset| place.get_mut(offset)) {
                    *place = byte;
                }
            }
        }
        Ok(())
    }

    /// Whether an item holds this record.
    pub(crate) fn holds(&mut self, item: &Item, record: &[u8]) -> Result<bool, StoreFault> {
        let mut block = Block([0; _]);
        let mut same = item.record() == record.len();
        for from in (0..item.length).step_by(BLOCK) {
            for (index, byte) in self.data(item, from, &mut block)?.iter().enumerate() {
                let offset = (from + index).checked_sub(BEFORE_RECORD);
                same &= offset.is_none_or(|offset| record.get(offset) == Some(byte));
            }
        }
        Ok(same)
    }

    /// Appends an item; `keys` are those of which the newest item must not get lost when an old page
    /// is erased for it.
    pub(crate) fn append(
        &mut self,
        key: u8,
        generation: u32,
        record: &[u8],
        keys: &[u8],
    ) -> Result<(), StoreFault> {
        for _ in 0..ATTEMPTS {
            let Some(at) = self.room(BEFORE_RECORD + record.len(), keys)? else {
                break;
            };
            if self.put(at, key, generation, record).is_ok() {
                return Ok(());
            }
        }
        Err(StoreFault)
    }

    /// Where an item has room; `None` in a log that is full.
    fn room(&mut self, data: usize, keys: &[u8]) -> Result<Option<u32>, StoreFault> {
        self.repair(keys)?;
        for _ in 0..self.pages() {
            if let Some(index) = self.find(Page::Begun)? {
                let page = self.page(index);
                let mut at = page + Self::WORD;
                loop {
                    let (item, next) = self.item_from(at)?;
                    at = next;
                    if item.is_none() {
                        break;
                    }
                }
                if at + Self::footprint(data) <= page + Self::PAGE - Self::WORD {
                    return Ok(Some(at));
                }
                self.close(page)?;
                self.mark(self.page(index + 1))?;
                self.free(index + 2, keys)?;
            } else {
                let index = self.find(Page::Blank)?.ok_or(StoreFault)?;
                self.mark(self.page(index))?;
                self.repair(keys)?;
            }
        }
        Ok(None)
    }

    /// Erases a page after what is needed of it has been moved into that before it, which has just been
    /// begun.
    fn free(&mut self, index: u32, keys: &[u8]) -> Result<(), StoreFault> {
        let page = self.page(index);
        if self.state(page)? == Page::Blank {
            return Ok(());
        }
        let mut to = self.page(index + self.pages() - 1) + Self::WORD;
        for &key in keys {
            if let Some(item) = self.newest(key)?
                && (page..page + Self::PAGE).contains(&item.at)
            {
                to = self.moved(&item, to)?;
            }
        }
        self.erase(page)
    }

    /// Copies an item to `to`; returns what is behind it.
    fn moved(&mut self, item: &Item, to: u32) -> Result<u32, StoreFault> {
        let length = Self::footprint(item.length);
        let mut block = Block([0; _]);
        for from in (0..length).step_by(BLOCK) {
            let part = (length - from).min(BLOCK as u32);
            let bytes = self.read(item.at + from, part, &mut block)?;
            self.write(to + from, bytes)?;
        }
        Ok(to + length)
    }

    /// Ends what power loss has interrupted: the erasing of a page, or the moving of what is needed of
    /// it.
    fn repair(&mut self, keys: &[u8]) -> Result<(), StoreFault> {
        while let Some(index) = self.find(Page::HalfErased)? {
            self.erase(self.page(index))?;
        }
        if let Some(index) = self.find(Page::Begun)?
            && self.state(self.page(index + 1))? != Page::Blank
        {
            self.erase(self.page(index))?;
            self.mark(self.page(index))?;
            self.free(index + 1, keys)?;
        }
        Ok(())
    }

    fn put(&mut self, at: u32, key: u8, generation: u32, record: &[u8]) -> Result<(), StoreFault> {
        let [a, b, c, d] = generation.to_le_bytes();
        let before = [key, a, b, c, d];
        let crc = crc_ended(crc_with(crc_with(CRC_START, &before), record));
        let length = BEFORE_RECORD + record.len();
        let mut block = Block([0xFF; _]);
        let head = [
            crc,
            u32::from(length_check(length as u16)) << 16 | length as u32,
        ];
        for (place, byte) in block
            .0
            .iter_mut()
            .zip(head.into_iter().flat_map(u32::to_le_bytes))
        {
            *place = byte;
        }
        self.write(at, block.0.get(..Self::HEAD as usize).ok_or(StoreFault)?)?;
        let mut data = before.iter().chain(record);
        for from in (0..length).step_by(BLOCK) {
            block = Block([0; _]);
            for (place, byte) in block.0.iter_mut().zip(&mut data) {
                *place = *byte;
            }
            let whole = (length - from)
                .min(BLOCK)
                .next_multiple_of(Self::WORD as usize);
            let bytes = block.0.get(..whole).ok_or(StoreFault)?;
            self.write(at + Self::HEAD + from as u32, bytes)?;
        }
        Ok(())
    }
}

/// CRC-16F/4.2 of a length.
fn length_check(length: u16) -> u16 {
    let mut crc = 0xFFFF;
    for byte in length.to_le_bytes() {
        crc ^= u16::from(byte);
        for _ in 0..8 {
            let carried = crc & 1 != 0;
            crc >>= 1;
            if carried {
                crc ^= 0x1A2E;
            }
        }
    }
    // What is erased is no length.
    match !crc {
        0xFFFF => 0xFFFE,
        crc => crc,
    }
}

/// A running CRC-32C after more bytes.
fn crc_with(mut crc: u32, bytes: &[u8]) -> u32 {
    for byte in bytes {
        crc ^= u32::from(*byte);
        for _ in 0..8 {
            let carried = crc & 1 != 0;
            crc >>= 1;
            if carried {
                crc ^= 0x82F6_3B78;
            }
        }
    }
    crc
}

/// The CRC as it is written: of one that is half written, the first byte is wrong.
fn crc_ended(crc: u32) -> u32 {
    match !crc {
        0 => 1,
        crc if matches!(crc & 0xFF, 0 | 0xFF) => crc ^ 1,
        crc => crc,
    }
}
