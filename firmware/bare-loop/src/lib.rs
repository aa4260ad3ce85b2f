//! What both images have beside their code.

#![no_std]

use core::panic::PanicInfo;

/// Does nothing from now on.
pub fn idle() -> ! {
    loop {
        cortex_m::asm::wfi();
    }
}

#[panic_handler]
fn panic(_: &PanicInfo) -> ! {
    idle()
}
