//! What boards with a chip of Nordic's nRF52 series share: the device clock, the data-ready line with time stamps by
//! hardware, the sensor's bus, the reset reason and the serial number.

#![no_std]

mod bus;
mod clock;
mod data_ready;

use embassy_nrf::pac;
use wimu_link::hello::ResetReason;

pub use bus::Bus;
pub use clock::{BoardTimer, start_clock};
pub use data_ready::Line;

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
