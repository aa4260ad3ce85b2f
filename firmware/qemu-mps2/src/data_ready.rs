//! The sensor's data-ready line, which ends at the bridge.

use core::cell::RefCell;
use core::convert::Infallible;
use core::future::{pending, poll_fn};
use core::task::{Poll, Waker};

use critical_section::Mutex as CsMutex;
use embassy_sync::blocking_mutex::raw::NoopRawMutex;
use embassy_sync::mutex::Mutex;
use embedded_hal::digital::ErrorType;
use embedded_hal_async::digital::Wait;
use wimu_node::Timer;

use crate::bridge::Bridge;
use crate::clock::{BoardTimer, is_lockstep};

/// How often the bridge is asked when time is free-running.
const ASK_US: u64 = 500;

static LINE: CsMutex<RefCell<Line>> = CsMutex::new(RefCell::new(Line {
    watched: false,
    high: false,
    waker: None,
}));

/// The line in lockstep.
struct Line {
    watched: bool,
    high: bool,
    waker: Option<Waker>,
}

fn with<R>(f: impl FnOnce(&mut Line) -> R) -> R {
    critical_section::with(|cs| f(&mut LINE.borrow_ref_mut(cs)))
}

/// Whether somebody waits for it in lockstep.
pub fn is_watched() -> bool {
    with(|line| line.watched)
}

/// What the bridge says of it in lockstep.
pub fn set(high: bool) {
    with(|line| {
        line.high = high;
        if high {
            line.waker.take().into_iter().for_each(Waker::wake);
        }
    });
}

/// The data-ready line. Waiting can be cancelled at any time.
pub struct DataReady(pub &'static Mutex<NoopRawMutex, Bridge>);

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
                // Whoever waits gives up in time, and finds out from the bus.
                Err(_) => pending().await,
            }
        }
    }
}

struct Watching;

impl Watching {
    /// What was known of the line may have changed since.
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

impl ErrorType for DataReady {
    type Error = Infallible;
}

impl Wait for DataReady {
    async fn wait_for_high(&mut self) -> Result<(), Infallible> {
        self.high().await;
        Ok(())
    }

    /// A level is all that the bridge tells: reading the data ends it.
    async fn wait_for_rising_edge(&mut self) -> Result<(), Infallible> {
        self.wait_for_high().await
    }

    /// Never: the bridge is asked for data, not for their absence.
    async fn wait_for_low(&mut self) -> Result<(), Infallible> {
        pending().await
    }

    /// Never, likewise.
    async fn wait_for_falling_edge(&mut self) -> Result<(), Infallible> {
        pending().await
    }

    async fn wait_for_any_edge(&mut self) -> Result<(), Infallible> {
        self.wait_for_high().await
    }
}
