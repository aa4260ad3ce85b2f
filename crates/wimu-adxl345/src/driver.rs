use wimu_registers::Registers;

use crate::bus::SPI;
use crate::registers::*;
use crate::{Bus, Error, Fifo, Interrupts, Setup};

/// Content of FIFO_STATUS.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct FifoLevel {
    /// Samples available, 0..=33: 32 in the FIFO and one at the filter's output.
    pub samples: u8,
}

/// An ADXL345.
///
/// Dropping a future may interrupt a bus transfer; the next call works normally.
#[derive(Debug)]
pub struct Adxl345<B> {
    registers: Registers<B>,
}

impl<B> Adxl345<B> {
    /// Content of register DEVID.
    pub const IDENTITY: u8 = 0xE5;

    /// A chip on `bus`; nothing is sent yet.
    pub fn new(bus: B) -> Self {
        Self { registers: Registers::new(bus, SPI) }
    }

    /// Returns the bus.
    pub fn release(self) -> B {
        self.registers.release()
    }
}

impl<B: Bus> Adxl345<B> {
    /// Verifies that the chip is an ADXL345.
    ///
    /// # Errors
    /// [`Error::WrongIdentity`] if it is not; [`Error::NotAnswering`], [`Error::Bus`].
    pub async fn check_identity(&mut self) -> Result<(), Error<B::Error>> {
        (self.registers.check_identity(DEVID, Self::IDENTITY)).await
    }

    /// Configures the chip, whatever its state, and starts measuring: FIFO emptied, offsets zero, no self-test.
    /// The first sample is valid after 1.1 ms + one sample period.
    ///
    /// # Errors
    /// [`Error::NotAnswering`], [`Error::Bus`]: some registers may have been written.
    pub async fn start(&mut self, setup: &Setup) -> Result<(), Error<B::Error>> {
        let registers = [
            (POWER_CTL, 0),
            (OFSX, 0),
            (OFSY, 0),
            (OFSZ, 0),
            (DATA_FORMAT, setup.format.register()),
            (BW_RATE, setup.rate.register(setup.low_power)),
            (FIFO_CTL, Fifo::Bypass.register()),
            (FIFO_CTL, setup.fifo.register()),
            (INT_MAP, setup.on_int2.0),
            (INT_ENABLE, setup.interrupts.0),
            (POWER_CTL, POWER_CTL_MEASURE),
        ];
        for (register, value) in registers {
            self.registers.write(register, value).await?;
        }
        Ok(())
    }

    /// Reads the active interrupts, enabled or not. Clears those that reading data does not clear.
    ///
    /// # Errors
    /// [`Error::NotAnswering`], [`Error::Bus`].
    pub async fn interrupts(&mut self) -> Result<Interrupts, Error<B::Error>> {
        self.registers.read_one(INT_SOURCE).await.map(Interrupts)
    }

    /// Reads the number of samples available.
    ///
    /// # Errors
    /// [`Error::NotAnswering`], [`Error::Bus`].
    pub async fn fifo_level(&mut self) -> Result<FifoLevel, Error<B::Error>> {
        let status = self.registers.read_one(FIFO_STATUS).await?;
        Ok(FifoLevel { samples: status & FIFO_STATUS_ENTRIES })
    }

    /// Reads the oldest sample available, or the latest one again: x, y, z in LSB of
    /// [`DataFormat::lsb_per_g`]. One burst, which removes it from the FIFO.
    ///
    /// # Errors
    /// [`Error::NotAnswering`], [`Error::Bus`]: the sample may be lost.
    pub async fn sample(&mut self) -> Result<[i16; 3], Error<B::Error>> {
        let mut bytes = [0; 6];
        self.registers.read(DATAX0, &mut bytes).await?;
        let [x0, x1, y0, y1, z0, z1] = bytes;
        Ok([[x0, x1], [y0, y1], [z0, z1]].map(i16::from_le_bytes))
    }
}
