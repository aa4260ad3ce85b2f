//! The device's clock: the machine's timers, or in lockstep the sensor bridge.

use core::cell::RefCell;
use core::future::Future;
use core::pin::Pin;
use core::sync::atomic::{AtomicBool, Ordering};
use core::task::{Context, Poll, Waker};

use critical_section::Mutex;
use wimu_model::DeviceTimeUs;
use wimu_node::Timer;

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
/// Most simultaneous deadlines: more than the node's tasks need.
const SLOTS: usize = 12;

static LOCKSTEP: AtomicBool = AtomicBool::new(false);

static CLOCK: Mutex<RefCell<Clock>> =
    Mutex::new(RefCell::new(Clock { wraps: 0, lockstep_us: 0, slots: [const { None }; SLOTS] }));

struct Clock {
    /// Wraps of the counter.
    wraps: u32,
    /// Time in lockstep.
    lockstep_us: u64,
    /// Tasks waiting for a deadline.
    slots: [Option<Slot>; SLOTS],
}

struct Slot {
    deadline: u64,
    /// None once it has been woken.
    waker: Option<Waker>,
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
    with(|clock| clock.next_deadline())
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
        register(ALARM, CTRL).write(0);
        register(ALARM, INTERRUPT).write(1);
        clock.wake_due();
        clock.set_alarm();
    });
}

fn with<R>(f: impl FnOnce(&mut Clock) -> R) -> R {
    critical_section::with(|cs| f(&mut CLOCK.borrow_ref_mut(cs)))
}

impl Clock {
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

    fn next_deadline(&self) -> Option<u64> {
        let waiting = |slot: &&Slot| slot.waker.is_some();
        let slots = self.slots.iter().flatten().filter(waiting);
        slots.map(|slot| slot.deadline).min()
    }

    fn wake_due(&mut self) {
        let now = self.now_us();
        for slot in self.slots.iter_mut().flatten() {
            if slot.deadline <= now
                && let Some(waker) = slot.waker.take()
            {
                waker.wake();
            }
        }
    }

    fn set_alarm(&self) {
        if is_lockstep() {
            return;
        }
        register(ALARM, CTRL).write(0);
        if let Some(deadline) = self.next_deadline() {
            let ticks = deadline.saturating_sub(self.now_us()) * TICKS_PER_US;
            // A deadline beyond the timer's range sets the alarm again.
            let ticks = u32::try_from(ticks).unwrap_or(u32::MAX).max(1);
            register(ALARM, RELOAD).write(ticks);
            register(ALARM, VALUE).write(ticks);
            register(ALARM, CTRL).write(CTRL_ENABLE | CTRL_INTERRUPT);
        }
    }
}

/// The device's clock.
#[derive(Clone, Copy)]
pub struct BoardTimer;

impl Timer for BoardTimer {
    fn now(&self) -> DeviceTimeUs {
        DeviceTimeUs(with(|clock| clock.now_us()))
    }

    async fn until(&self, moment: DeviceTimeUs) {
        let until = Until { deadline: moment.0, slot: None };
        until.await;
    }
}

struct Until {
    deadline: u64,
    slot: Option<usize>,
}

impl Future for Until {
    type Output = ();

    fn poll(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<()> {
        with(|clock| {
            if clock.now_us() >= self.deadline {
                return Poll::Ready(());
            }
            let free = || clock.slots.iter().position(Option::is_none);
            self.slot = self.slot.or_else(free);
            match self.slot.and_then(|slot| clock.slots.get_mut(slot)) {
                Some(slot) => {
                    *slot = Some(Slot {
                        deadline: self.deadline,
                        waker: Some(context.waker().clone()),
                    });
                    clock.set_alarm();
                }
                // No free slot: poll again.
                None => context.waker().wake_by_ref(),
            }
            Poll::Pending
        })
    }
}

impl Drop for Until {
    fn drop(&mut self) {
        if let Some(slot) = self.slot {
            with(|clock| clock.slots[slot] = None);
        }
    }
}
