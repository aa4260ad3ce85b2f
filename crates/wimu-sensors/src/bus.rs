//! Access to the 8-bit registers of a chip over I²C or SPI.

use embedded_hal_async::i2c::I2c;
use embedded_hal_async::spi::{Operation, SpiDevice};
use wimu_node::sensor::SensorFault;

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

/// Access to a chip's registers over one of its serial interfaces.
#[allow(async_fn_in_trait)] // Drivers are polled where they are built; nothing needs `Send`.
pub trait Bus {
    /// Whether the chip's I²C interface is in use. If not, a driver may turn it off, so that the chip
    /// does not mistake the traffic of other SPI devices for I²C.
    const I2C: bool;

    /// Writes one register.
    ///
    /// # Errors
    /// [`SensorFault::NotAnswering`], [`SensorFault::Transfer`].
    async fn write(&mut self, register: u8, value: u8) -> Result<(), SensorFault>;

    /// Reads `values.len()` registers from `register` on in one burst.
    ///
    /// # Errors
    /// [`SensorFault::NotAnswering`], [`SensorFault::Transfer`].
    async fn read(
        &mut self,
        register: u8,
        values: &mut [u8],
        spi: SpiRead,
    ) -> Result<(), SensorFault>;
}

/// The chip on an I²C bus.
#[derive(Debug)]
pub struct I2cBus<I> {
    /// The bus.
    pub i2c: I,
    /// Address of the chip, 7 bits.
    pub address: u8,
}

impl<I: I2c> Bus for I2cBus<I> {
    const I2C: bool = true;

    async fn write(&mut self, register: u8, value: u8) -> Result<(), SensorFault> {
        let outcome = self.i2c.write(self.address, &[register, value]).await;
        outcome.map_err(|error| SensorFault::of_bus(&error))
    }

    async fn read(
        &mut self,
        register: u8,
        values: &mut [u8],
        _spi: SpiRead,
    ) -> Result<(), SensorFault> {
        let outcome = self.i2c.write_read(self.address, &[register], values).await;
        outcome.map_err(|error| SensorFault::of_bus(&error))
    }
}

/// The chip on a four-wire SPI bus. If the chip needs [`SpiRead::delay_ns`], the device must support delays
/// within a transaction. SPI has no acknowledgement: an absent chip reads as 0x00 or 0xFF.
#[derive(Debug)]
pub struct SpiBus<S>(
    /// The bus with the chip's chip select.
    pub S,
);

impl<S: SpiDevice> Bus for SpiBus<S> {
    const I2C: bool = false;

    async fn write(&mut self, register: u8, value: u8) -> Result<(), SensorFault> {
        self.0.write(&[register, value]).await.map_err(|_| SensorFault::Transfer)
    }

    async fn read(
        &mut self,
        register: u8,
        values: &mut [u8],
        spi: SpiRead,
    ) -> Result<(), SensorFault> {
        let multiple = if values.len() > 1 { spi.multiple } else { 0 };
        let command = [register | SPI_READ | multiple];
        let mut operations =
            [Operation::DelayNs(spi.delay_ns), Operation::Write(&command), Operation::Read(values)];
        let first = usize::from(spi.delay_ns == 0);
        let operations = operations.get_mut(first..).unwrap_or_default();
        self.0.transaction(operations).await.map_err(|_| SensorFault::Transfer)
    }
}

/// The registers of a chip on `bus`.
#[derive(Debug)]
pub(crate) struct Registers<B> {
    pub(crate) bus: B,
    pub(crate) spi: SpiRead,
}

impl<B: Bus> Registers<B> {
    /// Checks that `register` contains `expected`.
    pub(crate) async fn check_identity(
        &mut self,
        register: u8,
        expected: u8,
    ) -> Result<(), SensorFault> {
        match self.read_one(register).await? {
            found if found == expected => Ok(()),
            found => Err(wrong_identity(expected, found)),
        }
    }

    pub(crate) async fn write(&mut self, register: u8, value: u8) -> Result<(), SensorFault> {
        self.bus.write(register, value).await
    }

    pub(crate) async fn write_all(&mut self, values: &[(u8, u8)]) -> Result<(), SensorFault> {
        for &(register, value) in values {
            self.write(register, value).await?;
        }
        Ok(())
    }

    pub(crate) async fn read_one(&mut self, register: u8) -> Result<u8, SensorFault> {
        let mut value = [0];
        self.read(register, &mut value).await?;
        Ok(value[0])
    }

    /// Reads consecutive registers in one burst.
    pub(crate) async fn read(
        &mut self,
        register: u8,
        values: &mut [u8],
    ) -> Result<(), SensorFault> {
        self.bus.read(register, values, self.spi).await
    }
}

/// Of an identity register: without a chip, a bus is at one level.
pub(crate) fn wrong_identity(expected: u8, found: u8) -> SensorFault {
    match found {
        0x00 | 0xFF => SensorFault::NotAnswering,
        found => SensorFault::WrongIdentity { expected, found },
    }
}
