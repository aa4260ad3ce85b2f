//! The LSM303AGR (accelerometer, magnetometer, temperature) behind [`InertialSensor`], through its
//! FIFO.
//!
//! The `lsm303agr` crate is not used: it reads neither the FIFO level nor several samples at once, keeps a
//! copy of each register, and changes its type with the magnetometer's mode. `wimu-sim` tests that crate and
//! this module against the same model of the chip.

use embedded_hal_async::i2c::I2c;
use wimu_link::hello::{Capabilities, Part, sensor};
use wimu_link::message::{Resolution, Settings};
use wimu_model::{CentiCelsius, Counts, MagneticFieldNt, PeriodNs};

use crate::data_ready::DataReady;
use crate::fifo::{FifoState, MAX_WATERMARK, SensorFifo};
use crate::mounting::Mounting;
use crate::sensor::{
    AccelerometerScale, Batch, InertialSensor, Plan, SensorFault, SensorPlan, Supported,
    Surroundings,
};
use crate::timer::Timer;

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

/// Ranges with code and sensitivity of 16-bit counts, LSB/g, and rates with code and nominal period, ns. A 12-bit
/// digit is 1, 2, 4 and 12 times 1/1024 g, so that ± 16 g is actually ± 24 g.
const SUPPORTED: Supported<(u8, &AccelerometerScale), (u8, u32)> = Supported {
    ranges: &[
        (2, (0, &AccelerometerScale::of(16384.0))),
        (4, (1, &AccelerometerScale::of(8192.0))),
        (8, (2, &AccelerometerScale::of(4096.0))),
        (16, (3, &AccelerometerScale::of(16384.0 / 12.0))),
    ],
    rates: &[
        (1, (1, 1_000_000_000)),
        (10, (2, 100_000_000)),
        (25, (3, 40_000_000)),
        (50, (4, 20_000_000)),
        (100, (5, 10_000_000)),
        (200, (6, 5_000_000)),
        (400, (7, 2_500_000)),
        (1344, (9, 744_048)),
    ],
    // At 1344 Hz the code means another rate.
    has_low_power: |(_, period)| period > 1_000_000,
};

/// Bytes of a sample: x, y, z, little-endian.
const SAMPLE: usize = 6;
/// Capacity of the FIFO, samples.
const DEPTH: u16 = 32;
/// Time to read a sample on a bus of 400 kHz, µs.
const TRANSFER_US: u64 = 140;

/// An LSM303AGR on an I²C bus with the accelerometer's INT1 line.
///
/// One burst reads the sensor's FIFO when INT1 signals the watermark: 40 ms of samples, at most 16. The FIFO
/// holds 32 samples.
pub struct Lsm303agr<I2C, D, T> {
    i2c: I2C,
    data_ready: D,
    timer: T,
    fifo: SensorFifo,
    mounting: Mounting,
    /// The magnetometer has measured since it was configured; before that its registers are undefined.
    field_measured: bool,
}

impl<I2C: I2c, D: DataReady, T: Timer> Lsm303agr<I2C, D, T> {
    /// A sensor on `i2c` whose INT1 is `data_ready`; other chips may share that line.
    pub fn new(i2c: I2C, data_ready: D, timer: T) -> Self {
        Self {
            i2c,
            data_ready,
            timer,
            fifo: SensorFifo::new(DEPTH, PeriodNs(10_000_000), TRANSFER_US),
            mounting: Mounting::STRAIGHT,
            field_measured: false,
        }
    }

    /// Converts samples and magnetic field to the board's axes. The chip's own axes are left-handed.
    pub fn mounted(self, mounting: Mounting) -> Self {
        Self { mounting, ..self }
    }

    /// Reads consecutive registers.
    async fn read(
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

    /// Reads samples, oldest first. A burst read wraps from OUT_Z_H to OUT_X_L, so it returns successive
    /// samples.
    async fn drain(&mut self, counts: &mut [Counts]) -> Result<(), SensorFault> {
        let mut bytes = [0; MAX_WATERMARK as usize * SAMPLE];
        for places in counts.chunks_mut(MAX_WATERMARK.into()) {
            let burst = bytes.get_mut(..places.len() * SAMPLE).unwrap_or_default();
            self.read(ACCELEROMETER, OUT_X_L, burst).await?;
            for (place, bytes) in places.iter_mut().zip(burst.as_chunks().0) {
                *place = Counts(self.axes(bytes));
            }
        }
        Ok(())
    }

    /// Waits for the watermark or a timeout, and reads the state of the FIFO.
    async fn read_state(&mut self) -> Result<FifoState, SensorFault> {
        let deadline = self.fifo.deadline(self.timer.now());
        loop {
            let edge = self.timer.before(deadline, self.data_ready.ready()).await;
            let woken = self.timer.now();
            let mut source = [0];
            self.read(ACCELEROMETER, FIFO_SRC, &mut source).await?;
            let [source] = source;
            let at = self.timer.now();
            let overrun = source & FIFO_SRC_FULL != 0;
            let level = if overrun { DEPTH } else { u16::from(source & FIFO_SRC_LEVEL) };
            let missing = self.fifo.watermark().saturating_sub(level);
            if missing == 0 || at >= deadline {
                let edge_time = edge.flatten().unwrap_or(woken);
                return Ok(FifoState::new(edge_time, at, level).with_overrun(overrun));
            }
            // Another chip drives the shared line: poll the sensor.
            self.timer.after_us(self.fifo.micros(missing)).await;
        }
    }
}

impl<I2C, D, T> Lsm303agr<I2C, D, T> {
    /// The plan for `wanted`.
    ///
    /// # Errors
    /// The nearest supported settings.
    pub fn plan(wanted: &Settings) -> Result<Plan, Settings> {
        SUPPORTED.plan(wanted, |(_, scale), (_, period)| {
            let full_scale = match wanted.resolution {
                Resolution::LowPower => 0x7F00,
                Resolution::Normal => 0x7FC0,
                Resolution::High => 0x7FF0,
            };
            SensorPlan::new(PeriodNs(period), scale, full_scale)
        })
    }
}

impl<I2C: I2c, D: DataReady, T: Timer> InertialSensor for Lsm303agr<I2C, D, T> {
    type Sample = Counts;
    type Planner = fn(&Settings) -> Result<Plan, Settings>;
    const PART: Part = Part::new(sensor::LSM303AGR, "LSM303AGR");
    const CAPABILITIES: Capabilities = Capabilities::ACCELEROMETER
        .with(Capabilities::MAGNETOMETER)
        .with(Capabilities::TEMPERATURE);

    fn planner(&self) -> Self::Planner {
        Self::plan
    }

    async fn configure(&mut self, plan: &Plan) -> Result<(), SensorFault> {
        self.fifo = SensorFifo::new(DEPTH, plan.sensor.period, TRANSFER_US);
        self.field_measured = false;
        let Some((settings, (range, _), (rate, _))) = SUPPORTED.nearest(&plan.settings) else {
            return Ok(()); // Not a plan of this sensor.
        };
        let (power, digits) = match settings.resolution {
            Resolution::LowPower => (CTRL1_LOW_POWER, 0),
            Resolution::Normal => (0, 0),
            Resolution::High => (0, CTRL4_HIGH_RESOLUTION),
        };

        let mut found = [0];
        self.read(ACCELEROMETER, WHO_AM_I, &mut found).await?;
        let [found] = found;
        if found != IDENTITY {
            return Err(SensorFault::WrongIdentity { expected: IDENTITY, found });
        }
        let registers = [
            CTRL2 | INCREMENT,
            0,
            CTRL3_WATERMARK_ON_INT1,
            CTRL4_BLOCK_UPDATE | range << 4 | digits,
            CTRL5_FIFO,
            0,
        ];
        // The line rises when the level exceeds the register's value.
        let stream = FIFO_CTRL_STREAM | (self.fifo.watermark() - 1) as u8;
        let magnetometer = [CFG_A_M | INCREMENT, CFG_A_M_RUN, 0, CFG_C_M_BLOCK_UPDATE];
        // Switched off, with an empty FIFO, during the configuration.
        let writes: [(u8, &[u8]); 7] = [
            (ACCELEROMETER, &[CTRL1, CTRL1_AXES]),
            (ACCELEROMETER, &[FIFO_CTRL, FIFO_CTRL_BYPASS]),
            (ACCELEROMETER, &[TEMP_CFG, TEMP_CFG_ON]),
            (ACCELEROMETER, &registers),
            (ACCELEROMETER, &[FIFO_CTRL, stream]),
            (MAGNETOMETER, &magnetometer),
            (ACCELEROMETER, &[CTRL1, rate << 4 | power | CTRL1_AXES]),
        ];
        for (address, bytes) in writes {
            let outcome = self.i2c.write(address, bytes).await;
            outcome.map_err(|error| SensorFault::of_bus(&error))?;
        }
        Ok(())
    }

    async fn next(&mut self, counts: &mut [Counts]) -> Result<Batch, SensorFault> {
        let mut lost = false;
        loop {
            let state = self.read_state().await?;
            if state.overrun {
                // A full FIFO overwrites its oldest sample, possibly while it is read. That sample is discarded.
                let mut oldest = [0; SAMPLE];
                self.read(ACCELEROMETER, OUT_X_L, &mut oldest).await?;
                lost = true;
                continue;
            }
            let count = counts.len().min(state.level.into());
            if count == 0 {
                return Err(SensorFault::NoData);
            }
            self.drain(counts.get_mut(..count).unwrap_or_default()).await?;
            if self.fifo.kept_up(&state, self.timer.now()) {
                let unread = state.level - count as u16;
                return Ok(self.fifo.read(state.with_overrun(lost), count, unread));
            }
            lost = true;
        }
    }

    async fn surroundings(&mut self) -> Result<Surroundings, SensorFault> {
        if !self.field_measured {
            let mut status = [0];
            self.read(MAGNETOMETER, STATUS_M, &mut status).await?;
            self.field_measured = status[0] & STATUS_M_NEW != 0;
        }
        let magnetic_field = if self.field_measured {
            let mut field = [0; SAMPLE];
            self.read(MAGNETOMETER, OUT_X_L_M, &mut field).await?;
            let field = self.axes(&field).map(|axis| i32::from(axis) * NT_PER_LSB);
            Some(MagneticFieldNt(field))
        } else {
            None
        };
        let mut temperature = [0; 2];
        self.read(ACCELEROMETER, OUT_TEMP_L, &mut temperature).await?;
        // 1/256 °C per LSB, relative to 25 °C.
        let centi = 2500 + i32::from(i16::from_le_bytes(temperature)) * 100 / 256;
        Ok(Surroundings { magnetic_field, temperature: Some(CentiCelsius(centi as i16)) })
    }
}
