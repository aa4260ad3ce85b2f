//! What the node asks of a sensor's data-ready line.

use embedded_hal_async::digital::Wait;
use wimu_model::DeviceTimeUs;

/// A line that is high while a sensor has data.
///
/// Every pin that can wait is one; then the node takes the time when it is woken, which is late by
/// whatever ran in between. A board that notes the time in the interrupt, or has its hardware note
/// it, implements this instead, and says [`DATA_READY`](wimu_link::hello::Capabilities::DATA_READY).
#[allow(async_fn_in_trait)] // Nodes are polled where they are built; nothing needs `Send`.
pub trait DataReady {
    /// Waits until the line is high; returns when it rose, device time, if that was noted. Can be
    /// cancelled at any time.
    async fn ready(&mut self) -> Option<DeviceTimeUs>;
}

impl<P: Wait> DataReady for P {
    async fn ready(&mut self) -> Option<DeviceTimeUs> {
        // A pin that fails is found out from the sensor.
        let _ = self.wait_for_high().await;
        None
    }
}
