//! `defmt` on the log UART, and the handlers of panics and faults.

use core::cell::UnsafeCell;
use core::panic::PanicInfo;

use cortex_m_rt::{ExceptionFrame, exception};
use critical_section::RestoreState;

use crate::semihosting;
use crate::uart::LOG;
use crate::watchdog::kept;

/// Exit codes of the board.
pub mod exit_code {
    /// Invalid command line.
    pub const USAGE: u8 = 2;
    /// Simulated power loss.
    pub const POWER_LOSS: u8 = 3;
    /// The watchdog.
    pub const WATCHDOG: u8 = 4;
    /// A panic.
    pub const PANIC: u8 = 101;
    /// A fault of the processor.
    pub const FAULT: u8 = 102;
}

#[defmt::global_logger]
struct Logger;

struct Encoder(UnsafeCell<(RestoreState, defmt::Encoder)>);

// SAFETY: it is touched only between `acquire` and `release`, with interrupts off, on one core.
unsafe impl Sync for Encoder {}

static ENCODER: Encoder =
    Encoder(UnsafeCell::new((RestoreState::invalid(), defmt::Encoder::new())));

// SAFETY: one frame at a time: interrupts stay off from `acquire` to `release`, and no code in
// between logs.
unsafe impl defmt::Logger for Logger {
    fn acquire() {
        // SAFETY: `release` follows, in the same thread, with what this returned.
        unsafe {
            let restore = critical_section::acquire();
            let (state, encoder) = &mut *ENCODER.0.get();
            *state = restore;
            encoder.start_frame(|bytes| LOG.write_now(bytes));
        }
    }

    unsafe fn flush() {}

    unsafe fn release() {
        // SAFETY: it follows `acquire`, as defmt promises.
        unsafe {
            let (state, encoder) = &mut *ENCODER.0.get();
            encoder.end_frame(|bytes| LOG.write_now(bytes));
            critical_section::release(*state);
        }
    }

    unsafe fn write(bytes: &[u8]) {
        // SAFETY: it comes between `acquire` and `release`, as defmt promises.
        unsafe {
            let (_, encoder) = &mut *ENCODER.0.get();
            encoder.write(bytes, |bytes| LOG.write_now(bytes));
        }
    }
}

#[panic_handler]
fn panic(info: &PanicInfo<'_>) -> ! {
    cortex_m::interrupt::disable();
    defmt::error!("{}", defmt::Display2Format(info));
    kept().start.record(&wimu_cortex_m::panicked());
    semihosting::exit(exit_code::PANIC)
}

#[defmt::panic_handler]
fn defmt_panic() -> ! {
    semihosting::exit(exit_code::PANIC)
}

#[exception]
unsafe fn HardFault(frame: &ExceptionFrame) -> ! {
    let fault = wimu_cortex_m::fault_of(frame);
    defmt::error!("{}", fault);
    kept().start.record(&fault);
    semihosting::exit(exit_code::FAULT)
}
