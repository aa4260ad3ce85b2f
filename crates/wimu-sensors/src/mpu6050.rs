//! The MPU-6050 family (accelerometer, gyroscope, temperature; register maps RM-MPU-6000A-00 and RM-MPU-6500A-00).

use wimu_link::hello::{Capabilities, Part, sensor};
use wimu_link::message::Resolution;
use wimu_model::{CentiCelsius, Counts, DeviceTimeUs};
use wimu_node::sensor::{GyroscopePlan, SensorFault, Surroundings};
use wimu_node::{
    DataReady, FifoChip, FifoLevel, FifoRead, FifoState, Range, Rate, SensorFifo, Setup, Timer,
};

use crate::bus::{Bus, Registers, SpiRead, wrong_identity};

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

const GYRO_2000_DPS: u8 = 3 << 3;
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

/// From a reset until the registers can be written, µs.
const RESET_US: u64 = 100_000;
/// From sleep until the gyroscope is within 1 °/s of its final output, µs: 30 ms by its datasheet, with reserve.
const SETTLING_US: u64 = 50_000;
/// Bytes of a sample in the FIFO.
const SAMPLE: usize = 12;
/// Samples of a burst.
const BURST: usize = 16;
/// Delay of the data-ready edge after which the FIFO is read without it, µs, beside two sample periods: the latency of
/// interrupts and tasks. The FIFO holds 42 ms at the highest rate.
const LATE_US: u64 = 10_000;

static RANGES: [Range; 4] = Range::four([0, 1, 2, 3], [16384.0, 8192.0, 4096.0, 2048.0]);

/// 1 kHz over 1 + the divider.
static RATES: [Rate; 8] = [
    rate(25, 39),
    rate(50, 19),
    rate(100, 9),
    rate(125, 7),
    rate(200, 4),
    rate(250, 3),
    rate(500, 1),
    rate(1000, 0),
];

const fn rate(hz: u16, divider: u8) -> Rate {
    Rate::new(hz, divider, 1_000_000 * (divider as u32 + 1), false)
}

/// ±2000 °/s, the widest, because a hand exceeds 1000 °/s, and a saturated rate ends the attitude.
static GYROSCOPE: GyroscopePlan =
    GyroscopePlan::new((2000.0_f64 / 32768.0).to_radians(), i16::MAX as i32);

/// An MPU-6050, MPU-6500, MPU-9250 or a part sold as one, on I²C, up to 400 kHz, or SPI, mode 0 or 3 up to 1 MHz, with its
/// INT line.
///
/// The chip has no watermark: the driver sleeps until a sample of the next batch is due and takes that sample's data-ready
/// edge as its time. Without the line (a [`DataReady`] that never completes) times follow the FIFO's level, up to a
/// sample period late. The gyroscope's range is ±2000 °/s.
#[derive(Debug)]
pub struct Mpu6050<B> {
    registers: Registers<B>,
    /// The register layout is that of the MPU-6500 and its successors: a filter of its own for the accelerometer, a FIFO of
    /// 512 bytes, not 1024.
    is_6500: bool,
    /// The FIFO was emptied; no sample has been read since.
    is_emptied: bool,
}

impl<B: Bus> Mpu6050<B> {
    /// Address with the pin AD0 low or open, as on GY-521 modules; 0x69 with it high.
    pub const ADDRESS: u8 = 0x68;

    /// A chip on `bus`; nothing is sent yet.
    pub fn new(bus: B) -> Self {
        let registers = Registers { bus, spi: SpiRead::default() };
        Self { registers, is_6500: false, is_emptied: true }
    }

    async fn identify(&mut self) -> Result<(), SensorFault> {
        self.is_6500 = match self.registers.read_one(WHO_AM_I).await? {
            0x68 => false,
            0x70..=0x75 | 0x98 => true,
            found => return Err(wrong_identity(0x68, found)),
        };
        Ok(())
    }
}

impl<B: Bus> FifoChip for Mpu6050<B> {
    type Sample = (Counts, Counts);
    const PART: Part = Part::new(sensor::MPU6050, "MPU-6050");
    const CAPABILITIES: Capabilities =
        Capabilities::ACCELEROMETER.with(Capabilities::GYROSCOPE).with(Capabilities::TEMPERATURE);
    const RANGES: &'static [Range] = &RANGES;
    const RATES: &'static [Rate] = &RATES;
    const RESOLUTION: Option<Resolution> = Some(Resolution::High);
    const GYROSCOPE: Option<&'static GyroscopePlan> = Some(&GYROSCOPE);
    /// Of the smallest FIFO of the family.
    const DEPTH: u16 = 512 / SAMPLE as u16;
    /// On an I²C bus of 400 kHz.
    const TRANSFER_US: u64 = 290;
    const MOST: usize = BURST;

    async fn start(&mut self, setup: &Setup, timer: &impl Timer) -> Result<(), SensorFault> {
        self.identify().await?;
        self.registers.write(PWR_MGMT_1, PWR_RESET).await?;
        timer.after_us(RESET_US).await;
        // DLPF_CFG: a bandwidth below half the rate down to 50 Hz: 184, 94, 44 or 21 Hz.
        let filter = match setup.rate.code {
            0..=1 => 1,
            2..=4 => 2,
            5..=9 => 3,
            _ => 4,
        };
        let registers = [
            // It leaves sleep with this write.
            (PWR_MGMT_1, PWR_CLOCK_GYRO),
            (SMPLRT_DIV, setup.rate.code),
            (CONFIG, filter),
            (GYRO_CONFIG, GYRO_2000_DPS),
            (ACCEL_CONFIG, setup.range << 3),
            (INT_PIN_CFG, INT_PIN_LATCH),
            (FIFO_EN, FIFO_EN_SIX_AXES),
        ];
        self.registers.write_all(&registers).await?;
        if self.is_6500 {
            self.registers.write(ACCEL_CONFIG2, filter).await?;
        }
        timer.after_us(SETTLING_US).await;
        self.registers.write(INT_ENABLE, INT_DATA_READY | INT_FIFO_OVERFLOW).await?;
        self.repair().await?;
        Ok(())
    }

    async fn level(&mut self) -> Result<FifoLevel, SensorFault> {
        let mut count = [0; 2];
        self.registers.read(FIFO_COUNT_H, &mut count).await?;
        let samples = u16::from_be_bytes(count) / SAMPLE as u16;
        let depth = if self.is_6500 { Self::DEPTH } else { 1024 / SAMPLE as u16 };
        Ok(FifoLevel { samples, overrun: samples >= depth })
    }

    async fn read(&mut self, samples: &mut [(Counts, Counts)]) -> Result<FifoRead, SensorFault> {
        let mut bytes = [[0; SAMPLE]; BURST];
        let bytes = bytes.get_mut(..samples.len()).unwrap_or_default();
        self.registers.read(FIFO_R_W, bytes.as_flattened_mut()).await?;
        for (sample, [a, b, c, d, e, f, g, h, i, j, k, l]) in samples.iter_mut().zip(&*bytes) {
            let acceleration = [[*a, *b], [*c, *d], [*e, *f]].map(i16::from_be_bytes);
            let angular_rate = [[*g, *h], [*i, *j], [*k, *l]].map(i16::from_be_bytes);
            *sample = (Counts(acceleration), Counts(angular_rate));
        }
        self.is_emptied = false;
        Ok(FifoRead { count: bytes.len(), lost: false })
    }

    /// Empties the FIFO: a full one loses single bytes, so that the axes are no longer aligned.
    async fn repair(&mut self) -> Result<bool, SensorFault> {
        let interface = if B::I2C { 0 } else { USER_I2C_DISABLE };
        self.is_emptied = true;
        for bits in [0, USER_FIFO_RESET, USER_FIFO] {
            self.registers.write(USER_CTRL, interface | bits).await?;
        }
        Ok(true)
    }

    /// Waits for the last sample of the next batch.
    async fn state(
        &mut self,
        fifo: &SensorFifo,
        line: &mut impl DataReady,
        timer: &impl Timer,
    ) -> Result<FifoState, SensorFault> {
        let last = fifo.last().filter(|_| !self.is_emptied).unwrap_or_else(|| timer.now());
        // Half a period before that sample.
        let before_us = fifo.micros(fifo.watermark()) - fifo.micros(1) / 2;
        timer.until(DeviceTimeUs(last.0.saturating_add(before_us))).await;
        // Makes the line low until the next sample.
        let overflowed = self.registers.read_one(INT_STATUS).await? & INT_FIFO_OVERFLOW != 0;
        let latest = timer.now().0.saturating_add(fifo.micros(2) + LATE_US);
        let edge = timer.before(DeviceTimeUs(latest), line.ready()).await;
        let woken = timer.now();
        let level = self.level().await?;
        let at = timer.now();
        let state = match edge {
            Some(edge) => {
                let edge_time = edge.unwrap_or(woken);
                let newer = at.0.saturating_sub(edge_time.0) / fifo.micros(1).max(1);
                let newer = u16::try_from(newer).unwrap_or(u16::MAX);
                FifoState::new(edge_time, at, level.samples)
                    .with_edge_at(level.samples.saturating_sub(newer))
            }
            // No time is believed.
            None => FifoState::new(DeviceTimeUs(0), at, level.samples),
        };
        Ok(state.with_overrun(overflowed || level.overrun))
    }

    async fn surroundings(&mut self) -> Result<Surroundings, SensorFault> {
        let mut bytes = [0; 2];
        self.registers.read(TEMP_OUT_H, &mut bytes).await?;
        let counts = i32::from(i16::from_be_bytes(bytes));
        let centi = if self.is_6500 {
            // 333.87 LSB/K, 0 at 21 °C.
            2100 + counts * 10_000 / 33_387
        } else {
            // 340 LSB/K, 0 at 36.53 °C.
            3653 + counts * 10 / 34
        };
        let centi = centi.clamp(i16::MIN.into(), i16::MAX.into()) as i16;
        Ok(Surroundings { magnetic_field: None, temperature: Some(CentiCelsius(centi)) })
    }
}
