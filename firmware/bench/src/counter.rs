//! Instructions counted with SysTick in QEMU's instruction-counting mode.

use core::arch::asm;
use core::sync::atomic::{AtomicU32, Ordering, compiler_fence};

use cortex_m::peripheral::SYST;
use cortex_m::peripheral::syst::SystClkSource;
use cortex_m_rt::exception;

/// SysTick counts down in 24 bits.
const MASK: u32 = 0xff_ffff;

/// Counts the instructions of a piece of code, exactly.
pub struct Counter {
    /// Ticks of 1000 instructions.
    per_thousand: u32,
    /// Ticks of nothing but starting and stopping.
    empty: u32,
    #[cfg_attr(
        not(target_abi = "eabihf"),
        expect(dead_code, reason = "for long counts")
    )]
    systick: SYST,
}

/// How often SysTick has come round, while that is counted.
static ROUNDS: AtomicU32 = AtomicU32::new(0);

#[exception]
fn SysTick() {
    // The only writer; a Cortex-M0 has no atomic addition.
    ROUNDS.store(
        ROUNDS.load(Ordering::Relaxed).wrapping_add(1),
        Ordering::Relaxed,
    );
}

impl Counter {
    /// Starts SysTick and finds how many ticks an instruction takes, from loops of known length.
    /// `None` if an instruction takes too few of them, or not always as many.
    pub fn new(mut systick: SYST) -> Option<Self> {
        systick.set_clock_source(SystClkSource::Core);
        systick.set_reload(MASK);
        systick.clear_current();
        systick.enable_counter();

        let [short, middle, long] = [500, 1000, 2000].map(ticks_of_turns);
        let per_thousand = middle.wrapping_sub(short);
        // Where within a tick the code begins may make one more or less.
        let even = long.wrapping_sub(middle).abs_diff(2 * per_thousand) <= 2;
        (even && per_thousand > 4000).then(|| Self {
            per_thousand,
            empty: ticks(|| ()),
            systick,
        })
    }

    /// Instructions that `code` takes; those of a call within it are the call itself, too.
    pub fn count(&self, code: impl FnOnce()) -> u32 {
        self.instructions(u64::from(ticks(code).saturating_sub(self.empty)))
    }

    /// The same for code that takes longer than SysTick counts to: its coming round is counted, at
    /// some twenty instructions in half a million.
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
    // Nothing of the code moves out from between the two readings.
    compiler_fence(Ordering::SeqCst);
    code();
    compiler_fence(Ordering::SeqCst);
    before.wrapping_sub(SYST::get_current()) & MASK
}

/// A function, so that the same instructions are around every loop.
#[inline(never)]
fn ticks_of_turns(turns: u32) -> u32 {
    ticks(|| spin(turns))
}

/// Twice as many instructions as `turns`, and a few.
#[inline(always)]
fn spin(turns: u32) {
    // SAFETY: counts a register down to zero and touches nothing else.
    unsafe {
        asm!("2:", "subs {0}, {0}, #1", "bne 2b", inout(reg) turns => _, options(nomem, nostack));
    }
}
