//! The sensor's data-ready line on a pin, with the time at which it rose. There is one such line.

use core::cell::{Cell, RefCell};
use core::future::{Future, poll_fn};
use core::pin::pin;
use core::ptr;
use core::task::{Context, RawWaker, RawWakerVTable, Waker};

use critical_section::Mutex;
use embedded_hal_async::digital::Wait;
use wimu_embassy::BoardTimer;
use wimu_model::DeviceTimeUs;
use wimu_node::{DataReady, Timer};

/// The pin's interrupt calls a waker, which captures the time before it wakes the task.
static ROSE: Mutex<Rose> = Mutex::new(Rose { at: Cell::new(None), task: RefCell::new(None) });

struct Rose {
    at: Cell<Option<DeviceTimeUs>>,
    task: RefCell<Option<Waker>>,
}

static CAPTURES_TIME: RawWakerVTable =
    RawWakerVTable::new(|_| waker(), |_| capture(), |_| capture(), |_| ());

const fn waker() -> RawWaker {
    RawWaker::new(ptr::null(), &CAPTURES_TIME)
}

fn capture() {
    let now = BoardTimer.now();
    let task = critical_section::with(|cs| {
        let rose = ROSE.borrow(cs);
        if rose.at.get().is_none() {
            rose.at.set(Some(now));
        }
        rose.task.take()
    });
    task.into_iter().for_each(Waker::wake);
}

/// The line.
pub struct Line<P>(pub P);

impl<P: Wait> DataReady for Line<P> {
    async fn ready(&mut self) -> Option<DeviceTimeUs> {
        critical_section::with(|cs| ROSE.borrow(cs).at.set(None));
        // SAFETY: the functions of the table do not use the pointer and can be called from any context.
        let waker = unsafe { Waker::from_raw(waker()) };
        let mut high = pin!(self.0.wait_for_high());
        // After a failure of the pin the driver polls the sensor.
        let _ = poll_fn(|context| {
            critical_section::with(|cs| {
                let task = context.waker().clone();
                ROSE.borrow(cs).task.replace(Some(task));
            });
            high.as_mut().poll(&mut Context::from_waker(&waker))
        })
        .await;
        critical_section::with(|cs| ROSE.borrow(cs).at.get())
    }
}
