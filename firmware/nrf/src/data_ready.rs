//! The sensor's data-ready line. The hardware captures the time of its edge.

use embassy_nrf::Peri;
use embassy_nrf::gpio::{Level, Pin, Pull};
use embassy_nrf::gpiote::{Channel, InputChannel, InputChannelPolarity};
use embassy_nrf::ppi::{AnyConfigurableChannel, ConfigurableChannel, Ppi};
use embassy_nrf::timer::Cc;
use wimu_model::DeviceTimeUs;
use wimu_node::DataReady;

use crate::clock;

/// The line.
pub struct Line {
    input: InputChannel<'static>,
    active: Level,
    edge: Cc<'static>,
    /// Lets the edge capture the time without the processor.
    _capture: Ppi<'static, AnyConfigurableChannel, 1, 1>,
}

impl Line {
    /// The line on `pin`, which is at `active` while the sensor has data. The time of the edge to that level is captured
    /// in `edge`, of [`start_clock`](crate::start_clock).
    pub fn new(
        channel: Peri<'static, impl Channel>,
        pin: Peri<'static, impl Pin>,
        pull: Pull,
        active: Level,
        ppi: Peri<'static, impl ConfigurableChannel>,
        edge: Cc<'static>,
    ) -> Self {
        let polarity = match active {
            Level::High => InputChannelPolarity::LoToHi,
            Level::Low => InputChannelPolarity::HiToLo,
        };
        let input = InputChannel::new(channel, pin, pull, polarity);
        let mut capture = Ppi::new_one_to_one(ppi.into(), input.event_in(), edge.task_capture());
        capture.enable();
        Self { input, active, edge, _capture: capture }
    }
}

impl DataReady for Line {
    async fn ready(&mut self) -> Option<DeviceTimeUs> {
        // Edges are detected from here on; after an earlier edge the line is still active.
        match self.active {
            Level::High => self.input.wait_for_high().await,
            Level::Low => self.input.wait_for_low().await,
        }
        Some(clock::when(self.edge.read()))
    }
}
