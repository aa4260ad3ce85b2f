//! The magnetometer's registers.

use super::output::Output;
use crate::sampling::SampleClock;
use crate::source::{Source, quantise};

const OFFSET_X_L: u8 = 0x45;
const WHO_AM_I: u8 = 0x4F;
const CFG_A: u8 = 0x60;
const CFG_C: u8 = 0x62;
const INT_SOURCE: u8 = 0x64;
const STATUS: u8 = 0x67;
const OUT_X_L: u8 = 0x68;
const OUT_Z_H: u8 = 0x6D;

const CFG_A_REBOOT: u8 = 0x40;
const CFG_A_SOFT_RESET: u8 = 0x20;
const CFG_A_LOW_POWER: u8 = 0x10;
const CFG_A_RATE_AND_MODE: u8 = 0x0F;
const CFG_A_MODE: u8 = 0x03;
const MODE_CONTINUOUS: u8 = 0b00;
const MODE_SINGLE: u8 = 0b01;
const MODE_IDLE: u8 = 0b11;
const CFG_C_BLOCK_UPDATE: u8 = 0x10;
const CFG_C_BIG_ENDIAN: u8 = 0x08;

/// 1.5 mG.
const NT_PER_LSB: f64 = 150.0;
/// Time of a single measurement, µs.
const SINGLE_HIGH_RESOLUTION_US: u64 = 9_400;
const SINGLE_LOW_POWER_US: u64 = 6_400;

#[derive(Debug)]
pub(super) struct Magnetometer {
    registers: [u8; 0x70],
    measuring: Measuring,
    taken: u64,
    output: Output<3>,
}

#[derive(Clone, Copy, Debug)]
enum Measuring {
    Idle,
    Once { done_us: u64 },
    Continuously(SampleClock),
}

impl Default for Magnetometer {
    fn default() -> Self {
        let mut magnetometer = Self {
            registers: [0; 0x70],
            measuring: Measuring::Idle,
            taken: 0,
            output: Output::new(),
        };
        magnetometer.reset();
        magnetometer
    }
}

impl Magnetometer {
    /// All registers as after power came; samples keep being counted.
    pub(super) fn reset(&mut self) {
        self.registers = [0; 0x70];
        self.registers[usize::from(WHO_AM_I)] = 0x40;
        self.registers[usize::from(CFG_A)] = MODE_IDLE;
        self.measuring = Measuring::Idle;
        self.output = Output::new();
    }

    pub(super) fn settle(&mut self, now: u64, source: &mut dyn Source) {
        match self.measuring {
            Measuring::Idle => {}
            Measuring::Once { done_us } if done_us > now => {}
            Measuring::Once { done_us } => {
                self.sample(done_us as f64 * 1e-6, source);
                self.measuring = Measuring::Idle;
                self.registers[usize::from(CFG_A)] |= MODE_IDLE;
            }
            Measuring::Continuously(mut sampling) => {
                while let Some(time_s) = sampling.take_due(now) {
                    self.sample(time_s, source);
                }
                self.measuring = Measuring::Continuously(sampling);
            }
        }
    }

    fn sample(&mut self, time_s: f64, source: &mut dyn Source) {
        let field = source.magnetic_field_nt(self.taken, time_s);
        self.taken += 1;
        let counts = std::array::from_fn(|axis| {
            let low = usize::from(OFFSET_X_L) + 2 * axis;
            let offset = i16::from_le_bytes([self.registers[low], self.registers[low + 1]]);
            quantise(field[axis] / NT_PER_LSB - f64::from(offset), 16)
        });
        let block_update = self.is_set(CFG_C, CFG_C_BLOCK_UPDATE);
        self.output.store(counts, [true; 3], block_update);
    }

    pub(super) fn read(&mut self, register: u8) -> u8 {
        match register {
            STATUS => self.output.status(),
            OUT_X_L..=OUT_Z_H => {
                let big_endian = self.is_set(CFG_C, CFG_C_BIG_ENDIAN);
                self.output.read(register - OUT_X_L, big_endian)
            }
            _ => self.registers.get(usize::from(register)).map_or(0, |r| *r),
        }
    }

    pub(super) fn write(&mut self, register: u8, value: u8, now: u64, period_error_ppm: f64) {
        let read_only = matches!(register, WHO_AM_I | INT_SOURCE | STATUS..=OUT_Z_H);
        let before = self.registers[usize::from(CFG_A)];
        match self.registers.get_mut(usize::from(register)) {
            Some(content) if !read_only => *content = value,
            _ => return,
        }
        if register != CFG_A {
            return;
        }
        if value & CFG_A_SOFT_RESET != 0 {
            self.reset();
            return;
        }
        self.registers[usize::from(CFG_A)] &= !CFG_A_REBOOT;
        let rate_hz = [10.0, 20.0, 50.0, 100.0][usize::from(value >> 2 & 0b11)];
        match value & CFG_A_MODE {
            MODE_SINGLE => {
                let time_us = if value & CFG_A_LOW_POWER != 0 {
                    SINGLE_LOW_POWER_US
                } else {
                    SINGLE_HIGH_RESOLUTION_US
                };
                let done_us = now + time_us;
                self.measuring = Measuring::Once { done_us };
            }
            // Written again as it is, the rate keeps its phase.
            MODE_CONTINUOUS if (value ^ before) & CFG_A_RATE_AND_MODE == 0 => {}
            MODE_CONTINUOUS => {
                let sampling = SampleClock::new(rate_hz, now, period_error_ppm);
                self.measuring = Measuring::Continuously(sampling);
            }
            _ => self.measuring = Measuring::Idle,
        }
    }

    fn is_set(&self, register: u8, mask: u8) -> bool {
        self.registers[usize::from(register)] & mask != 0
    }
}
