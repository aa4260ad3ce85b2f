//! The ADXL345 at register level: accelerometer at 0x53 or 0x1D, or on SPI.
//!
//! Modelled: identity, output data rates 0.10 to 3200 Hz, standby and measuring, ranges, 10 bits
//! and full resolution, both justifications, the lowest bit that is 0 at 1600 and 3200 Hz, the FIFO of 32
//! samples (bypass, FIFO, stream) that moves on within 5 µs of reading a sample, watermark, overrun,
//! data-ready, interrupt enable, map and invert on INT1. Other registers keep
//! what is written to them and do nothing: offsets, tap, activity, free fall, sleep, trigger mode,
//! INT2. Low power changes no noise.

use std::collections::VecDeque;

use crate::chip::{Chip, Core, FifoMode};
use crate::sampling::SampleClock;
use crate::source::{Conversion, Source};
use crate::spi;

/// Its I²C address, with SDO low.
pub const ADDRESS: u8 = 0x53;

const DEVID: u8 = 0x00;
const ACT_TAP_STATUS: u8 = 0x2B;
const BW_RATE: u8 = 0x2C;
const POWER_CTL: u8 = 0x2D;
const INT_ENABLE: u8 = 0x2E;
const INT_MAP: u8 = 0x2F;
const INT_SOURCE: u8 = 0x30;
const DATA_FORMAT: u8 = 0x31;
const DATAX0: u8 = 0x32;
const DATAZ1: u8 = 0x37;
const FIFO_CTL: u8 = 0x38;
const FIFO_STATUS: u8 = 0x39;

const RATE: u8 = 0x0F;
const MEASURE: u8 = 0x08;
const INVERT: u8 = 0x20;
const FULL_RES: u8 = 0x08;
const JUSTIFY: u8 = 0x04;
const DATA_READY: u8 = 0x80;
const WATERMARK: u8 = 0x02;
const OVERRUN: u8 = 0x01;

const FIFO_SAMPLES: usize = 32;
/// Bit of an SPI command: the register advances after each byte.
const MULTIPLE: u8 = 0x40;
/// Time that the FIFO needs to advance, µs. On I²C it has always passed.
const ADVANCE_US: u64 = 5;
/// From standby to the first conversion, µs.
const WAKE_UP_US: u64 = 1_100;

#[derive(Debug)]
pub(crate) struct Adxl345 {
    address: u8,
    core: Core,
    /// How far the register advances after each byte.
    step: u8,
    now: u64,
    fifo: VecDeque<[i16; 3]>,
    /// What the data registers show while nothing waits.
    latest: [i16; 3],
    /// A sample whose reading has begun: it does not change until the message ends.
    reading: Option<[i16; 3]>,
    /// Sample that the FIFO still shows, until this time, µs.
    leaving: Option<([i16; 3], u64)>,
    /// In bypass mode: not read yet.
    fresh: bool,
    overrun: bool,
}

impl Adxl345 {
    pub(crate) fn new(address: u8) -> Self {
        let mut chip = Self {
            address,
            core: Core::of(0xE5),
            step: 1,
            now: 0,
            fifo: VecDeque::new(),
            latest: [0; 3],
            reading: None,
            leaving: None,
            fresh: false,
            overrun: false,
        };
        chip.reset();
        chip
    }

    fn mode(&self) -> FifoMode {
        FifoMode::of(self.register(FIFO_CTL))
    }

    fn watermark(&self) -> usize {
        usize::from(self.register(FIFO_CTL) & 0x1F)
    }

    fn rate_hz(&self) -> Option<f64> {
        let slower = RATE - (self.register(BW_RATE) & RATE);
        let measures = self.is_set(POWER_CTL, MEASURE);
        measures.then(|| 3200.0 / f64::from(1_u32 << slower))
    }

    /// Bits that carry data.
    fn bits(&self) -> u32 {
        let format = self.register(DATA_FORMAT);
        match format & FULL_RES {
            0 => 10,
            _ => 10 + u32::from(format & 3),
        }
    }

    /// Of a left-justified sample: 256 LSB/g in 10 bits at ±2 g, half of it at twice the range.
    fn lsb_per_g(&self) -> f64 {
        f64::from(16384_u32 >> (self.register(DATA_FORMAT) & 3))
    }

    fn store(&mut self, sample: [i16; 3]) {
        self.latest = sample;
        match self.mode() {
            FifoMode::Bypass => {
                self.overrun |= self.fresh;
                self.fresh = true;
            }
            FifoMode::Fifo if self.fifo.len() >= FIFO_SAMPLES => self.overrun = true,
            FifoMode::Fifo => self.fifo.push_back(sample),
            FifoMode::Stream => {
                if self.fifo.len() >= FIFO_SAMPLES {
                    self.fifo.pop_front();
                    self.overrun = true;
                }
                self.fifo.push_back(sample);
            }
        }
    }

    /// A byte of the sample being read.
    fn data(&mut self, register: u8) -> u8 {
        let shown = match self.leaving {
            Some((leaving, _)) => leaving,
            None => self.fifo.front().copied().unwrap_or(self.latest),
        };
        let sample = *self.reading.get_or_insert(shown);
        let byte = usize::from(register - DATAX0);
        let value = sample[byte / 2].to_le_bytes()[byte % 2];
        self.fresh = false;
        self.overrun = false;
        if register == DATAZ1 {
            self.end_reading();
        }
        value
    }

    /// The FIFO advances when a sample has been read, or the message has ended within it.
    fn end_reading(&mut self) {
        let Some(sample) = self.reading.take() else {
            return;
        };
        if self.leaving.is_none() {
            self.fifo.pop_front();
            self.leaving = Some((sample, self.now + ADVANCE_US));
        }
    }

    fn interrupts(&self) -> u8 {
        let on = |condition: bool, bit: u8| if condition { bit } else { 0 };
        let bypass = self.mode() == FifoMode::Bypass;
        let waits = if bypass { self.fresh } else { !self.fifo.is_empty() };
        on(waits, DATA_READY)
            | on(self.fifo.len() >= self.watermark(), WATERMARK)
            | on(self.overrun, OVERRUN)
    }
}

impl Chip for Adxl345 {
    fn core(&self) -> &Core {
        &self.core
    }

    fn core_mut(&mut self) -> &mut Core {
        &mut self.core
    }

    fn sample(&mut self, time_s: f64, source: &mut dyn Source) {
        let bits = self.bits();
        let conversion = Conversion {
            index: self.core.taken,
            time_s,
            rate_hz: self.rate_hz().unwrap_or_default(),
            lsb_per_g: self.lsb_per_g(),
            bits,
        };
        let full = self.fifo.len() >= self.watermark().max(1);
        let unread = if self.mode() == FifoMode::Bypass { self.fresh } else { full };
        if source.waits_for_reader() && unread {
            return;
        }
        let Some(counts) = source.acceleration(&conversion) else {
            return;
        };
        self.core.taken += 1;
        let mut sample = counts.0;
        let fast = self.register(BW_RATE) & RATE >= 0x0E;
        let finest = self.is_set(DATA_FORMAT, FULL_RES) || !self.is_set(DATA_FORMAT, 3);
        if fast && finest {
            sample = sample.map(|axis| axis & !(1_i16 << (16 - bits)));
        }
        if !self.is_set(DATA_FORMAT, JUSTIFY) {
            sample = sample.map(|axis| axis >> (16 - bits));
        }
        self.store(sample);
    }

    fn settle(&mut self, now: u64, source: &mut dyn Source) {
        self.now = now;
        self.leaving = self.leaving.filter(|(_, until)| now < *until);
        self.take_due(now, source);
    }

    fn reset(&mut self) {
        self.core.clear();
        self.core.registers.set(BW_RATE, 0x0A);
        self.fifo.clear();
        self.reading = None;
        self.fresh = false;
        self.overrun = false;
    }

    fn acknowledges(&self, address: u8) -> bool {
        address == self.address || address == spi::ADDRESS
    }

    fn begin_write(&mut self, _address: u8) {
        self.end_reading();
        self.core.registers.begin();
    }

    fn write(&mut self, address: u8, byte: u8, now: u64, period_error_ppm: f64) {
        if self.core.registers.takes_number(byte) {
            self.core.registers.pointer = byte & 0x3F;
            self.step = u8::from(address != spi::ADDRESS || byte & MULTIPLE != 0);
            return;
        }
        let register = self.core.registers.pointer;
        self.core.registers.pointer = (register + self.step) & 0x3F;
        let read_only =
            matches!(register, DEVID | ACT_TAP_STATUS | INT_SOURCE | DATAX0..=DATAZ1 | FIFO_STATUS);
        if read_only {
            return;
        }
        let rate_before = self.rate_hz();
        self.core.registers.set(register, byte);
        if register == FIFO_CTL && self.mode() == FifoMode::Bypass {
            self.fifo.clear();
            self.overrun = false;
        }
        let rate = self.rate_hz();
        if rate != rate_before {
            let begins = if rate_before.is_none() { now + WAKE_UP_US } else { now };
            self.core.sampling = rate.map(|rate| SampleClock::new(rate, begins, period_error_ppm));
        }
    }

    fn read(&mut self, _address: u8) -> u8 {
        let register = self.core.registers.pointer;
        self.core.registers.pointer = (register + self.step) & 0x3F;
        match register {
            DEVID => self.core.identity,
            INT_SOURCE => self.interrupts(),
            DATAX0..=DATAZ1 => self.data(register),
            FIFO_STATUS => self.fifo.len() as u8 + u8::from(self.leaving.is_some()),
            _ => self.register(register),
        }
    }

    fn interrupt(&self) -> bool {
        let on_int1 = self.register(INT_ENABLE) & !self.register(INT_MAP);
        (self.interrupts() & on_int1 != 0) != self.is_set(DATA_FORMAT, INVERT)
    }

    fn has_unread(&self) -> bool {
        self.fresh || !self.fifo.is_empty()
    }
}
