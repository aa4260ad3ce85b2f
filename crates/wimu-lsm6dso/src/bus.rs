/// I²C address of the chip, selected by the level of its pin SDO/SA0 (DS12140 §5.1).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Address {
    /// The pin is low: 0x6A.
    #[default]
    Low = 0x6A,
    /// The pin is high: 0x6B.
    High = 0x6B,
}

impl From<Address> for u8 {
    fn from(address: Address) -> u8 {
        address as u8
    }
}

/// The chip on an I²C bus, up to 400 kHz, or 1 MHz in fast mode plus; SPI works in mode 0 or 3, up to 10 MHz.
pub type I2cBus<I> = wimu_registers::I2cBus<I, Address>;
