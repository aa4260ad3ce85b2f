//! A clock, a data-ready line and a mock bus.

use std::cell::{Cell, RefCell};
use std::collections::VecDeque;
use std::rc::Rc;

use embedded_hal_mock::eh1::i2c::{Mock, Transaction};
use wimu_link::message::{Resolution, Settings};
use wimu_model::DeviceTimeUs;
use wimu_node::sensor::Plan;
use wimu_node::{DataReady, FifoChip, FifoSensor, Timer};
use wimu_sensors::I2cBus;

/// A clock that moves when somebody waits, and where the test says.
#[derive(Clone, Default)]
pub struct Clock(pub Rc<Cell<u64>>);

impl Timer for Clock {
    fn now(&self) -> DeviceTimeUs {
        DeviceTimeUs(self.0.get())
    }

    async fn until(&self, moment: DeviceTimeUs) {
        self.0.set(self.0.get().max(moment.0));
    }
}

/// A line that is high now, since those times; after them never.
pub struct Line(pub Rc<RefCell<VecDeque<u64>>>);

impl DataReady for Line {
    async fn ready(&mut self) -> Option<DeviceTimeUs> {
        let rose = self.0.borrow_mut().pop_front();
        match rose {
            Some(rose) => Some(DeviceTimeUs(rose)),
            None => std::future::pending().await,
        }
    }
}

/// The plan of a chip.
pub fn plan<C: FifoChip>(rate_hz: u16, range_g: u8, resolution: Resolution) -> Plan {
    let settings = Settings { rate_hz, range_g, resolution, ..Settings::default() };
    FifoSensor::<C, Line, Clock>::plan(&settings).expect("the chip can do it")
}

/// Runs `use_it` with an I²C bus that sees exactly `expected` at `address`.
pub fn on_i2c<R>(
    address: u8,
    expected: &[Transaction],
    use_it: impl AsyncFnOnce(I2cBus<Mock>) -> R,
) -> R {
    let mut mock = Mock::new(expected);
    let result = embassy_futures::block_on(use_it(I2cBus { i2c: mock.clone(), address }));
    mock.done();
    result
}
