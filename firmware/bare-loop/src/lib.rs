//! What both images have beside their code.

#![no_std]

/// The memory routines of the boards.
#[path = "../../shared/src/memory.rs"]
mod memory;

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
