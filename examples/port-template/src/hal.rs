//! Stands for the HAL of the chip: types without hardware, so that the template compiles. Delete this file; the comments in
//! `main.rs` say what takes the place of each.

use core::convert::Infallible;
use core::future::pending;

use cortex_m::interrupt::InterruptNumber;
use embedded_hal_async::i2c;
use embedded_io_async::{Read, Write};
use embedded_storage::nor_flash::{NorFlash, NorFlashErrorKind, ReadNorFlash};
use wimu_model::DeviceTimeUs;
use wimu_node::DataReady;

/// An I²C controller to which nothing answers.
pub struct I2c;

impl i2c::ErrorType for I2c {
    type Error = i2c::ErrorKind;
}

impl i2c::I2c for I2c {
    async fn transaction(
        &mut self,
        _address: u8,
        _operations: &mut [i2c::Operation<'_>],
    ) -> Result<(), i2c::ErrorKind> {
        let source = i2c::NoAcknowledgeSource::Address;
        Err(i2c::ErrorKind::NoAcknowledge(source))
    }
}

/// A pin that stays low. A HAL's pin that can wait takes its place as it is.
pub struct Pin;

impl DataReady for Pin {
    async fn ready(&mut self) -> Option<DeviceTimeUs> {
        pending().await
    }
}

/// The receiving or the sending half of a UART that is not connected.
pub struct Uart;

impl embedded_io_async::ErrorType for Uart {
    type Error = Infallible;
}

impl Read for Uart {
    async fn read(&mut self, _buffer: &mut [u8]) -> Result<usize, Infallible> {
        pending().await
    }
}

impl Write for Uart {
    async fn write(&mut self, bytes: &[u8]) -> Result<usize, Infallible> {
        Ok(bytes.len())
    }

    async fn flush(&mut self) -> Result<(), Infallible> {
        Ok(())
    }
}

/// A flash that fails.
pub struct Flash;

impl embedded_storage::nor_flash::ErrorType for Flash {
    type Error = NorFlashErrorKind;
}

impl ReadNorFlash for Flash {
    const READ_SIZE: usize = 1;

    fn read(&mut self, _offset: u32, _bytes: &mut [u8]) -> Result<(), NorFlashErrorKind> {
        Err(NorFlashErrorKind::Other)
    }

    fn capacity(&self) -> usize {
        512 << 10
    }
}

impl NorFlash for Flash {
    const WRITE_SIZE: usize = 4;
    const ERASE_SIZE: usize = 4096;

    fn erase(&mut self, _from: u32, _to: u32) -> Result<(), NorFlashErrorKind> {
        Err(NorFlashErrorKind::Other)
    }

    fn write(&mut self, _offset: u32, _bytes: &[u8]) -> Result<(), NorFlashErrorKind> {
        Err(NorFlashErrorKind::Other)
    }
}

/// A watchdog that never resets.
pub struct Watchdog;

impl Watchdog {
    /// Feeds it.
    pub fn feed(&mut self) {}
}

/// An interrupt that no peripheral of the board uses.
#[derive(Clone, Copy)]
pub struct SpareInterrupt;

// SAFETY: the number is one of every Cortex-M.
unsafe impl InterruptNumber for SpareInterrupt {
    fn number(self) -> u16 {
        0
    }
}

/// µs since the start.
pub fn now_us() -> u64 {
    0
}

/// The table of interrupts.
#[unsafe(link_section = ".vector_table.interrupts")]
#[unsafe(no_mangle)]
static __INTERRUPTS: [unsafe extern "C" fn(); 1] = [crate::SPARE];
