//! I²C with a timeout.

use core::fmt;

use embedded_hal_async::i2c::{Error, ErrorKind, ErrorType, I2c, Operation};
use wimu_model::DeviceTimeUs;

use crate::timer::Timer;

/// Timeout of a transaction, µs. The longest one, a FIFO burst of 16 samples of six axes, takes 5.1 ms at 400 kHz.
const TIMEOUT_US: u64 = 25_000;

/// An I²C bus with a timeout of 25 ms per transaction.
///
/// Controllers wait without a limit while a line of the bus is held low. After the timeout the transaction's
/// future is dropped; `I2C` must stop then, and work again with the next transaction.
pub struct TimeoutBus<I2C, T> {
    bus: I2C,
    timer: T,
}

impl<I2C, T: Timer> TimeoutBus<I2C, T> {
    /// Adds the timeout to `bus`.
    pub fn new(bus: I2C, timer: T) -> Self {
        Self { bus, timer }
    }
}

impl<I2C: ErrorType, T> ErrorType for TimeoutBus<I2C, T> {
    type Error = BusError<I2C::Error>;
}

impl<I2C: I2c, T: Timer> I2c for TimeoutBus<I2C, T> {
    // `write`, `read` and `write_read` call this one.
    async fn transaction(
        &mut self,
        address: u8,
        operations: &mut [Operation<'_>],
    ) -> Result<(), Self::Error> {
        let transfer = self.bus.transaction(address, operations);
        in_time(&self.timer, transfer).await
    }
}

async fn in_time<E>(
    timer: &impl Timer,
    transfer: impl Future<Output = Result<(), E>>,
) -> Result<(), BusError<E>> {
    let end = DeviceTimeUs(timer.now().0.saturating_add(TIMEOUT_US));
    match timer.before(end, transfer).await {
        Some(result) => result.map_err(BusError::Transfer),
        None => Err(BusError::Held),
    }
}

/// Why a transaction of a [`TimeoutBus`] failed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum BusError<E> {
    /// The error of the bus.
    Transfer(E),
    /// Timeout: a line of the bus is held low.
    Held,
}

impl<E: Error> Error for BusError<E> {
    fn kind(&self) -> ErrorKind {
        match self {
            Self::Transfer(error) => error.kind(),
            Self::Held => ErrorKind::Bus,
        }
    }
}

impl<E: fmt::Debug> fmt::Display for BusError<E> {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Transfer(error) => write!(out, "the transfer failed: {error:?}"),
            Self::Held => out
                .write_str("the bus timed out: a line is held low; check its wiring and pull-ups"),
        }
    }
}

impl<E: fmt::Debug> core::error::Error for BusError<E> {}
