use embedded_hal_async::delay::DelayNs;
use wimu_registers::{Registers, SpiRead};

use crate::fifo::{Batch, DEPTH, Pairing, Sample, TR_C_DEPTH, TR_C_WORDS, WORD, pair};
use crate::registers::*;
use crate::{Bus, Error, Power, Setup};

/// Interval and number of looks at the reset bit: 10 ms; the chip takes 50 µs.
const RESET_POLL_US: u32 = 100;
const RESET_POLLS: u32 = 100;
/// From power-down until the gyroscope measures (70 ms by ST's AN5192), with reserve.
const TURN_ON_US: u32 = 80_000;
/// Samples that the filters take to settle after that.
const SETTLING: u32 = 2;
/// Words of a burst.
const BURST: usize = 32;

/// State of the FIFO.
#[derive(Clone, Copy)]
struct FifoStatus {
    /// Words that wait, 0..=512.
    words: u16,
    /// Whether words were dropped since the status was last read.
    overrun: bool,
}

/// A chip of the family.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Model {
    /// LSM6DSO: FIFO of 3 kbyte, each word with a tag.
    Lsm6dso,
    /// LSM6DS3TR-C: FIFO of 4 kbyte without tags, whose words follow each other in a fixed pattern.
    Lsm6ds3trC,
}

impl Model {
    /// Content of register WHO_AM_I.
    pub const fn who_am_i(self) -> u8 {
        match self {
            Self::Lsm6dso => 0x6C,
            Self::Lsm6ds3trC => 0x6A,
        }
    }
}

/// An LSM6DSO or LSM6DS3TR-C.
///
/// A future that is dropped may end a bus transfer early; the next call starts its own transfer, and
/// [`read`](Self::read) reports a gap.
#[derive(Debug)]
pub struct Lsm6dso<B> {
    registers: Registers<B>,
    model: Model,
    pairing: Pairing,
    /// Whether every word since the last batch can be accounted for.
    continuous: bool,
}

impl<B> Lsm6dso<B> {
    /// Most samples that [`read`](Self::read) delivers at once: one burst of 224 bytes.
    pub const MOST: usize = BURST / 2;

    /// An LSM6DSO on `bus`; nothing is sent yet.
    pub fn new(bus: B) -> Self {
        Self::of_model(bus, Model::Lsm6dso)
    }

    /// A chip of this model on `bus`.
    pub fn of_model(bus: B, model: Model) -> Self {
        Self {
            registers: Registers::new(bus, SpiRead::default()),
            model,
            pairing: Pairing::default(),
            continuous: false,
        }
    }

    /// Returns the bus.
    pub fn release(self) -> B {
        self.registers.release()
    }
}

impl<B: Bus> Lsm6dso<B> {
    /// Checks that the chip is of its model.
    ///
    /// # Errors
    /// [`Error::WrongIdentity`] if it is not; [`Error::NotAnswering`], [`Error::Bus`].
    pub async fn check_identity(&mut self) -> Result<(), Error<B::Error>> {
        (self.registers.check_identity(WHO_AM_I, self.model.who_am_i())).await
    }

    /// Resets all registers to their defaults, from any state of the chip: both sensors are off.
    ///
    /// # Errors
    /// [`Error::ResetTimeout`], [`Error::NotAnswering`], [`Error::Bus`].
    pub async fn reset(&mut self, delay: &mut impl DelayNs) -> Result<(), Error<B::Error>> {
        self.continuous = false;
        // Access to the registers of embedded functions would hide all others.
        self.registers.write(FUNC_CFG_ACCESS, 0).await?;
        self.registers.write(CTRL3_C, CTRL3_SW_RESET | CTRL3_IF_INC).await?;
        for _ in 0..RESET_POLLS {
            delay.delay_us(RESET_POLL_US).await;
            if self.registers.read_one(CTRL3_C).await? & CTRL3_SW_RESET == 0 {
                return Ok(());
            }
        }
        Err(Error::ResetTimeout)
    }

    /// Resets the chip and starts both sensors with `setup`. Returns when they have settled, after
    /// 80 ms and two sample periods; the FIFO fills from then on, and INT1 follows its watermark.
    ///
    /// # Errors
    /// Those of [`reset`](Self::reset): some of the settings may have been written.
    pub async fn start(
        &mut self,
        setup: &Setup,
        delay: &mut impl DelayNs,
    ) -> Result<(), Error<B::Error>> {
        self.reset(delay).await?;
        self.start_interface().await?;
        let on = |condition: bool, bits: u8| if condition { bits } else { 0 };
        let low_power = setup.power == Power::Low;
        let rate = setup.rate.code();
        let watermark = u16::from(setup.watermark.max(1));
        let tagged = self.model == Model::Lsm6dso;
        let [low, high] = (watermark * if tagged { 2 } else { TR_C_WORDS }).to_le_bytes();
        let fifo = if tagged {
            [(FIFO_CTRL1, low), (FIFO_CTRL2, high), (FIFO_CTRL3, rate << 4 | rate)]
        } else {
            let both = TR_C_FIFO_CTRL3_BOTH;
            [(TR_C_FIFO_CTRL1, low), (TR_C_FIFO_CTRL2, high), (TR_C_FIFO_CTRL3, both)]
        };
        let sensors = [
            (CTRL6_C, on(low_power, CTRL6_LOW_POWER)),
            (CTRL7_G, on(low_power, CTRL7_LOW_POWER)),
            (INT1_CTRL, INT1_CTRL_FIFO_TH),
            (CTRL1_XL, rate << 4 | setup.acceleration.bits()),
            (CTRL2_G, rate << 4 | setup.angular_rate.bits()),
        ];
        for (register, value) in fifo.into_iter().chain(sensors) {
            self.registers.write(register, value).await?;
        }
        let settling_us = SETTLING * (setup.rate.period_ns() / 1000);
        delay.delay_us(TURN_ON_US + settling_us).await;
        let (register, fifo) = match self.model {
            Model::Lsm6dso => (FIFO_CTRL4, FIFO_CTRL4_CONTINUOUS),
            Model::Lsm6ds3trC => (TR_C_FIFO_CTRL5, rate << 3 | FIFO_CTRL4_CONTINUOUS),
        };
        self.registers.write(register, fifo).await?;
        self.pairing = Pairing::default();
        self.continuous = true;
        Ok(())
    }

    /// Settings of the interface after a reset: block data update, no MIPI I3C, I²C only if used.
    async fn start_interface(&mut self) -> Result<(), Error<B::Error>> {
        if self.model == Model::Lsm6dso {
            self.registers.write(CTRL9_XL, CTRL9_I3C_DISABLE).await?;
        }
        self.registers.write(CTRL3_C, CTRL3_BDU | CTRL3_IF_INC).await?;
        if B::I2C {
            return Ok(());
        }
        self.registers.write(CTRL4_C, CTRL4_I2C_DISABLE).await
    }

    /// Reads the state of the FIFO. Words that arrive between the two bytes may make the level too
    /// high, but only above 255.
    async fn fifo_status(&mut self) -> Result<FifoStatus, Error<B::Error>> {
        let mut bytes = [0; 2];
        self.registers.read(FIFO_STATUS1, &mut bytes).await?;
        let [low, high] = bytes;
        // A bit of FIFO_STATUS2 is always 0, except on an SPI bus without a chip.
        if high == 0xFF {
            return Err(Error::NotAnswering);
        }
        let words = u16::from_le_bytes([low, high & FIFO_STATUS2_LEVEL]).min(DEPTH);
        let overrun = high & (FIFO_STATUS2_OVERRUN | FIFO_STATUS2_OVERRUN_LATCHED) != 0;
        Ok(FifoStatus { words, overrun })
    }

    /// Reads the oldest samples in the FIFO in one burst: at most [`MOST`](Self::MOST), and as many
    /// as `samples` holds. Call it again while it fills them.
    ///
    /// A sample consists of two words that follow each other with the same tag counter, and no word
    /// was lost during the burst: the status is read before and after it. Nothing is delivered from a
    /// burst during which the FIFO overran.
    ///
    /// # Errors
    /// [`Error::NotAnswering`], [`Error::Bus`]: words may be gone; the next batch reports a gap.
    pub async fn read(&mut self, samples: &mut [Sample]) -> Result<Batch, Error<B::Error>> {
        // Stays false if the transfer fails or the future is dropped.
        let continuous = core::mem::replace(&mut self.continuous, false);
        let mut batch = match self.model {
            Model::Lsm6dso => self.read_tagged(samples, continuous).await?,
            Model::Lsm6ds3trC => self.read_pattern(samples).await?,
        };
        batch.gap |= batch.overrun || batch.fault.is_some() || !continuous;
        self.continuous = true;
        Ok(batch)
    }

    async fn read_tagged(
        &mut self,
        samples: &mut [Sample],
        continuous: bool,
    ) -> Result<Batch, Error<B::Error>> {
        let before = self.fifo_status().await?;
        let mut bytes = [0; WORD * BURST];
        let words = (2 * samples.len()).min(BURST).min(before.words.into());
        let bytes = bytes.get_mut(..WORD * words).unwrap_or_default();
        let mut after = FifoStatus { overrun: false, ..before };
        if !bytes.is_empty() {
            self.registers.read(FIFO_DATA_OUT_TAG, bytes).await?;
            after = self.fifo_status().await?;
        }
        let mut batch = Batch {
            overrun: before.overrun || after.overrun,
            samples_left: after.words / 2,
            ..Batch::default()
        };
        if before.overrun || !continuous {
            self.pairing = Pairing::default();
        }
        for word in bytes.as_chunks().0 {
            match self.pairing.take(*word) {
                Ok(sample) => {
                    if let (Some(sample), Some(next)) = (sample, samples.get_mut(batch.count)) {
                        *next = sample;
                        batch.count += 1;
                    }
                }
                Err(fault) => {
                    batch.fault = Some(fault);
                    batch.count = 0;
                }
            }
        }
        if after.overrun {
            self.pairing = Pairing::default();
            batch.count = 0;
        }
        Ok(batch)
    }

    /// The same of an LSM6DS3TR-C. The place in the pattern at which the FIFO stands is read before the burst: after an
    /// overrun the rest of a torn sample is dropped.
    async fn read_pattern(&mut self, samples: &mut [Sample]) -> Result<Batch, Error<B::Error>> {
        let (before, place) = self.pattern_status().await?;
        let mut batch = Batch { overrun: before.overrun, ..Batch::default() };
        let mut words = before.words;
        if place != 0 {
            let torn = TR_C_WORDS.saturating_sub(place).min(words);
            let mut bytes = [0; 2 * TR_C_WORDS as usize];
            let bytes = bytes.get_mut(..2 * usize::from(torn)).unwrap_or_default();
            self.registers.read(TR_C_FIFO_DATA_OUT, bytes).await?;
            words -= torn;
            batch.gap = true;
        }
        let count = samples.len().min(Self::MOST).min((words / TR_C_WORDS).into());
        batch.samples_left = words / TR_C_WORDS - count as u16;
        if count == 0 {
            return Ok(batch);
        }
        let mut bytes = [[0; 2 * TR_C_WORDS as usize]; BURST / 2];
        let bytes = bytes.get_mut(..count).unwrap_or_default();
        self.registers.read(TR_C_FIFO_DATA_OUT, bytes.as_flattened_mut()).await?;
        let (after, place) = self.pattern_status().await?;
        if after.overrun || place != 0 {
            // Words were dropped during the burst.
            batch.overrun |= after.overrun;
            batch.gap = true;
            return Ok(batch);
        }
        for (sample, bytes) in samples.iter_mut().zip(&*bytes) {
            *sample = pair(*bytes);
            batch.count += 1;
        }
        Ok(batch)
    }

    /// State of the FIFO of an LSM6DS3TR-C, and the place of its next word in a sample.
    async fn pattern_status(&mut self) -> Result<(FifoStatus, u16), Error<B::Error>> {
        let mut bytes = [0; 4];
        self.registers.read(FIFO_STATUS1, &mut bytes).await?;
        let [low, high, place, place_high] = bytes;
        // Bits of FIFO_STATUS4 are always 0, except on an SPI bus without a chip.
        if place_high == 0xFF {
            return Err(Error::NotAnswering);
        }
        let words = match u16::from_le_bytes([low, high & 0b111]) {
            // The level has 11 bits: that of a full FIFO is 0.
            0 if high & TR_C_STATUS2_EMPTY == 0 => TR_C_DEPTH,
            words => words,
        };
        let status = FifoStatus { words, overrun: high & FIFO_STATUS2_OVERRUN != 0 };
        Ok((status, u16::from_le_bytes([place, place_high & 0b11]) % TR_C_WORDS))
    }

    /// Reads the temperature, LSB of 1/256 K from 25 °C; it changes 52 times a second at most.
    ///
    /// # Errors
    /// [`Error::NotAnswering`], [`Error::Bus`].
    pub async fn temperature(&mut self) -> Result<i16, Error<B::Error>> {
        let mut bytes = [0; 2];
        self.registers.read(OUT_TEMP_L, &mut bytes).await?;
        Ok(i16::from_le_bytes(bytes))
    }
}
