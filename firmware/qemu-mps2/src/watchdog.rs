//! What the machine keeps over a restart beside its flash, a watchdog, and requested failures.

use core::sync::atomic::{AtomicU32, Ordering};

use wimu_embassy::{Start, StartRecord};
use wimu_link::hello::ResetReason;
use wimu_node::Timer;

use crate::clock::BoardTimer;
use crate::log::exit_code;
use crate::semihosting;

/// Behind the pages of the flash.
const KEPT: usize = 0x2100_8000;
/// Timeout of the watchdog, ms.
const TIMEOUT_MS: u32 = 2_000;

/// Memory that survives a restart.
#[repr(C)]
pub struct Kept {
    /// The start record.
    pub start: StartRecord,
    /// Whether the watchdog has ended the machine.
    by_watchdog: AtomicU32,
}

/// The memory that survives a restart.
pub fn kept() -> &'static Kept {
    // SAFETY: nothing else uses this part of the machine's memory, and any content is valid.
    unsafe { &*(KEPT as *const Kept) }
}

/// Begins a start.
pub fn begin() -> Start {
    let reason = match kept().by_watchdog.swap(0, Ordering::Relaxed) {
        0 => ResetReason::PowerOn,
        _ => ResetReason::Watchdog,
    };
    wimu_cortex_m::stack::guard();
    kept().start.begin(reason)
}

/// When the watchdog was fed, ms.
static FED_MS: AtomicU32 = AtomicU32::new(0);

/// Feeds the watchdog.
pub fn feed() {
    FED_MS.store(now_ms(), Ordering::Relaxed);
}

/// Ends the machine if the watchdog has not been fed in time.
pub fn check() {
    if now_ms().wrapping_sub(FED_MS.load(Ordering::Relaxed)) > TIMEOUT_MS {
        kept().by_watchdog.store(1, Ordering::Relaxed);
        semihosting::exit(exit_code::WATCHDOG);
    }
}

/// Times at which the sensor's driver fails in one way, ms.
pub struct Failures {
    /// It panics.
    pub panic: AtomicU32,
    /// It never returns.
    pub stuck: AtomicU32,
    /// It overflows the stack.
    pub overflow: AtomicU32,
}

/// What the command line requests.
pub static FAILURES: Failures = Failures {
    panic: AtomicU32::new(u32::MAX),
    stuck: AtomicU32::new(u32::MAX),
    overflow: AtomicU32::new(u32::MAX),
};

/// Fails as requested, if it is time.
pub async fn fail_as_requested() {
    let is_due = |at: &AtomicU32| now_ms() >= at.load(Ordering::Relaxed);
    assert!(!is_due(&FAILURES.panic), "requested");
    if is_due(&FAILURES.stuck) {
        core::future::pending().await
    }
    if is_due(&FAILURES.overflow) {
        recurse(0);
    }
}

#[inline(never)]
fn recurse(depth: u32) -> u32 {
    let frame = core::hint::black_box([depth; 32]);
    match depth {
        u32::MAX => 0,
        _ => recurse(depth + 1).wrapping_add(frame[0]),
    }
}

fn now_ms() -> u32 {
    (BoardTimer.now().0 / 1000) as u32
}
