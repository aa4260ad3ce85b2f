use core::fmt;

use embedded_hal_async::i2c::{Error as _, ErrorKind, I2c, NoAcknowledgeSource};
use embedded_hal_async::spi::{Operation, SpiDevice};

/// Bits of the register address on SPI: a read, and more than one byte.
const SPI_READ: u8 = 0x80;
const SPI_MULTIPLE: u8 = 0x40;
/// Minimum time between reading a sample and the next access to the FIFO (datasheet, "Retrieving data from
/// FIFO").
const FIFO_NS: u32 = 5_000;

/// The chip's address, by the level of its pin SDO/ALT ADDRESS.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Address {
    /// The pin is low: 0x53, as on most breakout boards.
    #[default]
    Low = 0x53,
    /// The pin is high: 0x1D.
    High = 0x1D,
}

/// Access to the chip's registers over one of its serial interfaces.
#[allow(async_fn_in_trait)] // Drivers are polled where they are built; nothing needs `Send`.
pub trait Bus {
    /// Error of the bus.
    type Error: fmt::Debug;

    /// Whether the chip's I²C interface is in use.
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

/// The chip on an I²C bus, up to 400 kHz.
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

/// The chip on a four-wire SPI bus in mode 3, up to 5 MHz. The device must support delays within a
/// transaction.
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
        let multiple = if values.len() > 1 { SPI_MULTIPLE } else { 0 };
        let command = [register | SPI_READ | multiple];
        let mut operations = [
            // The read before may have been of a sample.
            Operation::DelayNs(FIFO_NS),
            Operation::Write(&command),
            Operation::Read(values),
        ];
        self.0.transaction(&mut operations).await
    }

    /// SPI has no acknowledgement: an absent chip reads as 0x00 or 0xFF.
    fn not_answering(_error: &S::Error) -> bool {
        false
    }
}
