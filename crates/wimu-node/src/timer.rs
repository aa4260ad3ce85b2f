//! Clock of a node.

use embassy_futures::select::{Either, select};
use wimu_model::DeviceTimeUs;

/// The device's clock.
#[allow(async_fn_in_trait)] // Nodes are polled where they are built; nothing needs `Send`.
pub trait Timer: Clone {
    /// Time since the device's start, µs; never runs backwards.
    fn now(&self) -> DeviceTimeUs;

    /// Completes at `moment`, or immediately if it has passed.
    async fn until(&self, moment: DeviceTimeUs);

    /// Completes `micros` µs after the call.
    fn after_us(&self, micros: u64) -> impl Future<Output = ()> {
        self.until(DeviceTimeUs(self.now().0.saturating_add(micros)))
    }

    /// Waits for `future`, until `moment` at the latest; `None` after a timeout.
    async fn before<F: Future>(&self, moment: DeviceTimeUs, future: F) -> Option<F::Output> {
        match select(future, self.until(moment)).await {
            Either::First(output) => Some(output),
            Either::Second(()) => None,
        }
    }
}
