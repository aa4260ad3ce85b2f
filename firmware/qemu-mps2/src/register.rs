//! A register of a peripheral.

/// A 32-bit register.
#[derive(Clone, Copy)]
pub struct Register(*mut u32);

impl Register {
    /// The register at `address`.
    ///
    /// # Safety
    /// There must be one, and reading and writing it must not break anybody's memory.
    pub const unsafe fn at(address: usize) -> Self {
        Self(address as *mut u32)
    }

    /// Its content; reading may have effects.
    pub fn read(self) -> u32 {
        // SAFETY: whoever made it said that there is a register.
        unsafe { self.0.read_volatile() }
    }

    /// Writes it.
    pub fn write(self, value: u32) {
        // SAFETY: whoever made it said that there is a register.
        unsafe { self.0.write_volatile(value) }
    }
}
