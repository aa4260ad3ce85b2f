//! The device's clock, embassy's time driver: the machine's timers, or in lockstep the sensor bridge.

use core::cell::RefCell;
use core::sync::atomic::{AtomicBool, Ordering};
use core::task::Waker;

use critical_section::Mutex;
use embassy_time_driver::{Driver, time_driver_impl};
use embassy_time_queue_utils::Queue;
pub use wimu_embassy::BoardTimer;

use crate::register::Register;

/// Timer that counts down from 2³² − 1 repeatedly.
const COUNTER: usize = 0x4000_0000;
/// Timer that counts down to the next deadline.
const ALARM: usize = 0x4000_1000;

const CTRL: usize = 0x00;
const VALUE: usize = 0x04;
const RELOAD: usize = 0x08;
const INTERRUPT: usize = 0x0C;
const CTRL_ENABLE: u32 = 1;
const CTRL_INTERRUPT: u32 = 1 << 3;

const TICKS_PER_US: u64 = 25;

static LOCKSTEP: AtomicBool = AtomicBool::new(false);

time_driver_impl!(static CLOCK: Clock = Clock(Mutex::new(RefCell::new(State {
    wraps: 0,
    lockstep_us: 0,
    queue: Queue::new(),
}))));

struct Clock(Mutex<RefCell<State>>);

struct State {
    /// Wraps of the counter.
    wraps: u32,
    /// Time in lockstep.
    lockstep_us: u64,
    /// Tasks waiting for a deadline.
    queue: Queue,
}

impl Driver for Clock {
    fn now(&self) -> u64 {
        with(|clock| clock.now_us())
    }

    fn schedule_wake(&self, at: u64, waker: &Waker) {
        with(|clock| {
            if clock.queue.schedule_wake(at, waker) {
                clock.wake_due();
            }
        });
    }
}

fn register(base: usize, offset: usize) -> Register {
    // SAFETY: `base` is one of the machine's timers, the offsets are those of its registers.
    unsafe { Register::at(base + offset) }
}

/// Starts the clock. In lockstep only [`advance_to`] advances it.
pub fn start(lockstep: bool) {
    LOCKSTEP.store(lockstep, Ordering::Relaxed);
    if !lockstep {
        register(COUNTER, RELOAD).write(u32::MAX);
        register(COUNTER, VALUE).write(u32::MAX);
        register(COUNTER, CTRL).write(CTRL_ENABLE | CTRL_INTERRUPT);
    }
}

/// Whether the bridge determines the time.
pub fn is_lockstep() -> bool {
    LOCKSTEP.load(Ordering::Relaxed)
}

/// The earliest deadline of a waiting task, µs.
pub fn next_deadline() -> Option<u64> {
    let deadline = with(State::wake_due);
    (deadline < u64::MAX).then_some(deadline)
}

/// Sets the time in lockstep, µs.
pub fn advance_to(now_us: u64) {
    with(|clock| {
        clock.lockstep_us = now_us;
        clock.wake_due();
    });
}

/// The counter's interrupt.
pub fn on_wrap() {
    with(|clock| {
        register(COUNTER, INTERRUPT).write(1);
        clock.wraps = clock.wraps.wrapping_add(1);
    });
}

/// The alarm's interrupt.
pub fn on_alarm() {
    with(|clock| {
        register(ALARM, INTERRUPT).write(1);
        clock.wake_due();
    });
}

fn with<R>(f: impl FnOnce(&mut State) -> R) -> R {
    critical_section::with(|cs| f(&mut CLOCK.0.borrow_ref_mut(cs)))
}

impl State {
    fn now_us(&self) -> u64 {
        if is_lockstep() {
            return self.lockstep_us;
        }
        let left = register(COUNTER, VALUE).read();
        // Interrupts are disabled: a wrap of the counter may not be counted yet.
        let unseen = register(COUNTER, INTERRUPT).read() & 1 != 0 && left > u32::MAX / 2;
        let wraps = u64::from(self.wraps) + u64::from(unseen);
        (wraps << 32 | u64::from(!left)) / TICKS_PER_US
    }

    /// Wakes the tasks that are due, and sets the alarm for the next deadline, µs, which it returns.
    fn wake_due(&mut self) -> u64 {
        let now = self.now_us();
        let deadline = self.queue.next_expiration(now);
        if is_lockstep() {
            return deadline;
        }
        register(ALARM, CTRL).write(0);
        if deadline < u64::MAX {
            // A deadline beyond the timer's range sets the alarm again.
            let ticks = deadline.saturating_sub(now).saturating_mul(TICKS_PER_US);
            let ticks = u32::try_from(ticks).unwrap_or(u32::MAX).max(1);
            register(ALARM, RELOAD).write(ticks);
            register(ALARM, VALUE).write(ticks);
            register(ALARM, CTRL).write(CTRL_ENABLE | CTRL_INTERRUPT);
        }
        deadline
    }
}
