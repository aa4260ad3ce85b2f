//! The LSM303AGR at register level: accelerometer at 0x19, magnetometer at 0x1E, thermometer.
//!
//! Modelled: identities, output data rates, power-down, ranges, resolutions of 8, 10 and 12 bits, left-justified output
//! with its status, the FIFO of 32 samples (bypass, FIFO, stream) with level and threshold, data-ready, watermark and
//! overrun on INT1 of either polarity, thermometer, sub-address increment, which goes back to the first output register
//! while the FIFO is on; magnetometer in continuous mode. Other registers keep what is written to them and do nothing:
//! block data update, byte order, axis enables, filters, self-test, interrupt generators, the magnetometer's single mode,
//! offsets, reset and pin.

use std::collections::VecDeque;

use crate::chip::{Chip, Core, FifoMode, Registers};
use crate::sampling::SampleClock;
use crate::source::{Conversion, Source, quantise};

/// I²C address of the accelerometer and thermometer.
pub const ACCELEROMETER_ADDRESS: u8 = 0x19;
/// I²C address of the magnetometer.
pub const MAGNETOMETER_ADDRESS: u8 = 0x1E;

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
/// Registers of the magnetometer.
const WHO_AM_I_M: u8 = 0x4F;
const CFG_A_M: u8 = 0x60;
const STATUS_M: u8 = 0x67;
const OUT_X_L_M: u8 = 0x68;
const OUT_Z_H_M: u8 = 0x6D;

const CTRL1_LOW_POWER: u8 = 0x08;
const CTRL3_DATA_READY: u8 = 0x18;
const CTRL3_WATERMARK: u8 = 0x04;
const CTRL3_OVERRUN: u8 = 0x02;
const CTRL4_HIGH_RESOLUTION: u8 = 0x08;
const CTRL5_FIFO: u8 = 0x40;
const CTRL6_ACTIVE_LOW: u8 = 0x02;
const TEMP_ENABLE: u8 = 0xC0;
const FIFO_THRESHOLD: u8 = 0x1F;
const FIFO_SRC_WATERMARK: u8 = 0x80;
const FIFO_SRC_FULL: u8 = 0x40;
const FIFO_SRC_EMPTY: u8 = 0x20;
const FIFO_SRC_LEVEL: u8 = 0x1F;
const CFG_A_M_RATE_AND_MODE: u8 = 0x0F;
const CFG_A_M_IDLE: u8 = 0x03;

const FIFO_SAMPLES: usize = 32;
/// 1.5 mG.
const NT_PER_LSB: f64 = 150.0;

/// Both chips of the part.
#[derive(Debug)]
pub(crate) struct Lsm303agr {
    /// With the registers of the accelerometer.
    core: Core,
    output: Output<3>,
    /// Samples that wait, while it is on; the oldest is what the output registers show.
    fifo: VecDeque<[i16; 3]>,
    thermometer: Output<1>,
    magnetometer: Registers,
    measuring: Option<SampleClock>,
    measured: u64,
    field: Output<3>,
}

impl Default for Lsm303agr {
    fn default() -> Self {
        let mut chip = Self {
            core: Core::of(0x33),
            output: Output::default(),
            fifo: VecDeque::new(),
            thermometer: Output::default(),
            magnetometer: Registers::default(),
            measuring: None,
            measured: 0,
            field: Output::default(),
        };
        chip.reset();
        chip
    }
}

/// Output registers, low byte first, with "new data" and "overrun".
#[derive(Clone, Copy, Debug)]
struct Output<const N: usize> {
    shown: [i16; N],
    fresh: bool,
    overrun: bool,
}

impl<const N: usize> Default for Output<N> {
    fn default() -> Self {
        Self { shown: [0; N], fresh: false, overrun: false }
    }
}

impl<const N: usize> Output<N> {
    fn store(&mut self, values: [i16; N]) {
        *self = Self { shown: values, fresh: true, overrun: self.fresh };
    }

    /// Byte `byte` (0..2 N); the last one ends "new data".
    fn read(&mut self, byte: u8) -> u8 {
        let byte = usize::from(byte);
        if byte + 1 == 2 * N {
            (self.fresh, self.overrun) = (false, false);
        }
        self.shown[byte / 2].to_le_bytes()[byte % 2]
    }

    /// The status register of three channels: ZYXOR, ZOR, YOR, XOR, ZYXDA, ZDA, YDA, XDA.
    fn status(&self) -> u8 {
        (0xF0 * u8::from(self.overrun)) | (0x0F * u8::from(self.fresh))
    }
}

impl Lsm303agr {
    fn mode(&self) -> FifoMode {
        if self.core.registers.is_set(CTRL5, CTRL5_FIFO) {
            FifoMode::of(self.core.registers.get(FIFO_CTRL))
        } else {
            FifoMode::Bypass
        }
    }

    /// Whether more samples wait than the threshold says.
    fn above_threshold(&self) -> bool {
        self.fifo.len() > usize::from(self.core.registers.get(FIFO_CTRL) & FIFO_THRESHOLD)
    }

    fn bits(&self) -> u32 {
        match self.core.registers.is_set(CTRL1, CTRL1_LOW_POWER) {
            true => 8,
            false if self.core.registers.is_set(CTRL4, CTRL4_HIGH_RESOLUTION) => 12,
            false => 10,
        }
    }

    /// `None` in power-down, and for codes that the datasheet gives no rate for.
    fn rate_hz(&self) -> Option<f64> {
        let low_power = self.core.registers.is_set(CTRL1, CTRL1_LOW_POWER);
        match (self.core.registers.get(CTRL1) >> 4, low_power) {
            (code @ 1..=7, _) => {
                Some([1.0, 10.0, 25.0, 50.0, 100.0, 200.0, 400.0][usize::from(code) - 1])
            }
            (8, true) => Some(1620.0),
            (9, false) => Some(1344.0),
            (9, true) => Some(5376.0),
            _ => None,
        }
    }

    /// Of the 16-bit register; a 12-bit digit is 1/1024, 2/1024, 4/1024 or 12/1024 g.
    fn lsb_per_g(&self) -> f64 {
        let range = self.core.registers.get(CTRL4) >> 4 & 0b11;
        [16384.0, 8192.0, 4096.0, 16384.0 / 12.0][usize::from(range)]
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
        if byte == OUT_Z_H - OUT_X_L {
            self.fifo.pop_front();
        }
        sample[usize::from(byte / 2)].to_le_bytes()[usize::from(byte % 2)]
    }

    fn fifo_source(&self) -> u8 {
        let on = |condition: bool, bit: u8| if condition { bit } else { 0 };
        on(self.above_threshold(), FIFO_SRC_WATERMARK)
            | on(self.fifo.len() >= FIFO_SAMPLES, FIFO_SRC_FULL)
            | on(self.fifo.is_empty(), FIFO_SRC_EMPTY)
            | (self.fifo.len() as u8).min(FIFO_SRC_LEVEL)
    }

    fn interrupts(&self) -> bool {
        let is_on = |mask| self.core.registers.is_set(CTRL3, mask);
        (is_on(CTRL3_WATERMARK) && self.above_threshold())
            || (is_on(CTRL3_OVERRUN) && self.fifo.len() >= FIFO_SAMPLES)
            || (is_on(CTRL3_DATA_READY) && self.has_unread())
    }

    fn registers(&mut self, address: u8) -> &mut Registers {
        match address {
            MAGNETOMETER_ADDRESS => &mut self.magnetometer,
            _ => &mut self.core.registers,
        }
    }

    /// The register of the next byte, after which the pointer goes on if that is wanted.
    fn next_register(&mut self, address: u8) -> u8 {
        let wraps = address == ACCELEROMETER_ADDRESS && self.mode() != FifoMode::Bypass;
        let registers = self.registers(address);
        let register = registers.pointer;
        if registers.increments {
            // The samples of the FIFO follow each other.
            registers.pointer = match register {
                OUT_Z_H if wraps => OUT_X_L,
                _ => (register + 1) & 0x7F,
            };
        }
        register
    }
}

impl Chip for Lsm303agr {
    fn core(&self) -> &Core {
        &self.core
    }

    fn core_mut(&mut self) -> &mut Core {
        &mut self.core
    }

    fn sample(&mut self, time_s: f64, source: &mut dyn Source) {
        let conversion = Conversion {
            index: self.core.taken,
            time_s,
            rate_hz: self.rate_hz().unwrap_or_default(),
            lsb_per_g: self.lsb_per_g(),
            bits: self.bits(),
        };
        let is_bypassed = self.mode() == FifoMode::Bypass;
        let waits = if is_bypassed { self.output.fresh } else { self.above_threshold() };
        if !(source.waits_for_reader() && waits)
            && let Some(counts) = source.acceleration(&conversion)
        {
            if is_bypassed {
                self.output.store(counts.0);
            } else {
                self.queue(counts.0);
            }
            self.core.taken += 1;
        }
        if self.core.registers.get(TEMP_CFG) & TEMP_ENABLE == TEMP_ENABLE {
            // Equation (38): 8 bits at low power, else 10.
            let lsb = (source.temperature_c(time_s) - 25.0) * 256.0;
            self.thermometer.store([quantise(lsb, self.bits().min(10))]);
        }
    }

    fn settle(&mut self, now: u64, source: &mut dyn Source) {
        self.take_due(now, source);
        while let Some(time_s) = self.measuring.as_mut().and_then(|m| m.take_due(now)) {
            let field = source.magnetic_field_nt(self.measured, time_s);
            self.measured += 1;
            self.field.store(field.map(|nt| quantise(nt / NT_PER_LSB, 16)));
        }
    }

    /// Samples keep being counted.
    fn reset(&mut self) {
        (self.core.registers, self.core.sampling) = (Registers::default(), None);
        self.core.registers.set(CTRL1, 0x07);
        self.output = Output::default();
        self.fifo.clear();
        self.thermometer = Output::default();
        self.magnetometer = Registers::default();
        self.magnetometer.set(WHO_AM_I_M, 0x40);
        self.magnetometer.set(CFG_A_M, CFG_A_M_IDLE);
        self.measuring = None;
        self.field = Output::default();
    }

    fn acknowledges(&self, address: u8) -> bool {
        matches!(address, ACCELEROMETER_ADDRESS | MAGNETOMETER_ADDRESS)
    }

    fn begin_write(&mut self, address: u8) {
        self.registers(address).begin();
    }

    fn write(&mut self, address: u8, byte: u8, now: u64, period_error_ppm: f64) {
        if self.registers(address).takes_number(byte) {
            return;
        }
        let register = self.next_register(address);
        let clock = |rate| SampleClock::new(rate, now, period_error_ppm);
        if address == MAGNETOMETER_ADDRESS {
            if matches!(register, WHO_AM_I_M | STATUS_M..=OUT_Z_H_M) {
                return;
            }
            let before = self.magnetometer.get(CFG_A_M);
            self.magnetometer.set(register, byte);
            // Written again as it is, the rate keeps its phase.
            let after = self.magnetometer.get(CFG_A_M);
            if (before ^ after) & CFG_A_M_RATE_AND_MODE != 0 {
                let rate_hz = [10.0, 20.0, 50.0, 100.0][usize::from(after >> 2 & 0b11)];
                self.measuring = (after & CFG_A_M_IDLE == 0).then(|| clock(rate_hz));
            }
            return;
        }
        if matches!(register, STATUS_AUX..=WHO_AM_I | STATUS..=OUT_Z_H | FIFO_SRC) {
            return;
        }
        let rate_before = self.rate_hz();
        self.core.registers.set(register, byte);
        if self.mode() == FifoMode::Bypass {
            self.fifo.clear();
        }
        let rate = self.rate_hz();
        if rate != rate_before {
            self.core.sampling = rate.map(clock);
        }
    }

    fn read(&mut self, address: u8) -> u8 {
        let register = self.next_register(address);
        match (address, register) {
            (MAGNETOMETER_ADDRESS, STATUS_M) => self.field.status(),
            (MAGNETOMETER_ADDRESS, OUT_X_L_M..=OUT_Z_H_M) => self.field.read(register - OUT_X_L_M),
            (MAGNETOMETER_ADDRESS, _) => self.magnetometer.get(register),
            (_, STATUS_AUX) => self.thermometer.status() & 0x44,
            (_, OUT_TEMP_L | OUT_TEMP_H) => self.thermometer.read(register - OUT_TEMP_L),
            (_, WHO_AM_I) => self.core.identity,
            (_, STATUS) => self.output.status(),
            (_, OUT_X_L..=OUT_Z_H) if self.mode() != FifoMode::Bypass => {
                self.unqueue(register - OUT_X_L)
            }
            (_, OUT_X_L..=OUT_Z_H) => self.output.read(register - OUT_X_L),
            (_, FIFO_SRC) => self.fifo_source(),
            _ => self.core.registers.get(register),
        }
    }

    fn interrupt(&self) -> bool {
        self.interrupts() != self.core.registers.is_set(CTRL6, CTRL6_ACTIVE_LOW)
    }

    /// `None` if INT1 is raised already, or for nothing.
    fn next_change(&self) -> Option<u64> {
        let any = CTRL3_DATA_READY | CTRL3_WATERMARK | CTRL3_OVERRUN;
        let may_rise = self.core.registers.is_set(CTRL3, any) && !self.interrupts();
        self.core.sampling.filter(|_| may_rise).map(|sampling| sampling.next_us())
    }

    fn has_unread(&self) -> bool {
        self.output.fresh || !self.fifo.is_empty()
    }
}
