//! What the boards share that needs `unsafe`: the memory of the start record, the handlers of panics and faults, the
//! guard of the stack, the check of the image, and small memory routines.

#![no_std]

mod image;
mod memory;
pub mod stack;

use wimu_embassy::wimu_link::hello::{Fault, ResetReason};
use wimu_embassy::{Start, StartRecord};

pub use {cortex_m, cortex_m_rt, embassy_executor, static_cell, wimu_embassy};

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

/// Defines what every board with a Cortex-M has beside pins and clocks:
/// - `main`, which runs `$start(Spawner)` in the executor of the thread,
/// - `SAMPLING`, an executor in the spare interrupt `$interrupt`, for the sampler,
/// - the handlers of panics and faults, which record the addresses in [`START`] and call `$restart`, a function
///   `fn() -> !` that resets the chip; with the board's feature `defmt` a panic is also logged,
/// - the module `tasks` of [`wimu_embassy::board!`], with whose further arguments.
///
/// The board imports its HAL's `interrupt`.
#[macro_export]
macro_rules! board {
    (start: $start:path, restart: $restart:path, sampling: $interrupt:ident, $($board:tt)*) => {
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

        $crate::wimu_embassy::board! {
            record: $crate::START,
            stack: $crate::stack::status,
            $($board)*
        }

        /// Runs the sampler above all tasks, below the interrupts of the bus and of the data-ready line.
        static SAMPLING: $crate::embassy_executor::InterruptExecutor =
            $crate::embassy_executor::InterruptExecutor::new();

        #[cortex_m_rt::interrupt]
        unsafe fn $interrupt() {
            // SAFETY: this is the executor's own interrupt.
            unsafe { SAMPLING.on_interrupt() };
        }

        #[cortex_m_rt::entry]
        fn main() -> ! {
            static EXECUTOR: $crate::static_cell::StaticCell<$crate::embassy_executor::Executor> =
                $crate::static_cell::StaticCell::new();
            EXECUTOR.init($crate::embassy_executor::Executor::new()).run($start)
        }
    };
}
