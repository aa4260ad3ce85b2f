//! The sensor's data-ready line. The hardware captures the time of its falling edge.
//!
//! The sensor's INT1 turns a transistor on that pulls P0.25 down, against the pull-up in this chip.
//! The magnetometer and the interface chip can pull it down too.

use embassy_nrf::gpio::Pull;
use embassy_nrf::gpiote::{InputChannel, InputChannelPolarity};
use embassy_nrf::peripherals::{GPIOTE_CH0, P0_25, PPI_CH0};
use embassy_nrf::ppi::Ppi;
use embassy_nrf::timer::Cc;
use embassy_nrf::{Peri, pac};
use wimu_model::DeviceTimeUs;
use wimu_node::DataReady;

use crate::clock;

/// Number of the pin in its port.
const PIN: usize = 25;

/// The line.
pub struct Line {
    input: InputChannel<'static>,
    fell: Cc<'static>,
    /// Lets the edge capture the time without the processor.
    _capture: Ppi<'static, PPI_CH0, 1, 1>,
}

impl Line {
    /// The line on P0.25, whose edges are captured in `fell`.
    pub fn new(
        channel: Peri<'static, GPIOTE_CH0>,
        pin: Peri<'static, P0_25>,
        ppi: Peri<'static, PPI_CH0>,
        fell: Cc<'static>,
    ) -> Self {
        let polarity = InputChannelPolarity::HiToLo;
        let input = InputChannel::new(channel, pin, Pull::Up, polarity);
        let mut capture = Ppi::new_one_to_one(ppi, input.event_in(), fell.task_capture());
        capture.enable();
        Self {
            input,
            fell,
            _capture: capture,
        }
    }
}

impl DataReady for Line {
    async fn ready(&mut self) -> Option<DeviceTimeUs> {
        // Edges are detected from here on; after an earlier edge the line is still low.
        let edge = self.input.wait();
        if pac::P0.in_().read().pin(PIN) {
            edge.await;
        }
        Some(clock::when(self.fell.read()))
    }
}
