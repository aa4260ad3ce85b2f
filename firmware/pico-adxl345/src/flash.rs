//! The last 16 KiB of the flash.
//!
//! While the flash is erased or written, neither data nor code can be read from it. So interrupts are disabled
//! and the routine runs from RAM, with functions of the chip's ROM.

use embassy_futures::yield_now;
use embassy_rp::Peri;
use embassy_rp::flash::{Blocking, ERASE_SIZE, FLASH_BASE, PAGE_SIZE};
use embassy_rp::peripherals::FLASH;
use embassy_rp::rom_data;
use embedded_storage::nor_flash::{ErrorType, NorFlash, NorFlashErrorKind, ReadNorFlash};
use wimu_node::{FlashLayout, PageFlash};

/// Size of a Pico's flash, bytes.
const CHIP: usize = 2 << 20;
/// Size of the store, bytes, which memory.x excludes.
const SIZE: usize = 4 * ERASE_SIZE;
const START: usize = CHIP - SIZE;
/// Size of the second stage of the bootloader, which makes the flash readable, words.
const BOOT2_WORDS: usize = 64;

/// That part of the flash, by offsets from its start.
pub struct StoreFlash(());

impl StoreFlash {
    /// The store's flash; takes the peripheral, so that there is only one.
    pub fn new(_chip: Peri<'static, FLASH>) -> Self {
        Self(())
    }

    fn range(offset: u32, length: usize, unit: usize) -> Result<usize, NorFlashErrorKind> {
        let offset = offset as usize;
        if offset.checked_add(length).is_none_or(|end| end > SIZE) {
            Err(NorFlashErrorKind::OutOfBounds)
        } else if !offset.is_multiple_of(unit) || !length.is_multiple_of(unit) {
            Err(NorFlashErrorKind::NotAligned)
        } else {
            Ok(START + offset)
        }
    }
}

impl ErrorType for StoreFlash {
    type Error = NorFlashErrorKind;
}

impl ReadNorFlash for StoreFlash {
    const READ_SIZE: usize = 1;

    fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), NorFlashErrorKind> {
        let from = Self::range(offset, bytes.len(), 1)?;
        let flash = FLASH_BASE.cast::<u8>();
        for (index, byte) in bytes.iter_mut().enumerate() {
            // SAFETY: the address is in the flash, which is mapped into memory.
            *byte = unsafe { flash.add(from + index).read_volatile() };
        }
        Ok(())
    }

    fn capacity(&self) -> usize {
        SIZE
    }
}

impl NorFlash for StoreFlash {
    const WRITE_SIZE: usize = 4;
    const ERASE_SIZE: usize = ERASE_SIZE;

    fn erase(&mut self, from: u32, to: u32) -> Result<(), NorFlashErrorKind> {
        let length = to.checked_sub(from).ok_or(NorFlashErrorKind::OutOfBounds)? as usize;
        let start = Self::range(from, length, ERASE_SIZE)?;
        for at in (start..start + length).step_by(ERASE_SIZE) {
            change(Change::Erase { at });
        }
        Ok(())
    }

    fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), NorFlashErrorKind> {
        let mut at = Self::range(offset, bytes.len(), Self::WRITE_SIZE)?;
        let mut rest = bytes;
        while !rest.is_empty() {
            // The chip writes whole pages; ones leave bits unchanged.
            let mut page = [0xFF; PAGE_SIZE];
            let skipped = at % PAGE_SIZE;
            let room = page.iter_mut().skip(skipped);
            let count = room.zip(rest).map(|(place, byte)| *place = *byte).count();
            change(Change::Write { at: at - skipped, page: &page });
            at += count;
            rest = rest.get(count..).unwrap_or_default();
        }
        Ok(())
    }
}

impl PageFlash for StoreFlash {
    async fn erase_page(&mut self, at: u32) -> Result<(), NorFlashErrorKind> {
        self.erase(at, at + ERASE_SIZE as u32)?;
        // Tasks run between two sectors.
        yield_now().await;
        Ok(())
    }
}

/// The unique number of the flash chip, which identifies the Pico.
pub fn chip_number(chip: Peri<'_, FLASH>) -> u64 {
    let mut number = [0; 8];
    // The driver would wait for the end of a background read.
    let idle = embassy_rp::pac::XIP_CTRL.stream_ctr().read().0 == 0;
    let mut flash = embassy_rp::flash::Flash::<_, Blocking, CHIP>::new_blocking(chip);
    if idle && flash.blocking_unique_id(&mut number).is_ok() {
        u64::from_be_bytes(number)
    } else {
        0
    }
}

/// The pages of the store: all of them.
pub const LAYOUT: FlashLayout<StoreFlash> = FlashLayout::new(0..SIZE as u32);

#[derive(Clone, Copy)]
enum Change<'a> {
    Erase {
        /// The sector.
        at: usize,
    },
    Write {
        at: usize,
        page: &'a [u8; PAGE_SIZE],
    },
}

/// Data of the routine, in RAM.
struct Rom {
    connect: unsafe extern "C" fn(),
    exit_xip: unsafe extern "C" fn(),
    erase: unsafe extern "C" fn(u32, usize, u32, u8),
    program: unsafe extern "C" fn(u32, *const u8, usize),
    flush_cache: unsafe extern "C" fn(),
    boot2: [u32; BOOT2_WORDS],
}

fn change(change: Change<'_>) {
    let mut rom = Rom {
        connect: rom_data::connect_internal_flash::ptr(),
        exit_xip: rom_data::flash_exit_xip::ptr(),
        erase: rom_data::flash_range_erase::ptr(),
        program: rom_data::flash_range_program::ptr(),
        flush_cache: rom_data::flash_flush_cache::ptr(),
        boot2: [0; BOOT2_WORDS],
    };
    for (index, word) in rom.boot2.iter_mut().enumerate() {
        // SAFETY: the second stage is at the start of the flash.
        *word = unsafe { FLASH_BASE.add(index).read_volatile() };
    }
    critical_section::with(|_| {
        // SAFETY: interrupts are disabled, the other core is not started and no DMA is used, so nothing reads
        // the flash; the range is within the store.
        unsafe { in_ram(&rom, change) }
    });
}

/// # Safety
/// Nothing else may read the flash meanwhile, and the change must be within the store.
#[inline(never)]
#[unsafe(link_section = ".data.in_ram")]
unsafe fn in_ram(rom: &Rom, change: Change<'_>) {
    // SAFETY: the caller's; a sector is erased by command 0x20.
    unsafe {
        (rom.connect)();
        (rom.exit_xip)();
        match change {
            // The command for larger blocks is never used.
            Change::Erase { at } => (rom.erase)(at as u32, ERASE_SIZE, 1 << 31, 0),
            Change::Write { at, page } => (rom.program)(at as u32, page.as_ptr(), PAGE_SIZE),
        }
        (rom.flush_cache)();
        let boot2 = rom.boot2.as_ptr().cast::<u8>().add(1);
        core::mem::transmute::<*const u8, unsafe extern "C" fn()>(boot2)();
    }
}
