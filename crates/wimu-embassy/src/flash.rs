//! Blocking flash for the node's store.

use embassy_futures::yield_now;
use embedded_storage::nor_flash::{ErrorType, NorFlash, ReadNorFlash};
use wimu_node::PageFlash;

/// A NOR flash as [`FlashStore`](wimu_node::FlashStore) uses it: other tasks run between two sectors that are erased. So
/// a watchdog has to allow for one sector only.
///
/// All sectors of the range have the size `F::ERASE_SIZE`. Of a flash with unequal sectors, `F` is the region of the HAL
/// whose sectors have the size that the store uses, not the whole flash.
#[derive(Debug)]
pub struct BlockingFlash<F>(pub F);

impl<F: ErrorType> ErrorType for BlockingFlash<F> {
    type Error = F::Error;
}

impl<F: ReadNorFlash> ReadNorFlash for BlockingFlash<F> {
    const READ_SIZE: usize = F::READ_SIZE;

    fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), F::Error> {
        self.0.read(offset, bytes)
    }

    fn capacity(&self) -> usize {
        self.0.capacity()
    }
}

impl<F: NorFlash> NorFlash for BlockingFlash<F> {
    const WRITE_SIZE: usize = F::WRITE_SIZE;
    const ERASE_SIZE: usize = F::ERASE_SIZE;

    fn erase(&mut self, from: u32, to: u32) -> Result<(), F::Error> {
        self.0.erase(from, to)
    }

    fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), F::Error> {
        self.0.write(offset, bytes)
    }
}

impl<F: NorFlash> PageFlash for BlockingFlash<F> {
    async fn erase_page(&mut self, at: u32) -> Result<(), F::Error> {
        self.0.erase(at, at + F::ERASE_SIZE as u32)?;
        yield_now().await;
        Ok(())
    }
}
