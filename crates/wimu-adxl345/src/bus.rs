use wimu_registers::SpiRead;

/// A sample is read in one burst. The delay is the minimum time between reading a sample and the next access to
/// the FIFO (datasheet, "Retrieving data from FIFO").
pub(crate) const SPI: SpiRead = SpiRead { multiple: 0x40, delay_ns: 5_000 };

/// The chip's address, by the level of its pin SDO/ALT ADDRESS.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Address {
    /// The pin is low: 0x53, as on most breakout boards.
    #[default]
    Low = 0x53,
    /// The pin is high: 0x1D.
    High = 0x1D,
}

impl From<Address> for u8 {
    fn from(address: Address) -> u8 {
        address as u8
    }
}

/// The chip on an I²C bus, up to 400 kHz. On SPI, mode 3 up to 5 MHz, the device must support delays within a
/// transaction.
pub type I2cBus<I> = wimu_registers::I2cBus<I, Address>;
