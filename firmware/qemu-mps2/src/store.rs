//! Simulated flash in the memory that QEMU keeps in a file.

use core::ops::Range;
use core::sync::atomic::{AtomicU32, Ordering};

use embedded_storage::nor_flash::{
    ErrorType, NorFlash, NorFlashErrorKind, ReadNorFlash, check_erase, check_read, check_write,
};
use wimu_node::{FlashLayout, PageFlash};

use crate::log::exit_code;
use crate::semihosting;

/// The machine's PSRAM.
const BASE: usize = 0x2100_0000;
/// Page (erase) size, bytes, as on an nRF52.
const PAGE: usize = 4096;
/// Write granularity, bytes.
const WORD: usize = 4;
const RANGE: Range<u32> = 0..4 * PAGE as u32;

/// Words that can be written or erased before power is lost.
static WORDS_LEFT: AtomicU32 = AtomicU32::new(u32::MAX);

/// Extra processor cycles to write or erase a word.
static SLOWNESS: AtomicU32 = AtomicU32::new(0);

/// Delays writing and erasing, so that a test can kill the machine meanwhile.
pub fn slow_down(cycles: u32) {
    SLOWNESS.store(cycles, Ordering::Relaxed);
}

/// Ends the machine when `words` more words have been written or erased, so that a test can lose
/// power at each of them.
pub fn lose_power_after(words: u32) {
    WORDS_LEFT.store(words, Ordering::Relaxed);
}

/// Flash in ordinary memory: an erase sets all bits of a page, a write only clears bits.
///
/// The memory holds the complement, so that a new file of zeros is erased flash.
pub struct Flash(());

impl Flash {
    /// The flash; only one may exist.
    ///
    /// # Safety
    /// Nothing else may use the first pages of the PSRAM.
    pub const unsafe fn new() -> Self {
        Self(())
    }

    /// Puts `value` into the aligned `address` of the memory.
    fn put(address: usize, value: u32) {
        match WORDS_LEFT.load(Ordering::Relaxed) {
            0 => semihosting::exit(exit_code::POWER_LOSS),
            u32::MAX => {}
            left => WORDS_LEFT.store(left - 1, Ordering::Relaxed),
        }
        // SAFETY: the aligned address is in the flash.
        unsafe { (address as *mut u32).write_volatile(value) };
        cortex_m::asm::delay(SLOWNESS.load(Ordering::Relaxed));
    }
}

impl ErrorType for Flash {
    type Error = NorFlashErrorKind;
}

impl ReadNorFlash for Flash {
    const READ_SIZE: usize = 1;

    fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), NorFlashErrorKind> {
        check_read(self, offset, bytes.len())?;
        for (place, address) in bytes.iter_mut().zip(BASE + offset as usize..) {
            // SAFETY: the address is in the flash.
            *place = !unsafe { (address as *const u8).read_volatile() };
        }
        Ok(())
    }

    fn capacity(&self) -> usize {
        RANGE.end as usize
    }
}

impl NorFlash for Flash {
    const WRITE_SIZE: usize = WORD;
    const ERASE_SIZE: usize = PAGE;

    fn erase(&mut self, from: u32, to: u32) -> Result<(), NorFlashErrorKind> {
        check_erase(self, from, to)?;
        for offset in (from as usize..to as usize).step_by(WORD) {
            Self::put(BASE + offset, 0);
        }
        Ok(())
    }

    fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), NorFlashErrorKind> {
        check_write(self, offset, bytes.len())?;
        let addresses = (BASE + offset as usize..).step_by(WORD);
        for (word, address) in bytes.as_chunks::<WORD>().0.iter().zip(addresses) {
            // SAFETY: the aligned address is in the flash.
            let before = unsafe { (address as *const u32).read_volatile() };
            Self::put(address, before | !u32::from_le_bytes(*word));
        }
        Ok(())
    }
}

impl PageFlash for Flash {}

/// The pages of the store.
pub const LAYOUT: FlashLayout<Flash> = FlashLayout::new(RANGE);
