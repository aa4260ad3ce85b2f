//! The device's clock: a timer at 1 MHz from the crystal. The HAL's clock has a resolution of 30 µs.

use core::cell::Cell;

use critical_section::Mutex;
use embassy_nrf::Peri;
use embassy_nrf::timer::{Cc, Frequency, Instance, Timer as Counter};
use wimu_model::DeviceTimeUs;
use wimu_node::Timer;

/// Capture registers for reading the time, and for the data-ready line.
const NOW: usize = 0;
const DATA_READY: usize = 1;

/// The counter and the upper 32 bits of the time. The counter wraps after 71 minutes and is read many times a
/// second, so no wrap is missed.
static CLOCK: Mutex<Cell<Option<Clock>>> = Mutex::new(Cell::new(None));

#[derive(Clone, Copy)]
struct Clock {
    registers: embassy_nrf::pac::timer::Timer,
    last: u32,
    wraps: u32,
}

/// Starts the clock on a timer of 32 bits; returns the capture register for the data-ready line. The high-frequency clock
/// must run from the crystal.
pub fn start_clock(timer: Peri<'static, impl Instance>) -> Cc<'static> {
    let mut counter = Counter::new(timer);
    counter.set_frequency(Frequency::F1MHz);
    counter.clear();
    counter.start();
    let clock = Clock { registers: counter.regs(), last: 0, wraps: 0 };
    let line = counter.cc(DATA_READY);
    counter.persist();
    critical_section::with(|cs| CLOCK.borrow(cs).set(Some(clock)));
    line
}

fn now() -> DeviceTimeUs {
    critical_section::with(|cs| {
        let cell = CLOCK.borrow(cs);
        let Some(mut clock) = cell.get() else {
            return DeviceTimeUs(0);
        };
        clock.registers.tasks_capture(NOW).write_value(1);
        let low = clock.registers.cc(NOW).read();
        if low < clock.last {
            clock.wraps = clock.wraps.wrapping_add(1);
        }
        clock.last = low;
        cell.set(Some(clock));
        DeviceTimeUs(u64::from(clock.wraps) << 32 | u64::from(low))
    })
}

/// The time at which the counter last showed `low`.
pub(crate) fn when(low: u32) -> DeviceTimeUs {
    let now = now().0;
    DeviceTimeUs(now.saturating_sub(u64::from((now as u32).wrapping_sub(low))))
}

/// Time since [`start_clock`].
#[derive(Clone, Copy)]
pub struct BoardTimer;

impl Timer for BoardTimer {
    fn now(&self) -> DeviceTimeUs {
        now()
    }

    async fn until(&self, moment: DeviceTimeUs) {
        loop {
            let left = moment.0.saturating_sub(now().0);
            if left == 0 {
                return;
            }
            // The timer of the executor is a coarser clock.
            embassy_time::Timer::after_micros(left).await;
        }
    }
}
