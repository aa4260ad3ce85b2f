//! Records in a board's NOR flash.

use core::marker::PhantomData;
use core::ops::Range;

use embedded_storage::nor_flash::NorFlash;

use crate::flash_log::{BEFORE_RECORD, Cursor, FlashLog, Item, WIDEST_WORD};
use crate::store::{Key, MAX_RECORD, Store, StoreFault};

/// Key of the directory.
const DIRECTORY: u8 = 0;
/// A record that would not be found after a restart, because the flash has been damaged where it was
/// written, is written to so many pages.
const PAGES_TRIED: usize = 2;

/// The pages of a flash that hold the store: two or more whole ones. Made at compile time, where a
/// layout that cannot work is an error.
///
/// Four pages of 4 KiB hold what a node keeps: parameters for four ranges with everything that can
/// be in them, settings, key, boot count. Two hold those for two ranges, or for four with less in
/// them. With more pages each is erased less often.
#[derive(Clone, Debug)]
pub struct FlashLayout<F> {
    range: Range<u32>,
    flash: PhantomData<F>,
}

impl<F: NorFlash> FlashLayout<F> {
    /// The pages at `range`, bytes from the start of the flash.
    ///
    /// # Panics
    /// When they are not two or more whole pages, each with room for two records of the longest,
    /// or the flash has words wider than 32 bytes: call it in a constant.
    pub const fn new(range: Range<u32>) -> Self {
        let page = F::ERASE_SIZE as u32;
        assert!(
            range.start.is_multiple_of(page)
                && range.end.is_multiple_of(page)
                && range.start < range.end
                && range.end - range.start >= 2 * page,
            "the store takes two or more whole pages of flash"
        );
        let word = FlashLog::<F>::WORD as usize;
        assert!(
            word <= WIDEST_WORD && word.is_power_of_two() && word.is_multiple_of(F::WRITE_SIZE),
            "the words of this flash are too wide"
        );
        assert!(
            F::ERASE_SIZE >= 3 * (BEFORE_RECORD + MAX_RECORD + WIDEST_WORD),
            "the pages of this flash are too small"
        );
        Self {
            range,
            flash: PhantomData,
        }
    }
}

/// The node's [`Store`] in any NOR flash: records are appended, page after page, so that pages wear
/// evenly, and a record stands or does not stand whenever power is lost. The flash is laid out as
/// [`sequential-storage`](https://docs.rs/sequential-storage) does it, which can read it.
///
/// It
/// - reads back every word it writes and every page it erases, so that worn-out flash is an error
///   and never takes an old record with it;
/// - numbers the generations of each record and keeps the latest numbers in a directory: a record
///   that was saved and has been damaged since is an error, never the one before it;
/// - looks, after each change, whether a restart would find what was written: what was damaged before
///   and written over is an error at once, or mended in another page, never a surprise later;
/// - removes several records in one step, and needs no flash that can be written twice;
/// - writes nothing when the record stands already.
///
/// An interrupted erase is taken to leave a page cleared up to somewhere from its beginning, and the
/// first and the last word of a page, its marks, to outlast the others.
///
/// ```
/// use embedded_storage::nor_flash::NorFlash;
/// use wimu_node::{FlashLayout, FlashStore};
///
/// /// The last four pages of 4 KiB of a flash of 512 KiB, as on an nRF52833; erasing one takes up
/// /// to 90 ms.
/// fn store<F: NorFlash>(flash: F) -> FlashStore<F> {
///     FlashStore::new(flash, const { FlashLayout::new(0x7C000..0x80000) }, 90)
/// }
/// ```
///
/// 0.2 KB of RAM.
pub struct FlashStore<F: NorFlash> {
    log: FlashLog<F>,
    /// What has been saved and removed; `None` before it has been read.
    directory: Option<Directory>,
    pause_ms: u16,
    /// Bytes of all items that fit for certain.
    capacity: u32,
}

impl<F: NorFlash> FlashStore<F> {
    /// The records that `flash` holds. Saving one may take `pause_ms`: as long as it takes to
    /// erase a page and write it, during which the processor may stand still.
    pub const fn new(flash: F, layout: FlashLayout<F>, pause_ms: u16) -> Self {
        let FlashLayout { range, .. } = layout;
        let log = FlashLog::new(flash, range);
        let usable = F::ERASE_SIZE as u32 - 2 * FlashLog::<F>::WORD;
        Self {
            // One page is always open, and at the end of each but one of the others there may be
            // too little room.
            capacity: (log.pages() - 1) * usable - (log.pages() - 2) * Self::footprint(MAX_RECORD),
            log,
            directory: None,
            pause_ms,
        }
    }

    /// The flash, to do other things with.
    pub fn release(self) -> F {
        self.log.flash
    }

    /// Bytes of flash that a record of `length` bytes takes.
    const fn footprint(length: usize) -> u32 {
        FlashLog::<F>::footprint(BEFORE_RECORD + length)
    }

    /// The directory, read at the first call.
    fn directory(&mut self) -> Result<Directory, StoreFault> {
        if let Some(directory) = self.directory {
            return Ok(directory);
        }
        let mut directory = Directory {
            ruined: self.log.holds_more_than_a_beginning()?,
            ..Directory::default()
        };
        if self.log.is_usable()? {
            if let Some(found) = self.log.newest(DIRECTORY)? {
                let mut bytes = [0; Directory::LENGTH];
                self.log.copy(&found, &mut bytes)?;
                directory = Directory::from_bytes(&bytes);
            }
            // Power may have been lost before the directory took note of a record.
            let mut cursor = Cursor::default();
            while let Some(item) = self.log.next(&mut cursor)? {
                if (directory.ruined || item.generation > directory.entry(item.key).generation)
                    && self.log.is_whole(&item)?
                {
                    directory.ruined = false;
                    if item.key != DIRECTORY
                        && item.generation > directory.entry(item.key).generation
                    {
                        directory.put(Entry {
                            key: item.key,
                            generation: item.generation,
                            stands: item.record() > 0,
                        })?;
                    }
                }
            }
        }
        self.directory = Some(directory);
        Ok(directory)
    }

    fn append(&mut self, key: u8, generation: u32, record: &[u8]) -> Result<(), StoreFault> {
        let known = self.directory.unwrap_or_default();
        let mut keys = [DIRECTORY; 1 + Directory::KEYS];
        for (key, entry) in keys.iter_mut().skip(1).zip(known.entries) {
            *key = entry.key;
        }
        self.log.append(key, generation, record, &keys)
    }

    fn save_directory(&mut self, directory: Directory) -> Result<(), StoreFault> {
        self.append(DIRECTORY, 0, &directory.to_bytes())?;
        self.directory = Some(directory);
        Ok(())
    }

    /// Whether a restart would find what `wanted` says of every record, and this `record` under
    /// `entry`'s key.
    fn would_be_found(&mut self, wanted: Directory, entry: Entry, record: &[u8]) -> bool {
        self.directory = None;
        let found = self.directory();
        // What is known of the others is not forgotten because it is hard to find.
        self.directory = Some(wanted);
        found.is_ok_and(|found| wanted.says_the_same(&found))
            && (!entry.stands || self.holds(entry, record) == Ok(true))
    }

    /// Whether an entry stands for this record.
    fn holds(&mut self, entry: Entry, record: &[u8]) -> Result<bool, StoreFault> {
        match self.found(entry)? {
            Some(item) => self.log.holds(&item, record),
            None => Ok(false),
        }
    }

    /// The item that an entry stands for.
    fn found(&mut self, entry: Entry) -> Result<Option<Item>, StoreFault> {
        let newest = self.log.newest(entry.key)?;
        Ok(newest.filter(|item| entry.stands && item.generation == entry.generation))
    }

    /// Flash that holds nothing that can be read is erased before it is written.
    fn writable(&mut self) -> Result<Directory, StoreFault> {
        let mut directory = self.directory()?;
        if directory.ruined {
            self.log.erase_all()?;
            directory.ruined = false;
            self.directory = Some(directory);
        }
        Ok(directory)
    }

    /// Bytes that all records take, and the directory twice, for it is saved with each of them.
    fn used(&mut self, directory: &Directory) -> Result<u32, StoreFault> {
        let mut used = 2 * Self::footprint(Directory::LENGTH);
        for entry in &directory.entries {
            if entry.key != DIRECTORY
                && let Some(item) = self.log.newest(entry.key)?
            {
                used += Self::footprint(item.record());
            }
        }
        Ok(used)
    }
}

impl<F: NorFlash> Store for FlashStore<F> {
    fn pause_ms(&self) -> u16 {
        self.pause_ms
    }

    fn load(&mut self, key: Key, buffer: &mut [u8]) -> Result<Option<usize>, StoreFault> {
        let key = key.number().ok_or(StoreFault)?;
        let directory = self.directory()?;
        if directory.ruined {
            return Err(StoreFault);
        }
        let known = directory.entry(key);
        if !known.stands {
            return Ok(None);
        }
        let item = self.found(known)?.ok_or(StoreFault)?;
        let length = item.record();
        let room = buffer.get_mut(..length).ok_or(StoreFault)?;
        self.log.copy(&item, room)?;
        Ok(Some(length))
    }

    fn save(&mut self, key: Key, record: &[u8]) -> Result<(), StoreFault> {
        let key = key.number().ok_or(StoreFault)?;
        if record.is_empty() || record.len() > MAX_RECORD {
            return Err(StoreFault);
        }
        let mut directory = self.writable()?;
        let known = directory.entry(key);
        // What stands is not written again.
        if self.holds(known, record)? {
            return Ok(());
        }
        // The old record may have to be moved before the new one stands.
        if self.used(&directory)? + Self::footprint(record.len()) > self.capacity {
            return Err(StoreFault);
        }
        let entry = known.followed_by(true);
        directory.put(entry)?;
        for _ in 0..PAGES_TRIED {
            self.append(key, entry.generation, record)?;
            // It stands. Without the directory, it would merely be missed less.
            let _ = self.save_directory(directory);
            if self.would_be_found(directory, entry, record) {
                return Ok(());
            }
            self.log.turn_the_page()?;
        }
        self.directory = None;
        Err(StoreFault)
    }

    fn remove(&mut self, which: fn(Key) -> bool) -> Result<(), StoreFault> {
        let before = self.writable()?;
        let mut directory = before;
        let mut removed = Entry::default();
        for entry in &mut directory.entries {
            if entry.stands && Key::from_number(entry.key).is_some_and(which) {
                *entry = entry.followed_by(false);
                removed = *entry;
            }
        }
        if directory == before {
            return Ok(());
        }
        for _ in 0..PAGES_TRIED {
            self.save_directory(directory)?;
            // They are removed. Lest they return if the directory is damaged some day:
            for (entry, before) in directory.entries.iter().zip(before.entries) {
                if *entry != before {
                    let _ = self.append(entry.key, entry.generation, &[]);
                }
            }
            if self.would_be_found(directory, removed, &[]) {
                return Ok(());
            }
            self.log.turn_the_page()?;
        }
        self.directory = None;
        Err(StoreFault)
    }
}

/// What a store has been told to keep.
#[derive(Clone, Copy, Default, PartialEq)]
struct Directory {
    /// Those that are not used have the directory's own key.
    entries: [Entry; Self::KEYS],
    /// The flash holds something, and no record.
    ruined: bool,
}

/// The latest of a record.
#[derive(Clone, Copy, Default, PartialEq)]
struct Entry {
    key: u8,
    generation: u32,
    /// Whether it was saved then, or removed.
    stands: bool,
}

impl Entry {
    fn followed_by(self, stands: bool) -> Self {
        Self {
            generation: self.generation.saturating_add(1),
            stands,
            ..self
        }
    }
}

impl Directory {
    const KEYS: usize = 16;
    const ENTRY: usize = 6;
    const LENGTH: usize = Self::KEYS * Self::ENTRY;

    fn entry(&self, key: u8) -> Entry {
        let mut entries = self.entries.iter();
        let known = entries.find(|entry| entry.key == key);
        known.copied().unwrap_or(Entry {
            key,
            ..Entry::default()
        })
    }

    /// Whether both know of the same records, in any order.
    fn says_the_same(&self, other: &Self) -> bool {
        let all = |a: &Self, b: &Self| {
            a.entries
                .iter()
                .filter(|entry| entry.key != DIRECTORY)
                .all(|entry| b.entry(entry.key) == *entry)
        };
        all(self, other) && all(other, self)
    }

    /// Takes the key's place, one that is not used, or that of a removed record.
    fn put(&mut self, entry: Entry) -> Result<(), StoreFault> {
        let place = |wanted: &dyn Fn(&Entry) -> bool| self.entries.iter().position(wanted);
        let place = place(&|known| known.key == entry.key)
            .or_else(|| place(&|known| known.key == DIRECTORY))
            .or_else(|| place(&|known| !known.stands));
        let place = place.and_then(|place| self.entries.get_mut(place));
        *place.ok_or(StoreFault)? = entry;
        Ok(())
    }

    fn to_bytes(self) -> [u8; Self::LENGTH] {
        let mut bytes = [0; Self::LENGTH];
        for (place, entry) in bytes.chunks_exact_mut(Self::ENTRY).zip(self.entries) {
            let [a, b, c, d] = entry.generation.to_le_bytes();
            place.copy_from_slice(&[entry.key, entry.stands.into(), a, b, c, d]);
        }
        bytes
    }

    fn from_bytes(bytes: &[u8]) -> Self {
        let mut directory = Self::default();
        for (entry, bytes) in directory
            .entries
            .iter_mut()
            .zip(bytes.chunks_exact(Self::ENTRY))
        {
            if let [key, stands, a, b, c, d] = *bytes {
                *entry = Entry {
                    key,
                    generation: u32::from_le_bytes([a, b, c, d]),
                    stands: stands != 0,
                };
            }
        }
        directory
    }
}
