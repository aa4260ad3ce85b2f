//! Blocking flash for the node's store.

use embassy_futures::yield_now;
use embedded_storage::nor_flash as blocking;
use embedded_storage_async::nor_flash::{ErrorType, NorFlash, ReadNorFlash};

/// A blocking NOR flash as [`FlashStore`](wimu_node::FlashStore) uses it. It erases one sector at a time, and other
/// tasks run in between. So a watchdog has to allow for one sector only, however many a range has.
///
/// All sectors of the range have the size `F::ERASE_SIZE`. Of a flash with unequal sectors, `F` is the region of the HAL
/// whose sectors have the size that the store uses, not the whole flash.
#[derive(Debug)]
pub struct BlockingFlash<F>(pub F);

impl<F: blocking::ErrorType> ErrorType for BlockingFlash<F> {
    type Error = F::Error;
}

impl<F: blocking::ReadNorFlash> ReadNorFlash for BlockingFlash<F> {
    const READ_SIZE: usize = F::READ_SIZE;

    async fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), F::Error> {
        self.0.read(offset, bytes)
    }

    fn capacity(&self) -> usize {
        self.0.capacity()
    }
}

impl<F: blocking::NorFlash> NorFlash for BlockingFlash<F> {
    const WRITE_SIZE: usize = F::WRITE_SIZE;
    const ERASE_SIZE: usize = F::ERASE_SIZE;

    async fn erase(&mut self, from: u32, to: u32) -> Result<(), F::Error> {
        if blocking::check_erase(&self.0, from, to).is_err() {
            // The flash refuses it, with its own error.
            return self.0.erase(from, to);
        }
        for sector in (from..to).step_by(F::ERASE_SIZE) {
            self.0.erase(sector, sector + F::ERASE_SIZE as u32)?;
            yield_now().await;
        }
        Ok(())
    }

    async fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), F::Error> {
        self.0.write(offset, bytes)
    }
}

#[cfg(test)]
mod tests {
    use std::vec::Vec;

    use embassy_futures::{block_on, join::join};
    use embedded_storage::nor_flash::{NorFlashErrorKind, check_erase};

    use super::*;

    /// Notes what is erased.
    struct Sectors(Vec<(u32, u32)>);

    impl blocking::ErrorType for Sectors {
        type Error = NorFlashErrorKind;
    }

    impl blocking::ReadNorFlash for Sectors {
        const READ_SIZE: usize = 1;

        fn read(&mut self, _: u32, _: &mut [u8]) -> Result<(), NorFlashErrorKind> {
            Ok(())
        }

        fn capacity(&self) -> usize {
            0x1_0000
        }
    }

    impl blocking::NorFlash for Sectors {
        const WRITE_SIZE: usize = 4;
        const ERASE_SIZE: usize = 0x4000;

        fn erase(&mut self, from: u32, to: u32) -> Result<(), NorFlashErrorKind> {
            check_erase(self, from, to)?;
            self.0.push((from, to));
            Ok(())
        }

        fn write(&mut self, _: u32, _: &[u8]) -> Result<(), NorFlashErrorKind> {
            Ok(())
        }
    }

    #[test]
    fn sectors_are_erased_one_at_a_time_and_other_tasks_run_in_between() {
        let mut flash = BlockingFlash(Sectors(Vec::new()));
        let mut turns = 0;
        let others = async {
            for _ in 0..3 {
                turns += 1;
                yield_now().await;
            }
        };
        let (outcome, ()) = block_on(join(flash.erase(0x4000, 0x1_0000), others));
        assert_eq!(outcome, Ok(()));
        let sectors = [(0x4000, 0x8000), (0x8000, 0xC000), (0xC000, 0x1_0000)];
        assert_eq!(flash.0.0, sectors);
        assert_eq!(turns, 3);
    }

    #[test]
    fn a_range_that_does_not_fit_is_refused_and_nothing_is_erased() {
        for (from, to) in [(0x2000, 0x8000), (0x4000, 0x5000), (0x8000, 0x1_4000), (8, 0)] {
            let mut flash = BlockingFlash(Sectors(Vec::new()));
            assert!(block_on(flash.erase(from, to)).is_err(), "{from:#x}");
            assert_eq!(flash.0.0, []);
        }
    }
}
