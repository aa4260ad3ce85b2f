//! The chip's flash, written in the pauses of the radio.

use embassy_nrf::Peri;
use embassy_nrf::nvmc::{FLASH_SIZE, PAGE_SIZE};
use embassy_nrf::peripherals::NVMC;
use embedded_storage::nor_flash::{ErrorType, NorFlash, ReadNorFlash};
use nrf_sdc::mpsl::{Flash, FlashError};
use wimu_node::PageFlash;

use crate::radio::{Layer, block_on};

/// The flash. A write waits for the radio and runs nothing else meanwhile; tasks run while a page is erased.
pub struct StoreFlash {
    flash: Flash<'static>,
    layer: &'static Layer,
}

impl StoreFlash {
    /// The store's flash; takes the peripheral, so that there is only one.
    pub fn new(layer: &'static Layer, chip: Peri<'static, NVMC>) -> Self {
        Self { flash: Flash::take(layer, chip), layer }
    }
}

impl ErrorType for StoreFlash {
    type Error = FlashError;
}

impl ReadNorFlash for StoreFlash {
    const READ_SIZE: usize = 1;

    fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), FlashError> {
        self.flash.read(offset, bytes)
    }

    fn capacity(&self) -> usize {
        FLASH_SIZE
    }
}

impl NorFlash for StoreFlash {
    const WRITE_SIZE: usize = 4;
    const ERASE_SIZE: usize = PAGE_SIZE;

    fn erase(&mut self, from: u32, to: u32) -> Result<(), FlashError> {
        block_on(self.layer, self.flash.erase(from, to))
    }

    fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), FlashError> {
        block_on(self.layer, self.flash.write(offset, bytes))
    }
}

impl PageFlash for StoreFlash {
    async fn erase_page(&mut self, at: u32) -> Result<(), FlashError> {
        self.flash.erase(at, at + PAGE_SIZE as u32).await
    }
}
