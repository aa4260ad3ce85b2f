//! The device's clock on the time driver of embassy.

use embassy_time::Instant;
use wimu_model::DeviceTimeUs;
use wimu_node::Timer;

/// Time since the start, from the board's time driver, which must have a resolution of 1 µs and run from a crystal.
#[derive(Clone, Copy, Debug)]
pub struct BoardTimer;

impl Timer for BoardTimer {
    fn now(&self) -> DeviceTimeUs {
        DeviceTimeUs(Instant::now().as_micros())
    }

    fn until(&self, moment: DeviceTimeUs) -> impl Future<Output = ()> {
        embassy_time::Timer::at(Instant::from_micros(moment.0))
    }
}
