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

/// Defines what every board has beside pins and clocks:
/// - `main`, which runs `$start(Spawner)` in the executor of the thread,
/// - `SAMPLING`, an executor in the spare interrupt `$interrupt`, for the sampler,
/// - the task `supervise(&Shared, $watchdog)`, which calls `$feed` while the tasks make progress within `$limits`,
/// - the task `show(&Shared, is_safe_mode, $led, $button)`, which shows the state; the LED is lit at the level `$lit`,
/// - the handlers of panics and faults: [`fault_handlers!`].
///
/// The board has a module `tasks` of `wimu_embassy::tasks!` and imports its HAL's `interrupt`.
#[macro_export]
macro_rules! board {
    (
        start: $start:path,
        restart: $restart:path,
        sampling: $interrupt:ident,
        timer: $timer:expr,
        watchdog: $watchdog:ty, $feed:expr, $limits:expr,
        $(light: ($led:ty, $button:ty), lit: $lit:expr,)?
    ) => {
        $crate::fault_handlers!($restart);

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

        /// Feeds the watchdog while the node works.
        #[$crate::embassy_executor::task(embassy_executor = $crate::embassy_executor)]
        async fn supervise(shared: &'static tasks::Shared, mut watchdog: $watchdog) -> ! {
            let feed: fn(&mut $watchdog) = $feed;
            let (record, stack) = (&$crate::START, $crate::stack::status);
            let feed = || feed(&mut watchdog);
            $crate::wimu_embassy::supervise($limits, shared, record, $timer, stack, feed).await
        }

        $(
            /// Shows the device's state with the LED and polls the button, which is pressed while low.
            #[$crate::embassy_executor::task(embassy_executor = $crate::embassy_executor)]
            async fn show(
                shared: &'static tasks::Shared,
                is_safe_mode: bool,
                mut led: $led,
                button: $button,
            ) -> ! {
                let light = |on: bool| led.set_level((on == $lit).into());
                let is_pressed = || button.is_low();
                $crate::wimu_embassy::attend(shared, is_safe_mode, $timer, light, is_pressed).await
            }
        )?
    };
}
