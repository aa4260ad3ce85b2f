//! The sensor's bus.

use embassy_nrf::pac;
use embassy_nrf::twim::{Error, Twim};
use embedded_hal_async::i2c::{ErrorType, I2c, Operation};

/// [`Twim`] on TWISPI0 that stops a transfer when its future is dropped. Otherwise its DMA would continue to write to
/// the dropped buffer.
pub struct Bus(pub Twim<'static>);

/// Disables the peripheral when dropped, which ends its transfer, and enables it again; its settings remain.
struct Abort;

impl Drop for Abort {
    fn drop(&mut self) {
        pac::TWIM0.enable().write(|w| w.set_enable(pac::twim::vals::Enable::Disabled));
        pac::TWIM0.enable().write(|w| w.set_enable(pac::twim::vals::Enable::Enabled));
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
        let abort = Abort;
        let outcome = self.0.transaction(address, operations).await;
        core::mem::forget(abort);
        outcome
    }
}
