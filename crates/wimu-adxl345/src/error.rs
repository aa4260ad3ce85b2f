use core::fmt;

/// A failure of the sensor.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Error<E> {
    /// No chip acknowledges the I²C address, or the SPI data line stays at one level.
    NotAnswering,
    /// A transfer failed.
    Bus(E),
    /// Another chip is on the bus.
    WrongIdentity {
        /// Its DEVID, instead of [`Adxl345::IDENTITY`](crate::Adxl345::IDENTITY).
        found: u8,
    },
}

impl<E: fmt::Debug> fmt::Display for Error<E> {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::NotAnswering => out.write_str(
                "the ADXL345 does not answer: check its supply, its wiring and its address or chip select",
            ),
            Self::Bus(error) => write!(
                out,
                "a transfer to the ADXL345 failed ({error:?}): check its wiring, pull-ups and the bus frequency"
            ),
            Self::WrongIdentity { found } => write!(
                out,
                "the chip found instead of an ADXL345 identifies itself as {found:#04x}, expected 0xe5: check which board this is"
            ),
        }
    }
}

impl<E: fmt::Debug> core::error::Error for Error<E> {}
