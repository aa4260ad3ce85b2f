use embedded_hal_async::delay::DelayNs;
use wimu_registers::{Registers, SpiRead};

use crate::{Bus, Error, Model, Setup};

// RM-MPU-6000A-00 and RM-MPU-6500A-00.
const SMPLRT_DIV: u8 = 0x19;
const CONFIG: u8 = 0x1A;
const GYRO_CONFIG: u8 = 0x1B;
const ACCEL_CONFIG: u8 = 0x1C;
/// Of the MPU-6500 only.
const ACCEL_CONFIG2: u8 = 0x1D;
const FIFO_EN: u8 = 0x23;
const INT_PIN_CFG: u8 = 0x37;
const INT_ENABLE: u8 = 0x38;
const INT_STATUS: u8 = 0x3A;
const TEMP_OUT_H: u8 = 0x41;
const USER_CTRL: u8 = 0x6A;
const PWR_MGMT_1: u8 = 0x6B;
const FIFO_COUNT_H: u8 = 0x72;
const FIFO_R_W: u8 = 0x74;
const WHO_AM_I: u8 = 0x75;

const PWR_RESET: u8 = 1 << 7;
/// The gyroscope's oscillator as the clock of both sensors.
const PWR_CLOCK_GYRO: u8 = 1;
/// All three axes of the gyroscope, and the accelerometer.
const FIFO_EN_SIX_AXES: u8 = 0b0111_1000;
const INT_PIN_LATCH: u8 = 1 << 5;
const INT_DATA_READY: u8 = 1;
const INT_FIFO_OVERFLOW: u8 = 1 << 4;
const USER_FIFO: u8 = 1 << 6;
const USER_I2C_DISABLE: u8 = 1 << 4;
const USER_FIFO_RESET: u8 = 1 << 2;

/// From a reset until the registers can be written, ms.
const RESET_MS: u32 = 100;
/// From sleep until the gyroscope is within 1 °/s of its final output, ms: 30 by its datasheet, with reserve.
const SETTLING_MS: u32 = 50;
/// Bytes of a sample in the FIFO.
const SAMPLE: usize = 12;
/// Samples of a burst.
const BURST: usize = 16;

/// One sample of both sensors, x, y, z in the chip's axes, which are right-handed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Sample {
    /// Specific force, LSB of [`AccelerationRange::lsb_per_g`](crate::AccelerationRange::lsb_per_g).
    pub acceleration: [i16; 3],
    /// Angular rate, 32,768 LSB at [`AngularRateRange::dps`](crate::AngularRateRange::dps).
    pub angular_rate: [i16; 3],
}

/// State of the FIFO.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct FifoLevel {
    /// Complete samples that it holds.
    pub samples: u16,
    /// It is full: bytes may have been lost, and [`Mpu6050::reset_fifo`] has to follow.
    pub full: bool,
}

/// A chip of the MPU-6050 family.
///
/// Dropping a future may interrupt a bus transfer; call [`reset_fifo`](Self::reset_fifo) then.
#[derive(Debug)]
pub struct Mpu6050<B> {
    registers: Registers<B>,
    model: Model,
}

impl<B> Mpu6050<B> {
    /// A chip on `bus`; nothing is sent yet.
    pub fn new(bus: B) -> Self {
        Self { registers: Registers::new(bus, SpiRead::default()), model: Model::Mpu6050 }
    }

    /// The layout found by [`identify`](Self::identify).
    pub fn model(&self) -> Model {
        self.model
    }

    /// Returns the bus.
    pub fn release(self) -> B {
        self.registers.release()
    }
}

impl<B: Bus> Mpu6050<B> {
    /// Reads WHO_AM_I.
    ///
    /// # Errors
    /// [`Error::WrongIdentity`] for a chip that is not of this family; [`Error::NotAnswering`], [`Error::Bus`].
    pub async fn identify(&mut self) -> Result<Model, Error<B::Error>> {
        let found = self.registers.read_one(WHO_AM_I).await?;
        let Some(model) = Model::of(found) else {
            return Err(match found {
                0x00 | 0xFF => Error::NotAnswering,
                _ => Error::WrongIdentity { expected: 0x68, found },
            });
        };
        self.model = model;
        Ok(model)
    }

    /// Identifies the chip, resets it and starts both sensors. The FIFO fills from the return on, after 150 ms.
    ///
    /// # Errors
    /// Those of [`identify`](Self::identify).
    pub async fn start(
        &mut self,
        setup: &Setup,
        delay: &mut impl DelayNs,
    ) -> Result<(), Error<B::Error>> {
        let model = self.identify().await?;
        self.registers.write(PWR_MGMT_1, PWR_RESET).await?;
        delay.delay_ms(RESET_MS).await;
        // It leaves sleep with this write.
        self.registers.write(PWR_MGMT_1, PWR_CLOCK_GYRO).await?;
        let registers = [
            (SMPLRT_DIV, setup.divider),
            (CONFIG, setup.filter()),
            (GYRO_CONFIG, (setup.angular_rate as u8) << 3),
            (ACCEL_CONFIG, (setup.acceleration as u8) << 3),
            (INT_PIN_CFG, INT_PIN_LATCH),
            (FIFO_EN, FIFO_EN_SIX_AXES),
        ];
        for (register, value) in registers {
            self.registers.write(register, value).await?;
        }
        if model == Model::Mpu6500 {
            self.registers.write(ACCEL_CONFIG2, setup.filter()).await?;
        }
        delay.delay_ms(SETTLING_MS).await;
        self.registers.write(INT_ENABLE, INT_DATA_READY | INT_FIFO_OVERFLOW).await?;
        self.reset_fifo().await
    }

    /// Empties the FIFO.
    ///
    /// # Errors
    /// [`Error::NotAnswering`], [`Error::Bus`].
    pub async fn reset_fifo(&mut self) -> Result<(), Error<B::Error>> {
        let interface = if B::I2C { 0 } else { USER_I2C_DISABLE };
        self.registers.write(USER_CTRL, interface).await?;
        self.registers.write(USER_CTRL, interface | USER_FIFO_RESET).await?;
        self.registers.write(USER_CTRL, interface | USER_FIFO).await
    }

    /// Makes INT low until the next sample. Returns whether the FIFO has overflowed since the last call.
    ///
    /// # Errors
    /// [`Error::NotAnswering`], [`Error::Bus`].
    pub async fn clear_interrupt(&mut self) -> Result<bool, Error<B::Error>> {
        let status = self.registers.read_one(INT_STATUS).await?;
        Ok(status & INT_FIFO_OVERFLOW != 0)
    }

    /// Reads how many samples the FIFO holds.
    ///
    /// # Errors
    /// [`Error::NotAnswering`], [`Error::Bus`].
    pub async fn level(&mut self) -> Result<FifoLevel, Error<B::Error>> {
        let mut count = [0; 2];
        self.registers.read(FIFO_COUNT_H, &mut count).await?;
        let samples = u16::from_be_bytes(count) / SAMPLE as u16;
        Ok(FifoLevel { samples, full: samples >= self.model.depth() })
    }

    /// Reads the oldest samples of the FIFO, of which there must be as many as `samples` holds.
    ///
    /// # Errors
    /// [`Error::NotAnswering`], [`Error::Bus`]: [`reset_fifo`](Self::reset_fifo) has to follow.
    pub async fn read(&mut self, samples: &mut [Sample]) -> Result<(), Error<B::Error>> {
        for samples in samples.chunks_mut(BURST) {
            let mut bytes = [0; SAMPLE * BURST];
            let length = SAMPLE * samples.len();
            let bytes = bytes.get_mut(..length).unwrap_or_default();
            self.registers.read(FIFO_R_W, bytes).await?;
            let words = bytes.as_chunks::<SAMPLE>().0;
            for (sample, [a, b, c, d, e, f, g, h, i, j, k, l]) in samples.iter_mut().zip(words) {
                *sample = Sample {
                    acceleration: [[*a, *b], [*c, *d], [*e, *f]].map(i16::from_be_bytes),
                    angular_rate: [[*g, *h], [*i, *j], [*k, *l]].map(i16::from_be_bytes),
                };
            }
        }
        Ok(())
    }

    /// Reads the temperature, 1/100 °C.
    ///
    /// # Errors
    /// [`Error::NotAnswering`], [`Error::Bus`].
    pub async fn temperature(&mut self) -> Result<i16, Error<B::Error>> {
        let mut bytes = [0; 2];
        self.registers.read(TEMP_OUT_H, &mut bytes).await?;
        Ok(self.model.centi_celsius(i16::from_be_bytes(bytes)))
    }
}
