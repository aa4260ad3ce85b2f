//! Records in a board's NOR flash.

use core::marker::PhantomData;
use core::ops::Range;

use embedded_storage_async::nor_flash::{
    ErrorType, NorFlash, NorFlashError, NorFlashErrorKind, ReadNorFlash,
};
use sequential_storage::Error;
use sequential_storage::cache::{Cache, Uncached};
use sequential_storage::map::{MapConfig, MapStorage, SerializationError, Value};

use crate::slot::put;
use crate::store::{Key, MAX_RECORD, Store, StoreFault};

/// Widest word of flash that is supported, bytes.
const WORD: usize = 32;
/// The number of an item's key, a record's generation, the record.
const MAX_ITEM: usize = 1 + GENERATION + MAX_RECORD;
const GENERATION: usize = 4;
/// Key of the directory.
const DIRECTORY: u8 = 0;
/// A record that cannot be written where it was to be is tried this often, each time elsewhere.
const ATTEMPTS: usize = 3;
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
        assert!(
            MapConfig::<Checked<F>>::try_new(range.start..range.end).is_ok(),
            "the store takes two or more whole pages of flash"
        );
        assert!(
            F::WRITE_SIZE <= WORD && F::READ_SIZE <= WORD && WORD.is_multiple_of(F::READ_SIZE),
            "the words of this flash are too wide"
        );
        assert!(
            F::ERASE_SIZE >= 3 * (MAX_ITEM + WORD),
            "the pages of this flash are too small"
        );
        Self {
            range,
            flash: PhantomData,
        }
    }
}

/// The node's [`Store`] in any NOR flash, on
/// [`sequential-storage`](https://docs.rs/sequential-storage): records are appended, page after
/// page, so that pages wear evenly, and a record stands or does not stand whenever power is lost.
///
/// On top of that it
/// - reads back every word it writes and every page it erases, so that worn-out flash is an error
///   and never takes an old record with it;
/// - numbers the generations of each record and keeps the latest numbers in a directory: a record
///   that was saved and has been damaged since is an error, where `sequential-storage` would
///   return the one before it;
/// - writes nothing into a hole that damage has left in a page: what stands behind it would return;
/// - looks, after each change, whether a restart would find what was written: what was damaged before
///   and written over is an error at once, or mended in another page, never a surprise later;
/// - removes several records in one step, and needs no flash that can be written twice;
/// - writes nothing when the record stands already.
///
/// An interrupted erase is taken to leave a page cleared up to somewhere from its beginning, and the
/// first and the last word of a page, its marks, to outlast the others.
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
/// 1.2 KB of RAM.
pub struct FlashStore<F: NorFlash> {
    map: MapStorage<u8, Checked<F>, Cache<Uncached, Uncached, Uncached, u8>>,
    buffer: Buffer,
    /// What has been saved and removed; `None` before it has been read.
    directory: Option<Directory>,
    pause_ms: u16,
    /// Bytes of all items that fit for certain.
    capacity: usize,
}

/// One item, in whole words; some flashes want it aligned.
#[repr(align(4))]
struct Buffer([u8; MAX_ITEM.next_multiple_of(WORD)]);

impl<F: NorFlash> FlashStore<F> {
    /// The records that `flash` holds. Saving one may take `pause_ms`: as long as it takes to
    /// erase a page and write it, during which the processor may stand still.
    pub const fn new(flash: F, layout: FlashLayout<F>, pause_ms: u16) -> Self {
        let FlashLayout { range, .. } = layout;
        let usable = F::ERASE_SIZE - 2 * F::WRITE_SIZE;
        let pages = (range.end - range.start) as usize / F::ERASE_SIZE;
        Self {
            // One page is always open, and at the end of each but one of the others there may be
            // too little room.
            capacity: (pages - 1) * usable - (pages - 2) * Self::footprint(MAX_RECORD),
            map: MapStorage::new(Checked(flash), MapConfig::new(range), Cache::new_uncached()),
            buffer: Buffer([0; _]),
            directory: None,
            pause_ms,
        }
    }

    /// The flash, to do other things with.
    pub fn release(self) -> F {
        self.map.destroy().0.0
    }

    /// Bytes of flash that a record of `length` bytes takes.
    const fn footprint(length: usize) -> usize {
        (1 + GENERATION + length).next_multiple_of(F::WRITE_SIZE)
            + 8_usize.next_multiple_of(F::WRITE_SIZE)
    }

    /// The directory, read at the first call.
    async fn directory(&mut self) -> Result<&mut Directory, StoreFault> {
        if self.directory.is_none() {
            self.read_directory().await?;
        }
        self.directory.as_mut().ok_or(StoreFault)
    }

    async fn read_directory(&mut self) -> Result<(), StoreFault> {
        // First: looking for records may repair the flash.
        let left_over = self.holds_more_than_a_beginning().await?;
        let found = self
            .map
            .fetch_item::<&[u8]>(&mut self.buffer.0, &DIRECTORY)
            .await;
        let mut directory = match found {
            Ok(Some(bytes)) => Directory::from_bytes(bytes.get(GENERATION..).unwrap_or_default()),
            Err(Error::Storage { .. }) => return Err(StoreFault),
            Ok(None) | Err(_) => Directory {
                ruined: left_over,
                ..Directory::default()
            },
        };
        // Power may have been lost before the directory took note of a record.
        if let Ok(mut items) = self.map.fetch_all_items(&mut self.buffer.0).await {
            while let Ok(Some((key, bytes))) = items.next::<&[u8]>(&mut self.buffer.0).await {
                directory.ruined = false;
                if let Some((&generation, record)) = bytes.split_first_chunk()
                    && key != DIRECTORY
                {
                    let generation = u32::from_le_bytes(generation);
                    if generation > directory.entry(key).generation {
                        directory.put(Entry {
                            key,
                            generation,
                            stands: !record.is_empty(),
                        })?;
                    }
                }
            }
        }
        put(&mut self.directory, &Some(directory));
        Ok(())
    }

    /// Whether the flash has been used beyond what the first records leave that power loss
    /// interrupted: a second page has been begun, or one has been filled.
    async fn holds_more_than_a_beginning(&mut self) -> Result<bool, StoreFault> {
        let range = self.map.flash_range();
        let (mut begun, mut filled) = (0, 0);
        for page in range.step_by(F::ERASE_SIZE) {
            let last = page + (F::ERASE_SIZE - F::WRITE_SIZE) as u32;
            let flash = self.map.flash();
            let length = F::ERASE_SIZE as u32;
            begun += u32::from(!flash.is_blank(page, length).await?);
            filled += u32::from(!flash.is_blank(last, F::WRITE_SIZE as u32).await?);
        }
        Ok(begun > 1 || filled > 0)
    }

    /// The newest record of a key that can be read: its generation and its length; it is in the
    /// buffer behind key and generation. One of no length has been removed.
    async fn newest(&mut self, key: u8) -> Result<Option<(u32, usize)>, StoreFault> {
        let found = self.map.fetch_item::<&[u8]>(&mut self.buffer.0, &key).await;
        let Some(bytes) = found.map_err(|_| StoreFault)? else {
            return Ok(None);
        };
        let (generation, record) = bytes.split_first_chunk().ok_or(StoreFault)?;
        Ok(Some((u32::from_le_bytes(*generation), record.len())))
    }

    /// Whether the newest record of a key that can be read is this one.
    async fn holds(&mut self, key: u8, generation: u32, record: &[u8]) -> Result<bool, StoreFault> {
        let newest = self.newest(key).await?;
        Ok(newest == Some((generation, record.len())) && self.latest_read(record.len()) == record)
    }

    /// Appends an item and reads it back.
    async fn append(&mut self, key: u8, generation: u32, record: &[u8]) -> Result<(), StoreFault> {
        let item = Item {
            generation: generation.to_le_bytes(),
            record,
        };
        for _ in 0..ATTEMPTS {
            let stored = self.map.store_item(&mut self.buffer.0, &key, &item).await;
            // Even if writing failed somewhere: what counts is what will be read.
            if self.holds(key, generation, record).await == Ok(true) {
                return Ok(());
            }
            match stored {
                Err(Error::FullStorage | Error::ItemTooBig) => break,
                Err(Error::Storage {
                    value: CheckedError::Hole,
                    ..
                }) => self.turn_the_page().await?,
                _ => {}
            }
        }
        Err(StoreFault)
    }

    async fn save_directory(&mut self, directory: &Directory) -> Result<(), StoreFault> {
        self.append(DIRECTORY, 0, &directory.to_bytes()).await?;
        put(&mut self.directory, &Some(*directory));
        Ok(())
    }

    /// Whether a restart would find what `wanted` says of every record, and this `record` under
    /// `entry`'s key.
    async fn would_be_found(&mut self, wanted: &Directory, entry: Entry, record: &[u8]) -> bool {
        let read = self.read_directory().await;
        let found = self.directory.as_ref();
        let same = found.is_some_and(|found| wanted.says_the_same(found));
        // What is known of the others is not forgotten because it is hard to find.
        put(&mut self.directory, &Some(*wanted));
        if read.is_err() || !same {
            return false;
        }
        !entry.stands || self.holds(entry.key, entry.generation, record).await == Ok(true)
    }

    /// The record that [`newest`](Self::newest) has read last.
    fn latest_read(&self, length: usize) -> &[u8] {
        let record = self.buffer.0.get(1 + GENERATION..).unwrap_or_default();
        record.get(..length).unwrap_or_default()
    }

    /// Takes the page that records are appended to for full: what is written where damage has cleared a
    /// part of it uncovers what stands behind.
    async fn turn_the_page(&mut self) -> Result<(), StoreFault> {
        let range = self.map.flash_range();
        for page in range.step_by(F::ERASE_SIZE) {
            let last = page + (F::ERASE_SIZE - F::WRITE_SIZE) as u32;
            let word = F::WRITE_SIZE as u32;
            let flash = self.map.flash();
            if !flash.is_blank(page, word).await? && flash.is_blank(last, word).await? {
                let mark = Word([0; WORD]);
                flash
                    .write(last, mark.0.get(..F::WRITE_SIZE).unwrap_or_default())
                    .await?;
            }
        }
        Ok(())
    }

    /// Flash that holds nothing that can be read is erased before it is written.
    async fn writable(&mut self) -> Result<Directory, StoreFault> {
        if self.directory().await?.ruined {
            self.map.erase_all().await.map_err(|_| StoreFault)?;
            self.directory().await?.ruined = false;
        }
        self.directory.ok_or(StoreFault)
    }

    /// Bytes that all records take, and the directory twice, for it is saved with each of them.
    async fn used(&mut self, directory: &Directory) -> usize {
        let mut used = 2 * Self::footprint(Directory::LENGTH);
        for entry in &directory.entries {
            if entry.key != DIRECTORY
                && let Ok(Some((_, length))) = self.newest(entry.key).await
            {
                used += Self::footprint(length);
            }
        }
        used
    }
}

impl<F: NorFlash> Store for FlashStore<F> {
    fn pause_ms(&self) -> u16 {
        self.pause_ms
    }

    async fn load(&mut self, key: Key, buffer: &mut [u8]) -> Result<Option<usize>, StoreFault> {
        let key = key.number().ok_or(StoreFault)?;
        let directory = self.directory().await?;
        if directory.ruined {
            return Err(StoreFault);
        }
        let known = directory.entry(key);
        if !known.stands {
            return Ok(None);
        }
        let length = match self.newest(key).await? {
            Some((generation, length)) if generation == known.generation => length,
            _ => return Err(StoreFault),
        };
        let room = buffer.get_mut(..length).ok_or(StoreFault)?;
        room.copy_from_slice(self.latest_read(length));
        Ok(Some(length))
    }

    async fn save(&mut self, key: Key, record: &[u8]) -> Result<(), StoreFault> {
        let key = key.number().ok_or(StoreFault)?;
        if record.is_empty() || record.len() > MAX_RECORD {
            return Err(StoreFault);
        }
        let mut directory = self.writable().await?;
        let known = directory.entry(key);
        // What stands is not written again.
        if known.stands && self.holds(key, known.generation, record).await? {
            return Ok(());
        }
        // The old record may have to be moved before the new one stands.
        let used = self.used(&directory).await;
        if used + Self::footprint(record.len()) > self.capacity {
            return Err(StoreFault);
        }
        let entry = known.followed_by(true);
        directory.put(entry)?;
        for _ in 0..PAGES_TRIED {
            self.append(key, entry.generation, record).await?;
            // It stands. Without the directory, it would merely be missed less.
            let _ = self.save_directory(&directory).await;
            if self.would_be_found(&directory, entry, record).await {
                return Ok(());
            }
            self.turn_the_page().await?;
        }
        self.directory = None;
        Err(StoreFault)
    }

    async fn remove(&mut self, which: fn(Key) -> bool) -> Result<(), StoreFault> {
        let before = self.writable().await?;
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
            self.save_directory(&directory).await?;
            // They are removed. Lest they return if the directory is damaged some day:
            for (entry, before) in directory.entries.iter().zip(before.entries) {
                if *entry != before {
                    let _ = self.append(entry.key, entry.generation, &[]).await;
                }
            }
            if self.would_be_found(&directory, removed, &[]).await {
                return Ok(());
            }
            self.turn_the_page().await?;
        }
        self.directory = None;
        Err(StoreFault)
    }
}

/// What is stored under a key.
struct Item<'a> {
    generation: [u8; GENERATION],
    record: &'a [u8],
}

impl<'a> Value<'a> for Item<'a> {
    fn serialize_into(&self, buffer: &mut [u8]) -> Result<usize, SerializationError> {
        let length = GENERATION + self.record.len();
        let place = buffer.get_mut(..length);
        let (head, body) = place
            .and_then(|place| place.split_first_chunk_mut())
            .ok_or(SerializationError::BufferTooSmall)?;
        *head = self.generation;
        body.copy_from_slice(self.record);
        Ok(length)
    }

    fn deserialize_from(buffer: &'a [u8]) -> Result<(Self, usize), SerializationError> {
        let (generation, record) = buffer
            .split_first_chunk()
            .ok_or(SerializationError::BufferTooSmall)?;
        let generation = *generation;
        Ok((Self { generation, record }, buffer.len()))
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

/// A flash whose writes and erases are errors unless they have been done.
struct Checked<F>(F);

impl<F: NorFlash> Checked<F> {
    /// Whether `length` bytes from `offset`, whole words, are erased.
    async fn is_blank(&mut self, offset: u32, length: u32) -> Result<bool, CheckedError<F::Error>> {
        let mut buffer = Word([0; WORD]);
        let mut at = 0;
        while at < length {
            let part = (length - at).min(WORD as u32);
            let bytes = buffer.0.get_mut(..part as usize).unwrap_or_default();
            self.read(offset + at, bytes).await?;
            if bytes.iter().any(|&byte| byte != 0xFF) {
                return Ok(false);
            }
            at += part;
        }
        Ok(true)
    }
}

#[repr(align(4))]
struct Word([u8; WORD]);

impl<F: NorFlash> ErrorType for Checked<F> {
    type Error = CheckedError<F::Error>;
}

impl<F: NorFlash> ReadNorFlash for Checked<F> {
    const READ_SIZE: usize = F::READ_SIZE;

    async fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), Self::Error> {
        self.0
            .read(offset, bytes)
            .await
            .map_err(CheckedError::Flash)
    }

    fn capacity(&self) -> usize {
        self.0.capacity()
    }
}

impl<F: NorFlash> NorFlash for Checked<F> {
    const WRITE_SIZE: usize = F::WRITE_SIZE;
    const ERASE_SIZE: usize = F::ERASE_SIZE;

    async fn erase(&mut self, from: u32, to: u32) -> Result<(), Self::Error> {
        self.0.erase(from, to).await.map_err(CheckedError::Flash)?;
        if self.is_blank(from, to.saturating_sub(from)).await? {
            Ok(())
        } else {
            Err(CheckedError::WornOut)
        }
    }

    async fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), Self::Error> {
        let page = offset - offset % F::ERASE_SIZE as u32;
        let last = page + (F::ERASE_SIZE - F::WRITE_SIZE) as u32;
        if offset != last && !self.is_blank(offset, last - offset).await? {
            if offset != page {
                return Err(CheckedError::Hole);
            }
            // The page is begun: nothing in it counts.
            self.erase(page, page + F::ERASE_SIZE as u32).await?;
        }
        self.0
            .write(offset, bytes)
            .await
            .map_err(CheckedError::Flash)?;
        let mut buffer = Word([0; WORD]);
        let mut at = offset;
        for written in bytes.chunks(WORD) {
            let found = buffer.0.get_mut(..written.len()).unwrap_or_default();
            self.read(at, found).await?;
            if found != written {
                return Err(CheckedError::WornOut);
            }
            at += WORD as u32;
        }
        Ok(())
    }
}

/// Why a flash operation was not done.
#[derive(Debug)]
enum CheckedError<E> {
    /// The flash says so.
    Flash(E),
    /// It says that it was done, and it was not.
    WornOut,
    /// Damage has cleared a part of a page, and something stands behind it.
    Hole,
}

impl<E: NorFlashError> NorFlashError for CheckedError<E> {
    fn kind(&self) -> NorFlashErrorKind {
        match self {
            Self::Flash(error) => error.kind(),
            Self::WornOut | Self::Hole => NorFlashErrorKind::Other,
        }
    }
}

impl<E> From<CheckedError<E>> for StoreFault {
    fn from(_: CheckedError<E>) -> Self {
        Self
    }
}
