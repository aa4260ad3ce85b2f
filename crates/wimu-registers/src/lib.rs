#![doc = include_str!("../README.md")]
#![no_std]
#![forbid(unsafe_code)]

use core::fmt;

use embedded_hal_async::i2c::{Error as _, ErrorKind, I2c, NoAcknowledgeSource};
use embedded_hal_async::spi::{Operation, SpiDevice};

/// Bit of the register address that marks a read on SPI.
const SPI_READ: u8 = 0x80;

/// How a chip is read on SPI.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct SpiRead {
    /// Bit of the register address that marks a read of several registers; 0 if the chip needs none.
    pub multiple: u8,
    /// Delay between chip select and the address, ns.
    pub delay_ns: u32,
}

/// Access to the chip's registers over one of its serial interfaces.
#[allow(async_fn_in_trait)] // Drivers are polled where they are built; nothing needs `Send`.
pub trait Bus {
    /// Error of the bus.
    type Error: fmt::Debug;

    /// Whether the chip's I²C interface is in use. If not, a driver may turn it off, so that the chip
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
    async fn read(
        &mut self,
        register: u8,
        values: &mut [u8],
        spi: SpiRead,
    ) -> Result<(), Self::Error>;

    /// Whether `error` reports that no device acknowledged its address.
    fn not_answering(error: &Self::Error) -> bool;
}

/// The chip on an I²C bus.
#[derive(Debug)]
pub struct I2cBus<I, A = u8> {
    /// The bus.
    pub i2c: I,
    /// Address of the chip, 7 bits.
    pub address: A,
}

impl<I: I2c, A: Copy + Into<u8>> Bus for I2cBus<I, A> {
    type Error = I::Error;
    const I2C: bool = true;

    async fn write(&mut self, register: u8, value: u8) -> Result<(), I::Error> {
        let address = self.address.into();
        self.i2c.write(address, &[register, value]).await
    }

    async fn read(
        &mut self,
        register: u8,
        values: &mut [u8],
        _spi: SpiRead,
    ) -> Result<(), I::Error> {
        let address = self.address.into();
        self.i2c.write_read(address, &[register], values).await
    }

    fn not_answering(error: &I::Error) -> bool {
        matches!(
            error.kind(),
            ErrorKind::NoAcknowledge(NoAcknowledgeSource::Address | NoAcknowledgeSource::Unknown)
        )
    }
}

/// The chip on a four-wire SPI bus. If the chip needs [`SpiRead::delay_ns`], the device must support delays
/// within a transaction.
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

    async fn read(
        &mut self,
        register: u8,
        values: &mut [u8],
        spi: SpiRead,
    ) -> Result<(), S::Error> {
        let multiple = if values.len() > 1 { spi.multiple } else { 0 };
        let command = [register | SPI_READ | multiple];
        let mut operations =
            [Operation::DelayNs(spi.delay_ns), Operation::Write(&command), Operation::Read(values)];
        let first = usize::from(spi.delay_ns == 0);
        let operations = operations.get_mut(first..).unwrap_or_default();
        self.0.transaction(operations).await
    }

    /// SPI has no acknowledgement: an absent chip reads as 0x00 or 0xFF.
    fn not_answering(_error: &S::Error) -> bool {
        false
    }
}

/// The registers of a chip on `bus`.
#[derive(Debug)]
pub struct Registers<B> {
    bus: B,
    spi: SpiRead,
}

impl<B> Registers<B> {
    /// A chip on `bus`, which is read on SPI as `spi` states; nothing is sent yet.
    pub const fn new(bus: B, spi: SpiRead) -> Self {
        Self { bus, spi }
    }

    /// Returns the bus.
    pub fn release(self) -> B {
        self.bus
    }
}

impl<B: Bus> Registers<B> {
    /// Checks that `register` contains `expected`.
    ///
    /// # Errors
    /// [`Error::WrongIdentity`] if it does not; [`Error::NotAnswering`], [`Error::Bus`].
    pub async fn check_identity(
        &mut self,
        register: u8,
        expected: u8,
    ) -> Result<(), Error<B::Error>> {
        match self.read_one(register).await? {
            found if found == expected => Ok(()),
            0x00 | 0xFF => Err(Error::NotAnswering),
            found => Err(Error::WrongIdentity { expected, found }),
        }
    }

    /// Writes one register.
    ///
    /// # Errors
    /// [`Error::NotAnswering`], [`Error::Bus`].
    pub async fn write(&mut self, register: u8, value: u8) -> Result<(), Error<B::Error>> {
        self.bus.write(register, value).await.map_err(error::<B>)
    }

    /// Reads one register.
    ///
    /// # Errors
    /// [`Error::NotAnswering`], [`Error::Bus`].
    pub async fn read_one(&mut self, register: u8) -> Result<u8, Error<B::Error>> {
        let mut value = [0];
        self.read(register, &mut value).await?;
        Ok(value[0])
    }

    /// Reads `values.len()` registers from `register` on in one burst.
    ///
    /// # Errors
    /// [`Error::NotAnswering`], [`Error::Bus`].
    pub async fn read(&mut self, register: u8, values: &mut [u8]) -> Result<(), Error<B::Error>> {
        let read = self.bus.read(register, values, self.spi).await;
        read.map_err(error::<B>)
    }
}

fn error<B: Bus>(error: B::Error) -> Error<B::Error> {
    if B::not_answering(&error) { Error::NotAnswering } else { Error::Bus(error) }
}

/// Why a sensor could not be used. `E` is the error of the bus.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Error<E> {
    /// No chip acknowledges the I²C address, or the SPI data line stays at one level.
    NotAnswering,
    /// A transfer failed.
    Bus(E),
    /// Another chip is on the bus.
    WrongIdentity {
        /// The expected content of the identity register.
        expected: u8,
        /// The content read.
        found: u8,
    },
    /// The chip did not finish its software reset in time.
    ResetTimeout,
}

impl<E: fmt::Debug> fmt::Display for Error<E> {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::NotAnswering => out.write_str(
                "the sensor does not answer: check its supply, its wiring and its address or chip select",
            ),
            Self::Bus(error) => write!(
                out,
                "a transfer to the sensor failed ({error:?}): check its wiring, pull-ups and the bus frequency"
            ),
            Self::WrongIdentity { expected, found } => write!(
                out,
                "the sensor's chip identifies itself as {found:#04x}, expected {expected:#04x}: check which board this is"
            ),
            Self::ResetTimeout => {
                out.write_str("the sensor did not finish its software reset: check its supply")
            }
        }
    }
}

impl<E: fmt::Debug> core::error::Error for Error<E> {}
