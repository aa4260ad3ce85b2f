//! The ICM-42688-P at register level on SPI, and how `wimu_node::Polled` reads it through the driver `icm426xx`.
//!
//! Modelled: identity, software reset, banks, both sensors on one oscillator at the rate of the accelerometer, ranges,
//! start-up time of the gyroscope, output registers that do not change during a message. Other registers keep what is
//! written to them and do nothing: FIFO, filters, interrupts, time stamps, APEX.

use embedded_hal_async::spi::{Operation, SpiDevice};
use icm426xx::{Config, ICM42688, OutputDataRate};
use wimu_link::hello::{Capabilities, Part, sensor};
use wimu_model::{CentiCelsius, Counts};
use wimu_node::sensor::{AccelerometerScale, GyroscopePlan, SensorFault};
use wimu_node::{PolledPlanner, ReadCounts, Timer};

use crate::chip::{Chip, Core};
use crate::sampling::SampleClock;
use crate::source::{Conversion, Source, quantise};
use crate::spi;

const DEVICE_CONFIG: u8 = 0x11;
const TEMP_DATA1: u8 = 0x1D;
const GYRO_DATA_Z0: u8 = 0x2A;
const PWR_MGMT0: u8 = 0x4E;
const GYRO_CONFIG0: u8 = 0x4F;
const ACCEL_CONFIG0: u8 = 0x50;
const WHO_AM_I: u8 = 0x75;
const REG_BANK_SEL: u8 = 0x76;

/// From off until the gyroscope measures, s; until then its output is [`INVALID`].
const TURN_ON_S: f64 = 0.030;
const INVALID: i16 = i16::MIN;

#[derive(Debug)]
pub(crate) struct Icm42688 {
    core: Core,
    bank: u8,
    on_us: u64,
    /// Temperature, accelerometer x, y, z, gyroscope x, y, z.
    output: [i16; 7],
    shown: [i16; 7],
    fresh: bool,
}

impl Default for Icm42688 {
    fn default() -> Self {
        let mut chip = Self {
            core: Core::of(0x47),
            bank: 0,
            on_us: 0,
            output: [INVALID; 7],
            shown: [INVALID; 7],
            fresh: false,
        };
        chip.reset();
        chip
    }
}

impl Icm42688 {
    fn rate_hz(&self) -> Option<f64> {
        let on = self.core.registers.get(PWR_MGMT0) & 0b11 == 0b11;
        let rate_hz = match self.core.registers.get(ACCEL_CONFIG0) & 0xF {
            code @ 3..=6 => f64::from(8000 >> (code - 3)),
            7 => 200.0,
            code @ 8..=11 => f64::from(100 >> (code - 8)),
            15 => 500.0,
            _ => return None,
        };
        on.then_some(rate_hz)
    }
}

impl Chip for Icm42688 {
    fn core(&self) -> &Core {
        &self.core
    }

    fn core_mut(&mut self) -> &mut Core {
        &mut self.core
    }

    fn sample(&mut self, time_s: f64, source: &mut dyn Source) {
        if source.waits_for_reader() && self.fresh {
            return;
        }
        let rate_hz = self.rate_hz().unwrap_or_default();
        let range = self.core.registers.get(ACCEL_CONFIG0) >> 5;
        let conversion = Conversion {
            index: self.core.taken,
            time_s,
            rate_hz,
            lsb_per_g: f64::from(2048_u32 << range.min(3)),
            bits: 16,
        };
        let Some(force) = source.acceleration(&conversion) else {
            return;
        };
        let range = self.core.registers.get(GYRO_CONFIG0) >> 5;
        let lsb_per_dps = 32_768.0 / (2000.0 / f64::from(1 << range));
        let [.., gx, gy, gz] = self.output;
        let is_on = time_s >= self.on_us as f64 * 1e-6 + TURN_ON_S;
        let taken = self.core.taken;
        let rate = self.core.angular_rate(is_on, [gx, gy, gz], || {
            source.angular_rate(taken, time_s, rate_hz, lsb_per_dps)
        });
        let temperature = quantise(132.48 * (source.temperature_c(time_s) - 25.0), 16);
        let ([x, y, z], [gx, gy, gz]) = (force.0, rate);
        self.output = [temperature, x, y, z, gx, gy, gz];
        self.core.taken += 1;
        self.fresh = true;
    }

    fn reset(&mut self) {
        self.core.clear();
        // 1 kHz.
        self.core.registers.set(GYRO_CONFIG0, 0x06);
        self.core.registers.set(ACCEL_CONFIG0, 0x06);
        self.bank = 0;
        self.output = [INVALID; 7];
        self.fresh = false;
    }

    fn acknowledges(&self, address: u8) -> bool {
        address == spi::ADDRESS
    }

    fn begin_write(&mut self, _address: u8) {
        self.shown = self.output;
        self.core.registers.begin();
    }

    fn write(&mut self, _address: u8, byte: u8, now: u64, period_error_ppm: f64) {
        if self.core.registers.takes_number(byte) {
            return;
        }
        let register = self.core.registers.pointer;
        self.core.registers.pointer = (register + 1) & 0x7F;
        if register == REG_BANK_SEL {
            self.bank = byte & 0b111;
        }
        let read_only = matches!(register, TEMP_DATA1..=GYRO_DATA_Z0 | WHO_AM_I | REG_BANK_SEL);
        // The registers of other banks do nothing.
        if self.bank != 0 || read_only {
            return;
        }
        let before = self.rate_hz();
        self.core.registers.set(register, byte);
        if register == DEVICE_CONFIG && byte & 1 != 0 {
            self.reset();
        }
        let rate = self.rate_hz();
        if rate != before {
            if before.is_none() {
                self.on_us = now;
            }
            self.core.sampling = rate.map(|rate| SampleClock::new(rate, now, period_error_ppm));
        }
    }

    fn read(&mut self, _address: u8) -> u8 {
        let register = self.core.registers.pointer;
        self.core.registers.pointer = (register + 1) & 0x7F;
        match register {
            REG_BANK_SEL => self.bank,
            _ if self.bank != 0 => 0,
            WHO_AM_I => self.core.identity,
            TEMP_DATA1..=GYRO_DATA_Z0 => {
                self.fresh = false;
                let byte = usize::from(register - TEMP_DATA1);
                self.shown[byte / 2].to_be_bytes()[byte % 2]
            }
            _ => self.core.registers.get(register),
        }
    }

    fn interrupt(&self) -> bool {
        false
    }

    fn has_unread(&self) -> bool {
        self.fresh
    }
}

static SCALE: AccelerometerScale = AccelerometerScale::of(2048.0);
static GYROSCOPE: GyroscopePlan =
    GyroscopePlan::new((2000.0_f64 / 32768.0).to_radians(), i16::MAX as i32);

/// Settings of a [`PolledIcm42688`]: the ranges of the driver, ± 16 g and ± 2000 °/s.
pub const PLANNER: PolledPlanner = PolledPlanner {
    range_g: 16,
    fastest_hz: 200,
    accelerometer: &SCALE,
    full_scale: i16::MAX as i32,
    gyroscope: Some(&GYROSCOPE),
};

/// An ICM-42688 on an SPI bus, started by the crate `icm426xx` at 1 kHz and read with one burst of its output registers.
pub struct PolledIcm42688<S, T> {
    spi: S,
    timer: T,
}

impl<S, T> PolledIcm42688<S, T> {
    /// The chip on `spi`.
    pub fn new(spi: S, timer: T) -> Self {
        Self { spi, timer }
    }
}

/// A delay of the driver.
struct Delay<'a, T>(&'a T);

impl<T: Timer> embedded_hal_async::delay::DelayNs for Delay<'_, T> {
    async fn delay_ns(&mut self, ns: u32) {
        self.0.after_us(ns.div_ceil(1000).into()).await;
    }
}

impl<S: SpiDevice, T: Timer> PolledIcm42688<S, T> {
    /// Reads big-endian words from a register on.
    async fn words<const N: usize>(&mut self, register: u8) -> Result<[i16; N], SensorFault> {
        let mut words = [[0; 2]; N];
        let command = [register | 0x80];
        let mut message = [Operation::Write(&command), Operation::Read(words.as_flattened_mut())];
        self.spi.transaction(&mut message).await.map_err(|_| SensorFault::Transfer)?;
        Ok(words.map(i16::from_be_bytes))
    }
}

impl<S: SpiDevice, T: Timer> ReadCounts for PolledIcm42688<S, T> {
    type Sample = (Counts, Counts);
    const PART: Part = Part::new(sensor::ICM42688, "ICM-42688");
    const CAPABILITIES: Capabilities =
        Capabilities::ACCELEROMETER.with(Capabilities::GYROSCOPE).with(Capabilities::TEMPERATURE);
    /// Half a period of 1 kHz.
    const AGE_US: u32 = 500;

    async fn start(&mut self) -> Result<(), SensorFault> {
        let config = Config { rate: OutputDataRate::Hz1000, ..Config::default() };
        let chip = ICM42688::new(&mut self.spi);
        match chip.initialize(Delay(&self.timer), config).await {
            Ok(_) => {}
            Err(icm426xx::Error::WhoAmIMismatch(0x00 | 0xFF)) => {
                return Err(SensorFault::NotAnswering);
            }
            Err(icm426xx::Error::WhoAmIMismatch(found)) => {
                return Err(SensorFault::WrongIdentity { expected: 0x47, found });
            }
            Err(_) => return Err(SensorFault::Transfer),
        }
        // The gyroscope starts.
        self.timer.after_us(45_000).await;
        Ok(())
    }

    async fn counts(&mut self) -> Result<(Counts, Counts), SensorFault> {
        let [x, y, z, gx, gy, gz] = self.words(TEMP_DATA1 + 2).await?;
        if [x, y, z] == [INVALID; 3] || [x, y, z] == [-1; 3] {
            // Without a chip all bits are set; after a reset no sample is valid.
            return Err(SensorFault::NoData);
        }
        Ok((Counts([x, y, z]), Counts([gx, gy, gz])))
    }

    async fn temperature(&mut self) -> Result<Option<CentiCelsius>, SensorFault> {
        let [raw] = self.words(TEMP_DATA1).await?;
        // 132.48 LSB/K, 0 at 25 °C.
        let centi = 2500 + i32::from(raw) * 10_000 / 13_248;
        Ok(Some(CentiCelsius(centi as i16)))
    }
}
