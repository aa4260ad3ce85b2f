//! Orders to the sampler.

use core::cell::RefCell;

use embassy_sync::blocking_mutex::Mutex;
use embassy_sync::blocking_mutex::raw::RawMutex;
use embassy_sync::signal::Signal;
use wimu_model::{CentiCelsius, CompassTerms, Corrector, ParameterId};

use crate::sample::RawSample;
use crate::sensor::Plan;
use crate::slot::Slot;

/// An order to the sampler.
#[allow(clippy::large_enum_variant, reason = "only one exists")]
pub(crate) enum Order<S: RawSample> {
    /// Configure the sensor and signal the result.
    Configure(Plan, Correction<S>),
    /// Use this corrector from the next sample on. Navigation restarts if the parameters changed.
    #[cfg(feature = "correction")]
    Correct(Correction<S>),
}

/// One order at a time. It stays here until it is executed, so that the sampler needs no memory for it
/// while it configures the sensor.
pub(crate) struct Orders<M: RawMutex, S: RawSample> {
    order: Mutex<M, RefCell<Slot<Order<S>>>>,
    pub(crate) given: Signal<M, ()>,
    taken: Signal<M, ()>,
}

impl<M: RawMutex, S: RawSample> Orders<M, S> {
    pub(super) const fn new() -> Self {
        Self {
            order: Mutex::new(RefCell::new(Slot::Empty)),
            given: Signal::new(),
            taken: Signal::new(),
        }
    }

    /// Waits until the previous order has been executed.
    pub(crate) async fn room(&self) {
        while self.order.lock(|order| order.borrow().as_ref().is_some()) {
            self.taken.wait().await;
        }
    }

    pub(crate) fn give(&self, new: Order<S>) {
        self.order.lock(|order| *order.borrow_mut() = Slot::Full(new));
        self.given.signal(());
    }

    /// The plan of a [`Order::Configure`].
    pub(crate) fn plan(&self) -> Option<Plan> {
        self.order.lock(|order| match order.borrow().as_ref() {
            Some(Order::Configure(plan, _)) => Some(*plan),
            _ => None,
        })
    }

    pub(crate) fn take(&self) -> Option<Order<S>> {
        let order = self.order.lock(|order| order.borrow_mut().take());
        self.taken.signal(());
        order
    }
}

/// A corrector and what it was compiled from.
pub(crate) struct Correction<S: RawSample> {
    /// `None` without the feature `correction`.
    pub(crate) correctors: Option<(Corrector, S::Gyroscope)>,
    pub(crate) parameters: ParameterId,
    pub(crate) temperature: Option<CentiCelsius>,
    /// `None` without a calibrated magnetometer.
    pub(crate) compass: Option<CompassTerms>,
}
