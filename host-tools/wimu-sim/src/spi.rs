//! A chip on an SPI bus in virtual time.

use std::convert::Infallible;
use std::rc::Rc;

use embedded_hal_async::spi::{ErrorType, Operation, SpiDevice};

use crate::clock::VirtualClock;
use crate::i2c::Target;

/// Address under which a chip is accessed on SPI; no I²C address.
pub(crate) const ADDRESS: u8 = 0x80;
/// Bit of the first byte that marks a read.
const READ: u8 = 0x80;

/// A chip with its own chip select, in mode 0 or 3; without a chip every bit reads as 1.
///
/// The first byte of a transaction is the register with the read bit, data follow in either direction.
/// A dropped transaction ends at the byte it had reached.
pub struct SimSpi {
    clock: VirtualClock,
    chip: Rc<dyn Target>,
    byte_ns: u64,
    time_ns: u64,
    /// The first byte of the transaction.
    command: Option<u8>,
}

impl SimSpi {
    /// `chip` on a bus of `bus_hz`, more than 0.
    pub fn new(clock: &VirtualClock, chip: Rc<dyn Target>, bus_hz: u32) -> Self {
        Self {
            clock: clock.clone(),
            chip,
            byte_ns: 8_000_000_000 / u64::from(bus_hz),
            time_ns: 0,
            command: None,
        }
    }

    /// One byte in both directions.
    async fn exchange(&mut self, byte: u8) -> u8 {
        self.time_ns += self.byte_ns;
        self.clock.until(self.time_ns.div_ceil(1000)).await;
        match self.command {
            _ if !self.chip.acknowledges(ADDRESS) => return 0xFF,
            Some(command) if command & READ != 0 => return self.chip.read(ADDRESS),
            Some(_) => self.chip.write(ADDRESS, byte),
            None => {
                self.command = Some(byte);
                self.chip.begin_write(ADDRESS);
                self.chip.write(ADDRESS, byte & !READ);
            }
        }
        0xFF
    }
}

impl ErrorType for SimSpi {
    type Error = Infallible;
}

impl SpiDevice for SimSpi {
    async fn transaction(
        &mut self,
        operations: &mut [Operation<'_, u8>],
    ) -> Result<(), Infallible> {
        self.time_ns = self.clock.now() * 1000;
        self.command = None;
        for operation in operations {
            let copy;
            let (read, written): (&mut [u8], &[u8]) = match operation {
                Operation::Read(buffer) => (buffer, &[]),
                Operation::Write(bytes) => (&mut [], bytes),
                Operation::Transfer(buffer, bytes) => (buffer, bytes),
                Operation::TransferInPlace(buffer) => {
                    copy = buffer.to_vec();
                    (buffer, &copy)
                }
                Operation::DelayNs(delay) => {
                    self.time_ns += u64::from(*delay);
                    continue;
                }
            };
            for i in 0..read.len().max(written.len()) {
                let answer = self.exchange(written.get(i).copied().unwrap_or(0)).await;
                if let Some(byte) = read.get_mut(i) {
                    *byte = answer;
                }
            }
        }
        Ok(())
    }
}
