//! The LSM303AGR at register level: accelerometer at 0x19, magnetometer at 0x1E, thermometer.
//!
//! Modelled: identities, output data rates, power-down, ranges, resolutions of 8, 10 and 12 bits,
//! left-justified output with block data update and either byte order, axis enables, status with
//! overruns, the FIFO of 32 samples (bypass, FIFO, stream) with its level and threshold, data-ready,
//! watermark and overrun on INT1 of either polarity, thermometer, sub-address increment, which goes
//! back to the first output register while the FIFO is on; magnetometer continuous, single and
//! idle, its offset registers and soft reset. Other registers keep what is written to them and do
//! nothing: the FIFO's trigger, filters, self-test, the interrupt generators and the
//! magnetometer's own pin are not modelled.

mod accelerometer;
mod magnetometer;
mod output;

use crate::chip::Chip;
use crate::source::Source;
use accelerometer::Accelerometer;
use magnetometer::Magnetometer;

/// I²C address of the accelerometer and thermometer.
pub const ACCELEROMETER_ADDRESS: u8 = 0x19;
/// I²C address of the magnetometer.
pub const MAGNETOMETER_ADDRESS: u8 = 0x1E;

/// Both chips of the part.
#[derive(Debug, Default)]
pub(crate) struct Lsm303agr {
    accelerometer: Accelerometer,
    magnetometer: Magnetometer,
    accelerometer_pointer: Pointer,
    magnetometer_pointer: Pointer,
}

/// Which register the next byte is for.
#[derive(Clone, Copy, Debug, Default)]
struct Pointer {
    register: u8,
    increments: bool,
    /// The next byte written is a sub-address.
    expects_register: bool,
}

impl Pointer {
    /// Takes a sub-address; its bit 7 asks for increments.
    fn set(&mut self, sub_address: u8) {
        self.register = sub_address & 0x7F;
        self.increments = sub_address & 0x80 != 0;
        self.expects_register = false;
    }

    /// The register for one byte of data, `after` which the next one is.
    fn next(&mut self, after: impl Fn(u8) -> u8) -> u8 {
        let register = self.register;
        if self.increments {
            self.register = after(register);
        }
        register
    }
}

impl Lsm303agr {
    fn pointer(&mut self, address: u8) -> &mut Pointer {
        if address == MAGNETOMETER_ADDRESS {
            &mut self.magnetometer_pointer
        } else {
            &mut self.accelerometer_pointer
        }
    }
}

impl Chip for Lsm303agr {
    fn settle(&mut self, now: u64, source: &mut dyn Source) {
        self.accelerometer.settle(now, source);
        self.magnetometer.settle(now, source);
    }

    fn reset(&mut self) {
        self.accelerometer.reset();
        self.magnetometer.reset();
    }

    fn acknowledges(&self, address: u8) -> bool {
        matches!(address, ACCELEROMETER_ADDRESS | MAGNETOMETER_ADDRESS)
    }

    fn begin_write(&mut self, address: u8) {
        self.pointer(address).expects_register = true;
    }

    fn write(&mut self, address: u8, byte: u8, now: u64, period_error_ppm: f64) {
        let pointer = self.pointer(address);
        if pointer.expects_register {
            pointer.set(byte);
            return;
        }
        let register = pointer.next(|register| (register + 1) & 0x7F);
        if address == MAGNETOMETER_ADDRESS {
            self.magnetometer.write(register, byte, now, period_error_ppm);
        } else {
            self.accelerometer.write(register, byte, now, period_error_ppm);
        }
    }

    fn read(&mut self, address: u8) -> u8 {
        if address == MAGNETOMETER_ADDRESS {
            let pointer = &mut self.magnetometer_pointer;
            let register = pointer.next(|register| (register + 1) & 0x7F);
            self.magnetometer.read(register)
        } else {
            let pointer = &mut self.accelerometer_pointer;
            let register = pointer.next(|register| self.accelerometer.after(register));
            self.accelerometer.read(register)
        }
    }

    fn interrupt(&self) -> bool {
        self.accelerometer.int1()
    }

    fn next_change(&self) -> Option<u64> {
        self.accelerometer.next_data_ready()
    }

    fn set_identity(&mut self, identity: u8) {
        self.accelerometer.who_am_i = identity;
    }

    fn samples_taken(&self) -> u64 {
        self.accelerometer.samples_taken()
    }

    fn has_unread(&self) -> bool {
        self.accelerometer.has_fresh()
    }
}
