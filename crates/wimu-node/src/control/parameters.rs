//! Parameter sets: checked, stored, and given to the sampler.

use embassy_sync::blocking_mutex::raw::RawMutex;
use wimu_link::message::{Event, Refusal, SetBytes};
use wimu_model::{CentiCelsius, CompiledSet, SetError};

use super::Control;
use crate::sensor::{InertialSensor, Plan};
use crate::shared::{Order, PersistentFault};
use crate::store::{Key, Store};
use crate::timer::Timer;

/// Change of the temperature after which the corrector is made again, 0.01 °C.
const TEMPERATURE_STEP: u16 = 50;

impl<A: InertialSensor, T: Timer, S: Store, M: RawMutex> Control<'_, A, T, S, M> {
    /// Makes the corrector again after a temperature step.
    pub(super) async fn follow_temperature(&mut self, plan: &Plan, temperature: CentiCelsius) {
        let moved = self
            .latched
            .is_none_or(|latched| latched.0.abs_diff(temperature.0) >= TEMPERATURE_STEP);
        if moved {
            self.latched = Some(temperature);
            self.orders.room().await;
            self.orders.give(Order::Correct(self.correction(plan, &self.shared.active())));
        }
    }

    /// The set, if it is one for this device.
    fn checked(&self, set: &SetBytes) -> Result<CompiledSet, SetError> {
        let set = set.set()?.ok_or(SetError::Length)?;
        let device = self.shared.with_published(|published| published.hello.device_id);
        if [0, device].contains(&set.device()) { Ok(set) } else { Err(SetError::Device) }
    }

    /// Stores a set and uses it. The one in use is left as it is: the answer was lost.
    pub(super) async fn set_parameters(
        &mut self,
        plan: &Plan,
        bytes: &SetBytes,
    ) -> Result<(), Refusal> {
        let set = self.checked(bytes).map_err(Refusal::InvalidParameters)?;
        if set.range_g() != plan.settings.range_g {
            return Err(Refusal::WrongRange {
                parameters_g: set.range_g(),
                device_g: plan.settings.range_g,
            });
        }
        if self.shared.active() == *bytes {
            return Ok(());
        }
        let key = Key::Parameters { range_g: set.range_g() };
        self.save(key, bytes.as_bytes()).await?;
        self.shared.activate(bytes, set.source());
        self.parameters_changed = true;
        self.clear_fault(PersistentFault::Parameters);
        self.orders.room().await;
        self.orders.give(Order::Correct(self.correction(plan, bytes)));
        Ok(())
    }

    /// Why a stored set cannot be used for a range, ± *g*.
    pub(super) fn fault_of(&self, stored: &SetBytes, range_g: u8) -> Option<Event> {
        match self.checked(stored) {
            Ok(set) if set.range_g() == range_g => None,
            Ok(_) => Some(Event::StoreUnreadable),
            Err(fault) => Some(Event::ParametersRejected(fault)),
        }
    }
}
