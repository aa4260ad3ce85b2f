//! The sensor's bus.

use embassy_nrf::gpio::Pin;
use embassy_nrf::interrupt::typelevel::{self, Binding};
use embassy_nrf::peripherals::TWISPI0;
use embassy_nrf::twim::{Config, Error, Frequency, InterruptHandler, Twim};
use embassy_nrf::{Peri, pac};
use embedded_hal_async::i2c::{ErrorType, I2c, Operation};
use static_cell::StaticCell;
use wimu_node::TimeoutBus;

use crate::BoardTimer;

/// The sensor's bus.
pub type SensorBus = TimeoutBus<Bus, BoardTimer>;

/// I²C on TWISPI0 at 400 kHz. Call it once.
pub fn sensor_bus(
    chip: Peri<'static, TWISPI0>,
    interrupts: impl Binding<typelevel::TWISPI0, InterruptHandler<TWISPI0>> + 'static,
    sda: Peri<'static, impl Pin>,
    scl: Peri<'static, impl Pin>,
) -> SensorBus {
    static BUFFER: StaticCell<[u8; 16]> = StaticCell::new();
    let mut config = Config::default();
    config.frequency = Frequency::K400;
    let i2c = Twim::new(chip, interrupts, sda, scl, config, BUFFER.init([0; 16]));
    TimeoutBus::new(Bus(i2c), BoardTimer)
}

/// [`Twim`] on TWISPI0 that stops a transfer when its future is dropped. Otherwise its DMA would continue to write to
/// the dropped buffer.
pub struct Bus(Twim<'static>);

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
