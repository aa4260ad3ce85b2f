//! The LSM303AGR at register level: accelerometer at 0x19, magnetometer at 0x1E, thermometer.
//!
//! Modelled: identities, output data rates, power-down, ranges, resolutions of 8, 10 and 12 bits,
//! left-justified output with block data update and either byte order, axis enables, status with
//! overruns, data-ready on INT1 of either polarity, thermometer, sub-address increment;
//! magnetometer continuous, single and idle, its offset registers and soft reset. Other registers
//! keep what is written to them and do nothing: FIFO, filters, self-test, the interrupt
//! generators and the magnetometer's own pin are not modelled.

mod accelerometer;
mod magnetometer;
mod sampling;

use std::cell::RefCell;
use std::convert::Infallible;
use std::future::{Future, poll_fn};
use std::pin::Pin;
use std::rc::Rc;
use std::task::{Context, Poll, Waker};

use embedded_hal::digital::{ErrorType, InputPin};
use embedded_hal_async::digital::Wait;

use crate::clock::{Until, VirtualClock};
use crate::i2c::Target;
use crate::source::Source;
use accelerometer::Accelerometer;
use magnetometer::Magnetometer;

/// I²C address of the accelerometer and thermometer.
pub const ACCELEROMETER_ADDRESS: u8 = 0x19;
/// I²C address of the magnetometer.
pub const MAGNETOMETER_ADDRESS: u8 = 0x1E;

/// A simulated LSM303AGR; clones are the same sensor, so that one can be on the bus and another
/// in the hands of a test.
///
/// It computes its samples when somebody looks, up to the time the clock shows.
#[derive(Clone, Debug)]
pub struct Lsm303agr {
    clock: VirtualClock,
    state: Rc<RefCell<State>>,
}

#[derive(Debug)]
struct State {
    source: Box<dyn Source>,
    present: bool,
    accelerometer: Accelerometer,
    magnetometer: Magnetometer,
    accelerometer_pointer: Pointer,
    magnetometer_pointer: Pointer,
    pin: PinState,
    watchers: Vec<Waker>,
}

/// INT1: its level, and how often it changed, so that no edge is missed.
#[derive(Clone, Copy, Debug, Default)]
struct PinState {
    high: bool,
    rises: u64,
    falls: u64,
}

/// Which register the next byte is for.
#[derive(Clone, Copy, Debug, Default)]
struct Pointer {
    register: u8,
    increments: bool,
    /// The next byte written is a sub-address.
    expects_register: bool,
}

impl Pointer {
    /// Takes a sub-address; its bit 7 asks for increments.
    fn set(&mut self, sub_address: u8) {
        self.register = sub_address & 0x7F;
        self.increments = sub_address & 0x80 != 0;
        self.expects_register = false;
    }

    /// The register for one byte of data.
    fn next(&mut self) -> u8 {
        let register = self.register;
        if self.increments {
            self.register = (register + 1) & 0x7F;
        }
        register
    }
}

impl Lsm303agr {
    /// A sensor that has just got power, with samples from `source`.
    pub fn new(clock: &VirtualClock, source: impl Source + 'static) -> Self {
        Self {
            clock: clock.clone(),
            state: Rc::new(RefCell::new(State {
                source: Box::new(source),
                present: true,
                accelerometer: Accelerometer::default(),
                magnetometer: Magnetometer::default(),
                accelerometer_pointer: Pointer::default(),
                magnetometer_pointer: Pointer::default(),
                pin: PinState::default(),
                watchers: Vec::new(),
            })),
        }
    }

    /// INT1, for the microcontroller to wait on.
    pub fn data_ready(&self) -> DataReadyPin {
        DataReadyPin {
            sensor: self.clone(),
        }
    }

    /// Takes the sensor off the board, or puts it back: it answers at no address and INT1 is low
    /// meanwhile; put back, it has just got power.
    pub fn set_present(&self, present: bool) {
        self.change(|state, _| {
            if present && !state.present {
                state.reset();
            }
            state.present = present;
        });
    }

    /// Makes the accelerometer identify itself as `id`; right is 0x33. Survives loss of power.
    pub fn set_who_am_i(&self, id: u8) {
        self.change(|state, _| state.accelerometer.who_am_i = id);
    }

    /// Takes samples from `source` from now on.
    pub fn set_source(&self, source: impl Source + 'static) {
        self.change(|state, _| state.source = Box::new(source));
    }

    /// Takes power off and puts it back: all registers are as after a start.
    pub fn power_cycle(&self) {
        self.change(|state, _| state.reset());
    }

    /// How many accelerometer samples were taken since the sensor was made, read or not.
    pub fn samples_taken(&self) -> u64 {
        self.look(|state, _| state.accelerometer.samples_taken())
    }

    /// Whether a replayed recording is at its end and its last sample was read.
    pub fn finished(&self) -> bool {
        self.look(|state, _| state.source.exhausted() && !state.accelerometer.has_fresh())
    }

    /// Brings the sensor up to now and lets `visit` see it.
    fn look<R>(&self, visit: impl FnOnce(&mut State, u64) -> R) -> R {
        let now = self.clock.now();
        let (result, watchers) = {
            let state = &mut *self.state.borrow_mut();
            let before = state.pin;
            state.settle(now);
            let result = visit(state, now);
            state.update_pin();
            let edges = |pin: PinState| (pin.rises, pin.falls);
            let watchers = if edges(state.pin) != edges(before) {
                std::mem::take(&mut state.watchers)
            } else {
                Vec::new()
            };
            (result, watchers)
        };
        watchers.into_iter().for_each(Waker::wake);
        result
    }

    /// Wakes `waker` at the next change.
    fn watch(&self, waker: &Waker) {
        let watchers = &mut self.state.borrow_mut().watchers;
        if !watchers.iter().any(|known| known.will_wake(waker)) {
            watchers.push(waker.clone());
        }
    }

    /// As [`look`](Self::look), where the change may move the next sample.
    fn change(&self, change: impl FnOnce(&mut State, u64)) {
        let watchers = self.look(|state, now| {
            change(state, now);
            std::mem::take(&mut state.watchers)
        });
        watchers.into_iter().for_each(Waker::wake);
    }
}

impl State {
    /// Takes the samples that are due.
    fn settle(&mut self, now: u64) {
        if self.present {
            let source = self.source.as_mut();
            self.accelerometer.settle(now, source);
            self.magnetometer.settle(now, source);
        }
        self.update_pin();
    }

    fn reset(&mut self) {
        self.accelerometer.reset();
        self.magnetometer.reset();
    }

    fn update_pin(&mut self) {
        let high = self.present && self.accelerometer.int1();
        if high != self.pin.high {
            self.pin.high = high;
            if high {
                self.pin.rises += 1;
            } else {
                self.pin.falls += 1;
            }
        }
    }

    /// When INT1 may next change without anybody touching the sensor, µs.
    fn next_change(&self) -> Option<u64> {
        if self.present && !self.source.exhausted() {
            self.accelerometer.next_data_ready()
        } else {
            None
        }
    }

    fn pointer(&mut self, address: u8) -> &mut Pointer {
        if address == MAGNETOMETER_ADDRESS {
            &mut self.magnetometer_pointer
        } else {
            &mut self.accelerometer_pointer
        }
    }
}

impl Target for Lsm303agr {
    fn acknowledges(&self, address: u8) -> bool {
        let present = self.state.borrow().present;
        present && matches!(address, ACCELEROMETER_ADDRESS | MAGNETOMETER_ADDRESS)
    }

    fn begin_write(&self, address: u8) {
        self.look(|state, _| state.pointer(address).expects_register = true);
    }

    fn write(&self, address: u8, byte: u8) {
        self.change(|state, now| {
            let pointer = state.pointer(address);
            if pointer.expects_register {
                pointer.set(byte);
                return;
            }
            let register = pointer.next();
            let error = state.source.period_error_ppm();
            if address == MAGNETOMETER_ADDRESS {
                state.magnetometer.write(register, byte, now, error);
            } else {
                state.accelerometer.write(register, byte, now, error);
            }
        });
    }

    fn read(&self, address: u8) -> u8 {
        self.look(|state, _| {
            let register = state.pointer(address).next();
            if address == MAGNETOMETER_ADDRESS {
                state.magnetometer.read(register)
            } else {
                state.accelerometer.read(register)
            }
        })
    }
}

/// INT1 of the sensor as a pin of the microcontroller. Waiting can be cancelled at any time.
#[derive(Clone, Debug)]
pub struct DataReadyPin {
    sensor: Lsm303agr,
}

impl DataReadyPin {
    fn state(&self) -> PinState {
        self.sensor.look(|state, _| state.pin)
    }

    /// Waits until `reached` holds of the pin.
    async fn until(&self, reached: impl Fn(PinState) -> bool) {
        let mut timer = None;
        poll_fn(|context| self.poll(context, &mut timer, &reached)).await;
    }

    fn poll(
        &self,
        context: &mut Context<'_>,
        timer: &mut Option<Until>,
        reached: impl Fn(PinState) -> bool,
    ) -> Poll<()> {
        loop {
            let (pin, next_change) = self
                .sensor
                .look(|state, _| (state.pin, state.next_change()));
            if reached(pin) {
                return Poll::Ready(());
            }
            self.sensor.watch(context.waker());
            *timer = next_change.map(|time| self.sensor.clock.until(time));
            let timer = timer.as_mut().map(|timer| Pin::new(timer).poll(context));
            if timer != Some(Poll::Ready(())) {
                return Poll::Pending;
            }
        }
    }
}

impl ErrorType for DataReadyPin {
    type Error = Infallible;
}

impl InputPin for DataReadyPin {
    fn is_high(&mut self) -> Result<bool, Infallible> {
        Ok(self.state().high)
    }

    fn is_low(&mut self) -> Result<bool, Infallible> {
        Ok(!self.state().high)
    }
}

impl Wait for DataReadyPin {
    async fn wait_for_high(&mut self) -> Result<(), Infallible> {
        self.until(|pin| pin.high).await;
        Ok(())
    }

    async fn wait_for_low(&mut self) -> Result<(), Infallible> {
        self.until(|pin| !pin.high).await;
        Ok(())
    }

    async fn wait_for_rising_edge(&mut self) -> Result<(), Infallible> {
        let seen = self.state().rises;
        self.until(|pin| pin.rises > seen).await;
        Ok(())
    }

    async fn wait_for_falling_edge(&mut self) -> Result<(), Infallible> {
        let seen = self.state().falls;
        self.until(|pin| pin.falls > seen).await;
        Ok(())
    }

    async fn wait_for_any_edge(&mut self) -> Result<(), Infallible> {
        let seen = self.state();
        self.until(|pin| (pin.rises, pin.falls) != (seen.rises, seen.falls))
            .await;
        Ok(())
    }
}
