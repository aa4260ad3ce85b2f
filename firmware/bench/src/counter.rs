//! Instructions counted with SysTick in QEMU's instruction-counting mode.

use core::arch::asm;
use core::sync::atomic::{Ordering, compiler_fence};

use cortex_m::peripheral::SYST;
use cortex_m::peripheral::syst::SystClkSource;

/// SysTick counts down in 24 bits.
const MASK: u32 = 0xff_ffff;

/// Counts the instructions of a piece of code.
pub struct Counter {
    /// Ticks of 1000 instructions.
    per_thousand: u32,
    /// Ticks of an empty measurement.
    empty: u32,
}

impl Counter {
    /// Starts SysTick and calibrates it with loops of known length. `None` if an instruction takes too few
    /// ticks, or a varying number.
    pub fn new(mut systick: SYST) -> Option<Self> {
        systick.set_clock_source(SystClkSource::Core);
        systick.set_reload(MASK);
        systick.clear_current();
        systick.enable_counter();

        let [short, middle, long] = [500, 1000, 2000].map(ticks_of_loop);
        let per_thousand = middle.wrapping_sub(short);
        // The phase of the tick causes a difference of up to one.
        let constant = long.wrapping_sub(middle).abs_diff(2 * per_thousand) <= 2;
        (constant && per_thousand > 4000).then(|| Self { per_thousand, empty: ticks(|| ()) })
    }

    /// Instructions of `code`, including calls within it.
    pub fn count(&self, code: impl FnOnce()) -> u32 {
        self.instructions(u64::from(ticks(code).saturating_sub(self.empty)))
    }

    fn instructions(&self, ticks: u64) -> u32 {
        let per_thousand = u64::from(self.per_thousand);
        ((ticks * 1000 + per_thousand / 2) / per_thousand) as u32
    }
}

#[inline(always)]
fn ticks(code: impl FnOnce()) -> u32 {
    let before = SYST::get_current();
    // The code must stay between the two readings.
    compiler_fence(Ordering::SeqCst);
    code();
    compiler_fence(Ordering::SeqCst);
    before.wrapping_sub(SYST::get_current()) & MASK
}

/// A function, so that every loop has the same instructions around it.
#[inline(never)]
fn ticks_of_loop(iterations: u32) -> u32 {
    ticks(|| spin(iterations))
}

/// Executes two instructions per iteration, and a constant number of others.
#[inline(always)]
fn spin(iterations: u32) {
    // SAFETY: counts a register down to zero and touches nothing else.
    unsafe {
        asm!("2:", "subs {0}, {0}, #1", "bne 2b", inout(reg) iterations => _, options(nomem, nostack));
    }
}
