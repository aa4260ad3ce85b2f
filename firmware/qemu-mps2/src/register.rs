//! A register of a peripheral.

/// A 32-bit register.
#[derive(Clone, Copy)]
pub struct Register(*mut u32);

impl Register {
    /// The register at `address`.
    ///
    /// # Safety
    /// There must be one, and accesses to it must not affect memory.
    pub const unsafe fn at(address: usize) -> Self {
        Self(address as *mut u32)
    }

    /// Reads the register, which may have side effects.
    pub fn read(self) -> u32 {
        // SAFETY: guaranteed by the caller of `at`.
        unsafe { self.0.read_volatile() }
    }

    /// Writes the register.
    pub fn write(self, value: u32) {
        // SAFETY: guaranteed by the caller of `at`.
        unsafe { self.0.write_volatile(value) }
    }
}
