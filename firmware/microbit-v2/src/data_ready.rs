//! The sensor's data-ready line, whose falling edge the hardware stamps.
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

/// Its number in its port.
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
        // From here on an edge is seen; of one that came before, the line is down still.
        let edge = self.input.wait();
        if pac::P0.in_().read().pin(PIN) {
            edge.await;
        }
        Some(clock::when(self.fell.read()))
    }
}
