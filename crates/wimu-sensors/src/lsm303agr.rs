//! The LSM303AGR (accelerometer, magnetometer, temperature).
//!
//! The `lsm303agr` crate is not used: it reads neither the FIFO level nor several samples at once, keeps a
//! copy of each register, and changes its type with the magnetometer's mode. `wimu-sim` tests that crate and
//! this module against the same model of the chip.

use embedded_hal_async::i2c::I2c;
use wimu_link::hello::{Capabilities, Part, sensor};
use wimu_link::message::{Resolution, Settings};
use wimu_model::{Counts, MagneticFieldNt};
use wimu_node::sensor::{SensorFault, Surroundings};
use wimu_node::{FifoChip, FifoLevel, FifoRead, Mounting, Range, Rate, Setup, Timer};

use crate::bus::wrong_identity;

/// I²C addresses of the accelerometer (with thermometer) and of the magnetometer.
const ACCELEROMETER: u8 = 0x19;
const MAGNETOMETER: u8 = 0x1E;
/// WHO_AM_I_A.
const IDENTITY: u8 = 0x33;

/// Bit of a register address: auto-increment.
const INCREMENT: u8 = 0x80;
/// Registers of the accelerometer.
const OUT_TEMP_L: u8 = 0x0C;
const WHO_AM_I: u8 = 0x0F;
const TEMP_CFG: u8 = 0x1F;
const CTRL1: u8 = 0x20;
const CTRL2: u8 = 0x21;
const OUT_X_L: u8 = 0x28;
const FIFO_CTRL: u8 = 0x2E;
const FIFO_SRC: u8 = 0x2F;
/// Registers of the magnetometer.
const CFG_A_M: u8 = 0x60;
const STATUS_M: u8 = 0x67;
const OUT_X_L_M: u8 = 0x68;

const CTRL1_AXES: u8 = 0x07;
const CTRL1_LOW_POWER: u8 = 0x08;
const CTRL3_WATERMARK_ON_INT1: u8 = 0x04;
const CTRL4_BLOCK_UPDATE: u8 = 0x80;
const CTRL4_HIGH_RESOLUTION: u8 = 0x08;
const CTRL5_FIFO: u8 = 0x40;
const TEMP_CFG_ON: u8 = 0xC0;
const FIFO_CTRL_BYPASS: u8 = 0;
const FIFO_CTRL_STREAM: u8 = 0x80;
const FIFO_SRC_FULL: u8 = 0x40;
const FIFO_SRC_LEVEL: u8 = 0x1F;
/// 10 Hz, continuous mode, temperature-compensated.
const CFG_A_M_RUN: u8 = 0x80;
const CFG_C_M_BLOCK_UPDATE: u8 = 0x10;
const STATUS_M_NEW: u8 = 0x08;

/// Sensitivity of the magnetometer, nT/LSB (1.5 mG/LSB).
const NT_PER_LSB: i32 = 150;

/// Scales of 16-bit counts: a 12-bit digit is 1, 2, 4 and 12 times 1/1024 g, so that ± 16 g is actually ± 24 g.
static RANGES: [Range; 4] = Range::four([0, 1, 2, 3], [16384.0, 8192.0, 4096.0, 16384.0 / 12.0]);

static RATES: [Rate; 8] = [
    Rate::new(1, 1, 1_000_000_000, true),
    Rate::new(10, 2, 100_000_000, true),
    Rate::new(25, 3, 40_000_000, true),
    Rate::new(50, 4, 20_000_000, true),
    Rate::new(100, 5, 10_000_000, true),
    Rate::new(200, 6, 5_000_000, true),
    Rate::new(400, 7, 2_500_000, true),
    // With low power the code means another rate.
    Rate::new(1344, 9, 744_048, false),
];

/// Bytes of a sample: x, y, z, little-endian.
const SAMPLE: usize = 6;
/// Samples of a burst.
const BURST: usize = 16;

/// An LSM303AGR on an I²C bus with the accelerometer's INT1 line.
#[derive(Debug)]
pub struct Lsm303agr<I2C> {
    i2c: I2C,
    mounting: Mounting,
    /// The magnetometer has measured since it was configured; before that its registers are undefined.
    field_measured: bool,
}

impl<I2C: I2c> Lsm303agr<I2C> {
    /// A sensor on `i2c`.
    pub fn new(i2c: I2C) -> Self {
        Self { i2c, mounting: Mounting::STRAIGHT, field_measured: false }
    }

    /// Converts samples and magnetic field to the board's axes. The chip's own axes are left-handed.
    #[must_use]
    pub fn mounted(self, mounting: Mounting) -> Self {
        Self { mounting, ..self }
    }

    /// Reads consecutive registers.
    async fn registers(
        &mut self,
        address: u8,
        register: u8,
        values: &mut [u8],
    ) -> Result<(), SensorFault> {
        let register = [register | INCREMENT];
        let outcome = self.i2c.write_read(address, &register, values).await;
        outcome.map_err(|error| SensorFault::of_bus(&error))
    }

    /// x, y, z of either sensor from its registers.
    fn axes(&self, &[x0, x1, y0, y1, z0, z1]: &[u8; SAMPLE]) -> [i16; 3] {
        let sent = [[x0, x1], [y0, y1], [z0, z1]];
        self.mounting.to_board(sent.map(i16::from_le_bytes))
    }
}

impl<I2C: I2c> FifoChip for Lsm303agr<I2C> {
    type Sample = Counts;
    const PART: Part = Part::new(sensor::LSM303AGR, "LSM303AGR");
    const CAPABILITIES: Capabilities = Capabilities::ACCELEROMETER
        .with(Capabilities::MAGNETOMETER)
        .with(Capabilities::TEMPERATURE);
    const MAGNETOMETER: bool = true;
    const RANGES: &'static [Range] = &RANGES;
    const RATES: &'static [Rate] = &RATES;
    const DEPTH: u16 = 32;
    /// On a bus of 400 kHz.
    const TRANSFER_US: u64 = 140;

    fn full_scale(settings: &Settings, _range: u8) -> i32 {
        match settings.resolution {
            Resolution::LowPower => 0x7F00,
            Resolution::Normal => 0x7FC0,
            Resolution::High => 0x7FF0,
        }
    }

    async fn start(&mut self, setup: &Setup, _: &impl Timer) -> Result<(), SensorFault> {
        self.field_measured = false;
        let (power, digits) = match setup.resolution {
            Resolution::LowPower => (CTRL1_LOW_POWER, 0),
            Resolution::Normal => (0, 0),
            Resolution::High => (0, CTRL4_HIGH_RESOLUTION),
        };
        let mut found = [0];
        self.registers(ACCELEROMETER, WHO_AM_I, &mut found).await?;
        if found != [IDENTITY] {
            return Err(wrong_identity(IDENTITY, found[0]));
        }
        let registers = [
            CTRL2 | INCREMENT,
            0,
            CTRL3_WATERMARK_ON_INT1,
            CTRL4_BLOCK_UPDATE | setup.range << 4 | digits,
            CTRL5_FIFO,
            0,
        ];
        // The line rises when the level exceeds the register's value.
        let stream = FIFO_CTRL_STREAM | setup.watermark.saturating_sub(1) as u8;
        let magnetometer = [CFG_A_M | INCREMENT, CFG_A_M_RUN, 0, CFG_C_M_BLOCK_UPDATE];
        // Switched off, with an empty FIFO, during the configuration.
        let writes: [(u8, &[u8]); 7] = [
            (ACCELEROMETER, &[CTRL1, CTRL1_AXES]),
            (ACCELEROMETER, &[FIFO_CTRL, FIFO_CTRL_BYPASS]),
            (ACCELEROMETER, &[TEMP_CFG, TEMP_CFG_ON]),
            (ACCELEROMETER, &registers),
            (ACCELEROMETER, &[FIFO_CTRL, stream]),
            (MAGNETOMETER, &magnetometer),
            (ACCELEROMETER, &[CTRL1, setup.rate.code << 4 | power | CTRL1_AXES]),
        ];
        for (address, bytes) in writes {
            let outcome = self.i2c.write(address, bytes).await;
            outcome.map_err(|error| SensorFault::of_bus(&error))?;
        }
        Ok(())
    }

    async fn level(&mut self) -> Result<FifoLevel, SensorFault> {
        let mut source = [0];
        self.registers(ACCELEROMETER, FIFO_SRC, &mut source).await?;
        let [source] = source;
        let overrun = source & FIFO_SRC_FULL != 0;
        let samples = if overrun { Self::DEPTH } else { u16::from(source & FIFO_SRC_LEVEL) };
        Ok(FifoLevel { samples, overrun })
    }

    /// A burst read wraps from OUT_Z_H to OUT_X_L, so it returns successive samples.
    async fn read(&mut self, samples: &mut [Counts]) -> Result<FifoRead, SensorFault> {
        let mut bytes = [0; BURST * SAMPLE];
        for places in samples.chunks_mut(BURST) {
            let burst = bytes.get_mut(..places.len() * SAMPLE).unwrap_or_default();
            self.registers(ACCELEROMETER, OUT_X_L, burst).await?;
            for (place, bytes) in places.iter_mut().zip(burst.as_chunks().0) {
                *place = Counts(self.axes(bytes));
            }
        }
        Ok(FifoRead { count: samples.len(), lost: false })
    }

    /// A full FIFO overwrites its oldest sample, possibly while it is read. That sample is discarded.
    async fn repair(&mut self) -> Result<bool, SensorFault> {
        let mut oldest = [0; SAMPLE];
        self.registers(ACCELEROMETER, OUT_X_L, &mut oldest).await?;
        Ok(true)
    }

    async fn surroundings(&mut self) -> Result<Surroundings, SensorFault> {
        if !self.field_measured {
            let mut status = [0];
            self.registers(MAGNETOMETER, STATUS_M, &mut status).await?;
            self.field_measured = status[0] & STATUS_M_NEW != 0;
        }
        let magnetic_field = if self.field_measured {
            let mut field = [0; SAMPLE];
            self.registers(MAGNETOMETER, OUT_X_L_M, &mut field).await?;
            let field = self.axes(&field).map(|axis| i32::from(axis) * NT_PER_LSB);
            Some(MagneticFieldNt(field))
        } else {
            None
        };
        let mut bytes = [0; 2];
        self.registers(ACCELEROMETER, OUT_TEMP_L, &mut bytes).await?;
        Ok(Surroundings { magnetic_field, temperature: Some(crate::temperature(bytes)) })
    }
}
