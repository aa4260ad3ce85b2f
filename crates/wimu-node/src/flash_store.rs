//! Records in a board's NOR flash: two halves, of which a change writes the other one.

use core::marker::PhantomData;
use core::ops::Range;

use embedded_storage::nor_flash::NorFlash;
use heapless::Vec;
use wimu_model::checksum::{Digest, crc_32c};

use crate::store::{Key, MAX_RECORD, Store, StoreFault};

/// Widest word of flash that is supported, bytes.
const WORD: usize = 32;
/// Most records.
const RECORDS: usize = 12;
/// Bytes of a header: format, generation, starts, number of records, whether records were lost; of each record key, 0,
/// length, CRC-32C of these and the record; CRC-32C.
const HEADER: usize = 128;
const FORMAT: [u8; 4] = *b"wim1";
/// Copies of the header. A change writes two, the others are for starts that find one that may be unstable.
const COPIES: usize = 6;
/// Starts that are counted in a half before a change.
const CELLS: usize = 64;
/// Times that a header which was written after a restart is read back.
const CONFIRMATIONS: usize = 8;

/// Where the marks of a half are, bytes from its start: its headers are stable; another half has followed it; its first
/// cell.
const SETTLED: usize = COPIES * HEADER;
const RETIRED: usize = SETTLED + WORD;
const FIRST_CELL: usize = RETIRED + WORD;

/// A NOR flash that reads and writes at once, and may let other tasks run while a page is erased.
#[allow(async_fn_in_trait)] // As of `Store`.
pub trait PageFlash: NorFlash {
    /// Erases the page at `at`, bytes from the start of the flash.
    ///
    /// # Errors
    /// Those of [`NorFlash::erase`].
    async fn erase_page(&mut self, at: u32) -> Result<(), Self::Error> {
        self.erase(at, at + Self::ERASE_SIZE as u32)
    }
}

/// The pages of a flash that hold the store: an even number of whole ones. Made at compile time, where a layout that
/// cannot work is an error.
///
/// Two pages of 4 KiB hold what a node keeps: parameter sets for four ranges, settings, key and rates. All pages have one
/// size; of a flash with unequal sectors, `F` is a driver of those of one size.
#[derive(Clone, Debug)]
pub struct FlashLayout<F> {
    range: Range<u32>,
    flash: PhantomData<F>,
}

impl<F: PageFlash> FlashLayout<F> {
    /// The pages at `range`, bytes from the start of the flash.
    ///
    /// # Panics
    /// When the range is not an even number of whole pages, with room for ten of the longest records in each half, or the
    /// flash has words wider than 32 bytes. Call it in a constant.
    pub const fn new(range: Range<u32>) -> Self {
        let page = F::ERASE_SIZE as u32;
        let length = range.end.saturating_sub(range.start);
        assert!(
            range.start.is_multiple_of(page) && length > 0 && length.is_multiple_of(2 * page),
            "the store needs an even number of whole pages of flash"
        );
        assert!(
            WORD.is_multiple_of(F::WRITE_SIZE) && WORD.is_multiple_of(F::READ_SIZE),
            "the words of this flash are too wide"
        );
        assert!(
            length as usize / 2 >= FlashStore::<F>::FIRST_RECORD + 10 * MAX_RECORD,
            "the store needs more pages of this flash"
        );
        Self { range, flash: PhantomData }
    }
}

/// The node's [`Store`] in any NOR flash.
///
/// A half has copies of a header (generation, number of starts, the records' keys, lengths and checksums), marks, cells
/// in which starts are counted, and the records. A change erases the half that is not in use, writes all records there
/// and reads them back, and then the header, twice. The half with the later header is in use. A start is counted by
/// writing a cell.
///
/// A write or an erase that power loss interrupts may leave cells that read differently each time. So a start does not
/// read a record before this holds, whatever it finds:
/// - The header in use is stable: the change that wrote it has marked it as settled, or the start writes another copy.
/// - The other half has an older header, or never again one: its headers are overwritten with zeros.
///
/// A record whose checksum is wrong is an error, and so is every record when the headers of the latest half cannot be read,
/// because that half has marked the other one as retired. What was lost stays an error until it is written again, or
/// until records are removed.
/// Everything that is written or erased is read back, so a worn-out flash is an error and keeps the old records. An
/// unchanged record is not written again.
///
/// Assumptions: an interrupted write disturbs only what is being written, an interrupted erase only its pages; programming
/// zeros over a word that was begun is allowed.
///
/// ```
/// use wimu_node::{FlashLayout, FlashStore, PageFlash};
///
/// /// The last two pages of 4 KiB of a flash of 512 KiB, as on an nRF52833; erasing one takes up
/// /// to 90 ms.
/// fn store<F: PageFlash>(flash: F) -> FlashStore<F> {
///     FlashStore::new(flash, const { FlashLayout::new(0x7E000..0x80000) }, 90)
/// }
/// ```
pub struct FlashStore<F> {
    flash: F,
    range: Range<u32>,
    /// `None` before the flash has been read.
    state: Option<State>,
    pause_ms: u16,
}

/// What the flash holds.
#[derive(Clone, Default)]
struct State {
    /// Start of the half in use; `None` without one.
    half: Option<u32>,
    header: Header,
    /// Cells of that half that are written.
    cells: usize,
}

#[derive(Clone, Default)]
struct Header {
    generation: u32,
    /// Starts before the first cell.
    starts: u32,
    /// Records that are not in it were lost.
    lost: bool,
    entries: Vec<Entry, RECORDS>,
}

#[derive(Clone, Copy)]
struct Entry {
    key: u8,
    length: u16,
    check: u32,
}

/// A change of what is stored.
enum Change<'a> {
    Save(u8, &'a [u8]),
    Remove(fn(Key) -> bool),
    /// Room for more starts.
    Start,
}

/// Room for part of a record or for a word. Some flash drivers need it aligned.
#[repr(align(4))]
struct Part<const N: usize>([u8; N]);

impl Header {
    fn to_bytes(&self) -> Part<HEADER> {
        let mut bytes = Part([0; HEADER]);
        let mut rest = &mut bytes.0[..HEADER - 4];
        let mut put = |field: &[u8]| {
            if let Some((place, after)) =
                core::mem::take(&mut rest).split_at_mut_checked(field.len())
            {
                place.copy_from_slice(field);
                rest = after;
            }
        };
        put(&FORMAT);
        put(&self.generation.to_le_bytes());
        put(&self.starts.to_le_bytes());
        put(&[self.entries.len() as u8, self.lost.into(), 0, 0]);
        for entry in &self.entries {
            put(&[entry.key, 0]);
            put(&entry.length.to_le_bytes());
            put(&entry.check.to_le_bytes());
        }
        if let Some((content, check)) = bytes.0.split_last_chunk_mut::<4>() {
            *check = crc_32c(content).to_le_bytes();
        }
        bytes
    }

    /// `None` of bytes that are no header.
    fn from_bytes(bytes: &[u8; HEADER]) -> Option<Self> {
        let (content, check) = bytes.split_last_chunk::<4>()?;
        let (words, _) = content.as_chunks::<4>();
        let [format, generation, starts, [count, lost, ..], entries @ ..] = words else {
            return None;
        };
        if crc_32c(content) != u32::from_le_bytes(*check) || *format != FORMAT {
            return None;
        }
        let mut header = Self {
            generation: u32::from_le_bytes(*generation),
            starts: u32::from_le_bytes(*starts),
            lost: *lost != 0,
            entries: Vec::new(),
        };
        for entry in entries.as_chunks::<2>().0.iter().take((*count).into()) {
            let [[key, _, low, high], check] = *entry;
            let length = u16::from_le_bytes([low, high]);
            header.entries.push(Entry { key, length, check: u32::from_le_bytes(check) }).ok()?;
        }
        Some(header)
    }
}

impl<F: PageFlash> FlashStore<F> {
    /// Granularity of reads and writes, bytes.
    const UNIT: usize = if F::WRITE_SIZE > F::READ_SIZE { F::WRITE_SIZE } else { F::READ_SIZE };
    const FIRST_RECORD: usize = (FIRST_CELL + CELLS * Self::UNIT).next_multiple_of(WORD);

    /// The records that `flash` holds. `pause_ms` is the longest time to erase a page and write it, ms,
    /// during which the processor may be stalled.
    pub const fn new(flash: F, layout: FlashLayout<F>, pause_ms: u16) -> Self {
        let FlashLayout { range, .. } = layout;
        Self { flash, range, state: None, pause_ms }
    }

    /// The flash, for other uses.
    pub fn release(self) -> F {
        self.flash
    }

    const fn half_bytes(&self) -> u32 {
        (self.range.end - self.range.start) / 2
    }

    fn halves(&self) -> [u32; 2] {
        [self.range.start, self.range.start + self.half_bytes()]
    }

    fn other(&self, half: u32) -> u32 {
        let [first, second] = self.halves();
        if half == first { second } else { first }
    }

    fn padded(length: u16) -> u32 {
        usize::from(length).next_multiple_of(WORD) as u32
    }

    fn read(&mut self, at: u32, bytes: &mut [u8]) -> Result<(), StoreFault> {
        self.flash.read(at, bytes).map_err(|_| StoreFault)
    }

    /// Writes whole words and reads them back.
    fn write(&mut self, at: u32, bytes: &[u8]) -> Result<(), StoreFault> {
        self.flash.write(at, bytes).map_err(|_| StoreFault)?;
        self.verify(at, bytes)
    }

    fn verify(&mut self, at: u32, bytes: &[u8]) -> Result<(), StoreFault> {
        let mut found = Part([0; WORD]);
        for (part, at) in bytes.chunks(WORD).zip((at..).step_by(WORD)) {
            let found = found.0.get_mut(..part.len()).unwrap_or_default();
            self.read(at, found)?;
            if found != part {
                return Err(StoreFault);
            }
        }
        Ok(())
    }

    /// Whether every byte of a range of whole parts is `value`.
    fn is_all(&mut self, range: Range<u32>, value: u8) -> Result<bool, StoreFault> {
        let mut part = Part([0; WORD]);
        for at in range.step_by(WORD) {
            self.read(at, &mut part.0)?;
            if part.0.iter().any(|&byte| byte != value) {
                return Ok(false);
            }
        }
        Ok(true)
    }

    fn copy_of(half: u32, copy: usize) -> Range<u32> {
        let at = half + (copy * HEADER) as u32;
        at..at + HEADER as u32
    }

    /// The header of a half; `None` without a copy that is one.
    fn header(&mut self, half: u32) -> Result<Option<Header>, StoreFault> {
        let mut bytes = Part([0; HEADER]);
        for copy in 0..COPIES {
            self.read(Self::copy_of(half, copy).start, &mut bytes.0)?;
            let header = Header::from_bytes(&bytes.0);
            if header.is_some() {
                return Ok(header);
            }
        }
        Ok(None)
    }

    fn mark(&mut self, half: u32, mark: usize) -> Result<(), StoreFault> {
        self.write(half + mark as u32, &Part([0; WORD]).0)
    }

    /// Reads the flash if its content is not known, and makes sure that every later start finds the same.
    fn recover(&mut self) -> Result<(), StoreFault> {
        if self.state.is_some() {
            return Ok(());
        }
        let [first, second] = self.halves();
        let (in_first, in_second) = (self.header(first)?, self.header(second)?);
        let is_alone = in_first.is_none() || in_second.is_none();
        let newer = match (in_first, in_second) {
            (Some(a), Some(b)) if a.generation > b.generation => Some((first, a)),
            (Some(a), None) => Some((first, a)),
            (_, Some(b)) => Some((second, b)),
            (None, None) => None,
        };
        let Some((half, header)) = newer else {
            return self.begin_empty();
        };
        let retired = half + RETIRED as u32;
        if self.is_all(retired..retired + WORD as u32, 0)? {
            // The headers of the half that followed it cannot be read.
            let Header { generation, starts, .. } = header;
            let header = Header {
                generation: generation.saturating_add(1),
                starts: starts.saturating_add(2 * CELLS as u32),
                lost: true,
                ..Header::default()
            };
            self.state = Some(State { half: None, header, cells: 0 });
            return Ok(());
        }
        // A worn-out flash can still be read.
        let _ = self.settle(half, &header);
        if is_alone {
            let _ = self.close(self.other(half));
        }
        let cells = self.cells(half)?;
        self.state = Some(State { half: Some(half), header, cells });
        Ok(())
    }

    /// Neither half has a header: the flash is new, its first change was interrupted, or both are damaged.
    fn begin_empty(&mut self) -> Result<(), StoreFault> {
        let halves = self.halves();
        let mut damaged = 0;
        for half in halves {
            let first = Self::copy_of(half, 0);
            let is_closed = self.is_all(first.clone(), 0)?;
            damaged += u32::from(!is_closed && !self.is_all(first, 0xFF)?);
        }
        let lost = damaged > 1;
        if !lost {
            for half in halves {
                let _ = self.close(half);
            }
        }
        let header = Header { lost, ..Header::default() };
        self.state = Some(State { half: None, header, cells: 0 });
        Ok(())
    }

    /// Whether the headers of a half read the same at every start.
    fn is_settled(&mut self, half: u32) -> Result<bool, StoreFault> {
        let at = half + SETTLED as u32;
        Ok(!self.is_all(at..at + WORD as u32, 0xFF)?)
    }

    /// Makes sure that the header which was found stays readable.
    fn settle(&mut self, half: u32, header: &Header) -> Result<(), StoreFault> {
        if self.is_settled(half)? {
            return Ok(());
        }
        for copy in 2..COPIES {
            let range = Self::copy_of(half, copy);
            if self.is_all(range.clone(), 0xFF)? {
                let bytes = header.to_bytes();
                self.write(range.start, &bytes.0)?;
                for _ in 0..CONFIRMATIONS {
                    self.verify(range.start, &bytes.0)?;
                }
                return self.mark(half, SETTLED);
            }
        }
        Ok(())
    }

    /// Makes sure that no header appears in a half that has none: one may be partly written, and look erased.
    fn close(&mut self, half: u32) -> Result<(), StoreFault> {
        if self.is_settled(half)? {
            return Ok(());
        }
        self.void(half)?;
        self.mark(half, SETTLED)
    }

    /// Overwrites the headers of a half.
    fn void(&mut self, half: u32) -> Result<(), StoreFault> {
        let mut outcome = Ok(());
        for at in (half..half + SETTLED as u32).step_by(WORD) {
            outcome = outcome.and(self.write(at, &Part([0; WORD]).0));
        }
        outcome
    }

    /// Number of cells up to the last one that is written.
    fn cells(&mut self, half: u32) -> Result<usize, StoreFault> {
        let mut cell = Part([0; WORD]);
        for index in (0..CELLS).rev() {
            let bytes = cell.0.get_mut(..Self::UNIT).unwrap_or_default();
            self.read(Self::cell(half, index), bytes)?;
            if bytes.iter().any(|&byte| byte != 0xFF) {
                return Ok(index + 1);
            }
        }
        Ok(0)
    }

    fn cell(half: u32, index: usize) -> u32 {
        half + (FIRST_CELL + index * Self::UNIT) as u32
    }

    /// Erases the half that is not in use, writes the records there and uses it from then on. Reading and writing block;
    /// other tasks run while a page is erased, if the flash allows it.
    async fn change(&mut self, change: Change<'_>) -> Result<(), StoreFault> {
        self.check_room(&change)?;
        let before = self.state.take().ok_or(StoreFault)?;
        let half = before.half.map_or(self.range.start, |old| self.other(old));
        for page in (half..half + self.half_bytes()).step_by(F::ERASE_SIZE) {
            self.flash.erase_page(page).await.map_err(|_| StoreFault)?;
        }
        self.fill(half, &before, &change)
    }

    /// Whether the records fit after a change.
    fn check_room(&self, change: &Change<'_>) -> Result<(), StoreFault> {
        let entries = &self.state.as_ref().ok_or(StoreFault)?.header.entries;
        let kept = entries.iter().filter(|entry| change.keeps(entry.key));
        let (mut count, mut bytes) = (0, Self::FIRST_RECORD as u32);
        for length in kept.map(|entry| entry.length).chain(change.new_length()) {
            count += 1;
            bytes += Self::padded(length);
        }
        if count > RECORDS || bytes > self.half_bytes() { Err(StoreFault) } else { Ok(()) }
    }

    /// Writes the records after a change to an erased half.
    fn fill(&mut self, half: u32, before: &State, change: &Change<'_>) -> Result<(), StoreFault> {
        if !self.is_all(half..half + self.half_bytes(), 0xFF)? {
            return Err(StoreFault);
        }
        let mut header = Header {
            generation: before.header.generation.saturating_add(1),
            starts: before.starts(),
            lost: before.header.lost && !matches!(change, Change::Remove(_)),
            entries: Vec::new(),
        };
        let mut at = half + Self::FIRST_RECORD as u32;
        let mut from = before.half.unwrap_or_default() + Self::FIRST_RECORD as u32;
        for entry in &before.header.entries {
            if change.keeps(entry.key) {
                self.copy(from, at, entry.length)?;
                header.entries.push(*entry).map_err(|_| StoreFault)?;
                at += Self::padded(entry.length);
            }
            from += Self::padded(entry.length);
        }
        if let Change::Save(key, record) = *change {
            self.write_record(at, record)?;
            header.entries.push(Entry::of(key, record)).map_err(|_| StoreFault)?;
        }
        let old = before.half;
        if let Err(fault) = self.publish(half, old, &header) {
            // Not at the next start either.
            let _ = self.void(half);
            return Err(fault);
        }
        self.state = Some(State { half: Some(half), header, cells: 0 });
        Ok(())
    }

    /// Puts the records of a half in use.
    fn publish(&mut self, half: u32, old: Option<u32>, header: &Header) -> Result<(), StoreFault> {
        let bytes = header.to_bytes();
        for copy in 0..2 {
            self.write(Self::copy_of(half, copy).start, &bytes.0)?;
        }
        self.mark(half, SETTLED)?;
        match old {
            Some(old) => self.mark(old, RETIRED),
            None => Ok(()),
        }
    }

    fn copy(&mut self, from: u32, to: u32, length: u16) -> Result<(), StoreFault> {
        let mut part = Part([0; WORD]);
        for offset in (0..Self::padded(length)).step_by(WORD) {
            self.read(from + offset, &mut part.0)?;
            self.write(to + offset, &part.0)?;
        }
        Ok(())
    }

    fn write_record(&mut self, at: u32, record: &[u8]) -> Result<(), StoreFault> {
        for (bytes, at) in record.chunks(WORD).zip((at..).step_by(WORD)) {
            let mut part = Part([0; WORD]);
            if let Some(place) = part.0.get_mut(..bytes.len()) {
                place.copy_from_slice(bytes);
            }
            self.write(at, &part.0)?;
        }
        Ok(())
    }

    /// Reads a record into `buffer`; returns its length.
    fn find(&mut self, key: u8, buffer: &mut [u8]) -> Result<Option<usize>, StoreFault> {
        let state = self.state.as_ref().ok_or(StoreFault)?;
        let entry = state.header.entries.iter().find(|entry| entry.key == key);
        let (Some(half), Some(&entry)) = (state.half, entry) else {
            return if state.header.lost { Err(StoreFault) } else { Ok(None) };
        };
        let before = state.header.entries.iter().take_while(|entry| entry.key != key);
        let bytes: u32 = before.map(|entry| Self::padded(entry.length)).sum();
        let at = half + Self::FIRST_RECORD as u32 + bytes;
        let record = buffer.get_mut(..entry.length.into()).ok_or(StoreFault)?;
        let mut part = Part([0; WORD]);
        for (bytes, at) in record.chunks_mut(WORD).zip((at..).step_by(WORD)) {
            self.read(at, &mut part.0)?;
            bytes.copy_from_slice(part.0.get(..bytes.len()).unwrap_or_default());
        }
        if Entry::of(key, record).check != entry.check {
            return Err(StoreFault);
        }
        Ok(Some(record.len()))
    }
    /// Whether a record is stored already.
    fn holds(&mut self, key: u8, record: &[u8]) -> bool {
        let mut held = [0; MAX_RECORD];
        let length = self.find(key, &mut held).ok().flatten();
        length.and_then(|length| held.get(..length)) == Some(record)
    }
}

impl State {
    fn starts(&self) -> u32 {
        self.header.starts.saturating_add(self.cells as u32)
    }
}

impl Change<'_> {
    fn keeps(&self, key: u8) -> bool {
        match *self {
            Self::Save(new, _) => new != key,
            Self::Remove(which) => !Key::from_number(key).is_some_and(which),
            Self::Start => true,
        }
    }

    fn new_length(&self) -> Option<u16> {
        match self {
            Self::Save(_, record) => Some(record.len() as u16),
            Self::Remove(_) | Self::Start => None,
        }
    }
}

impl Entry {
    fn of(key: u8, record: &[u8]) -> Self {
        let length = record.len() as u16;
        let mut digest = Digest::new();
        digest.update(&[key]);
        digest.update(&length.to_le_bytes());
        digest.update(record);
        Self { key, length, check: digest.finalize() }
    }
}

impl<F: PageFlash> Store for FlashStore<F> {
    fn pause_ms(&self) -> u16 {
        self.pause_ms
    }

    fn load(&mut self, key: Key, buffer: &mut [u8]) -> Result<Option<usize>, StoreFault> {
        let key = key.number().ok_or(StoreFault)?;
        self.recover()?;
        self.find(key, buffer)
    }

    async fn save(&mut self, key: Key, record: &[u8]) -> Result<(), StoreFault> {
        let key = key.number().ok_or(StoreFault)?;
        if record.is_empty() || record.len() > MAX_RECORD {
            return Err(StoreFault);
        }
        self.recover()?;
        if self.holds(key, record) {
            return Ok(());
        }
        self.change(Change::Save(key, record)).await
    }

    async fn remove(&mut self, which: fn(Key) -> bool) -> Result<(), StoreFault> {
        self.recover()?;
        let change = Change::Remove(which);
        let header = &self.state.as_ref().ok_or(StoreFault)?.header;
        // Whoever may remove records begins anew where some were lost.
        if !header.lost && header.entries.iter().all(|entry| change.keeps(entry.key)) {
            return Ok(());
        }
        self.change(change).await
    }

    async fn count_start(&mut self) -> Result<u32, StoreFault> {
        self.recover()?;
        let state = self.state.as_ref().ok_or(StoreFault)?;
        if state.header.lost && state.half.is_none() {
            return Err(StoreFault);
        }
        if state.half.is_none() || state.cells == CELLS {
            self.change(Change::Start).await?;
        }
        let state = self.state.as_mut().ok_or(StoreFault)?;
        let (half, cell) = (state.half.ok_or(StoreFault)?, state.cells);
        state.cells += 1;
        let starts = state.starts();
        let zeros = Part([0; WORD]);
        self.write(Self::cell(half, cell), zeros.0.get(..Self::UNIT).unwrap_or_default())?;
        Ok(starts)
    }
}
