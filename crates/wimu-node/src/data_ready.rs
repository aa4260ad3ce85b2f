//! Data-ready line of a sensor.

use embedded_hal_async::digital::Wait;
use wimu_model::DeviceTimeUs;

/// A line that is high while a sensor has data.
///
/// Implemented for every pin that can wait; the sample time is then taken when the task wakes, with its
/// latency. A board that captures the time in the interrupt or in hardware implements this trait itself and
/// sets [`DATA_READY`](wimu_link::hello::Capabilities::DATA_READY).
#[allow(async_fn_in_trait)] // Nodes are polled where they are built; nothing needs `Send`.
pub trait DataReady {
    /// Waits until the line is high; returns the captured time of its edge, device clock, if there is one.
    /// Cancel-safe.
    async fn ready(&mut self) -> Option<DeviceTimeUs>;
}

impl<P: Wait> DataReady for P {
    async fn ready(&mut self) -> Option<DeviceTimeUs> {
        // After a failure of the pin the driver polls the sensor.
        let _ = self.wait_for_high().await;
        None
    }
}
