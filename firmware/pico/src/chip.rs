//! What differs between RP2040 and RP2350.

use embassy_rp::Peri;
use embassy_rp::flash::{Blocking, Flash};
use embassy_rp::interrupt::{Interrupt, InterruptExt, Priority};
use embassy_rp::peripherals::{FLASH, WATCHDOG};
use embassy_rp::watchdog::{ResetReason as WatchdogReason, Watchdog};
use wimu_embassy::BlockingFlash;
use wimu_link::hello::ResetReason;
use wimu_node::FlashLayout;

/// Flash of the board, bytes, as in memory.x.
const SIZE: usize = if cfg!(feature = "pico2") { 4 << 20 } else { 2 << 20 };
/// The last 8 KiB of the flash. A change erases one sector, which stalls the processor: 45 ms, at most 400 ms.
pub const LAYOUT: FlashLayout<StoreFlash> =
    FlashLayout::new((SIZE - (8 << 10)) as u32..SIZE as u32);

pub type StoreFlash = BlockingFlash<Flash<'static, FLASH, Blocking, SIZE>>;

/// The flash, and the chip's unique number.
pub fn flash(chip: Peri<'static, FLASH>) -> (StoreFlash, u64) {
    #[allow(unused_mut)]
    let mut flash = Flash::<_, Blocking, SIZE>::new_blocking(chip);
    #[cfg(feature = "pico")]
    let number = {
        let mut number = [0; 8];
        let read = flash.blocking_unique_id(&mut number);
        read.map_or(0, |()| u64::from_be_bytes(number))
    };
    #[cfg(feature = "pico2")]
    let number = embassy_rp::otp::get_chipid().unwrap_or(0);
    (BlockingFlash(flash), number)
}

/// The reset reason. Power-on and brown-out resets are not distinguished.
pub fn reset_reason(watchdog: &Watchdog) -> ResetReason {
    #[cfg(feature = "pico")]
    let chip = embassy_rp::pac::VREG_AND_CHIP_RESET.chip_reset().read();
    #[cfg(feature = "pico2")]
    let chip = embassy_rp::pac::POWMAN.chip_reset().read();
    #[cfg(feature = "pico2")]
    let by_pin = chip.had_run_low();
    #[cfg(feature = "pico")]
    let by_pin = chip.had_run();
    match watchdog.reset_reason() {
        Some(WatchdogReason::TimedOut) => ResetReason::Watchdog,
        Some(WatchdogReason::Forced) => ResetReason::Software,
        None if by_pin => ResetReason::Pin,
        None if chip.had_por() => ResetReason::PowerOn,
        None => ResetReason::Unknown,
    }
}

/// Data-ready line, then bus and time driver, then the sampler and the links.
pub fn set_priorities() {
    #[cfg(feature = "pico")]
    let timer = Interrupt::TIMER_IRQ_0;
    #[cfg(feature = "pico2")]
    let timer = Interrupt::TIMER0_IRQ_0;
    Interrupt::IO_IRQ_BANK0.set_priority(Priority::P0);
    Interrupt::I2C0_IRQ.set_priority(Priority::P1);
    timer.set_priority(Priority::P1);
    for lower in
        [Interrupt::SWI_IRQ_1, Interrupt::UART0_IRQ, Interrupt::UART1_IRQ, Interrupt::USBCTRL_IRQ]
    {
        lower.set_priority(Priority::P2);
    }
}

/// Resets the chip.
pub fn restart() -> ! {
    // SAFETY: the callers do not use the watchdog again.
    Watchdog::new(unsafe { WATCHDOG::steal() }).trigger_reset();
    loop {
        cortex_m::asm::nop();
    }
}
