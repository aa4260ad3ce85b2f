//! The accelerometer's and the thermometer's registers.

use std::collections::VecDeque;

use super::output::Output;
use crate::chip::FifoMode;
use crate::sampling::SampleClock;
use crate::source::{Conversion, Source, quantise};

const STATUS_AUX: u8 = 0x07;
const OUT_TEMP_L: u8 = 0x0C;
const OUT_TEMP_H: u8 = 0x0D;
const WHO_AM_I: u8 = 0x0F;
const TEMP_CFG: u8 = 0x1F;
const CTRL1: u8 = 0x20;
const CTRL3: u8 = 0x22;
const CTRL4: u8 = 0x23;
const CTRL5: u8 = 0x24;
const CTRL6: u8 = 0x25;
const STATUS: u8 = 0x27;
const OUT_X_L: u8 = 0x28;
const OUT_Z_H: u8 = 0x2D;
const FIFO_CTRL: u8 = 0x2E;
const FIFO_SRC: u8 = 0x2F;
const INT1_SRC: u8 = 0x31;
const INT2_SRC: u8 = 0x35;
const CLICK_SRC: u8 = 0x39;

const CTRL1_LOW_POWER: u8 = 0x08;
const CTRL3_DATA_READY: u8 = 0x18;
const CTRL3_WATERMARK: u8 = 0x04;
const CTRL3_OVERRUN: u8 = 0x02;
const CTRL4_BLOCK_UPDATE: u8 = 0x80;
const CTRL4_BIG_ENDIAN: u8 = 0x40;
const CTRL4_HIGH_RESOLUTION: u8 = 0x08;
const CTRL5_BOOT: u8 = 0x80;
const CTRL5_FIFO: u8 = 0x40;
const CTRL6_ACTIVE_LOW: u8 = 0x02;
const TEMP_ENABLE: u8 = 0xC0;
const FIFO_CTRL_THRESHOLD: u8 = 0x1F;
const FIFO_SRC_WATERMARK: u8 = 0x80;
const FIFO_SRC_FULL: u8 = 0x40;
const FIFO_SRC_EMPTY: u8 = 0x20;
const FIFO_SRC_LEVEL: u8 = 0x1F;

const FIFO_SAMPLES: usize = 32;

#[derive(Debug)]
pub(super) struct Accelerometer {
    pub(super) who_am_i: u8,
    /// What was written; outputs and status live below.
    registers: [u8; 0x40],
    sampling: Option<SampleClock>,
    taken: u64,
    output: Output<3>,
    /// Samples that wait, while it is on; the oldest is what the output registers show.
    fifo: VecDeque<[i16; 3]>,
    thermometer: Output<1>,
}

impl Default for Accelerometer {
    fn default() -> Self {
        let mut accelerometer = Self {
            who_am_i: 0x33,
            registers: [0; 0x40],
            sampling: None,
            taken: 0,
            output: Output::new(),
            fifo: VecDeque::new(),
            thermometer: Output::new(),
        };
        accelerometer.reset();
        accelerometer
    }
}

impl Accelerometer {
    /// All registers as after power came; samples keep being counted.
    pub(super) fn reset(&mut self) {
        self.registers = [0; 0x40];
        self.registers[usize::from(CTRL1)] = 0x07;
        self.sampling = None;
        self.output = Output::new();
        self.fifo.clear();
        self.thermometer = Output::new();
    }

    pub(super) fn samples_taken(&self) -> u64 {
        self.taken
    }

    pub(super) fn has_fresh(&self) -> bool {
        self.output.fresh() || !self.fifo.is_empty()
    }

    fn mode(&self) -> FifoMode {
        match self.is_set(CTRL5, CTRL5_FIFO) {
            true => FifoMode::of(self.registers[usize::from(FIFO_CTRL)]),
            false => FifoMode::Bypass,
        }
    }

    /// Whether more samples wait than the threshold says.
    fn above_threshold(&self) -> bool {
        let threshold = self.registers[usize::from(FIFO_CTRL)] & FIFO_CTRL_THRESHOLD;
        self.fifo.len() > usize::from(threshold)
    }

    /// Whether the source has to wait for the reader.
    fn waits(&self) -> bool {
        match self.mode() {
            FifoMode::Bypass => self.output.fresh(),
            _ => self.above_threshold(),
        }
    }

    /// The register after `register`: while the FIFO is on, its samples follow each other.
    pub(super) fn after(&self, register: u8) -> u8 {
        if register == OUT_Z_H && self.mode() != FifoMode::Bypass {
            OUT_X_L
        } else {
            (register + 1) & 0x7F
        }
    }

    pub(super) fn settle(&mut self, now: u64, source: &mut dyn Source) {
        while let Some(time_s) = self.sampling.as_mut().and_then(|s| s.take_due(now)) {
            self.sample(time_s, source);
        }
    }

    fn sample(&mut self, time_s: f64, source: &mut dyn Source) {
        let block_update = self.is_set(CTRL4, CTRL4_BLOCK_UPDATE);
        let conversion = Conversion {
            index: self.taken,
            time_s,
            rate_hz: self.rate_hz().unwrap_or_default(),
            lsb_per_g: self.lsb_per_g(),
            bits: self.bits(),
        };
        if !(source.waits_for_reader() && self.waits())
            && let Some(counts) = source.acceleration(&conversion)
        {
            let on = [0, 1, 2].map(|axis| self.is_set(CTRL1, 1 << axis));
            if self.mode() == FifoMode::Bypass {
                self.output.store(counts.0, on, block_update);
            } else {
                self.queue(counts.0);
            }
            self.taken += 1;
        }
        if self.registers[usize::from(TEMP_CFG)] & TEMP_ENABLE == TEMP_ENABLE {
            // Equation (38): 8 bits at low power, else 10.
            let lsb = (source.temperature_c(time_s) - 25.0) * 256.0;
            let value = quantise(lsb, self.bits().min(10));
            self.thermometer.store([value], [true], block_update);
        }
    }

    /// A new sample replaces the oldest one even while that is read; the datasheet does not specify it.
    fn queue(&mut self, sample: [i16; 3]) {
        let full = self.fifo.len() >= FIFO_SAMPLES;
        if full && self.mode() == FifoMode::Fifo {
            return;
        }
        if full {
            self.fifo.pop_front();
        }
        self.fifo.push_back(sample);
    }

    /// A byte of the oldest sample; its last byte removes it.
    fn unqueue(&mut self, byte: u8) -> u8 {
        let sample = self.fifo.front().copied().unwrap_or_default();
        let bytes = sample.map(i16::to_le_bytes);
        if byte == OUT_Z_H - OUT_X_L {
            self.fifo.pop_front();
        }
        bytes[usize::from(byte / 2)][usize::from(byte % 2)]
    }

    fn fifo_source(&self) -> u8 {
        let on = |condition: bool, bit: u8| if condition { bit } else { 0 };
        on(self.above_threshold(), FIFO_SRC_WATERMARK)
            | on(self.fifo.len() >= FIFO_SAMPLES, FIFO_SRC_FULL)
            | on(self.fifo.is_empty(), FIFO_SRC_EMPTY)
            | (self.fifo.len() as u8).min(FIFO_SRC_LEVEL)
    }

    pub(super) fn read(&mut self, register: u8) -> u8 {
        match register {
            STATUS_AUX => {
                let (fresh, overrun) = (self.thermometer.fresh(), self.thermometer.overrun());
                u8::from(overrun) << 6 | u8::from(fresh) << 2
            }
            OUT_TEMP_L | OUT_TEMP_H => self.thermometer.read(register - OUT_TEMP_L, false),
            WHO_AM_I => self.who_am_i,
            STATUS => self.output.status(),
            OUT_X_L..=OUT_Z_H if self.mode() != FifoMode::Bypass => {
                self.unqueue(register - OUT_X_L)
            }
            OUT_X_L..=OUT_Z_H => {
                // Byte order is the programmer's choice at high resolution only.
                let big_endian = self.is_set(CTRL4, CTRL4_BIG_ENDIAN) && self.bits() == 12;
                self.output.read(register - OUT_X_L, big_endian)
            }
            FIFO_SRC => self.fifo_source(),
            _ => self.registers.get(usize::from(register)).map_or(0, |r| *r),
        }
    }

    pub(super) fn write(&mut self, register: u8, value: u8, now: u64, period_error_ppm: f64) {
        let read_only = matches!(
            register,
            STATUS_AUX..=WHO_AM_I
                | STATUS..=OUT_Z_H
                | FIFO_SRC
                | INT1_SRC
                | INT2_SRC
                | CLICK_SRC
        );
        let rate_before = self.rate_hz();
        match self.registers.get_mut(usize::from(register)) {
            Some(content) if !read_only => *content = value,
            _ => return,
        }
        // Rebooting the trimming values is done before the next byte.
        self.registers[usize::from(CTRL5)] &= !CTRL5_BOOT;
        if self.mode() == FifoMode::Bypass {
            self.fifo.clear();
        }
        let rate = self.rate_hz();
        if rate != rate_before {
            self.sampling = rate.map(|rate| SampleClock::new(rate, now, period_error_ppm));
        }
    }

    /// The level of INT1.
    pub(super) fn int1(&self) -> bool {
        let active_low = self.is_set(CTRL6, CTRL6_ACTIVE_LOW);
        self.interrupts() != active_low
    }

    fn interrupts(&self) -> bool {
        let watermark = self.is_set(CTRL3, CTRL3_WATERMARK) && self.above_threshold();
        let full = self.is_set(CTRL3, CTRL3_OVERRUN) && self.fifo.len() >= FIFO_SAMPLES;
        let ready = self.is_set(CTRL3, CTRL3_DATA_READY) && self.has_fresh();
        watermark || full || ready
    }

    /// When the next sample may raise INT1, µs; `None` if it is raised already, or for nothing.
    pub(super) fn next_data_ready(&self) -> Option<u64> {
        let any = CTRL3_DATA_READY | CTRL3_WATERMARK | CTRL3_OVERRUN;
        if self.is_set(CTRL3, any) && !self.interrupts() {
            self.sampling.map(|sampling| sampling.next_us())
        } else {
            None
        }
    }

    /// Whether any bit of `mask` is set.
    fn is_set(&self, register: u8, mask: u8) -> bool {
        self.registers[usize::from(register)] & mask != 0
    }

    fn bits(&self) -> u32 {
        if self.is_set(CTRL1, CTRL1_LOW_POWER) {
            8
        } else if self.is_set(CTRL4, CTRL4_HIGH_RESOLUTION) {
            12
        } else {
            10
        }
    }

    /// `None` in power-down, and for codes that the datasheet gives no rate for.
    fn rate_hz(&self) -> Option<f64> {
        let low_power = self.is_set(CTRL1, CTRL1_LOW_POWER);
        match (self.registers[usize::from(CTRL1)] >> 4, low_power) {
            (1, _) => Some(1.0),
            (2, _) => Some(10.0),
            (3, _) => Some(25.0),
            (4, _) => Some(50.0),
            (5, _) => Some(100.0),
            (6, _) => Some(200.0),
            (7, _) => Some(400.0),
            (8, true) => Some(1620.0),
            (9, false) => Some(1344.0),
            (9, true) => Some(5376.0),
            _ => None,
        }
    }

    /// Of the 16-bit register; a 12-bit digit is 1/1024, 2/1024, 4/1024 or 12/1024 g.
    fn lsb_per_g(&self) -> f64 {
        match self.registers[usize::from(CTRL4)] >> 4 & 0b11 {
            0b00 => 16384.0,
            0b01 => 8192.0,
            0b10 => 4096.0,
            _ => 16384.0 / 12.0,
        }
    }
}
