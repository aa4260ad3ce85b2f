//! Interface of a sensor chip.

use std::fmt;

use wimu_model::Counts;

use crate::sampling::SampleClock;
use crate::source::Source;

/// How a gyroscope fails.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum GyroscopeFault {
    /// It works.
    #[default]
    None,
    /// It takes no samples: no new words in the FIFO, output registers unchanged.
    Stops,
    /// It repeats its last sample for ever.
    Stuck,
    /// Every axis reads positive full scale.
    Saturates,
}

/// Mode of a FIFO.
#[derive(Clone, Copy, PartialEq)]
pub(crate) enum FifoMode {
    Bypass,
    Fifo,
    Stream,
}

impl FifoMode {
    /// Mode in the two highest bits of a control register; trigger mode is not modelled.
    pub(crate) fn of(control: u8) -> Self {
        match control >> 6 {
            0b00 => Self::Bypass,
            0b01 => Self::Fifo,
            _ => Self::Stream,
        }
    }
}

/// The registers of a chip: a message begins with a register's number, data follow.
#[derive(Clone, Debug)]
pub(crate) struct Registers {
    bytes: [u8; 0x80],
    /// The register of the next byte of data.
    pub pointer: u8,
    /// Whether the highest bit of the register's number was set.
    pub increments: bool,
    expects_number: bool,
}

impl Default for Registers {
    fn default() -> Self {
        Self { bytes: [0; 0x80], pointer: 0, increments: false, expects_number: false }
    }
}

impl Registers {
    /// Content of a register, 0..=127.
    pub(crate) fn get(&self, register: u8) -> u8 {
        self.bytes[usize::from(register & 0x7F)]
    }

    /// Whether any bit of `mask` is set.
    pub(crate) fn is_set(&self, register: u8, mask: u8) -> bool {
        self.get(register) & mask != 0
    }

    pub(crate) fn set(&mut self, register: u8, content: u8) {
        self.bytes[usize::from(register & 0x7F)] = content;
    }

    /// A message begins.
    pub(crate) fn begin(&mut self) {
        self.expects_number = true;
    }

    /// Whether this byte is the message's first: the number of a register.
    pub(crate) fn takes_number(&mut self, byte: u8) -> bool {
        let is_first = std::mem::take(&mut self.expects_number);
        if is_first {
            (self.pointer, self.increments) = (byte & 0x7F, byte & 0x80 != 0);
        }
        is_first
    }

    /// All registers are zero; the message goes on.
    pub(crate) fn clear(&mut self) {
        self.bytes = [0; 0x80];
    }
}

/// What every chip has.
#[derive(Debug, Default)]
pub(crate) struct Core {
    /// Content of its identification register.
    pub identity: u8,
    pub fault: GyroscopeFault,
    pub registers: Registers,
    /// While it takes samples.
    pub sampling: Option<SampleClock>,
    /// Accelerometer samples taken since it was made, read or not.
    pub taken: u64,
}

impl Core {
    /// Of a chip that identifies itself as `identity`.
    pub(crate) fn of(identity: u8) -> Self {
        Self { identity, ..Self::default() }
    }

    /// All registers are zero, and no samples are taken.
    pub(crate) fn clear(&mut self) {
        self.registers.clear();
        self.sampling = None;
    }

    /// Angular rate of a gyroscope that has turned on or not, LSB: its last output where it gives no other.
    pub(crate) fn angular_rate(
        &self,
        is_on: bool,
        last: [i16; 3],
        measured: impl FnOnce() -> Counts,
    ) -> [i16; 3] {
        match self.fault {
            GyroscopeFault::None if is_on => measured().0,
            GyroscopeFault::Saturates => [i16::MAX; 3],
            _ => last,
        }
    }
}

/// The behaviour of a chip.
pub(crate) trait Chip: fmt::Debug {
    fn core(&self) -> &Core;
    fn core_mut(&mut self) -> &mut Core;
    /// Takes a sample at a time, s, or of another rate than the accelerometer's what is due then.
    fn sample(&mut self, time_s: f64, source: &mut dyn Source);
    /// All registers as after power-on.
    fn reset(&mut self);
    /// Whether it answers at the 7-bit `address`.
    fn acknowledges(&self, address: u8) -> bool;
    /// A message to `address` begins.
    fn begin_write(&mut self, _address: u8) {
        self.core_mut().registers.begin();
    }
    /// The next byte of it.
    fn write(&mut self, address: u8, byte: u8, now: u64, period_error_ppm: f64);
    /// The next byte from `address`.
    fn read(&mut self, address: u8) -> u8;
    /// The level of its interrupt line.
    fn interrupt(&self) -> bool;
    /// Whether unread samples are waiting.
    fn has_unread(&self) -> bool;

    /// Takes the samples that are due by `now` (µs).
    fn settle(&mut self, now: u64, source: &mut dyn Source) {
        self.take_due(now, source);
    }
    /// The same without what else is due.
    fn take_due(&mut self, now: u64, source: &mut dyn Source) {
        while let Some(time_s) = self.core_mut().sampling.as_mut().and_then(|s| s.take_due(now)) {
            self.sample(time_s, source);
        }
    }
    /// Time at which the interrupt line may next change by itself, µs.
    fn next_change(&self) -> Option<u64> {
        self.core().sampling.map(|sampling| sampling.next_us())
    }
    /// Content of a register.
    fn register(&self, register: u8) -> u8 {
        self.core().registers.get(register)
    }
    /// Whether any bit of `mask` is set in a register.
    fn is_set(&self, register: u8, mask: u8) -> bool {
        self.core().registers.is_set(register, mask)
    }
}
