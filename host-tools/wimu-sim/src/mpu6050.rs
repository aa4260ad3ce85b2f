//! The MPU-6050 family at register level: accelerometer, gyroscope, thermometer, FIFO, on I²C or SPI.
//!
//! Modelled: identity (MPU-6050 or MPU-6500 and clones), reset, sleep until the clock is chosen, rates 1 kHz / (1 + divider)
//! with a filter, ranges, the byte FIFO of 1024 or 512 bytes with accelerometer and gyroscope, which loses single bytes when
//! it is full, overflow and data-ready on INT, latched until INT_STATUS is read or as a pulse. Other registers keep what is
//! written to them and do nothing: filters, self-test, magnetometer, motion detection, DMP.

use std::collections::VecDeque;

use crate::chip::{Chip, Core};
use crate::sampling::SampleClock;
use crate::source::{Conversion, Source, quantise};
use crate::spi;

/// Its I²C address, with AD0 low.
pub const ADDRESS: u8 = 0x68;

const SMPLRT_DIV: u8 = 0x19;
const CONFIG: u8 = 0x1A;
const GYRO_CONFIG: u8 = 0x1B;
const ACCEL_CONFIG: u8 = 0x1C;
const FIFO_EN: u8 = 0x23;
const INT_PIN_CFG: u8 = 0x37;
const INT_ENABLE: u8 = 0x38;
const INT_STATUS: u8 = 0x3A;
const ACCEL_XOUT_H: u8 = 0x3B;
const GYRO_ZOUT_L: u8 = 0x48;
const USER_CTRL: u8 = 0x6A;
const PWR_MGMT_1: u8 = 0x6B;
const FIFO_COUNT_H: u8 = 0x72;
const FIFO_COUNT_L: u8 = 0x73;
const FIFO_R_W: u8 = 0x74;
const WHO_AM_I: u8 = 0x75;

const RESET: u8 = 1 << 7;
const SLEEP: u8 = 1 << 6;
const LATCH: u8 = 1 << 5;
const FIFO_ON: u8 = 1 << 6;
const FIFO_RESET: u8 = 1 << 2;
const I2C_DISABLE: u8 = 1 << 4;
const OVERFLOW: u8 = 1 << 4;
const DATA_READY: u8 = 1;
/// From sleep until the gyroscope measures, s.
const TURN_ON_S: f64 = 0.030;
/// Duration of a pulse on INT, µs.
const PULSE_US: u64 = 50;

#[derive(Debug, Default)]
pub(crate) struct Mpu6050 {
    core: Core,
    now: u64,
    awake_us: u64,
    sampled_us: u64,
    /// Accelerometer x, y, z, temperature, gyroscope x, y, z.
    output: [i16; 7],
    /// What a message reads: the output at its beginning.
    shown: [i16; 7],
    fifo: VecDeque<u8>,
    status: u8,
}

impl Mpu6050 {
    pub(crate) fn new(identity: u8) -> Self {
        let mut chip = Self { core: Core::of(identity), ..Self::default() };
        chip.reset();
        chip
    }

    fn capacity(&self) -> usize {
        if self.core.identity == 0x68 { 1024 } else { 512 }
    }

    fn rate_hz(&self) -> Option<f64> {
        let filtered = matches!(self.register(CONFIG) & 7, 1..=6);
        let fastest_hz = if filtered { 1000.0 } else { 8000.0 };
        let awake = !self.core.registers.is_set(PWR_MGMT_1, SLEEP);
        awake.then(|| fastest_hz / (1.0 + f64::from(self.register(SMPLRT_DIV))))
    }

    fn is_full(&self) -> bool {
        self.fifo.len() >= self.capacity()
    }

    fn batch(&mut self) {
        let enabled = self.register(FIFO_EN);
        let on = [1 << 3, 1 << 3, 1 << 3, 1 << 7, 1 << 6, 1 << 5, 1 << 4];
        for (value, bit) in self.output.into_iter().zip(on) {
            if enabled & bit == 0 {
                continue;
            }
            for byte in value.to_be_bytes() {
                if self.is_full() {
                    self.fifo.pop_front();
                    self.status |= OVERFLOW;
                }
                self.fifo.push_back(byte);
            }
        }
    }
}

impl Chip for Mpu6050 {
    fn core(&self) -> &Core {
        &self.core
    }

    fn core_mut(&mut self) -> &mut Core {
        &mut self.core
    }

    fn sample(&mut self, time_s: f64, source: &mut dyn Source) {
        if source.waits_for_reader() && self.fifo.len() >= 12 {
            return;
        }
        let rate_hz = self.rate_hz().unwrap_or_default();
        let range = self.register(ACCEL_CONFIG) >> 3 & 3;
        let conversion = Conversion {
            index: self.core.taken,
            time_s,
            rate_hz,
            lsb_per_g: f64::from(16_384 >> range),
            bits: 16,
        };
        let Some(force) = source.acceleration(&conversion) else {
            return;
        };
        let lsb_per_dps = 32_768.0 / f64::from(250 << (self.register(GYRO_CONFIG) >> 3 & 3));
        let turned_on = time_s >= self.awake_us as f64 * 1e-6 + TURN_ON_S;
        let [x, y, z] = force.0;
        let (taken, [.., gx, gy, gz]) = (self.core.taken, self.output);
        let [gx, gy, gz] = self.core.angular_rate(turned_on, [gx, gy, gz], || {
            source.angular_rate(taken, time_s, rate_hz, lsb_per_dps)
        });
        let celsius = source.temperature_c(time_s);
        let temperature = match self.core.identity {
            0x68 => 340.0 * (celsius - 36.53),
            _ => 333.87 * (celsius - 21.0),
        };
        self.output = [x, y, z, quantise(temperature, 16), gx, gy, gz];
        self.core.taken += 1;
        self.sampled_us = self.now;
        self.status |= DATA_READY;
        if self.core.registers.is_set(USER_CTRL, FIFO_ON) {
            self.batch();
        }
    }

    fn settle(&mut self, now: u64, source: &mut dyn Source) {
        self.now = now;
        while let Some(time_s) = self.core.sampling.as_mut().and_then(|s| s.take_due(now)) {
            self.now = (time_s * 1e6) as u64;
            self.sample(time_s, source);
        }
        self.now = now;
    }

    fn reset(&mut self) {
        self.core.clear();
        self.core.registers.set(PWR_MGMT_1, SLEEP);
        self.output = [0; 7];
        self.fifo.clear();
        self.status = 0;
    }

    fn acknowledges(&self, address: u8) -> bool {
        let i2c = address == ADDRESS && !self.core.registers.is_set(USER_CTRL, I2C_DISABLE);
        i2c || address == spi::ADDRESS
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
        let read_only =
            matches!(register, INT_STATUS..=GYRO_ZOUT_L | FIFO_COUNT_H | FIFO_COUNT_L | WHO_AM_I);
        if read_only {
            return;
        }
        let before = self.rate_hz();
        self.core.registers.set(register, byte);
        match register {
            PWR_MGMT_1 if byte & RESET != 0 => self.reset(),
            USER_CTRL if byte & FIFO_RESET != 0 => {
                self.fifo.clear();
                self.core.registers.set(USER_CTRL, byte & !FIFO_RESET);
            }
            _ => {}
        }
        let rate = self.rate_hz();
        if rate != before {
            if before.is_none() {
                self.awake_us = now;
            }
            self.core.sampling = rate.map(|rate| SampleClock::new(rate, now, period_error_ppm));
        }
    }

    fn read(&mut self, _address: u8) -> u8 {
        let register = self.core.registers.pointer;
        if register != FIFO_R_W {
            self.core.registers.pointer = (register + 1) & 0x7F;
        }
        let [high, low] = (self.fifo.len() as u16).to_be_bytes();
        match register {
            WHO_AM_I => self.core.identity,
            INT_STATUS => std::mem::take(&mut self.status),
            ACCEL_XOUT_H..=GYRO_ZOUT_L => {
                let byte = usize::from(register - ACCEL_XOUT_H);
                self.shown[byte / 2].to_be_bytes()[byte % 2]
            }
            FIFO_COUNT_H => high,
            FIFO_COUNT_L => low,
            FIFO_R_W => self.fifo.pop_front().unwrap_or(0xFF),
            _ => self.register(register),
        }
    }

    fn interrupt(&self) -> bool {
        let pulses = !self.core.registers.is_set(INT_PIN_CFG, LATCH);
        let over = pulses && self.now >= self.sampled_us + PULSE_US;
        self.status & self.register(INT_ENABLE) != 0 && !over
    }

    fn has_unread(&self) -> bool {
        !self.fifo.is_empty()
    }
}
