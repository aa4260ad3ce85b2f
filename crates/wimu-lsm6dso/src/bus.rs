use core::fmt;

use embedded_hal_async::i2c::{Error as _, ErrorKind, I2c, NoAcknowledgeSource};
use embedded_hal_async::spi::{Operation, SpiDevice};

/// Bit of the register address that marks a read on SPI.
const SPI_READ: u8 = 0x80;

/// I²C address of the chip, selected by the level of its pin SDO/SA0 (DS12140 §5.1).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Address {
    /// The pin is low: 0x6A.
    #[default]
    Low = 0x6A,
    /// The pin is high: 0x6B.
    High = 0x6B,
}

/// Access to the chip's registers over one of its serial interfaces.
#[allow(async_fn_in_trait)] // Drivers are polled where they are built; nothing needs `Send`.
pub trait Bus {
    /// Error of the bus.
    type Error: fmt::Debug;

    /// Whether the chip's I²C interface is in use. If not, the driver turns it off, so that the chip
    /// does not mistake the traffic of other SPI devices for I²C.
    const I2C: bool;

    /// Writes one register.
    ///
    /// # Errors
    /// Those of the bus.
    async fn write(&mut self, register: u8, value: u8) -> Result<(), Self::Error>;

    /// Reads `values.len()` registers from `register` on in one burst.
    ///
    /// # Errors
    /// Those of the bus.
    async fn read(&mut self, register: u8, values: &mut [u8]) -> Result<(), Self::Error>;

    /// Whether `error` says that no device acknowledged its address.
    fn not_answering(error: &Self::Error) -> bool;
}

/// The chip on an I²C bus, up to 400 kHz, or 1 MHz in fast mode plus.
#[derive(Debug)]
pub struct I2cBus<I> {
    /// The bus.
    pub i2c: I,
    /// Address of the chip.
    pub address: Address,
}

impl<I: I2c> Bus for I2cBus<I> {
    type Error = I::Error;
    const I2C: bool = true;

    async fn write(&mut self, register: u8, value: u8) -> Result<(), I::Error> {
        let address = self.address as u8;
        self.i2c.write(address, &[register, value]).await
    }

    async fn read(&mut self, register: u8, values: &mut [u8]) -> Result<(), I::Error> {
        let address = self.address as u8;
        self.i2c.write_read(address, &[register], values).await
    }

    fn not_answering(error: &I::Error) -> bool {
        matches!(
            error.kind(),
            ErrorKind::NoAcknowledge(NoAcknowledgeSource::Address | NoAcknowledgeSource::Unknown)
        )
    }
}

/// The chip on a four-wire SPI bus in mode 0 or 3, up to 10 MHz.
#[derive(Debug)]
pub struct SpiBus<S>(
    /// The bus with the chip's chip select.
    pub S,
);

impl<S: SpiDevice> Bus for SpiBus<S> {
    type Error = S::Error;
    const I2C: bool = false;

    async fn write(&mut self, register: u8, value: u8) -> Result<(), S::Error> {
        self.0.write(&[register, value]).await
    }

    async fn read(&mut self, register: u8, values: &mut [u8]) -> Result<(), S::Error> {
        let command = [register | SPI_READ];
        let mut operations = [Operation::Write(&command), Operation::Read(values)];
        self.0.transaction(&mut operations).await
    }

    /// SPI has no acknowledgement: an absent chip reads as 0x00 or 0xFF.
    fn not_answering(_error: &S::Error) -> bool {
        false
    }
}
