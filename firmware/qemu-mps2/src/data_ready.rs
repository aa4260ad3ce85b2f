//! The sensor's data-ready line, which ends at the bridge.

use core::cell::RefCell;
use core::future::{pending, poll_fn};
use core::task::{Poll, Waker};

use critical_section::Mutex as CsMutex;
use embassy_sync::mutex::Mutex;
use wimu_embassy::Mutex as RawMutex;
use wimu_model::DeviceTimeUs;
use wimu_node::Timer;

use crate::bridge::Bridge;
use crate::clock::{BoardTimer, is_lockstep};

/// Interval between questions to the bridge when time is free-running, µs.
const ASK_US: u64 = 500;

static LINE: CsMutex<RefCell<Line>> =
    CsMutex::new(RefCell::new(Line { watched: false, high: false, waker: None }));

/// The line in lockstep.
struct Line {
    watched: bool,
    high: bool,
    waker: Option<Waker>,
}

fn with<R>(f: impl FnOnce(&mut Line) -> R) -> R {
    critical_section::with(|cs| f(&mut LINE.borrow_ref_mut(cs)))
}

/// Whether a task waits for it in lockstep.
pub fn is_watched() -> bool {
    with(|line| line.watched)
}

/// Sets its level in lockstep.
pub fn set(high: bool) {
    with(|line| {
        line.high = high;
        if high {
            line.waker.take().into_iter().for_each(Waker::wake);
        }
    });
}

/// The data-ready line. Waiting can be cancelled at any time.
pub struct DataReady(pub &'static Mutex<RawMutex, Bridge>);

impl DataReady {
    async fn high(&mut self) {
        if is_lockstep() {
            let _watching = Watching::begin();
            poll_fn(|context| {
                with(|line| {
                    if line.high {
                        return Poll::Ready(());
                    }
                    line.waker = Some(context.waker().clone());
                    Poll::Pending
                })
            })
            .await;
            return;
        }
        loop {
            match self.0.lock().await.data_ready().await {
                Ok(true) => return,
                Ok(false) => BoardTimer.after_us(ASK_US).await,
                // The sensor driver times out and finds the fault on the bus.
                Err(_) => pending().await,
            }
        }
    }
}

struct Watching;

impl Watching {
    /// Forgets the last known level, which may be outdated.
    fn begin() -> Self {
        with(|line| (line.watched, line.high) = (true, false));
        Self
    }
}

impl Drop for Watching {
    fn drop(&mut self) {
        with(|line| line.watched = false);
    }
}

impl wimu_node::DataReady for DataReady {
    async fn ready(&mut self) -> Option<DeviceTimeUs> {
        self.high().await;
        None
    }
}
