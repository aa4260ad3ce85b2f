//! What boards with a chip of Nordic's nRF52 series share: the device clock, the data-ready line with time stamps by
//! hardware, the sensor's bus, the reset reason and the serial number.

#![no_std]

mod bus;
mod clock;
mod data_ready;

use embassy_nrf::config::{Config, HfclkSource};
use embassy_nrf::interrupt::Priority;
use embassy_nrf::peripherals::WDT;
use embassy_nrf::wdt::{self, Watchdog, WatchdogHandle};
use embassy_nrf::{Peri, pac};
use wimu_link::hello::ResetReason;

pub use bus::{SensorBus, sensor_bus};
pub use clock::{BoardTimer, start_clock};
pub use data_ready::Line;

/// The high-frequency clock from the crystal, which the device's clock needs; the interrupts of lines and time driver below
/// a radio's and above the links'.
pub fn config() -> Config {
    let mut config = Config::default();
    config.hfclk_source = HfclkSource::ExternalXtal;
    config.gpiote_interrupt_priority = Priority::P1;
    config.time_interrupt_priority = Priority::P2;
    config
}

/// The reset reason, which is cleared.
pub fn reset_reason() -> ResetReason {
    let found = pac::POWER.resetreas().read();
    // The bits accumulate until they are cleared by writing ones.
    pac::POWER.resetreas().write_value(found);
    match found {
        // Power-on and brown-out are not distinguished.
        _ if found.0 == 0 => ResetReason::PowerOn,
        _ if found.dog() => ResetReason::Watchdog,
        _ if found.lockup() => ResetReason::Fault,
        _ if found.sreq() => ResetReason::Software,
        _ if found.resetpin() => ResetReason::Pin,
        _ => ResetReason::Unknown,
    }
}

/// Timeout of the watchdog: 2 s of 32,768 Hz.
const WATCHDOG_TICKS: u32 = 65_536;

/// Starts the watchdog, which pauses while a debugger holds the processor. Call it once.
pub fn watchdog(chip: Peri<'static, WDT>) -> WatchdogHandle {
    let mut config = wdt::Config::default();
    config.timeout_ticks = WATCHDOG_TICKS;
    config.action_during_debug_halt = wdt::HaltConfig::Pause;
    // It is not running yet: a reset stops it.
    let Ok((_, [watchdog])) = Watchdog::try_new(chip, config) else { panic!() };
    watchdog
}

/// The chip's serial number.
pub fn device_id() -> u64 {
    let [low, high] = [0, 1].map(|word| u64::from(pac::FICR.deviceid(word).read()));
    high << 32 | low
}

/// Makes the hardware block writes to the flash below 2.1 V.
pub fn protect_flash() {
    pac::POWER.pofcon().write(|power_fail| {
        power_fail.set_pof(true);
        power_fail.set_threshold(pac::power::vals::Threshold::V21);
    });
}
