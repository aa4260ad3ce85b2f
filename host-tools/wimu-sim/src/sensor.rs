//! A simulated sensor: its chip at register level, its interrupt line, and its removal.

use std::cell::RefCell;
use std::future::{Future, poll_fn};
use std::pin::Pin;
use std::rc::Rc;
use std::task::{Context, Poll, Waker};

use crate::adxl345::{self, Adxl345};
use crate::chip::Chip;
pub use crate::chip::GyroscopeFault;
use crate::clock::{Until, VirtualClock};
use crate::i2c::Target;
use crate::icm42688::Icm42688;
use crate::lsm6dso::Lsm6dso;
use crate::lsm303agr::Lsm303agr;
use crate::mpu6050::Mpu6050;
use crate::source::Source;

/// A simulated sensor; clones are the same one, so that one can be on the bus and another be controlled by
/// a test.
///
/// Samples are computed on access, up to the time of the clock.
#[derive(Clone, Debug)]
pub struct Sensor {
    clock: VirtualClock,
    state: Rc<RefCell<State>>,
}

#[derive(Debug)]
struct State {
    source: Box<dyn Source>,
    present: bool,
    chip: Box<dyn Chip>,
    pin: PinState,
    watchers: Vec<Waker>,
}

/// The interrupt line.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct PinState {
    high: bool,
    /// Time of the last rising edge, µs.
    rose_us: u64,
}

impl Sensor {
    /// An LSM303AGR after power-on, with samples from `source`; its interrupt line is
    /// INT1.
    pub fn lsm303agr(clock: &VirtualClock, source: impl Source + 'static) -> Self {
        Self::of(clock, source, Box::new(Lsm303agr::default()))
    }

    /// An ADXL345 at 0x53 after power-on, with samples from `source`; its interrupt line is INT1.
    pub fn adxl345(clock: &VirtualClock, source: impl Source + 'static) -> Self {
        Self::adxl345_at(clock, adxl345::ADDRESS, source)
    }

    /// An ADXL345 at `address` (0x53 or 0x1D), likewise.
    pub fn adxl345_at(clock: &VirtualClock, address: u8, source: impl Source + 'static) -> Self {
        Self::of(clock, source, Box::new(Adxl345::new(address)))
    }

    /// An LSM6DSO at `address` (0x6A or 0x6B) after power-on, with samples from `source`; its interrupt
    /// line is INT1.
    pub fn lsm6dso(clock: &VirtualClock, address: u8, source: impl Source + 'static) -> Self {
        Self::of(clock, source, Box::new(Lsm6dso::new(address)))
    }

    /// An LSM6DS3TR-C at `address` (0x6A or 0x6B), likewise.
    pub fn lsm6ds3tr_c(clock: &VirtualClock, address: u8, source: impl Source + 'static) -> Self {
        Self::of(clock, source, Box::new(Lsm6dso::lsm6ds3tr_c(address)))
    }

    /// A chip of the MPU-6050 family at 0x68 that identifies itself as `who_am_i`: 0x68 is an MPU-6050, others are an
    /// MPU-6500 or a part like it. Its interrupt line is INT.
    pub fn mpu6050(clock: &VirtualClock, who_am_i: u8, source: impl Source + 'static) -> Self {
        Self::of(clock, source, Box::new(Mpu6050::new(who_am_i)))
    }

    /// An ICM-42688 on SPI; its interrupt line is not modelled.
    pub fn icm42688(clock: &VirtualClock, source: impl Source + 'static) -> Self {
        Self::of(clock, source, Box::new(Icm42688::default()))
    }

    pub(crate) fn of(
        clock: &VirtualClock,
        source: impl Source + 'static,
        chip: Box<dyn Chip>,
    ) -> Self {
        Self {
            clock: clock.clone(),
            state: Rc::new(RefCell::new(State {
                source: Box::new(source),
                present: true,
                chip,
                pin: PinState::default(),
                watchers: Vec::new(),
            })),
        }
    }

    /// Whether the interrupt line is high.
    pub fn is_ready(&self) -> bool {
        self.look(|state, _| state.pin.high)
    }

    /// Waits until the interrupt line is high; returns the time of its rising edge, µs on the simulation's clock. Waiting
    /// can be cancelled at any time.
    pub async fn ready(&self) -> u64 {
        let mut timer = None;
        poll_fn(|context| self.poll_ready(context, &mut timer)).await
    }

    fn poll_ready(&self, context: &mut Context<'_>, timer: &mut Option<Until>) -> Poll<u64> {
        loop {
            let (pin, next_change) = self.look(|state, _| (state.pin, state.next_change()));
            if pin.high {
                return Poll::Ready(pin.rose_us);
            }
            self.watch(context.waker());
            *timer = next_change.map(|time| self.clock.until(time));
            let timer = timer.as_mut().map(|timer| Pin::new(timer).poll(context));
            if timer != Some(Poll::Ready(())) {
                return Poll::Pending;
            }
        }
    }

    /// Removes the sensor from the board, or puts it back: absent, it answers at no address and its line is
    /// low; put back, it is as after power-on.
    pub fn set_present(&self, present: bool) {
        self.change(|state, _| {
            if present && !state.present {
                state.chip.reset();
            }
            state.present = present;
        });
    }

    /// Makes the accelerometer identify itself as `id`, also after power-on.
    pub fn set_who_am_i(&self, id: u8) {
        self.change(|state, _| state.chip.core_mut().identity = id);
    }

    /// Breaks its gyroscope, or repairs it; nothing for a sensor without one.
    pub fn set_gyroscope_fault(&self, fault: GyroscopeFault) {
        self.change(|state, _| state.chip.core_mut().fault = fault);
    }

    /// Switches power off and on: all registers are reset.
    pub fn power_cycle(&self) {
        self.change(|state, _| state.chip.reset());
    }

    /// Number of accelerometer samples since the sensor was made, read or not.
    pub fn samples_taken(&self) -> u64 {
        self.look(|state, _| state.chip.core().taken)
    }

    /// Whether a replayed recording has ended and its last sample was read.
    pub fn finished(&self) -> bool {
        self.look(|state, _| state.source.exhausted() && !state.chip.has_unread())
    }

    /// Updates the sensor to the present time and calls `visit`.
    fn look<R>(&self, visit: impl FnOnce(&mut State, u64) -> R) -> R {
        let now = self.clock.now();
        let (result, watchers) = {
            let state = &mut *self.state.borrow_mut();
            let before = state.pin;
            state.settle(now);
            let result = visit(state, now);
            state.update_pin(now);
            let watchers =
                if state.pin != before { std::mem::take(&mut state.watchers) } else { Vec::new() };
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

    /// As [`look`](Self::look), for changes that may move the next sample.
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
            self.chip.settle(now, self.source.as_mut());
        }
        self.update_pin(now);
    }

    fn update_pin(&mut self, now: u64) {
        let high = self.present && self.chip.interrupt();
        if high != self.pin.high {
            self.pin.high = high;
            if high {
                self.pin.rose_us = now;
            }
        }
    }

    fn next_change(&self) -> Option<u64> {
        if self.present && !self.source.exhausted() { self.chip.next_change() } else { None }
    }
}

impl Target for Sensor {
    fn acknowledges(&self, address: u8) -> bool {
        let state = self.state.borrow();
        state.present && state.chip.acknowledges(address)
    }

    fn begin_write(&self, address: u8) {
        self.look(|state, _| state.chip.begin_write(address));
    }

    fn write(&self, address: u8, byte: u8) {
        self.change(|state, now| {
            let error = state.source.period_error_ppm();
            state.chip.write(address, byte, now, error);
        });
    }

    fn read(&self, address: u8) -> u8 {
        self.look(|state, _| state.chip.read(address))
    }
}
