//! The device's clock: the chip's µs timer.

use embassy_time::Instant;
use wimu_model::DeviceTimeUs;
use wimu_node::Timer;

/// Time since the start.
#[derive(Clone, Copy)]
pub struct BoardTimer;

impl Timer for BoardTimer {
    fn now(&self) -> DeviceTimeUs {
        DeviceTimeUs(Instant::now().as_micros())
    }

    fn until(&self, moment: DeviceTimeUs) -> impl Future<Output = ()> {
        embassy_time::Timer::at(Instant::from_micros(moment.0))
    }
}
