use core::fmt;

/// Why the sensor could not be used. `E` is the error of the bus.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Error<E> {
    /// No chip acknowledges the I²C address, or the SPI data line stays at one level.
    NotAnswering,
    /// A transfer failed.
    Bus(E),
    /// Another chip is on the bus.
    WrongIdentity {
        /// Its WHO_AM_I, instead of [`Lsm6dso::IDENTITY`](crate::Lsm6dso::IDENTITY).
        found: u8,
    },
    /// The chip did not finish its software reset within 10 ms.
    ResetTimeout,
}

impl<E: fmt::Debug> fmt::Display for Error<E> {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::NotAnswering => out.write_str(
                "the LSM6DSO does not answer: check its supply, its wiring and its address or chip select",
            ),
            Self::Bus(error) => write!(
                out,
                "a transfer to the LSM6DSO failed ({error:?}): check its wiring and the bus frequency"
            ),
            Self::WrongIdentity { found } => write!(
                out,
                "the chip found instead of an LSM6DSO identifies itself as {found:#04x}, not 0x6c: check which board this is"
            ),
            Self::ResetTimeout => out.write_str(
                "the LSM6DSO did not finish its software reset within 10 ms: check its supply",
            ),
        }
    }
}

impl<E: fmt::Debug> core::error::Error for Error<E> {}
