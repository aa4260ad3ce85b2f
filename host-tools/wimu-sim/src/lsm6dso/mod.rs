//! The LSM6DSO and the LSM6DS3TR-C at register level: accelerometer, gyroscope, thermometer, FIFO, on I²C or SPI.
//!
//! Modelled: identity, both addresses, I2C_disable, output data rates 12.5 Hz to 6.66 kHz with both
//! sensors on one oscillator, ranges, turn-on time of the gyroscope (full scale until it has passed),
//! output registers with block data update, the FIFO of 512 tagged words (bypass, continuous) with
//! batch rates and temperatures, watermark, overrun and its latch, data-ready, watermark, overrun and
//! full on INT1 of either polarity, software reset, access to the embedded functions'
//! registers, which hides all others. Other registers keep what is written to them and do nothing:
//! timestamps, filters, decimation of the LSM6DS3TR-C's FIFO, whose words have no tags, compression, embedded functions, I3C, INT2. Low power changes no noise. The
//! order of the words of one instant (gyroscope, accelerometer, temperature) and the content of an
//! empty FIFO are not in the datasheet.

mod fifo;
mod pattern;

use wimu_model::Counts;

use crate::chip::{Chip, Core, GyroscopeFault};
use crate::sampling::SampleClock;
use crate::source::{Conversion, Source, quantise};
use crate::spi;
use fifo::{ACCELEROMETER, Fifo, GYROSCOPE, TEMPERATURE, WORDS};

const FUNC_CFG_ACCESS: u8 = 0x01;
/// Of the LSM6DS3TR-C: one lower than the LSM6DSO's.
const PLAIN_CTRL1: u8 = 0x06;
const PLAIN_CTRL5: u8 = 0x0A;
const PLAIN_STATUS4: u8 = 0x3D;
const PLAIN_DATA_L: u8 = 0x3E;
const PLAIN_DATA_H: u8 = 0x3F;
const FIFO_CTRL1: u8 = 0x07;
const FIFO_CTRL3: u8 = 0x09;
const FIFO_CTRL4: u8 = 0x0A;
const INT1_CTRL: u8 = 0x0D;
const WHO_AM_I: u8 = 0x0F;
const CTRL1_XL: u8 = 0x10;
const CTRL2_G: u8 = 0x11;
const CTRL3_C: u8 = 0x12;
const CTRL4_C: u8 = 0x13;
const CTRL9_XL: u8 = 0x18;
const ALL_INT_SRC: u8 = 0x1A;
const STATUS: u8 = 0x1E;
const OUT_TEMP_L: u8 = 0x20;
const OUTZ_H_A: u8 = 0x2D;
const FIFO_STATUS1: u8 = 0x3A;
const FIFO_STATUS2: u8 = 0x3B;
const FIFO_TAG: u8 = 0x78;
const FIFO_Z_H: u8 = 0x7E;

const SW_RESET: u8 = 1;
const IF_INC: u8 = 1 << 2;
const ACTIVE_LOW: u8 = 1 << 5;
const BDU: u8 = 1 << 6;
const I2C_DISABLE: u8 = 1 << 2;

/// Rate of code 10, the fastest, Hz; each code below halves it.
const FASTEST_HZ: f64 = 20_000.0 / 3.0;
const RESET_US: u64 = 50;
/// From power-down until the gyroscope measures.
const TURN_ON_S: f64 = 0.070;

#[derive(Debug, Default)]
pub(crate) struct Lsm6dso {
    address: u8,
    /// Samples at the faster of both rates; the slower one is a power of two below it.
    core: Core,
    now: u64,
    reset_until: u64,
    gyroscope_on_us: u64,
    /// Samples of the gyroscope.
    rates_taken: u64,
    ticks: u64,
    /// Tag counter: instants with words in the FIFO.
    slot: u8,
    /// Temperature, gyroscope x, y, z, accelerometer x, y, z.
    output: [i16; 7],
    /// High byte of the value whose low byte was read, with block data update.
    held_high: [Option<u8>; 7],
    /// STATUS: TDA, GDA, XLDA.
    fresh: u8,
    fifo: Fifo,
    /// The FIFO of an LSM6DS3TR-C, which is what the chip is if this is there.
    plain: Option<pattern::Fifo>,
}

impl Lsm6dso {
    /// A chip at `address` after power-on.
    pub(crate) fn new(address: u8) -> Self {
        let mut chip = Self { address, core: Core::of(0x6C), ..Self::default() };
        chip.reset();
        chip
    }

    /// An LSM6DS3TR-C at `address` after power-on.
    pub(crate) fn lsm6ds3tr_c(address: u8) -> Self {
        let plain = Some(pattern::Fifo::default());
        let mut chip = Self { address, core: Core::of(0x6A), plain, ..Self::default() };
        chip.reset();
        chip
    }

    /// Rate codes of the gyroscope and the accelerometer, 0 while one is off.
    fn codes(&self) -> [u8; 2] {
        [CTRL2_G, CTRL1_XL].map(|control| match self.register(control) >> 4 {
            code @ 0..=10 => code,
            _ => 0,
        })
    }

    fn fastest_code(&self) -> u8 {
        self.codes()[0].max(self.codes()[1])
    }

    /// Whether something of rate `code` happens at this tick.
    fn is_due(&self, code: u8) -> bool {
        let slower = self.fastest_code().saturating_sub(code);
        code != 0 && self.ticks.is_multiple_of(1 << slower)
    }

    fn lsb_per_dps(&self) -> f64 {
        let range = self.register(CTRL2_G);
        let doublings = if range & 0b10 == 0 { 1 + (range >> 2 & 0b11) } else { 0 };
        1e3 / (4.375 * f64::from(1 << doublings))
    }

    fn lsb_per_g(&self) -> f64 {
        let mg_per_lsb = [0.061, 0.488, 0.122, 0.244];
        1e3 / mg_per_lsb[usize::from(self.register(CTRL1_XL) >> 2 & 0b11)]
    }

    fn above_watermark(&self) -> bool {
        let (first, high, words) = match &self.plain {
            Some(plain) => (PLAIN_CTRL1, 0b111, plain.len()),
            None => (FIFO_CTRL1, 1, self.fifo.len()),
        };
        let watermark = [self.register(first), self.register(first + 1) & high];
        let watermark = usize::from(u16::from_le_bytes(watermark));
        watermark > 0 && words >= watermark
    }

    fn sample_rate(&mut self, time_s: f64, source: &mut dyn Source) {
        let turned_on = time_s >= self.gyroscope_on_us as f64 * 1e-6 + TURN_ON_S;
        let rate_hz = FASTEST_HZ / f64::from(1 << (10 - self.codes()[0]));
        let (index, lsb_per_dps) = (self.rates_taken, self.lsb_per_dps());
        let Counts(counts) = match self.core.fault {
            GyroscopeFault::None if turned_on => {
                source.angular_rate(index, time_s, rate_hz, lsb_per_dps)
            }
            _ => Counts([i16::MAX; 3]),
        };
        if self.core.fault != GyroscopeFault::Stuck {
            self.output[1..4].copy_from_slice(&counts);
        }
        self.rates_taken += 1;
        self.fresh |= 0b010;
    }

    /// Whether the source had a sample.
    fn sample_force(&mut self, time_s: f64, source: &mut dyn Source) -> bool {
        let conversion = Conversion {
            index: self.core.taken,
            time_s,
            rate_hz: FASTEST_HZ / f64::from(1 << (10 - self.codes()[1])),
            lsb_per_g: self.lsb_per_g(),
            bits: 16,
        };
        let Some(counts) = source.acceleration(&conversion) else {
            return false;
        };
        self.output[4..7].copy_from_slice(&counts.0);
        self.core.taken += 1;
        self.fresh |= 0b001;
        true
    }

    /// Puts the words of this tick into the FIFO.
    fn batch(&mut self, rate: bool, force: bool) {
        let codes = self.codes();
        let batched = self.register(FIFO_CTRL3);
        let rate = rate && self.is_due(codes[0].min(batched >> 4));
        let force = force && self.is_due(codes[1].min(batched & 0xF));
        self.slot = self.slot.wrapping_add(u8::from(rate || force));
        let control = self.register(FIFO_CTRL4);
        // At 1.6 Hz (an eighth of code 1), 12.5 Hz, 52 Hz.
        let temperature = match control >> 4 & 0b11 {
            0b00 => false,
            0b01 => self.ticks.is_multiple_of(8 << (self.fastest_code() - 1)),
            0b10 => self.is_due(1),
            _ => self.is_due(3),
        };
        let [t, gx, gy, gz, ax, ay, az] = self.output.map(i16::to_le_bytes);
        for (is_due, sensor, data) in [
            (rate, GYROSCOPE, [gx, gy, gz]),
            (force, ACCELEROMETER, [ax, ay, az]),
            (temperature, TEMPERATURE, [t, [0; 2], [0; 2]]),
        ] {
            if is_due {
                self.fifo.push(sensor, self.slot, data);
            }
        }
    }

    fn read_output(&mut self, byte: usize) -> u8 {
        let word = byte / 2;
        self.fresh &= [!0b100, !0b010, !0b001][word.div_ceil(3)];
        let [low, high] = self.output[word].to_le_bytes();
        if byte.is_multiple_of(2) {
            self.held_high[word] = self.is_set(CTRL3_C, BDU).then_some(high);
            low
        } else {
            self.held_high[word].take().unwrap_or(high)
        }
    }

    /// The register after `register` in a burst: words of the FIFO follow each other.
    fn after(&self, register: u8) -> u8 {
        match register {
            _ if !self.is_set(CTRL3_C, IF_INC) => register,
            FIFO_Z_H => FIFO_TAG,
            PLAIN_DATA_H if self.plain.is_some() => PLAIN_DATA_L,
            _ => (register + 1) & 0x7F,
        }
    }

    /// Whether the registers of the embedded functions hide `register`.
    fn is_hidden(&self, register: u8) -> bool {
        register != FUNC_CFG_ACCESS && self.is_set(FUNC_CFG_ACCESS, 0xC0)
    }
}

impl Chip for Lsm6dso {
    fn core(&self) -> &Core {
        &self.core
    }

    fn core_mut(&mut self) -> &mut Core {
        &mut self.core
    }

    fn sample(&mut self, time_s: f64, source: &mut dyn Source) {
        if source.waits_for_reader() && self.above_watermark() {
            return;
        }
        let [mut rate, force] = self.codes().map(|code| self.is_due(code));
        if force && !self.sample_force(time_s, source) {
            return;
        }
        rate &= self.core.fault != GyroscopeFault::Stops;
        if rate {
            self.sample_rate(time_s, source);
        }
        self.output[0] = quantise(256.0 * (source.temperature_c(time_s) - 25.0), 16);
        self.fresh |= 0b100;
        if let Some(plain) = &mut self.plain {
            let [_, sample @ ..] = self.output;
            if self.core.registers.get(PLAIN_CTRL5) & 0b111 != 0 && force {
                plain.push(sample);
            }
        } else if self.register(FIFO_CTRL4) & 0b111 != 0 {
            self.batch(rate, force);
        }
        self.ticks += 1;
    }

    fn settle(&mut self, now: u64, source: &mut dyn Source) {
        self.now = now;
        self.take_due(now, source);
    }

    fn reset(&mut self) {
        self.core.clear();
        self.core.registers.set(CTRL3_C, IF_INC);
        self.core.registers.set(CTRL9_XL, 0xE0);
        self.output = [0; 7];
        self.fresh = 0;
        self.fifo = Fifo::default();
        self.plain = self.plain.as_ref().map(|_| pattern::Fifo::default());
    }

    fn acknowledges(&self, address: u8) -> bool {
        let i2c = address == self.address && !self.is_set(CTRL4_C, I2C_DISABLE);
        i2c || address == spi::ADDRESS
    }

    fn write(&mut self, _address: u8, byte: u8, now: u64, period_error_ppm: f64) {
        if self.core.registers.takes_number(byte) {
            return;
        }
        let register = self.core.registers.pointer;
        self.core.registers.pointer = self.after(register);
        let read_only = matches!(
            register,
            WHO_AM_I | ALL_INT_SRC..=OUTZ_H_A | FIFO_STATUS1 | FIFO_STATUS2 | FIFO_TAG..
        );
        if self.is_hidden(register) || read_only {
            return;
        }
        let codes = self.codes();
        self.core.registers.set(register, byte);
        match register {
            CTRL3_C if byte & SW_RESET != 0 => {
                self.reset();
                self.reset_until = now + RESET_US;
            }
            FIFO_CTRL4 if byte & 0b111 == 0 => self.fifo = Fifo::default(),
            PLAIN_CTRL5 if byte & 0b111 == 0 && self.plain.is_some() => {
                self.plain = Some(pattern::Fifo::default());
            }
            _ => {}
        }
        if self.codes() != codes {
            if codes[0] == 0 {
                self.gyroscope_on_us = now;
            }
            self.ticks = 0;
            let rate_hz = FASTEST_HZ / f64::from(1 << (10 - self.fastest_code()));
            let sampling = SampleClock::new(rate_hz, now, period_error_ppm);
            self.core.sampling = (self.fastest_code() > 0).then_some(sampling);
        }
    }

    fn read(&mut self, _address: u8) -> u8 {
        let register = self.core.registers.pointer;
        self.core.registers.pointer = self.after(register);
        let above_watermark = self.above_watermark();
        if let Some(plain) = &mut self.plain {
            match register {
                FIFO_STATUS1..=PLAIN_STATUS4 => {
                    return plain.status(usize::from(register - FIFO_STATUS1), above_watermark);
                }
                PLAIN_DATA_L | PLAIN_DATA_H => return plain.read(register == PLAIN_DATA_H),
                _ => {}
            }
        }
        match register {
            _ if self.is_hidden(register) => 0,
            WHO_AM_I => self.core.identity,
            CTRL3_C => self.register(CTRL3_C) | u8::from(self.now < self.reset_until),
            STATUS => self.fresh,
            OUT_TEMP_L..=OUTZ_H_A => self.read_output(usize::from(register - OUT_TEMP_L)),
            FIFO_STATUS1 => self.fifo.len() as u8,
            FIFO_STATUS2 => u8::from(above_watermark) << 7 | self.fifo.status2(),
            FIFO_TAG..=FIFO_Z_H => self.fifo.read(usize::from(register - FIFO_TAG)),
            _ => self.register(register),
        }
    }

    fn interrupt(&self) -> bool {
        let full = match &self.plain {
            Some(plain) => plain.len() >= pattern::WORDS,
            None => self.fifo.len() >= WORDS,
        };
        // Data-ready of both sensors, FIFO threshold, overrun and full.
        let happened = self.fresh & 0b011
            | u8::from(self.above_watermark()) << 3
            | u8::from(full) << 4
            | u8::from(full) << 5;
        (self.register(INT1_CTRL) & happened != 0) != self.is_set(CTRL3_C, ACTIVE_LOW)
    }

    fn has_unread(&self) -> bool {
        self.fifo.len() > 0 || self.plain.as_ref().is_some_and(|plain| plain.len() > 0)
    }
}
