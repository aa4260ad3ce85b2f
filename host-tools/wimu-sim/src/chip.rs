//! Interface of a sensor chip.

use std::fmt;

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

/// The behaviour of a chip.
pub(crate) trait Chip: fmt::Debug {
    /// Takes the samples that are due by `now` (µs).
    fn settle(&mut self, now: u64, source: &mut dyn Source);
    /// All registers as after power-on.
    fn reset(&mut self);
    /// Whether it answers at the 7-bit `address`.
    fn acknowledges(&self, address: u8) -> bool;
    /// A message to `address` begins.
    fn begin_write(&mut self, address: u8);
    /// The next byte of it.
    fn write(&mut self, address: u8, byte: u8, now: u64, period_error_ppm: f64);
    /// The next byte from `address`.
    fn read(&mut self, address: u8) -> u8;
    /// The level of its interrupt line.
    fn interrupt(&self) -> bool;
    /// Time at which that may next change by itself, µs.
    fn next_change(&self) -> Option<u64>;
    /// Makes it identify itself as `identity`.
    fn set_identity(&mut self, identity: u8);
    /// Breaks its gyroscope, or repairs it.
    fn set_gyroscope_fault(&mut self, _fault: GyroscopeFault) {}
    /// Accelerometer samples taken since it was made, read or not.
    fn samples_taken(&self) -> u64;
    /// Whether unread samples are waiting.
    fn has_unread(&self) -> bool;
}
