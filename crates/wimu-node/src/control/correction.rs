//! The correction that the sampler applies.

use embassy_sync::blocking_mutex::raw::RawMutex;
use wimu_link::message::{Refusal, SetBytes};
use wimu_model::{CompiledSet, ParameterId};

use super::Control;
use crate::sample::sealed::Process as _;
use crate::sensor::{InertialSensor, Plan};
use crate::shared::{Correction, Order};
use crate::store::Store;
use crate::timer::Timer;

impl<A: InertialSensor, T: Timer, S: Store, M: RawMutex> Control<'_, A, T, S, M> {
    /// Configures the sensor for `plan`, corrected with `set`.
    pub(super) async fn configure(&mut self, plan: &Plan, set: &SetBytes) -> Result<(), Refusal> {
        self.orders.room().await;
        self.shared.configured.reset();
        self.orders.give(Order::Configure(*plan, self.correction(plan, set)));
        let outcome = self.shared.configured.wait().await;
        outcome.map_err(|_| Refusal::SensorFailed)
    }

    /// The corrector for `plan`: that of `set` if it is for its range, else that of an ideal sensor.
    pub(super) fn correction(&self, plan: &Plan, set: &SetBytes) -> Correction<A::Sample> {
        if !cfg!(feature = "correction") {
            return Correction {
                correctors: None,
                parameters: ParameterId::UNCALIBRATED,
                temperature: None,
                compass: None,
            };
        }
        let set = set.set().ok().flatten();
        let set = set.as_ref().filter(|set| set.range_g() == plan.settings.range_g);
        let accelerometer = match set {
            Some(set) => set.corrector(self.latched),
            None => plan.sensor.accelerometer.ideal(),
        };
        let gyroscope = A::Sample::gyroscope(set, &plan.sensor, self.latched);
        Correction {
            correctors: Some((accelerometer, gyroscope)),
            parameters: set.map_or(ParameterId::UNCALIBRATED, CompiledSet::source),
            temperature: self.latched,
            compass: (set.and_then(CompiledSet::compass).copied())
                .filter(|_| A::MAGNETOMETER && cfg!(feature = "heading")),
        }
    }

    /// Uses a stored set from now on.
    pub(super) fn activate(&self, set: &SetBytes) {
        if !cfg!(feature = "correction") {
            return;
        }
        let id = set.set().ok().flatten().map_or(ParameterId::UNCALIBRATED, |set| set.source());
        self.shared.activate(set, id);
    }
}
