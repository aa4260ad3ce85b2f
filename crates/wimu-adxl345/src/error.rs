use core::fmt;

/// A failure of the sensor.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Error<E> {
    /// The bus failed.
    Bus(E),
    /// Another chip is at the address.
    WrongIdentity {
        /// Its DEVID, instead of [`Adxl345::IDENTITY`](crate::Adxl345::IDENTITY).
        found: u8,
    },
}

impl<E> From<E> for Error<E> {
    fn from(error: E) -> Self {
        Self::Bus(error)
    }
}

impl<E: fmt::Debug> fmt::Display for Error<E> {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Bus(error) => write!(
                out,
                "the ADXL345 cannot be reached ({error:?}): check its supply, its wiring, pull-ups and address"
            ),
            Self::WrongIdentity { found } => write!(
                out,
                "the chip at the ADXL345's address identifies itself as {found:#04x}, expected 0xe5: check which board this is"
            ),
        }
    }
}

impl<E: fmt::Debug> core::error::Error for Error<E> {}
