//! Instructions counted with SysTick in QEMU's instruction-counting mode.

use core::arch::asm;
use core::sync::atomic::{AtomicU32, Ordering, compiler_fence};

use cortex_m::peripheral::SYST;
use cortex_m::peripheral::syst::SystClkSource;
use cortex_m_rt::exception;

/// SysTick counts down in 24 bits.
const MASK: u32 = 0xff_ffff;

/// Counts the instructions of a piece of code.
pub struct Counter {
    /// Ticks of 1000 instructions.
    per_thousand: u32,
    /// Ticks of an empty measurement.
    empty: u32,
    #[cfg_attr(not(target_abi = "eabihf"), expect(dead_code, reason = "for long counts"))]
    systick: SYST,
}

/// Wraps of SysTick, while they are counted.
static ROUNDS: AtomicU32 = AtomicU32::new(0);

#[exception]
fn SysTick() {
    // The only writer; a Cortex-M0 has no atomic addition.
    ROUNDS.store(ROUNDS.load(Ordering::Relaxed).wrapping_add(1), Ordering::Relaxed);
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
        (constant && per_thousand > 4000).then(|| Self {
            per_thousand,
            empty: ticks(|| ()),
            systick,
        })
    }

    /// Instructions of `code`, including calls within it.
    pub fn count(&self, code: impl FnOnce()) -> u32 {
        self.instructions(u64::from(ticks(code).saturating_sub(self.empty)))
    }

    /// The same for code that takes longer than the range of SysTick, whose wraps are counted. That adds about
    /// twenty instructions in half a million.
    #[cfg(target_abi = "eabihf")]
    pub fn count_long(&mut self, code: impl FnOnce()) -> u32 {
        let rounds = ROUNDS.load(Ordering::Relaxed);
        self.systick.enable_interrupt();
        let before = SYST::get_current();
        compiler_fence(Ordering::SeqCst);
        code();
        compiler_fence(Ordering::SeqCst);
        let after = SYST::get_current();
        self.systick.disable_interrupt();
        let rounds = ROUNDS.load(Ordering::Relaxed).wrapping_sub(rounds);
        let ticks = u64::from(rounds) * u64::from(MASK + 1) + u64::from(before);
        self.instructions(ticks - u64::from(after))
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
