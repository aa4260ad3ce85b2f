//! Records in a board's NOR flash.

mod compaction;
mod directory;
mod item;
mod recovery;

use core::marker::PhantomData;
use core::ops::Range;

use embedded_storage_async::nor_flash::NorFlash;
use heapless::Vec;

use self::directory::{Directory, Entry, KEYS};
use self::item::{Buffer, HEAD, HEADER, Word};
use crate::store::{Key, MAX_RECORD, Store, StoreFault};

/// Widest word of flash that is supported, bytes.
const WORD: usize = 32;
/// Key of a directory. A directory without entries is a seal.
const DIRECTORY: u8 = 0;
/// Each byte of the first word of a page. Firmware that used `sequential-storage` wrote zeros.
const MARK: u8 = 0x77;
/// Attempts at a change, each in another page.
const ATTEMPTS: usize = 3;
/// Directories that a change appends. A removal appends no record, so its directory is written twice.
const SAVE_DIRECTORIES: usize = 1;
const REMOVAL_DIRECTORIES: usize = 2;

/// The pages of a flash that hold the store: two or more whole ones. Made at compile time, where a
/// layout that cannot work is an error.
///
/// Four pages of 4 KiB hold what a node keeps: complete parameter sets for four
/// ranges, settings, key, boot count. Two hold complete sets for two ranges, or shorter ones for four.
/// With more pages each is erased less often. All pages have one size; of a flash with unequal sectors, `F` is a driver of
/// those of one size.
#[derive(Clone, Debug)]
pub struct FlashLayout<F> {
    range: Range<u32>,
    flash: PhantomData<F>,
}

impl<F: NorFlash> FlashLayout<F> {
    /// The pages at `range`, bytes from the start of the flash.
    ///
    /// # Panics
    /// When the range is not two or more whole pages, each with room for three of the longest records,
    /// or the flash has words wider than 32 bytes. Call it in a constant.
    pub const fn new(range: Range<u32>) -> Self {
        let page = F::ERASE_SIZE as u32;
        assert!(
            range.start.is_multiple_of(page)
                && range.end.is_multiple_of(page)
                && range.end.saturating_sub(range.start) >= 2 * page,
            "the store needs two or more whole pages of flash"
        );
        assert!(
            WORD.is_multiple_of(F::WRITE_SIZE) && WORD.is_multiple_of(F::READ_SIZE),
            "the words of this flash are too wide"
        );
        assert!(
            F::ERASE_SIZE >= 3 * (HEAD + MAX_RECORD + WORD),
            "the pages of this flash are too small"
        );
        Self { range, flash: PhantomData }
    }
}

/// The node's [`Store`] in any NOR flash: a log of items, page after page, so that pages wear evenly.
///
/// Each record has a generation. A change appends the record, a directory (the latest generation of
/// every record) and a seal (an empty directory). It takes effect when its directory is readable. A
/// record that is damaged after it was saved is an error, because the directory lists its generation;
/// an older generation is never returned instead.
///
/// A write or an erase that power loss interrupts may leave cells that read differently each time.
/// The store never relies on the last words written before a restart:
/// - A page is finished if its last item is a seal. The directory before the seal was complete, whether
///   or not the seal stays readable.
/// - The valid part of an unfinished page is copied to another page, and the page is erased, before any
///   record is read from it. A change that was found once stays, one that was not found never appears.
/// - A page is erased when it is begun, and only if it holds no record in use, neither by all items nor by the sealed ones
///   alone: what follows a seal may read differently at the next start. A new page is accepted from its first seal on, so the
///   source of a copy exists until the copy is complete.
/// - Words that read as erased may be a partly written header. The first change after a restart overwrites them with
///   zeros and appends behind them.
///
/// Every written word and every erased page is read back, so a worn-out flash is an error and never
/// loses an old record. The store can be written whatever the flash contains: if damage leaves no page without a
/// record in use, the page with the fewest is erased, and its records are errors from then on. No word
/// is written twice, and an unchanged record is not written again.
///
/// Assumptions: an interrupted write disturbs only the words being written, an interrupted erase only
/// its page.
///
/// The item format is that of [`sequential-storage`](https://docs.rs/sequential-storage) 8, which earlier
/// firmware used. Its pages are read, and copied when the flash is first used.
///
/// Blocking flash drivers, such as those of `embassy-nrf` and `embassy-rp`, become asynchronous in
/// `embassy_embedded_hal::adapter::BlockingAsync`:
///
/// ```
/// use embedded_storage_async::nor_flash::NorFlash;
/// use wimu_node::{FlashLayout, FlashStore};
///
/// /// The last four pages of 4 KiB of a flash of 512 KiB, as on an nRF52833; erasing one takes up
/// /// to 90 ms.
/// fn store<F: NorFlash>(flash: F) -> FlashStore<F> {
///     FlashStore::new(flash, const { FlashLayout::new(0x7C000..0x80000) }, 90)
/// }
/// ```
///
/// 1.3 KB of RAM.
pub struct FlashStore<F: NorFlash> {
    flash: F,
    range: Range<u32>,
    buffer: Buffer,
    directory: Directory,
    /// The directory and the fields below describe the flash.
    is_known: bool,
    /// No accepted item was found.
    is_empty: bool,
    /// No accepted item was found, but more than one page has been written.
    is_corrupt: bool,
    /// Of two equally reliable copies of a record the last one is used.
    prefers_last: bool,
    /// There are pages that are neither empty nor finished.
    has_unfinished: bool,
    /// Addresses of the records that are in use by the sealed items alone, while there are such pages.
    sealed: Vec<u32, KEYS>,
    /// Latest number of an accepted directory or seal.
    serial: u32,
    /// Latest number of a seal.
    newest_seal: u32,
    /// The page where items are appended: the one with the newest seal, if it is finished.
    page: Option<u32>,
    /// Address at which the next item is appended: the end of the items of `page`.
    end: u32,
    /// The page with the newest seal, finished or not, if it has only one seal.
    single_seal: Option<u32>,
    /// The page whose end has been overwritten with zeros since the restart.
    secured: Option<u32>,
    pause_ms: u16,
}

impl<F: NorFlash> FlashStore<F> {
    /// Granularity of reads and writes, bytes.
    const UNIT: usize = if F::WRITE_SIZE > F::READ_SIZE { F::WRITE_SIZE } else { F::READ_SIZE };
    const PAGE: u32 = F::ERASE_SIZE as u32;
    const HEADER: usize = HEADER.next_multiple_of(Self::UNIT);
    /// Bytes that a page keeps free when records are copied into it: for two directories with their seal, and
    /// for five more seals. One of them ends the copying, the others are for repairs after a restart.
    const OPENING: usize = Self::overhead(REMOVAL_DIRECTORIES) + 5 * Self::overhead(0);

    /// The records that `flash` holds. `pause_ms` is the longest time to erase a page and write it, ms,
    /// during which the processor may be stalled.
    pub const fn new(flash: F, layout: FlashLayout<F>, pause_ms: u16) -> Self {
        let FlashLayout { range, .. } = layout;
        Self {
            flash,
            range,
            buffer: Buffer([0; _]),
            directory: Directory::EMPTY,
            is_known: false,
            is_empty: true,
            is_corrupt: false,
            prefers_last: true,
            has_unfinished: false,
            sealed: Vec::new(),
            serial: 0,
            newest_seal: 0,
            page: None,
            end: 0,
            single_seal: None,
            secured: None,
            pause_ms,
        }
    }

    /// The flash, for other uses.
    pub fn release(self) -> F {
        self.flash
    }

    /// Bytes of flash that a record of `length` bytes takes.
    const fn footprint(length: u16) -> usize {
        Self::HEADER + (HEAD + length as usize).next_multiple_of(Self::UNIT)
    }

    /// Bytes of flash for `directories` directories, their seal and the zeros before a change.
    const fn overhead(directories: usize) -> usize {
        let directory = Self::footprint(directory::MAX_BYTES as u16);
        Self::HEADER + directories * directory + Self::footprint(0)
    }

    /// Total footprint of records that always fits, bytes. One page is kept free; each other page begins
    /// with its directories and may end with less room than a change takes.
    const fn capacity(&self) -> usize {
        let pages = ((self.range.end - self.range.start) / Self::PAGE) as usize;
        let change = Self::footprint(MAX_RECORD as u16) + Self::overhead(SAVE_DIRECTORIES);
        let usable = F::ERASE_SIZE - 2 * Self::UNIT - Self::OPENING;
        (pages - 1) * usable - (pages - 2) * change - Self::overhead(SAVE_DIRECTORIES)
    }

    fn pages(&self) -> impl Iterator<Item = u32> + use<F> {
        self.range.clone().step_by(F::ERASE_SIZE)
    }

    /// The page after `page`; the first one after the last.
    fn after(&self, page: u32) -> u32 {
        match page + Self::PAGE {
            next if next < self.range.end => next,
            _ => self.range.start,
        }
    }

    fn page_of(at: u32) -> u32 {
        at - at % Self::PAGE
    }

    /// The end of the items of the page that holds `at`.
    fn limit(at: u32) -> u32 {
        Self::page_of(at) + Self::PAGE - Self::UNIT as u32
    }

    /// Footprint of the records in use in a range, bytes.
    fn used(&self, range: Range<u32>) -> usize {
        let entries = self.directory.entries.iter();
        let in_use = entries.filter(|entry| entry.at > 0 && range.contains(&entry.at));
        in_use.map(|entry| Self::footprint(entry.length)).sum()
    }

    /// Footprint of the records in use in a page, bytes, plus 1 for each record that the sealed items alone place there.
    fn used_in(&self, page: u32) -> usize {
        let sealed = self.sealed.iter().filter(|at| Self::page_of(**at) == page);
        self.used(page..page + Self::PAGE) + sealed.count()
    }

    /// Appends the directory `count` times, and a seal.
    async fn append_directories(&mut self, count: usize) -> Result<(), StoreFault> {
        self.serial = self.serial.saturating_add(1);
        let bytes = self.directory.to_bytes();
        for _ in 0..count {
            self.append_record(DIRECTORY, self.serial, &bytes).await?;
        }
        self.seal().await
    }

    async fn seal(&mut self) -> Result<(), StoreFault> {
        self.secure_end().await?;
        self.append_record(DIRECTORY, self.serial, &[]).await
    }

    /// Overwrites words that may be an interrupted header, once after a restart.
    async fn secure_end(&mut self) -> Result<(), StoreFault> {
        if self.secured != self.page {
            let zeros = Word([0; WORD]);
            let zeros = zeros.0.get(..Self::HEADER).unwrap_or_default();
            Self::write(&mut self.flash, self.end, zeros).await?;
            self.end += Self::HEADER as u32;
            self.secured = self.page;
        }
        Ok(())
    }

    /// Makes room for a change of `length` bytes where items are appended.
    async fn make_room(&mut self, length: usize) -> Result<(), StoreFault> {
        // Items of an unfinished page would no longer be accepted if another page got a newer directory.
        if self.page.is_none() && self.newest_seal > 0 {
            return Err(StoreFault);
        }
        for _ in 0..=2 * self.pages().count() {
            let room = self.page.map_or(0, |page| Self::limit(page) - self.end) as usize;
            if room >= length + Self::overhead(0) {
                break;
            }
            // The page is not copied at once, so it must stay finished.
            if self.secured != self.page && room >= Self::overhead(0) {
                self.seal().await?;
            }
            self.compact(None).await?;
        }
        self.secure_end().await
    }

    async fn replace(&mut self, key: u8, record: &[u8]) -> Result<(), StoreFault> {
        let length = Self::footprint(record.len() as u16) + Self::overhead(SAVE_DIRECTORIES);
        self.make_room(length).await?;
        let entry = self.directory.entry(key).followed_by(true);
        self.directory.insert(entry)?;
        self.append_record(key, entry.generation, record).await?;
        self.append_directories(SAVE_DIRECTORIES).await
    }

    async fn remove_all(&mut self, is_removed: impl Fn(&Entry) -> bool) -> Result<(), StoreFault> {
        self.make_room(Self::overhead(REMOVAL_DIRECTORIES)).await?;
        for entry in &mut self.directory.entries {
            if is_removed(entry) {
                *entry = entry.followed_by(false);
            }
        }
        self.append_directories(REMOVAL_DIRECTORIES).await
    }

    /// The record in use, if any.
    async fn find(&mut self, key: u8) -> Result<Option<&[u8]>, StoreFault> {
        let known = self.directory.entry(key);
        if !self.is_corrupt && !known.exists {
            return Ok(None);
        }
        let item = self.item(known.at).await?.ok_or(StoreFault)?;
        if known.at == 0 || (item.key, item.generation) != (key, known.generation) {
            return Err(StoreFault);
        }
        Ok(self.buffer.0.get(HEAD..HEAD + usize::from(item.length)))
    }
}

impl<F: NorFlash> Store for FlashStore<F> {
    fn pause_ms(&self) -> u16 {
        self.pause_ms
    }

    async fn load(&mut self, key: Key, buffer: &mut [u8]) -> Result<Option<usize>, StoreFault> {
        let key = key.number().ok_or(StoreFault)?;
        self.recover().await?;
        let Some(record) = self.find(key).await? else {
            return Ok(None);
        };
        let room = buffer.get_mut(..record.len()).ok_or(StoreFault)?;
        room.copy_from_slice(record);
        Ok(Some(record.len()))
    }

    async fn save(&mut self, key: Key, record: &[u8]) -> Result<(), StoreFault> {
        let key = key.number().ok_or(StoreFault)?;
        if record.is_empty() || record.len() > MAX_RECORD {
            return Err(StoreFault);
        }
        for attempt in 0..=ATTEMPTS {
            self.recover().await?;
            if self.find(key).await == Ok(Some(record)) {
                return Ok(());
            }
            // The old record may have to be copied before the new one is saved.
            let used = self.used(self.range.clone()) + Self::footprint(record.len() as u16);
            if attempt == ATTEMPTS || used > self.capacity() {
                break;
            }
            // The next survey tells whether it was saved.
            let _ = self.replace(key, record).await;
            self.is_known = false;
        }
        Err(StoreFault)
    }

    async fn remove(&mut self, which: fn(Key) -> bool) -> Result<(), StoreFault> {
        let is_removed =
            |entry: &Entry| entry.exists && Key::from_number(entry.key).is_some_and(which);
        for attempt in 0..=ATTEMPTS {
            self.recover().await?;
            if !self.is_corrupt && !self.directory.entries.iter().any(is_removed) {
                return Ok(());
            }
            if attempt < ATTEMPTS {
                let _ = self.remove_all(is_removed).await;
                self.is_known = false;
            }
        }
        Err(StoreFault)
    }
}
