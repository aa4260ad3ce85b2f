//! The simulated board's non-volatile memory: a NOR flash that can wear out, lose bits and lose power.

use std::cell::RefCell;
use std::collections::BTreeMap;
use std::fs::{File, OpenOptions};
use std::io::{self, Read, Seek, SeekFrom, Write};
use std::ops::Range;
use std::path::Path;
use std::rc::Rc;

use embedded_storage::nor_flash::{ErrorType, NorFlash, NorFlashErrorKind, ReadNorFlash};
use wimu_node::{FlashLayout, FlashStore, Key, MAX_RECORD, PageFlash, Store};

const PAGES: usize = 4;
/// As on an nRF52.
const PAGE: usize = 4096;
const WORD: usize = 4;
/// How long an erase may take on an nRF52, ms.
const PAUSE_MS: u16 = 90;

/// Flash of four pages of 4 KiB that survives restarts of the board, and of the program if it is kept
/// in a file. Clones are the same flash.
///
/// An erase sets all bits of a page, a write only clears bits, byte by byte from the first on.
#[derive(Clone, Debug, Default)]
pub struct Storage(Rc<RefCell<Chip>>);

#[derive(Debug)]
struct Chip {
    bytes: Vec<u8>,
    file: Option<File>,
    worn_out: bool,
    /// Bytes that have one value.
    stuck: BTreeMap<usize, u8>,
    /// Bytes that can be written or erased before power is lost.
    left: Option<u64>,
    /// Bytes written or erased so far.
    changed: u64,
    erases: [u32; PAGES],
}

impl Default for Chip {
    fn default() -> Self {
        Self {
            bytes: vec![0xFF; PAGES * PAGE],
            file: None,
            worn_out: false,
            stuck: BTreeMap::new(),
            left: None,
            changed: 0,
            erases: [0; PAGES],
        }
    }
}

impl Storage {
    /// Flash in memory.
    pub fn in_memory() -> Self {
        Self::default()
    }

    /// Flash that contains `image`, the rest erased.
    pub fn from_image(image: &[u8]) -> Self {
        let storage = Self::default();
        for (byte, kept) in storage.0.borrow_mut().bytes.iter_mut().zip(image) {
            *byte = *kept;
        }
        storage
    }

    /// Flash kept in the file at `path`, created if absent. Every byte is written to the file immediately.
    ///
    /// # Errors
    /// When the file cannot be opened or read. A damaged file is read as far as possible;
    /// the node detects the damage.
    pub fn in_file(path: &Path) -> io::Result<Self> {
        let mut options = OpenOptions::new();
        options.read(true).write(true).create(true).truncate(false);
        // It contains the board's key.
        #[cfg(unix)]
        std::os::unix::fs::OpenOptionsExt::mode(&mut options, 0o600);
        let mut file = options.open(path)?;
        let mut image = Vec::new();
        file.read_to_end(&mut image)?;
        let storage = Self::from_image(&image);
        storage.0.borrow_mut().file = Some(file);
        Ok(storage)
    }

    /// Its content.
    pub fn image(&self) -> Vec<u8> {
        self.0.borrow().bytes.clone()
    }

    /// The node's store in it.
    pub fn store(&self) -> FlashStore<Self> {
        const LAYOUT: FlashLayout<Storage> = FlashLayout::new(0..(PAGES * PAGE) as u32);
        FlashStore::new(self.clone(), LAYOUT, PAUSE_MS)
    }

    /// Makes all writes and erases ineffective, or effective again.
    pub fn set_worn_out(&self, worn_out: bool) {
        self.0.borrow_mut().worn_out = worn_out;
    }

    /// Wears out the byte at `at`: it reads `value` once it is written or erased.
    pub fn stick(&self, at: usize, value: u8) {
        self.0.borrow_mut().stuck.insert(at, value);
    }

    /// Removes power after this many more bytes have been written or erased: the next write and what follows has no
    /// effect and fails. `None` restores power.
    pub fn lose_power_after(&self, bytes: Option<u64>) {
        self.0.borrow_mut().left = bytes;
    }

    /// Number of bytes written or erased so far.
    pub fn bytes_changed(&self) -> u64 {
        self.0.borrow().changed
    }

    /// Number of erases of each page.
    pub fn erases(&self) -> [u32; PAGES] {
        self.0.borrow().erases
    }

    /// Damages all headers.
    pub fn corrupt_headers(&self) {
        let mut chip = self.0.borrow_mut();
        let half = chip.bytes.len() / 2;
        for start in [0, half] {
            chip.bytes[start..start + 800].iter_mut().for_each(|byte| *byte ^= 0x55);
        }
        let everything = 0..chip.bytes.len();
        chip.keep(everything);
    }

    /// Damages the stored record of `key`, if there is one.
    pub fn corrupt(&self, key: Key) {
        let mut record = [0; MAX_RECORD];
        let mut store = Self::from_image(&self.image()).store();
        let Ok(Some(length)) = store.load(key, &mut record) else {
            return;
        };
        let mut chip = self.0.borrow_mut();
        let mut at = 0;
        while let Some(copy) = chip.bytes.get_mut(at..at + length) {
            if *copy == record[..length] {
                copy[length / 2] ^= 0x55;
            }
            at += 1;
        }
        let everything = 0..chip.bytes.len();
        chip.keep(everything);
    }
}

impl Chip {
    /// Changes a byte; false without power.
    fn change(&mut self, at: usize, change: impl FnOnce(u8) -> u8) -> bool {
        match &mut self.left {
            Some(0) => return false,
            Some(left) => *left -= 1,
            None => {}
        }
        self.changed += 1;
        if let Some(byte) = self.bytes.get_mut(at)
            && !self.worn_out
        {
            let changed = change(*byte);
            *byte = self.stuck.get(&at).copied().unwrap_or(changed);
        }
        true
    }

    /// Writes bytes to the file. On a full disk the content is kept in memory only.
    fn keep(&mut self, range: Range<usize>) {
        if let (Some(file), Some(bytes)) = (&mut self.file, self.bytes.get(range.clone())) {
            let _ =
                file.seek(SeekFrom::Start(range.start as u64)).and_then(|_| file.write_all(bytes));
        }
    }
}

impl ErrorType for Storage {
    type Error = NorFlashErrorKind;
}

impl ReadNorFlash for Storage {
    const READ_SIZE: usize = 1;

    fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), NorFlashErrorKind> {
        let offset = offset as usize;
        let chip = self.0.borrow();
        let held = chip.bytes.get(offset..offset + bytes.len());
        bytes.copy_from_slice(held.ok_or(NorFlashErrorKind::OutOfBounds)?);
        Ok(())
    }

    fn capacity(&self) -> usize {
        PAGES * PAGE
    }
}

impl NorFlash for Storage {
    const WRITE_SIZE: usize = WORD;
    const ERASE_SIZE: usize = PAGE;

    fn erase(&mut self, from: u32, to: u32) -> Result<(), NorFlashErrorKind> {
        let range = within(from as usize..to as usize, PAGE)?;
        let done = {
            let mut chip = self.0.borrow_mut();
            for page in range.clone().step_by(PAGE) {
                chip.erases[page / PAGE] += 1;
            }
            let done = range.clone().all(|at| chip.change(at, |_| 0xFF));
            chip.keep(range);
            done
        };
        if done { Ok(()) } else { Err(NorFlashErrorKind::Other) }
    }

    fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), NorFlashErrorKind> {
        let offset = offset as usize;
        within(offset..offset + bytes.len(), WORD)?;
        let done = {
            let mut chip = self.0.borrow_mut();
            let mut places = (offset..).zip(bytes);
            let done = places.all(|(at, byte)| chip.change(at, |before| before & byte));
            chip.keep(offset..offset + bytes.len());
            done
        };
        if done { Ok(()) } else { Err(NorFlashErrorKind::Other) }
    }
}

impl PageFlash for Storage {}

fn within(range: Range<usize>, unit: usize) -> Result<Range<usize>, NorFlashErrorKind> {
    if !range.start.is_multiple_of(unit) || !range.end.is_multiple_of(unit) {
        Err(NorFlashErrorKind::NotAligned)
    } else if range.start > range.end || range.end > PAGES * PAGE {
        Err(NorFlashErrorKind::OutOfBounds)
    } else {
        Ok(range)
    }
}
