//! The LSM6DSO and the LSM6DS3TR-C (accelerometer, gyroscope, temperature; DS12140 and DS12110).

mod words;

use core::mem;

use wimu_link::hello::{Capabilities, Part, sensor};
use wimu_link::message::Resolution;
use wimu_model::Counts;
use wimu_node::sensor::{GyroscopePlan, SensorFault, Surroundings};
use wimu_node::{FifoChip, FifoLevel, FifoRead, Range, Rate, Setup, Timer};

use self::words::{Fault, Pairing, WORD, axes};
use crate::bus::{Bus, Registers, SpiRead};

const FUNC_CFG_ACCESS: u8 = 0x01;
const FIFO_CTRL1: u8 = 0x07;
const FIFO_CTRL2: u8 = 0x08;
const FIFO_CTRL3: u8 = 0x09;
const FIFO_CTRL4: u8 = 0x0A;
const INT1_CTRL: u8 = 0x0D;
const WHO_AM_I: u8 = 0x0F;
const CTRL1_XL: u8 = 0x10;
const CTRL2_G: u8 = 0x11;
const CTRL3_C: u8 = 0x12;
const CTRL4_C: u8 = 0x13;
const CTRL6_C: u8 = 0x15;
const CTRL7_G: u8 = 0x16;
const CTRL9_XL: u8 = 0x18;
const OUT_TEMP_L: u8 = 0x20;
const FIFO_STATUS1: u8 = 0x3A;
const FIFO_DATA_OUT_TAG: u8 = 0x78;

// Registers of the LSM6DS3TR-C that differ: those of the FIFO are one lower.
const TR_C_FIFO_CTRL1: u8 = 0x06;
const TR_C_FIFO_CTRL2: u8 = 0x07;
const TR_C_FIFO_CTRL3: u8 = 0x08;
const TR_C_FIFO_CTRL5: u8 = 0x0A;
const TR_C_FIFO_DATA_OUT: u8 = 0x3E;
const TR_C_STATUS2_EMPTY: u8 = 1 << 4;
/// Both sensors in the FIFO at its rate (DEC_FIFO_GYRO, DEC_FIFO_XL).
const TR_C_FIFO_CTRL3_BOTH: u8 = 0b001_001;

const FIFO_CTRL4_CONTINUOUS: u8 = 0b110;
const INT1_CTRL_FIFO_TH: u8 = 1 << 3;
/// FS_G of ±2000 °/s.
const CTRL2_2000_DPS: u8 = 0b11 << 2;
const CTRL3_SW_RESET: u8 = 1;
const CTRL3_IF_INC: u8 = 1 << 2;
const CTRL3_BDU: u8 = 1 << 6;
const CTRL4_I2C_DISABLE: u8 = 1 << 2;
/// XL_HM_MODE: high-performance mode of the accelerometer is off.
const CTRL6_LOW_POWER: u8 = 1 << 4;
/// G_HM_MODE: high-performance mode of the gyroscope is off.
const CTRL7_LOW_POWER: u8 = 1 << 7;
/// The register's default value with I3C_disable set.
const CTRL9_I3C_DISABLE: u8 = 0xE0 | 1 << 1;
const FIFO_STATUS2_OVERRUN: u8 = 1 << 6;
const FIFO_STATUS2_OVERRUN_LATCHED: u8 = 1 << 3;
const FIFO_STATUS2_LEVEL: u8 = 0b11;

/// Interval and number of looks at the reset bit: 10 ms; the chip takes 50 µs.
const RESET_POLL_US: u64 = 100;
const RESET_POLLS: u32 = 100;
/// From power-down until the gyroscope measures, µs (70 ms by ST's AN5192), with reserve.
const TURN_ON_US: u64 = 80_000;
/// Samples that the filters take to settle after that.
const SETTLING: u64 = 2;
/// Words that the LSM6DSO's FIFO holds: 3 kbyte of data.
const DEPTH: u16 = 512;
/// Samples of a burst: 224 bytes.
const BURST: usize = 16;
/// Words of a sample of the LSM6DS3TR-C: three axes of the gyroscope, then of the accelerometer.
const TR_C_WORDS: u16 = 6;
/// Words that its FIFO holds: 4 kbyte.
const TR_C_DEPTH: u16 = 2048;
/// Reads in succession without a gyroscope word after which the gyroscope has stopped.
const WITHOUT_GYROSCOPE: u8 = 2;

/// Typical sensitivities, 61 µ*g*/LSB at ±2 *g*; the part's own is within ±1 % (DS12140 §4.1, Table 2).
static RANGES: [Range; 4] =
    Range::four([0b00, 0b10, 0b11, 0b01], [1e6 / 61.0, 1e6 / 122.0, 1e6 / 244.0, 1e6 / 488.0]);

/// The rates up to the fastest on an I²C bus of 400 kHz, by their names. The chip divides one oscillator by powers of two:
/// 6.667 kHz, and 13.02 Hz where the name says 12.5 Hz (DS12140 §9, INTERNAL_FREQ_FINE).
static RATES: [Rate; 8] = [
    rate(13, 1),
    rate(26, 2),
    rate(52, 3),
    rate(104, 4),
    rate(208, 5),
    rate(416, 6),
    rate(833, 7),
    rate(1666, 8),
];

/// With its code in ODR_XL, ODR_G, BDR_XL and BDR_GY. Low power up to 52 Hz and normal mode at 104 and 208 Hz save power.
const fn rate(hz: u16, code: u8) -> Rate {
    Rate::new(hz, code, 150_000 << (10 - code), code <= 5)
}

/// Nominal LSB of the gyroscope at ±2000 °/s, µ°/s (DS12140 §4.1, Table 2): as large as the noise at 208 Hz.
const UDPS_PER_LSB: f64 = 70_000.0;
/// ±2000 °/s, the widest, because a hand exceeds 1000 °/s, and a saturated rate ends the attitude.
static GYROSCOPE: GyroscopePlan =
    GyroscopePlan::new((UDPS_PER_LSB * 1e-6).to_radians(), i16::MAX as i32);

/// An LSM6DS3TR-C, as on the Seeed XIAO nRF52840 Sense; otherwise as [`Lsm6dso`]. Its FIFO has no tags, so that a
/// gyroscope that stops is not noticed.
pub type Lsm6ds3trC<B> = Lsm6dso<B, false>;

/// An LSM6DSO on I²C, up to 400 kHz, or 1 MHz in fast mode plus, or SPI, mode 0 or 3 up to 10 MHz, with its INT1 line. The
/// gyroscope's range is ±2000 °/s.
///
/// A sample consists of two words that follow each other with the same tag counter, and no word was lost during the
/// burst: the status is read before and after it. Nothing is delivered from a burst during which the FIFO overran.
/// A transfer that is interrupted counts as lost samples.
#[derive(Debug)]
pub struct Lsm6dso<B, const TAGGED: bool = true> {
    registers: Registers<B>,
    pairing: Pairing,
    /// Whether every word since the last read can be accounted for.
    continuous: bool,
    /// Reads in succession without a gyroscope word.
    without_gyroscope: u8,
}

impl<B: Bus, const TAGGED: bool> Lsm6dso<B, TAGGED> {
    /// Address with the pin SDO/SA0 low; 0x6B with it high (DS12140 §5.1).
    pub const ADDRESS: u8 = 0x6A;
    const IDENTITY: u8 = if TAGGED { 0x6C } else { 0x6A };

    /// A chip on `bus`; nothing is sent yet.
    pub fn new(bus: B) -> Self {
        Self {
            registers: Registers { bus, spi: SpiRead::default() },
            pairing: Pairing::default(),
            continuous: false,
            without_gyroscope: 0,
        }
    }

    /// Resets all registers to their defaults, from any state of the chip: both sensors are off.
    async fn reset(&mut self, timer: &impl Timer) -> Result<(), SensorFault> {
        self.continuous = false;
        // Access to the registers of embedded functions would hide all others.
        self.registers.write(FUNC_CFG_ACCESS, 0).await?;
        self.registers.write(CTRL3_C, CTRL3_SW_RESET | CTRL3_IF_INC).await?;
        for _ in 0..RESET_POLLS {
            timer.after_us(RESET_POLL_US).await;
            if self.registers.read_one(CTRL3_C).await? & CTRL3_SW_RESET == 0 {
                return Ok(());
            }
        }
        Err(SensorFault::Transfer)
    }

    /// Settings of the interface after a reset: block data update, no MIPI I3C, I²C only if used.
    async fn start_interface(&mut self) -> Result<(), SensorFault> {
        if TAGGED {
            self.registers.write(CTRL9_XL, CTRL9_I3C_DISABLE).await?;
        }
        self.registers.write(CTRL3_C, CTRL3_BDU | CTRL3_IF_INC).await?;
        if B::I2C {
            return Ok(());
        }
        self.registers.write(CTRL4_C, CTRL4_I2C_DISABLE).await
    }

    /// State of the LSM6DSO's FIFO. Words that arrive between the two bytes may make the level too high, but only above 255.
    async fn tagged_level(&mut self) -> Result<FifoLevel, SensorFault> {
        let mut bytes = [0; 2];
        self.registers.read(FIFO_STATUS1, &mut bytes).await?;
        let [low, high] = bytes;
        // A bit of FIFO_STATUS2 is always 0, except on an SPI bus without a chip.
        if high == 0xFF {
            return Err(SensorFault::NotAnswering);
        }
        let words = u16::from_le_bytes([low, high & FIFO_STATUS2_LEVEL]).min(DEPTH);
        let overrun = high & (FIFO_STATUS2_OVERRUN | FIFO_STATUS2_OVERRUN_LATCHED) != 0;
        Ok(FifoLevel { samples: words / 2, overrun })
    }

    async fn read_tagged(
        &mut self,
        samples: &mut [(Counts, Counts)],
    ) -> Result<FifoRead, SensorFault> {
        let mut words = [[0; WORD]; 2 * BURST];
        let words = words.get_mut(..2 * samples.len()).unwrap_or_default();
        self.registers.read(FIFO_DATA_OUT_TAG, words.as_flattened_mut()).await?;
        let after = self.tagged_level().await?;
        let mut read = FifoRead { count: 0, lost: false };
        let mut missing = false;
        for word in words {
            match self.pairing.take(*word) {
                Ok(sample) => {
                    if let (Some(sample), Some(next)) = (sample, samples.get_mut(read.count)) {
                        *next = sample;
                        read.count += 1;
                    }
                }
                Err(fault) => {
                    missing = fault == Fault::GyroscopeMissing;
                    read = FifoRead { count: 0, lost: true };
                }
            }
        }
        if after.overrun {
            self.pairing = Pairing::default();
            read = FifoRead { count: 0, lost: true };
        }
        let stopped = read.count == 0 && missing;
        self.without_gyroscope = if stopped { self.without_gyroscope + 1 } else { 0 };
        if self.without_gyroscope >= WITHOUT_GYROSCOPE {
            self.without_gyroscope = 0;
            return Err(SensorFault::GyroscopeStopped);
        }
        Ok(read)
    }

    /// State of the LSM6DS3TR-C's FIFO, and the place of its next word in a sample.
    async fn pattern_level(&mut self) -> Result<(u16, bool, u16), SensorFault> {
        let mut bytes = [0; 4];
        self.registers.read(FIFO_STATUS1, &mut bytes).await?;
        let [low, high, place, place_high] = bytes;
        // Bits of FIFO_STATUS4 are always 0, except on an SPI bus without a chip.
        if place_high == 0xFF {
            return Err(SensorFault::NotAnswering);
        }
        let words = match u16::from_le_bytes([low, high & 0b111]) {
            // The level has 11 bits: that of a full FIFO is 0.
            0 if high & TR_C_STATUS2_EMPTY == 0 => TR_C_DEPTH,
            words => words,
        };
        let place = u16::from_le_bytes([place, place_high & 0b11]) % TR_C_WORDS;
        Ok((words, high & FIFO_STATUS2_OVERRUN != 0, place))
    }

    /// The level of the LSM6DS3TR-C's FIFO, without the rest of a sample that an overrun has torn, which is dropped.
    async fn aligned_level(&mut self) -> Result<FifoLevel, SensorFault> {
        let (words, overrun, place) = self.pattern_level().await?;
        let torn = if place == 0 { 0 } else { (TR_C_WORDS - place).min(words) };
        let mut bytes = [0; 2 * TR_C_WORDS as usize];
        if let Some(bytes) = bytes.get_mut(..2 * usize::from(torn))
            && torn > 0
        {
            self.registers.read(TR_C_FIFO_DATA_OUT, bytes).await?;
        }
        Ok(FifoLevel { samples: (words - torn) / TR_C_WORDS, overrun: overrun || place != 0 })
    }

    async fn read_pattern(
        &mut self,
        samples: &mut [(Counts, Counts)],
    ) -> Result<FifoRead, SensorFault> {
        let mut bytes = [[0; 2 * TR_C_WORDS as usize]; BURST];
        let bytes = bytes.get_mut(..samples.len()).unwrap_or_default();
        self.registers.read(TR_C_FIFO_DATA_OUT, bytes.as_flattened_mut()).await?;
        let (_, overrun, place) = self.pattern_level().await?;
        if overrun || place != 0 {
            // Words were dropped during the burst.
            return Ok(FifoRead { count: 0, lost: true });
        }
        for (sample, bytes) in samples.iter_mut().zip(&*bytes) {
            let [gx, hx, gy, hy, gz, hz, acceleration @ ..] = *bytes;
            *sample = (axes(acceleration), axes([gx, hx, gy, hy, gz, hz]));
        }
        Ok(FifoRead { count: bytes.len(), lost: false })
    }
}

impl<B: Bus, const TAGGED: bool> FifoChip for Lsm6dso<B, TAGGED> {
    type Sample = (Counts, Counts);
    const PART: Part = if TAGGED {
        Part::new(sensor::LSM6DSO, "LSM6DSO")
    } else {
        Part::new(sensor::LSM6DS3TR_C, "LSM6DS3TR-C")
    };
    const CAPABILITIES: Capabilities =
        Capabilities::ACCELEROMETER.with(Capabilities::GYROSCOPE).with(Capabilities::TEMPERATURE);
    const RANGES: &'static [Range] = &RANGES;
    const RATES: &'static [Rate] = &RATES;
    const GYROSCOPE: Option<&'static GyroscopePlan> = Some(&GYROSCOPE);
    const DEPTH: u16 = DEPTH / 2;
    /// On an I²C bus of 400 kHz.
    const TRANSFER_US: u64 = 350;
    const MOST: usize = BURST;

    /// Resets the chip and starts both sensors. Returns when they have settled, after 80 ms and two sample periods; the FIFO
    /// fills from then on.
    async fn start(&mut self, setup: &Setup, timer: &impl Timer) -> Result<(), SensorFault> {
        self.registers.check_identity(WHO_AM_I, Self::IDENTITY).await?;
        self.reset(timer).await?;
        self.start_interface().await?;
        let low_power = setup.resolution == Resolution::LowPower;
        let rate = setup.rate.code;
        let [low, high] = (setup.watermark * if TAGGED { 2 } else { TR_C_WORDS }).to_le_bytes();
        let fifo = if TAGGED {
            [(FIFO_CTRL1, low), (FIFO_CTRL2, high), (FIFO_CTRL3, rate << 4 | rate)]
        } else {
            let both = TR_C_FIFO_CTRL3_BOTH;
            [(TR_C_FIFO_CTRL1, low), (TR_C_FIFO_CTRL2, high), (TR_C_FIFO_CTRL3, both)]
        };
        let sensors = [
            (CTRL6_C, if low_power { CTRL6_LOW_POWER } else { 0 }),
            (CTRL7_G, if low_power { CTRL7_LOW_POWER } else { 0 }),
            (INT1_CTRL, INT1_CTRL_FIFO_TH),
            (CTRL1_XL, rate << 4 | setup.range << 2),
            (CTRL2_G, rate << 4 | CTRL2_2000_DPS),
        ];
        self.registers.write_all(&fifo).await?;
        self.registers.write_all(&sensors).await?;
        let settling_us = SETTLING * u64::from(setup.rate.period_ns / 1000);
        timer.after_us(TURN_ON_US + settling_us).await;
        let (register, fifo) = if TAGGED {
            (FIFO_CTRL4, FIFO_CTRL4_CONTINUOUS)
        } else {
            (TR_C_FIFO_CTRL5, rate << 3 | FIFO_CTRL4_CONTINUOUS)
        };
        self.registers.write(register, fifo).await?;
        self.pairing = Pairing::default();
        self.continuous = true;
        Ok(())
    }

    async fn level(&mut self) -> Result<FifoLevel, SensorFault> {
        // Stays false if the transfer fails or the future is dropped.
        let continuous = mem::replace(&mut self.continuous, false);
        let level = if TAGGED { self.tagged_level().await? } else { self.aligned_level().await? };
        if level.overrun {
            self.pairing = Pairing::default();
        }
        self.continuous = continuous;
        Ok(level)
    }

    async fn read(&mut self, samples: &mut [(Counts, Counts)]) -> Result<FifoRead, SensorFault> {
        let continuous = mem::replace(&mut self.continuous, false);
        if !continuous {
            self.pairing = Pairing::default();
        }
        let read = if TAGGED {
            self.read_tagged(samples).await?
        } else {
            self.read_pattern(samples).await?
        };
        self.continuous = true;
        Ok(FifoRead { lost: read.lost || !continuous, ..read })
    }

    async fn surroundings(&mut self) -> Result<Surroundings, SensorFault> {
        let mut bytes = [0; 2];
        self.registers.read(OUT_TEMP_L, &mut bytes).await?;
        Ok(Surroundings { magnetic_field: None, temperature: Some(crate::temperature(bytes)) })
    }
}
