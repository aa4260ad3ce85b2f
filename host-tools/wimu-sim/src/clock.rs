//! Virtual time, which passes only while everything waits.

use std::cell::{Cell, RefCell};
use std::collections::BTreeMap;
use std::future::Future;
use std::pin::{Pin, pin};
use std::rc::Rc;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::task::{Context, Poll, Wake, Waker};

/// A clock in µs that stands still until it is advanced; clones share it.
///
/// Timers that are due at the same µs wake in the order in which they were first polled, so that
/// every run of a simulation is the same. Single-threaded: only wakers may cross threads.
///
/// ```
/// use wimu_sim::clock::VirtualClock;
///
/// let clock = VirtualClock::new();
/// clock.run(clock.until(60_000_000))?;
/// assert_eq!(clock.now(), 60_000_000); // a minute, in no time
/// # Ok::<(), wimu_sim::clock::Stalled>(())
/// ```
#[derive(Clone, Debug, Default)]
pub struct VirtualClock(Rc<Inner>);

#[derive(Debug, Default)]
struct Inner {
    now: Cell<u64>,
    timers: RefCell<Timers>,
}

#[derive(Debug, Default)]
struct Timers {
    /// By deadline, then by age.
    waiting: BTreeMap<(u64, u64), Waker>,
    made: u64,
}

impl VirtualClock {
    /// A clock at 0 µs.
    pub fn new() -> Self {
        Self::default()
    }

    /// µs since the start.
    pub fn now(&self) -> u64 {
        self.0.now.get()
    }

    /// Waits until the clock shows `deadline` µs or more. Dropping it early is harmless.
    pub fn until(&self, deadline: u64) -> Until {
        Until { clock: self.clone(), deadline, age: None }
    }

    /// Deadline of the next timer, µs; `None` without timers.
    pub fn next_deadline(&self) -> Option<u64> {
        let timers = self.0.timers.borrow();
        timers.waiting.keys().next().map(|&(deadline, _)| deadline)
    }

    /// Moves the clock to `time` µs and wakes what is due; never moves it back.
    ///
    /// Woken tasks see `time`, even if they were due earlier: step through
    /// [`next_deadline`](Self::next_deadline) to keep every event at its own time.
    pub fn advance_to(&self, time: u64) {
        self.0.now.set(self.now().max(time));
        loop {
            // Borrowed for one statement only: a waker may set timers.
            let due = {
                let waiting = &mut self.0.timers.borrow_mut().waiting;
                match waiting.first_entry() {
                    Some(first) if first.key().0 <= self.now() => first.remove(),
                    _ => break,
                }
            };
            due.wake();
        }
    }

    /// Runs `future` to its end in virtual time: whenever it waits, the clock jumps to the next
    /// deadline.
    ///
    /// # Errors
    /// [`Stalled`] when it waits for something other than time that nothing can provide.
    pub fn run<F: Future>(&self, future: F) -> Result<F::Output, Stalled> {
        match self.drive(pin!(future), u64::MAX) {
            Poll::Ready(output) => Ok(output),
            Poll::Pending => Err(Stalled { at_us: self.now() }),
        }
    }

    /// Runs `future` until it ends or the clock shows `time` µs: for a host that does something
    /// in between, or that keeps the simulation in step with real time.
    ///
    /// ```
    /// use std::pin::pin;
    /// use wimu_sim::clock::VirtualClock;
    ///
    /// let clock = VirtualClock::new();
    /// let mut board = pin!(clock.until(25_000));
    /// assert!(clock.run_until(board.as_mut(), 10_000).is_pending());
    /// assert_eq!(clock.now(), 10_000);
    /// assert!(clock.run_until(board.as_mut(), 30_000).is_ready());
    /// assert_eq!(clock.now(), 25_000);
    /// ```
    pub fn run_until<F: Future>(&self, future: Pin<&mut F>, time: u64) -> Poll<F::Output> {
        let poll = self.drive(future, time);
        if poll.is_pending() {
            self.advance_to(time);
        }
        poll
    }

    /// Runs `future` over all deadlines up to `limit` µs.
    fn drive<F: Future>(&self, mut future: Pin<&mut F>, limit: u64) -> Poll<F::Output> {
        let woken = Arc::new(Woken(AtomicBool::new(true)));
        let waker = Waker::from(woken.clone());
        let mut context = Context::from_waker(&waker);
        loop {
            while woken.0.swap(false, Ordering::Relaxed) {
                if let Poll::Ready(output) = future.as_mut().poll(&mut context) {
                    return Poll::Ready(output);
                }
            }
            match self.next_deadline() {
                Some(deadline) if deadline <= limit => self.advance_to(deadline),
                _ => return Poll::Pending,
            }
        }
    }
}

struct Woken(AtomicBool);

impl Wake for Woken {
    fn wake(self: Arc<Self>) {
        self.0.store(true, Ordering::Relaxed);
    }
}

impl embedded_hal_async::delay::DelayNs for VirtualClock {
    /// Waits at least `ns`: up to the next whole µs.
    async fn delay_ns(&mut self, ns: u32) {
        self.until(self.now() + u64::from(ns.div_ceil(1000))).await;
    }
}

/// The clock of a device that was started at 0.
impl wimu_node::Timer for VirtualClock {
    fn now(&self) -> wimu_model::DeviceTimeUs {
        wimu_model::DeviceTimeUs(VirtualClock::now(self))
    }

    async fn until(&self, moment: wimu_model::DeviceTimeUs) {
        VirtualClock::until(self, moment.0).await;
    }
}

/// A future waits for something that nothing can provide.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("the simulation stalled at {at_us} µs: everything waits and no timer is set")]
pub struct Stalled {
    /// When, µs.
    pub at_us: u64,
}

/// Waits for a time: made by [`VirtualClock::until`].
#[derive(Debug)]
#[must_use = "does nothing unless awaited"]
pub struct Until {
    clock: VirtualClock,
    deadline: u64,
    /// The rank among timers of the same deadline, once waiting.
    age: Option<u64>,
}

impl Future for Until {
    type Output = ();

    fn poll(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<()> {
        if self.clock.now() >= self.deadline {
            return Poll::Ready(());
        }
        let timers = &self.clock.clone().0.timers;
        let mut timers = timers.borrow_mut();
        let age = *self.age.get_or_insert_with(|| {
            timers.made += 1;
            timers.made
        });
        let key = (self.deadline, age);
        match timers.waiting.get_mut(&key) {
            Some(waker) => waker.clone_from(context.waker()),
            None => {
                timers.waiting.insert(key, context.waker().clone());
            }
        }
        Poll::Pending
    }
}

impl Drop for Until {
    fn drop(&mut self) {
        if let Some(age) = self.age {
            let timers = &self.clock.0.timers;
            timers.borrow_mut().waiting.remove(&(self.deadline, age));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use embassy_futures::{join::join3, select::select};

    #[test]
    fn equal_deadlines_wake_in_the_order_of_waiting() {
        // Each task runs in its own join, so the order of polling is the order of the list; the
        // log shows that time never runs backwards either.
        let clock = VirtualClock::new();
        let log = RefCell::new(Vec::new());
        let task = |name: char, times: [u64; 2]| {
            let (clock, log) = (&clock, &log);
            async move {
                for time in times {
                    clock.until(time).await;
                    log.borrow_mut().push((clock.now(), name));
                }
            }
        };
        clock.run(join3(task('a', [30, 50]), task('b', [10, 50]), task('c', [20, 30]))).unwrap();
        assert_eq!(
            *log.borrow(),
            [(10, 'b'), (20, 'c'), (30, 'a'), (30, 'c'), (50, 'a'), (50, 'b')]
        );
    }

    #[test]
    fn wakers_fire_first_in_first_out() {
        struct Note(u8, Arc<std::sync::Mutex<Vec<u8>>>);
        impl Wake for Note {
            fn wake(self: Arc<Self>) {
                self.1.lock().unwrap().push(self.0);
            }
        }
        let clock = VirtualClock::new();
        let log = Arc::new(std::sync::Mutex::new(Vec::new()));
        let mut timers = Vec::new();
        for (name, deadline) in [(1, 500), (2, 100), (3, 500), (4, 100), (5, 500)] {
            let waker = Waker::from(Arc::new(Note(name, log.clone())));
            let mut timer = Box::pin(clock.until(deadline));
            let poll = timer.as_mut().poll(&mut Context::from_waker(&waker));
            assert!(poll.is_pending());
            timers.push(timer);
        }
        clock.advance_to(500);
        assert_eq!(*log.lock().unwrap(), [2, 4, 1, 3, 5]);
    }

    #[test]
    fn a_dropped_timer_leaves_no_deadline() {
        let clock = VirtualClock::new();
        clock.run(select(clock.until(1_000_000), clock.until(10))).unwrap();
        assert_eq!(clock.now(), 10);
        assert_eq!(clock.next_deadline(), None);
    }

    #[test]
    fn running_in_steps_is_running_at_once() {
        let ticks = |steps: &[u64]| {
            let clock = VirtualClock::new();
            let log = RefCell::new(Vec::new());
            {
                let mut task = pin!(async {
                    for time in [3, 10, 17, 20] {
                        clock.until(time).await;
                        log.borrow_mut().push(clock.now());
                    }
                });
                for &step in steps {
                    let _ = clock.run_until(task.as_mut(), step);
                }
            }
            log.into_inner()
        };
        assert_eq!(ticks(&[30]), [3, 10, 17, 20]);
        assert_eq!(ticks(&[1, 10, 11, 12, 19]), [3, 10, 17]);
    }

    #[test]
    fn a_future_that_nobody_can_finish_is_a_stall_not_a_hang() {
        let clock = VirtualClock::new();
        let forever = async {
            clock.until(25).await;
            std::future::pending::<()>().await;
        };
        assert_eq!(clock.run(forever), Err(Stalled { at_us: 25 }));
    }
}
