//! What the boards share that needs `unsafe`: the memory of the start record, the handlers of panics and faults, the
//! guard of the stack, the check of the image, and small memory routines.

#![no_std]

mod image;
mod memory;
pub mod stack;

use wimu_embassy::wimu_link::hello::{Fault, ResetReason};
use wimu_embassy::{Start, StartRecord};

pub use {cortex_m, cortex_m_rt, wimu_embassy};

/// The start record, in memory that is not cleared at a start.
// `used`: the compiler must not assume the initial value.
#[used]
#[unsafe(link_section = ".uninit.WIMU_START")]
pub static START: StartRecord = StartRecord::new();

/// Guards the stack and begins a start that the hardware explains with `reason`. An image in flash that differs from
/// its CRC starts in safe mode. Call it once, first of all.
pub fn begin(reason: ResetReason) -> Start {
    stack::guard();
    let start = START.begin(reason);
    match image::damaged() {
        Some(crc) => start.in_safe_mode(Fault::processor("image CRC", crc)),
        None => start,
    }
}

/// The fault of the processor with this stack frame.
pub fn fault_of(frame: &cortex_m_rt::ExceptionFrame) -> Fault {
    let address = core::ptr::from_ref(frame) as u32;
    match stack::is_overflow(address) {
        // The frame could not be written.
        true => Fault::processor("stack overflow", address),
        false => Fault::processor("hard fault", frame.pc()),
    }
}

/// The fault of a panic. Call it in the panic handler. It does not read the panic's location, so the linker drops
/// the names of all source files.
#[inline(always)]
pub fn panicked() -> Fault {
    Fault::panic(stack::callers())
}

/// Defines the handlers of panics and processor faults. They record the addresses in [`START`] and call `$restart`, a
/// function `fn() -> !` that resets the chip. With the board's feature `defmt` a panic is also logged.
#[macro_export]
macro_rules! fault_handlers {
    ($restart:path) => {
        #[panic_handler]
        fn panic(_info: &core::panic::PanicInfo<'_>) -> ! {
            $crate::cortex_m::interrupt::disable();
            #[cfg(feature = "defmt")]
            defmt::error!("{}", defmt::Display2Format(_info));
            $crate::START.record(&$crate::panicked());
            $restart()
        }

        #[$crate::cortex_m_rt::exception]
        unsafe fn HardFault(frame: &$crate::cortex_m_rt::ExceptionFrame) -> ! {
            $crate::cortex_m::interrupt::disable();
            $crate::START.record(&$crate::fault_of(frame));
            $restart()
        }
    };
}
