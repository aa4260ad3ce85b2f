//! The chip's flash, whose pages are erased in small steps.
//!
//! Erasing a page stalls the processor for 87 ms, in which the sensor's FIFO of 32 samples would overflow. So
//! the store's pages are erased in steps; interrupts and tasks run between them.

use embassy_nrf::nvmc::{Error, FLASH_SIZE, Nvmc, PAGE_SIZE};
use embassy_nrf::pac;
use embassy_nrf::pac::nvmc::vals::Wen;
use embedded_storage::nor_flash::{ErrorType, NorFlash, ReadNorFlash};
use wimu_node::{PageFlash, Timer};
use wimu_nrf::BoardTimer;

/// Total time to erase a page (datasheet), ms.
const ERASE_MS: u8 = 87;
/// Duration of a step, ms. Half of the sensor's FIFO holds 12 ms of samples at 1344 Hz.
const STEP_MS: u8 = 4;
/// Time between two steps, µs: long enough to read 16 samples.
const BETWEEN_US: u64 = 3_000;

/// The flash.
pub struct StoreFlash(pub Nvmc<'static>);

impl ErrorType for StoreFlash {
    type Error = Error;
}

impl ReadNorFlash for StoreFlash {
    const READ_SIZE: usize = 1;

    fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), Error> {
        self.0.read(offset, bytes)
    }

    fn capacity(&self) -> usize {
        FLASH_SIZE
    }
}

impl NorFlash for StoreFlash {
    const WRITE_SIZE: usize = 4;
    const ERASE_SIZE: usize = PAGE_SIZE;

    fn erase(&mut self, from: u32, to: u32) -> Result<(), Error> {
        self.0.erase(from, to)
    }

    fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), Error> {
        self.0.write(offset, bytes)
    }
}

impl PageFlash for StoreFlash {
    async fn erase_page(&mut self, at: u32) -> Result<(), Error> {
        let page = at as usize;
        if page >= FLASH_SIZE {
            return Err(Error::OutOfBounds);
        }
        if !page.is_multiple_of(PAGE_SIZE) {
            return Err(Error::Unaligned);
        }
        for _ in 0..ERASE_MS.div_ceil(STEP_MS) {
            erase_partly(at);
            BoardTimer.after_us(BETWEEN_US).await;
        }
        Ok(())
    }
}

/// Erases a page for [`STEP_MS`]. The processor stalls for this time and 1 ms to begin.
fn erase_partly(page: u32) {
    let nvmc = pac::NVMC;
    nvmc.erasepagepartialcfg().write(|w| w.set_duration(STEP_MS));
    nvmc.config().write(|w| w.set_wen(Wen::Een));
    nvmc.erasepagepartial().write_value(page);
    while !nvmc.ready().read().ready() {}
    nvmc.config().write(|w| w.set_wen(Wen::Ren));
}
