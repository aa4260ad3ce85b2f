//! Records in a board's NOR flash.

use core::marker::PhantomData;
use core::ops::Range;

use embedded_storage_async::nor_flash::NorFlash;

use crate::store::{Key, MAX_RECORD, Store, StoreFault};

/// Widest word of flash that is supported, bytes.
const WORD: usize = 32;
/// An item's check sum, its length and the check sum of that, bytes.
const HEADER: usize = 8;
/// An item's key and generation, before its record, bytes.
const HEAD: usize = 1 + 4;
/// Key of a directory.
const DIRECTORY: u8 = 0;
/// First word of a page, in each of its bytes. Earlier firmware wrote zeros.
const MARK: u8 = 0x77;
/// A change that cannot be written is tried this often, each time in another page.
const ATTEMPTS: usize = 3;
/// Directories of a change. One that removes records has no record that says so too.
const OF_A_SAVE: usize = 1;
const OF_A_REMOVAL: usize = 2;

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
                && range.end.saturating_sub(range.start) >= 2 * page,
            "the store takes two or more whole pages of flash"
        );
        assert!(
            WORD.is_multiple_of(F::WRITE_SIZE) && WORD.is_multiple_of(F::READ_SIZE),
            "the words of this flash are too wide"
        );
        assert!(
            F::ERASE_SIZE >= 3 * (HEAD + MAX_RECORD + WORD),
            "the pages of this flash are too small"
        );
        Self {
            range,
            flash: PhantomData,
        }
    }
}

/// The node's [`Store`] in any NOR flash: a log of items, page after page, so that pages wear evenly.
///
/// Each record has a generation. A change appends the record, a directory (the latest generation of
/// every record) and a seal (an empty directory). It holds from the moment at which its directory can
/// be read. A record that was saved and has been damaged since is an error, because the directory
/// names it, and never the record before it.
///
/// A write or an erase that power loss interrupts may leave cells that read differently each time.
/// What is written last before a restart is therefore never relied on:
/// - a page counts as finished where its last item is a seal. The directory before it was complete
///   then, whether or not the seal can be read the next time;
/// - a page that does not end so is copied, as far as it holds, to another page, and erased before
///   any record is read from it: a change that has been found stays, one that has not never returns;
/// - a page is erased when it is begun, never before, and only if no record in use is in it. A new
///   page counts from its first seal on. So the source of a copy outlasts the copying;
/// - words that are erased may be an interrupted header: the first change after a restart writes
///   zeros there and goes behind them.
///
/// Every word that is written and every page that is erased is read back, so that worn-out flash is an
/// error and never takes an old record with it. Whatever the flash holds, it can be written: if damage
/// leaves no page without a record in use, the one that holds the fewest is given up, and its records
/// are errors from then on. No word is written twice, and a record that stands is not written again.
///
/// An interrupted write is taken to disturb only the words that it was writing, an interrupted erase
/// only its page.
///
/// The items are those of [`sequential-storage`](https://docs.rs/sequential-storage) 8, which earlier
/// firmware used: its pages are read, and moved when the flash is first used.
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
    /// Whether the directory, and what is below, is what the flash holds.
    known: bool,
    /// Nothing counts, and, if it is ruined, something has been written.
    is_empty: bool,
    ruined: bool,
    /// Which of two copies counts that are equally good.
    last_counts: bool,
    /// There are pages that are neither erased nor finished.
    waste: bool,
    /// The latest number of a directory, and of a seal.
    serial: u32,
    newest: u32,
    /// The page with the newest seal if it is finished; where its items end. Items are appended there.
    page: Option<u32>,
    end: u32,
    /// That page, finished or not, if it has but one seal.
    single: Option<u32>,
    /// The page whose end has been written since the restart.
    secured: Option<u32>,
    pause_ms: u16,
}

/// The data of one item, in whole words; some flashes want it aligned.
#[repr(align(4))]
struct Buffer([u8; (HEAD + MAX_RECORD).next_multiple_of(WORD)]);

#[repr(align(4))]
struct Word([u8; WORD]);

/// What a page holds.
struct Shape {
    /// Where its items begin, and where nothing is written any more.
    begin: u32,
    end: u32,
    /// End of its last directory, and of its last seal; 0 for none.
    directory: u32,
    seal: u32,
    /// The latest number of its directories, and of its seals; how many seals.
    serial: u32,
    seal_serial: u32,
    seals: u32,
    /// Not begun by this firmware.
    is_foreign: bool,
}

impl Shape {
    fn is_finished(&self) -> bool {
        self.seal == self.end
    }

    fn is_settled(&self) -> bool {
        self.end == self.begin || self.is_finished()
    }

    /// How far what ends at `end` can be relied on; `None` if it does not count. `newest` is the latest
    /// number of a seal: what an unfinished page before that one holds has been moved, and a directory
    /// lists what counts of earlier firmware's.
    fn rank(&self, end: u32, newest: u32) -> Option<u32> {
        // The only seal may be an interrupted one: it counts if it was there from the first.
        let is_unseen = self.seals == 1 && self.seal_serial > newest;
        if self.seal == 0 {
            self.is_foreign
                .then_some(if newest == 0 { TOLD } else { LISTED })
        } else if is_unseen || !self.is_finished() && self.serial < newest {
            None
        } else if end <= self.seal {
            Some(SEALED | self.seal_serial.min(SEALED - 1))
        } else {
            Some(if end <= self.directory { TOLD } else { LISTED })
        }
    }
}

/// Ranks: before a seal, before a directory, and only if a directory lists it.
const SEALED: u32 = 1 << 31;
const TOLD: u32 = 2;
const LISTED: u32 = 1;

impl<F: NorFlash> FlashStore<F> {
    const UNIT: usize = if F::WRITE_SIZE > F::READ_SIZE {
        F::WRITE_SIZE
    } else {
        F::READ_SIZE
    };
    const PAGE: u32 = F::ERASE_SIZE as u32;
    const HEADER: usize = HEADER.next_multiple_of(Self::UNIT);
    /// What tells of the records that a page begins with, and room for seals.
    const OPENING: usize = Self::told(OF_A_REMOVAL) + 5 * Self::told(0);

    /// The records that `flash` holds. Saving one may take `pause_ms`: as long as it takes to
    /// erase a page and write it, during which the processor may stand still.
    pub const fn new(flash: F, layout: FlashLayout<F>, pause_ms: u16) -> Self {
        let FlashLayout { range, .. } = layout;
        Self {
            flash,
            range,
            buffer: Buffer([0; _]),
            directory: Directory::EMPTY,
            known: false,
            is_empty: true,
            ruined: false,
            last_counts: true,
            waste: false,
            serial: 0,
            newest: 0,
            page: None,
            end: 0,
            single: None,
            secured: None,
            pause_ms,
        }
    }

    /// The flash, to do other things with.
    pub fn release(self) -> F {
        self.flash
    }

    /// Bytes of flash that a record of `length` bytes takes.
    const fn footprint(length: u16) -> usize {
        Self::HEADER + (HEAD + length as usize).next_multiple_of(Self::UNIT)
    }

    /// Bytes of so many directories, their seal, and what secures the end of a page.
    const fn told(directories: usize) -> usize {
        Self::HEADER + directories * Self::footprint(Directory::LENGTH as u16) + Self::footprint(0)
    }

    /// Bytes of records, the new one too, that fit for certain: one page is kept free, each of the
    /// others begins with what is told of all, and at its end there may be too little room.
    const fn capacity(&self) -> usize {
        let pages = ((self.range.end - self.range.start) / Self::PAGE) as usize;
        let change = Self::footprint(MAX_RECORD as u16) + Self::told(OF_A_SAVE);
        let usable = F::ERASE_SIZE - 2 * Self::UNIT - Self::OPENING;
        (pages - 1) * usable - (pages - 2) * change - Self::told(OF_A_SAVE)
    }

    fn pages(&self) -> impl Iterator<Item = u32> + use<F> {
        self.range.clone().step_by(F::ERASE_SIZE)
    }

    /// The page after one, the first after the last.
    fn after(&self, page: u32) -> u32 {
        match page + Self::PAGE {
            next if next < self.range.end => next,
            _ => self.range.start,
        }
    }

    fn page_of(at: u32) -> u32 {
        at - at % Self::PAGE
    }

    /// Where the items of the page of `at` end at most.
    fn limit(at: u32) -> u32 {
        Self::page_of(at) + Self::PAGE - Self::UNIT as u32
    }

    /// Bytes of the records in use in a page.
    fn used(&self, pages: Range<u32>) -> usize {
        let entries = self.directory.entries.iter();
        let in_use = entries.filter(|entry| entry.at > 0 && pages.contains(&entry.at));
        in_use.map(|entry| Self::footprint(entry.length)).sum()
    }

    fn used_in(&self, page: u32) -> usize {
        self.used(page..page + Self::PAGE)
    }

    /// Where the last byte of a range ends that is not erased, in whole words; its start if all are.
    async fn written(&mut self, range: Range<u32>) -> Result<u32, StoreFault> {
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

    async fn read(flash: &mut F, at: u32, bytes: &mut [u8]) -> Result<(), StoreFault> {
        flash.read(at, bytes).await.map_err(|_| StoreFault)
    }

    /// The item at `at` if it can be read; its data is in the buffer then.
    async fn item(&mut self, at: u32) -> Result<Option<Entry>, StoreFault> {
        let mut header = Word([0xFF; WORD]);
        let data_at = at + Self::HEADER as u32;
        let Some(room) = Self::limit(at).checked_sub(data_at) else {
            return Ok(None);
        };
        let place = header.0.get_mut(..Self::HEADER).unwrap_or_default();
        Self::read(&mut self.flash, at, place).await?;
        let [a, b, c, d, low, high, e, f, ..] = header.0;
        let length = u16::from_le_bytes([low, high]);
        let whole = usize::from(length).next_multiple_of(Self::UNIT);
        let data = self.buffer.0.get_mut(..whole);
        let Some(data) = data.filter(|_| check_16([low, high]) == [e, f] && whole <= room as usize)
        else {
            return Ok(None);
        };
        Self::read(&mut self.flash, data_at, data).await?;
        let data = data.get(..length.into()).unwrap_or_default();
        match *data {
            [key, g, h, i, j, ..] if check_32(data) == [a, b, c, d] => Ok(Some(Entry {
                key,
                stands: length as usize > HEAD,
                generation: u32::from_le_bytes([g, h, i, j]),
                at,
                length: length - HEAD as u16,
                rank: 0,
            })),
            _ => Ok(None),
        }
    }

    /// The next item from `at` on, before `end`, and where it ends: what is damaged is passed over word
    /// by word.
    async fn next_item(&mut self, at: u32, end: u32) -> Result<Option<(Entry, u32)>, StoreFault> {
        for at in (at..end).step_by(Self::UNIT) {
            if let Some(item) = self.item(at).await? {
                return Ok(Some((item, at + Self::footprint(item.length) as u32)));
            }
        }
        Ok(None)
    }

    async fn shape(&mut self, page: u32) -> Result<Shape, StoreFault> {
        let begin = page + Self::UNIT as u32;
        let mut first = Word([MARK; WORD]);
        let bytes = first.0.get_mut(..Self::UNIT).unwrap_or_default();
        Self::read(&mut self.flash, page, bytes).await?;
        let mut shape = Shape {
            begin,
            end: self.written(begin..Self::limit(page)).await?,
            directory: 0,
            seal: 0,
            serial: 0,
            seal_serial: 0,
            seals: 0,
            is_foreign: first.0 != [MARK; WORD],
        };
        let mut at = begin;
        while let Some((item, end)) = self.next_item(at, shape.end).await? {
            (at, shape.end) = (end, shape.end.max(end));
            if item.key == DIRECTORY {
                shape.directory = end;
                shape.serial = shape.serial.max(item.generation);
                if !item.stands {
                    shape.seal = end;
                    shape.seal_serial = shape.serial;
                    shape.seals += 1;
                }
            }
        }
        Ok(shape)
    }

    /// Reads what the flash holds.
    async fn survey(&mut self) -> Result<(), StoreFault> {
        self.known = false;
        self.directory = Directory::EMPTY;
        self.newest = 0;
        self.page = None;
        self.waste = false;
        let mut begun = 0;
        for page in self.pages() {
            let shape = self.shape(page).await?;
            self.waste |= !shape.is_settled();
            if shape.seal_serial >= self.newest {
                self.newest = shape.seal_serial;
                self.page = shape.is_finished().then_some(page);
                self.end = shape.end;
                self.single = (shape.seals == 1).then_some(page);
            }
            let is_blank = self.written(page..page + Self::PAGE).await? == page;
            begun += u32::from(shape.is_foreign && !is_blank);
        }
        self.serial = self.newest;
        // One page may be what power loss has left of the first change.
        self.ruined = begun > 1;
        self.is_empty = true;
        // First the generations, then where the records of those are.
        for places in [false, true] {
            for page in self.pages() {
                let shape = self.shape(page).await?;
                let mut at = shape.begin;
                while let Some((item, end)) = self.next_item(at, shape.end).await? {
                    at = end;
                    if let Some(rank) = shape.rank(end, self.newest) {
                        self.ruined = false;
                        self.is_empty = false;
                        self.count(Entry { rank, ..item }, places)?;
                    }
                }
            }
        }
        self.known = true;
        Ok(())
    }

    /// Takes note of an item: of generations, or of where records are.
    fn count(&mut self, item: Entry, places: bool) -> Result<(), StoreFault> {
        let directory = &mut self.directory;
        if places {
            let known = directory.entry(item.key);
            let is_the_one = (known.generation, known.stands) == (item.generation, item.stands);
            let is_better = item.rank > known.rank || item.rank == known.rank && self.last_counts;
            if item.key != DIRECTORY && is_the_one && is_better {
                return directory.put(item);
            }
        } else if item.key == DIRECTORY {
            self.serial = self.serial.max(item.generation);
            let record = self.buffer.0.get(HEAD..HEAD + usize::from(item.length));
            for entry in record.unwrap_or_default().chunks_exact(Directory::ENTRY) {
                directory.take_newer(Entry::from_bytes(entry))?;
            }
        } else if item.rank != LISTED {
            directory.take_newer(Entry {
                at: 0,
                rank: 0,
                ..item
            })?;
        }
        Ok(())
    }

    /// Makes what the flash holds known, and certain: whoever asks again has the same answer.
    async fn ready(&mut self) -> Result<(), StoreFault> {
        if self.known {
            return Ok(());
        }
        self.survey().await?;
        // What cannot be made certain, since the flash is worn out, can still be read.
        if let Some(page) = self.single
            && self.end + Self::told(0) as u32 <= Self::limit(page)
        {
            self.page = Some(page);
            self.secured = None;
            self.serial = self.newest;
            let _ = self.seal().await;
            self.survey().await?;
        }
        if self.waste && !self.ruined && self.finish().await.is_err() {
            self.survey().await?;
        }
        Ok(())
    }

    /// Appends one more seal.
    async fn seal(&mut self) -> Result<(), StoreFault> {
        self.secure().await?;
        self.append_record(DIRECTORY, self.serial, &[]).await
    }

    /// Writes over words that may be an interrupted header.
    async fn secure(&mut self) -> Result<(), StoreFault> {
        if self.secured != self.page {
            let zeros = Word([0; WORD]);
            let zeros = zeros.0.get(..Self::HEADER).unwrap_or_default();
            Self::write(&mut self.flash, self.end, zeros).await?;
            self.end += Self::HEADER as u32;
            self.secured = self.page;
        }
        Ok(())
    }

    /// Moves what counts in unfinished pages, and erases them.
    async fn finish(&mut self) -> Result<(), StoreFault> {
        for _ in 0..=2 * self.pages().count() {
            if !self.waste {
                return Ok(());
            }
            let mut least = None;
            for page in self.pages() {
                let shape = self.shape(page).await?;
                if shape.is_settled() {
                    continue;
                }
                // Noise is no source as long as there is another.
                let used = self.used_in(page).wrapping_sub(1);
                let counts = shape.rank(0, self.newest).is_some();
                let has_moved =
                    used == usize::MAX && shape.seal == 0 && (self.newest > 0 || self.is_empty);
                if has_moved || !counts {
                    // Nothing in it counts, also if this fails.
                    let _ = self.erase(page).await;
                } else if least.is_none_or(|(least, _)| used < least) {
                    least = Some((used, page));
                }
            }
            let is_free = |page| self.used_in(page) == 0;
            match least {
                // Two pages of earlier firmware may hold the same, and one of them all of it.
                Some(_) if self.last_counts && !self.pages().any(is_free) => {
                    self.last_counts = false;
                    self.survey().await?;
                }
                Some((_, page)) => self.turn(Some(page)).await?,
                None => self.survey().await?,
            }
        }
        Ok(())
    }

    /// Begins a page, and moves there what counts in another: in `source`, or else in the next one, which
    /// is to be begun after this.
    async fn turn(&mut self, source: Option<u32>) -> Result<(), StoreFault> {
        let begun = self.begin(source.or(self.page)).await?;
        let source = source.unwrap_or_else(|| self.after(begun));
        let room = Self::limit(begun) - Self::OPENING as u32;
        // Then what else is to be moved, as far as there is room.
        for others in [false, true] {
            for index in 0..Directory::KEYS {
                let entry = self.directory.entries.get(index).copied();
                let entry = entry.unwrap_or(Entry::NONE);
                let is_there = Self::page_of(entry.at) == source;
                let is_moved = if others {
                    !is_there && entry.rank < SEALED
                } else {
                    is_there
                };
                let fits = self.end + Self::footprint(entry.length) as u32 <= room;
                if entry.at > 0 && is_moved && fits && self.item(entry.at).await?.is_some() {
                    self.append(HEAD + usize::from(entry.length)).await?;
                }
            }
        }
        // More than the number of a directory that was interrupted and cannot be read.
        self.serial = self.serial.saturating_add(1);
        self.tell(OF_A_REMOVAL).await?;
        self.seal().await?;
        self.survey().await
    }

    /// Erases the next page after `kept` that holds nothing that counts, or else as little as possible.
    async fn begin(&mut self, kept: Option<u32>) -> Result<u32, StoreFault> {
        let mut page = kept.map_or(self.range.start, |kept| self.after(kept));
        let mut best = None;
        for _ in self.pages() {
            if kept != Some(page) {
                let shape = self.shape(page).await?;
                let counts = !shape.is_settled() && shape.rank(0, self.newest).is_some();
                let tells = counts || self.page == Some(page);
                let cost = 2 * self.used_in(page) + usize::from(tells);
                if best.is_none_or(|(least, _)| cost < least) {
                    best = Some((cost, page));
                }
            }
            page = self.after(page);
        }
        let (_, page) = best.ok_or(StoreFault)?;
        self.erase(page).await?;
        let mark = Word([MARK; WORD]);
        let mark = mark.0.get(..Self::UNIT).unwrap_or_default();
        Self::write(&mut self.flash, page, mark).await?;
        self.page = Some(page);
        self.end = page + Self::UNIT as u32;
        self.secured = Some(page);
        Ok(page)
    }

    async fn erase(&mut self, page: u32) -> Result<(), StoreFault> {
        let end = page + Self::PAGE;
        let erased = self.flash.erase(page, end).await;
        erased.map_err(|_| StoreFault)?;
        match self.written(page..end).await? {
            written if written == page => Ok(()),
            _ => Err(StoreFault),
        }
    }

    /// Writes whole words, and reads them back.
    async fn write(flash: &mut F, at: u32, bytes: &[u8]) -> Result<(), StoreFault> {
        flash.write(at, bytes).await.map_err(|_| StoreFault)?;
        let mut found = Word([0; WORD]);
        for (written, at) in bytes.chunks(WORD).zip((at..).step_by(WORD)) {
            let found = found.0.get_mut(..written.len()).unwrap_or_default();
            flash.read(at, found).await.map_err(|_| StoreFault)?;
            if found != written {
                return Err(StoreFault);
            }
        }
        Ok(())
    }

    /// Appends an item with the first `length` bytes of the buffer.
    async fn append(&mut self, length: usize) -> Result<(), StoreFault> {
        let at = self.end;
        let whole = length.next_multiple_of(Self::UNIT);
        let data_at = at + Self::HEADER as u32;
        let (data, rest) = self
            .buffer
            .0
            .split_at_mut_checked(length)
            .ok_or(StoreFault)?;
        rest.get_mut(..whole - length).ok_or(StoreFault)?.fill(0);
        let mut header = Word([0xFF; WORD]);
        let [low, high] = (length as u16).to_le_bytes();
        let [a, b, c, d] = check_32(data);
        let [e, f] = check_16([low, high]);
        if let Some(place) = header.0.first_chunk_mut() {
            *place = [a, b, c, d, low, high, e, f];
        }
        self.end = data_at + whole as u32;
        let header = header.0.get(..Self::HEADER).unwrap_or_default();
        Self::write(&mut self.flash, at, header).await?;
        let data = self.buffer.0.get(..whole).unwrap_or_default();
        Self::write(&mut self.flash, data_at, data).await
    }

    async fn append_record(
        &mut self,
        key: u8,
        generation: u32,
        record: &[u8],
    ) -> Result<(), StoreFault> {
        let length = HEAD + record.len();
        let [a, b, c, d] = generation.to_le_bytes();
        let place = self.buffer.0.get_mut(..length).ok_or(StoreFault)?;
        let (head, body) = place.split_at_mut_checked(HEAD).ok_or(StoreFault)?;
        head.copy_from_slice(&[key, a, b, c, d]);
        body.copy_from_slice(record);
        self.append(length).await
    }

    /// Appends the directory so many times, and a seal.
    async fn tell(&mut self, directories: usize) -> Result<(), StoreFault> {
        self.serial = self.serial.saturating_add(1);
        let bytes = self.directory.to_bytes();
        let entries = self.directory.entries.iter();
        let known = entries.filter(|entry| entry.key != DIRECTORY).count();
        // One with no entry would be a seal.
        let bytes = bytes.get(..Directory::ENTRY * known.max(1));
        for _ in 0..directories {
            self.append_record(DIRECTORY, self.serial, bytes.unwrap_or_default())
                .await?;
        }
        self.seal().await
    }

    /// Makes room for a change of so many bytes, and secures the end that it is appended to.
    async fn make_room(&mut self, length: usize) -> Result<(), StoreFault> {
        // What counts in an unfinished page would not if another went on.
        if self.page.is_none() && self.newest > 0 {
            return Err(StoreFault);
        }
        for _ in 0..=2 * self.pages().count() {
            let room = self.page.map_or(0, |page| Self::limit(page) - self.end) as usize;
            if room >= length + Self::told(0) {
                break;
            }
            // The page is not moved at once: it has to count as finished from now on.
            if self.secured != self.page && room >= Self::told(0) {
                self.seal().await?;
            }
            self.turn(None).await?;
        }
        self.secure().await
    }

    /// Appends a record and what tells of it.
    async fn replace(&mut self, key: u8, record: &[u8]) -> Result<(), StoreFault> {
        let length = Self::footprint(record.len() as u16) + Self::told(OF_A_SAVE);
        self.make_room(length).await?;
        let entry = self.directory.entry(key).followed_by(true);
        self.directory.put(entry)?;
        self.append_record(key, entry.generation, record).await?;
        self.tell(OF_A_SAVE).await
    }

    /// Appends that records are no more.
    async fn remove_all(&mut self, is_removed: impl Fn(&Entry) -> bool) -> Result<(), StoreFault> {
        self.make_room(Self::told(OF_A_REMOVAL)).await?;
        for entry in &mut self.directory.entries {
            if is_removed(entry) {
                *entry = entry.followed_by(false);
            }
        }
        self.tell(OF_A_REMOVAL).await
    }

    /// A record in use. `None` if there is none.
    async fn find(&mut self, key: u8) -> Result<Option<&[u8]>, StoreFault> {
        let known = self.directory.entry(key);
        if !self.ruined && !known.stands {
            return Ok(None);
        }
        let found = self.item(known.at).await?;
        let found = found.filter(|item| known.at > 0 && item.generation == known.generation);
        let length = found
            .filter(|item| item.key == key)
            .ok_or(StoreFault)?
            .length;
        Ok(self.buffer.0.get(HEAD..HEAD + usize::from(length)))
    }
}

impl<F: NorFlash> Store for FlashStore<F> {
    fn pause_ms(&self) -> u16 {
        self.pause_ms
    }

    async fn load(&mut self, key: Key, buffer: &mut [u8]) -> Result<Option<usize>, StoreFault> {
        let key = key.number().ok_or(StoreFault)?;
        self.ready().await?;
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
            self.ready().await?;
            // What stands is not written again.
            if self.find(key).await == Ok(Some(record)) {
                return Ok(());
            }
            // The old record may have to be moved before the new one stands.
            let used = self.used(self.range.clone()) + Self::footprint(record.len() as u16);
            if attempt == ATTEMPTS || used > self.capacity() {
                break;
            }
            // What counts is what can be read.
            let _ = self.replace(key, record).await;
            self.known = false;
        }
        Err(StoreFault)
    }

    async fn remove(&mut self, which: fn(Key) -> bool) -> Result<(), StoreFault> {
        let is_removed =
            |entry: &Entry| entry.stands && Key::from_number(entry.key).is_some_and(which);
        for attempt in 0..=ATTEMPTS {
            self.ready().await?;
            if !self.ruined && !self.directory.entries.iter().any(is_removed) {
                return Ok(());
            }
            if attempt < ATTEMPTS {
                // As for a record.
                let _ = self.remove_all(is_removed).await;
                self.known = false;
            }
        }
        Err(StoreFault)
    }
}

/// What a store has been told to keep.
#[derive(Clone, Copy)]
struct Directory {
    /// Those that are not used have the directory's own key.
    entries: [Entry; Self::KEYS],
}

/// The latest of a record.
#[derive(Clone, Copy)]
struct Entry {
    key: u8,
    /// Whether it was saved then, or removed.
    stands: bool,
    generation: u32,
    /// Where it is and of how many bytes, how far that can be relied on; 0 if it is not found.
    at: u32,
    length: u16,
    rank: u32,
}

impl Entry {
    const NONE: Self = Self {
        key: DIRECTORY,
        stands: false,
        generation: 0,
        at: 0,
        length: 0,
        rank: 0,
    };

    fn followed_by(self, stands: bool) -> Self {
        Self {
            key: self.key,
            stands,
            generation: self.generation.saturating_add(1),
            ..Self::NONE
        }
    }

    fn from_bytes(bytes: &[u8]) -> Self {
        match *bytes {
            [key, stands, a, b, c, d] => Self {
                key,
                stands: stands != 0,
                generation: u32::from_le_bytes([a, b, c, d]),
                ..Self::NONE
            },
            _ => Self::NONE,
        }
    }
}

impl Directory {
    const KEYS: usize = 16;
    const ENTRY: usize = 6;
    const LENGTH: usize = Self::KEYS * Self::ENTRY;
    const EMPTY: Self = Self {
        entries: [Entry::NONE; Self::KEYS],
    };

    fn entry(&self, key: u8) -> Entry {
        let mut entries = self.entries.iter();
        let known = entries.find(|entry| entry.key == key);
        known.copied().unwrap_or(Entry { key, ..Entry::NONE })
    }

    fn take_newer(&mut self, entry: Entry) -> Result<(), StoreFault> {
        if entry.key == DIRECTORY || entry.generation <= self.entry(entry.key).generation {
            return Ok(());
        }
        self.put(entry)
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
}

/// CRC-16F/4.2 (Koopman), reflected, of an item's length; never that of erased flash.
fn check_16(length: [u8; 2]) -> [u8; 2] {
    let check = length.iter().fold(0xFFFF, |check, &byte| {
        shifted(check ^ u32::from(byte), 0x1A2E, 8)
    });
    match !check as u16 {
        0xFFFF => 0xFFFE_u16.to_le_bytes(),
        check => check.to_le_bytes(),
    }
}

/// CRC-32C from 0xEEEEEEEE on, reflected, of an item's data; its first byte is neither 0 nor 0xFF.
fn check_32(data: &[u8]) -> [u8; 4] {
    const NIBBLES: [u32; 16] = {
        let mut nibbles = [0; 16];
        let mut index = 0;
        while index < nibbles.len() {
            nibbles[index] = shifted(index as u32, 0x82F6_3B78, 4);
            index += 1;
        }
        nibbles
    };
    let check = data.iter().fold(0xEEEE_EEEE, |check: u32, &byte| {
        let nibble = |check: u32| check >> 4 ^ NIBBLES[check as usize % 16];
        nibble(nibble(check ^ u32::from(byte)))
    });
    match (!check).to_le_bytes() {
        [first @ (0 | 0xFF), rest @ ..] => {
            let [b, c, d] = rest;
            [first ^ 1, b, c, d]
        }
        check => check,
    }
}

/// So many steps of a reflected CRC.
const fn shifted(mut check: u32, polynomial: u32, mut steps: u32) -> u32 {
    while steps > 0 {
        check = check >> 1 ^ if check & 1 == 1 { polynomial } else { 0 };
        steps -= 1;
    }
    check
}
