//! The sensor's bus.

use embassy_nrf::pac;
use embassy_nrf::twim::{Error, Twim};
use embedded_hal_async::i2c::{ErrorType, I2c, Operation};

/// [`Twim`], whose transfers really end when they are given up: its DMA would go on writing where
/// the caller's buffer was.
pub struct Bus(pub Twim<'static>);

/// Switches the peripheral off, which ends its transfer, and on again: its settings stay.
struct GiveUp;

impl Drop for GiveUp {
    fn drop(&mut self) {
        pac::TWIM0
            .enable()
            .write(|w| w.set_enable(pac::twim::vals::Enable::Disabled));
        pac::TWIM0
            .enable()
            .write(|w| w.set_enable(pac::twim::vals::Enable::Enabled));
    }
}

impl ErrorType for Bus {
    type Error = Error;
}

impl I2c for Bus {
    async fn transaction(
        &mut self,
        address: u8,
        operations: &mut [Operation<'_>],
    ) -> Result<(), Error> {
        let give_up = GiveUp;
        let outcome = self.0.transaction(address, operations).await;
        core::mem::forget(give_up);
        outcome
    }
}
