//! The sensor's bus.

use embedded_hal_async::i2c::{ErrorType, I2c, Operation};
use esp_hal::Async;
use esp_hal::i2c::master::{Error, I2c as Master};

/// I²C that the sampler's executor may own.
pub struct Bus(pub Master<'static, Async>);

// SAFETY: it must not change its processor, and there is only one.
unsafe impl Send for Bus {}

impl ErrorType for Bus {
    type Error = Error;
}

impl I2c for Bus {
    async fn transaction(
        &mut self,
        address: u8,
        operations: &mut [Operation<'_>],
    ) -> Result<(), Error> {
        I2c::transaction(&mut self.0, address, operations).await
    }
}
