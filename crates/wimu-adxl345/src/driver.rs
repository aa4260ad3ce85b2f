use wimu_registers::Registers;

use crate::bus::SPI;
use crate::registers::*;
use crate::{Bus, DataFormat, Error, Fifo, Interrupts, Rate, Setup};

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
    pub(crate) registers: Registers<B>,
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
    /// Reads register DEVID.
    ///
    /// # Errors
    /// [`Error::NotAnswering`], [`Error::Bus`].
    pub async fn device_id(&mut self) -> Result<u8, Error<B::Error>> {
        self.registers.read_one(DEVID).await
    }

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

    /// Stops measuring. Change settings in standby.
    ///
    /// # Errors
    /// [`Error::NotAnswering`], [`Error::Bus`].
    pub async fn standby(&mut self) -> Result<(), Error<B::Error>> {
        self.registers.write(POWER_CTL, 0).await
    }

    /// Starts measuring. The first sample is valid after 1.1 ms + one sample period.
    ///
    /// # Errors
    /// [`Error::NotAnswering`], [`Error::Bus`].
    pub async fn measure(&mut self) -> Result<(), Error<B::Error>> {
        self.registers.write(POWER_CTL, POWER_CTL_MEASURE).await
    }

    /// Sets range, resolution and justification; ends a self-test.
    ///
    /// # Errors
    /// [`Error::NotAnswering`], [`Error::Bus`].
    pub async fn set_data_format(&mut self, format: DataFormat) -> Result<(), Error<B::Error>> {
        self.registers.write(DATA_FORMAT, format.register()).await
    }

    /// Sets the rate, and low-power mode (more noise), which has an effect only where [`Rate::has_low_power`].
    ///
    /// # Errors
    /// [`Error::NotAnswering`], [`Error::Bus`].
    pub async fn set_rate(&mut self, rate: Rate, low_power: bool) -> Result<(), Error<B::Error>> {
        self.registers.write(BW_RATE, rate.register(low_power)).await
    }

    /// Empties the FIFO and sets its mode.
    ///
    /// # Errors
    /// [`Error::NotAnswering`], [`Error::Bus`].
    pub async fn set_fifo(&mut self, fifo: Fifo) -> Result<(), Error<B::Error>> {
        self.registers.write(FIFO_CTL, Fifo::Bypass.register()).await?;
        if fifo == Fifo::Bypass {
            return Ok(());
        }
        self.registers.write(FIFO_CTL, fifo.register()).await
    }

    /// Enables interrupts on the pins, active high; those in `on_int2` on INT2, the others on INT1.
    ///
    /// # Errors
    /// [`Error::NotAnswering`], [`Error::Bus`].
    pub async fn set_interrupts(
        &mut self,
        enabled: Interrupts,
        on_int2: Interrupts,
    ) -> Result<(), Error<B::Error>> {
        self.registers.write(INT_MAP, on_int2.0).await?;
        self.registers.write(INT_ENABLE, enabled.0).await
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

    /// Sets the offset that the chip adds to each axis, 15.6 m*g*/LSB: registers OFSX to OFSZ.
    ///
    /// # Errors
    /// [`Error::NotAnswering`], [`Error::Bus`].
    pub async fn set_offset(&mut self, offset: [i8; 3]) -> Result<(), Error<B::Error>> {
        for (register, axis) in [OFSX, OFSY, OFSZ].into_iter().zip(offset) {
            self.registers.write(register, axis as u8).await?;
        }
        Ok(())
    }
}
