//! Parameter sets: checked, compiled and given to the sampler.

use core::ops::Range;

use embassy_sync::blocking_mutex::raw::RawMutex;
use wimu_integrator::Compass;
use wimu_link::hello::sensor;
use wimu_link::message::{EncodedParameters, Event, ParameterFault, Refusal, WireParameters};
use wimu_model::{CentiCelsius, Corrector, ParameterId, ParameterSet};

use super::Control;
use crate::sample::SENSITIVITY_RATIO;
use crate::sample::sealed::Process as _;
use crate::sensor::{InertialSensor, Plan};
use crate::shared::{Correction, Order, PersistentFault, Set, Staged};
use crate::store::Store;
use crate::timer::Timer;

/// Change of the temperature after which the corrector is compiled again, 0.01 °C.
const TEMPERATURE_STEP: u16 = 50;
/// Index of the sensor whose samples the device corrects.
const CORRECTED: u8 = 0;

impl<A: InertialSensor, T: Timer, S: Store, M: RawMutex> Control<'_, A, T, S, M> {
    /// Configures the sensor for `plan`, corrected with the set in use, or with the set at the given position
    /// in `record`, if there is one.
    pub(super) async fn configure(
        &mut self,
        plan: &Plan,
        with: Option<&Option<Range<usize>>>,
    ) -> Result<(), Refusal> {
        self.orders.room().await;
        self.shared.configured.reset();
        let correction = match with {
            None => self.correction_in_use(plan)?,
            Some(position) => self.correction(plan, self.set_at(position))?,
        };
        self.orders.give(Order::Configure(*plan, correction));
        let outcome = self.shared.configured.wait().await;
        outcome.map_err(|_| Refusal::SensorFailed)
    }

    /// Compiles the corrector again after a temperature step.
    pub(super) async fn follow_temperature(&mut self, plan: &Plan, temperature: CentiCelsius) {
        let moved = self
            .latched
            .is_none_or(|latched| latched.0.abs_diff(temperature.0) >= TEMPERATURE_STEP);
        if moved {
            self.latched = Some(temperature);
            self.orders.room().await;
            if let Ok(correction) = self.correction_in_use(plan) {
                self.orders.give(Order::Correct(correction));
            }
        }
    }

    /// The corrector for `plan` with the set in use.
    pub(super) fn correction_in_use(&self, plan: &Plan) -> Result<Correction<A::Sample>, Refusal> {
        let mut active = Set::NONE;
        self.shared.active(&mut active);
        self.correction(plan, active.get())
    }

    /// The corrector for `plan`: that of the committed parameters if they are for its range, else that of an
    /// ideal sensor.
    pub(super) fn correction(
        &self,
        plan: &Plan,
        committed: Option<EncodedParameters>,
    ) -> Result<Correction<A::Sample>, Refusal> {
        if !cfg!(feature = "correction") {
            return Ok(Correction {
                correctors: None,
                parameters: ParameterId::UNCALIBRATED,
                temperature: None,
                compass: None,
            });
        }
        let range_g = plan.settings.range_g;
        if let Some(set) = committed {
            match self.compiled(plan, set) {
                Ok((correction, of)) if of == range_g => {
                    self.clear_fault(PersistentFault::Parameters);
                    return Ok(correction);
                }
                Err(Refusal::InvalidParameters(fault)) => {
                    let event = Event::ModelRejected(fault);
                    self.set_fault(PersistentFault::Parameters, event);
                    self.shared.report(self.timer.now(), event);
                }
                _ => {}
            }
        }
        self.ideal(plan)
    }

    /// The corrector of an ideal sensor.
    #[inline(never)] // Keeps its set off the stack of the caller.
    fn ideal(&self, plan: &Plan) -> Result<Correction<A::Sample>, Refusal> {
        let range_g = plan.settings.range_g;
        let uncalibrated = ParameterSet::uncalibrated(range_g, plan.sensor.sensitivity);
        self.compile(plan, &uncalibrated, ParameterId::UNCALIBRATED)
    }

    /// The corrector of a set, and its full-scale range, ± *g*.
    pub(super) fn compiled(
        &self,
        plan: &Plan,
        set: EncodedParameters,
    ) -> Result<(Correction<A::Sample>, u8), Refusal> {
        let mut wire = WireParameters::BLANK;
        wire.read(set.0).map_err(|_| Refusal::NothingStaged)?;
        // By reference: a copy of the set takes 1.2 kB of stack.
        let decoded = A::Sample::decode(&wire);
        let decoded = (decoded.as_ref()).map_err(|fault| Refusal::InvalidParameters(*fault))?;
        Ok((self.compile(plan, decoded, set.id())?, decoded.range_g))
    }

    pub(super) fn compile(
        &self,
        plan: &Plan,
        set: &ParameterSet,
        parameters: ParameterId,
    ) -> Result<Correction<A::Sample>, Refusal> {
        Ok(Correction {
            correctors: Some((
                Corrector::compile(set, self.latched)
                    .map_err(|fault| Refusal::InvalidParameters(fault.into()))?,
                A::Sample::compile_gyroscope(set, &plan.sensor, self.latched)
                    .map_err(Refusal::InvalidParameters)?,
            )),
            parameters,
            temperature: self.latched,
            compass: if A::MAGNETOMETER && cfg!(feature = "heading") {
                Compass::new(set)
            } else {
                None
            },
        })
    }

    /// Checks the received set and stores it in canonical form (rotations of length 1); returns its id.
    #[inline(never)] // Keeps the decoded set off the stack afterwards.
    pub(super) fn check_staged(
        &self,
        plan: &Plan,
        staging: &mut Staged,
    ) -> Result<ParameterId, Refusal> {
        let set = staging.set.get().ok_or(Refusal::NothingStaged)?;
        let mut wire = WireParameters::BLANK;
        let read = wire.read(set.0).map_err(ParameterFault::from);
        read.map_err(Refusal::InvalidParameters)?;
        let set = A::Sample::decode(&wire);
        let set = (set.as_ref()).map_err(|fault| Refusal::InvalidParameters(*fault))?;
        self.check_sensor(&wire).map_err(Refusal::InvalidParameters)?;
        wire.take_rotations(set);
        if set.range_g != plan.settings.range_g {
            return Err(Refusal::WrongRange {
                parameters_g: set.range_g,
                device_g: plan.settings.range_g,
            });
        }
        self.compile(plan, set, ParameterId::UNCALIBRATED)?;
        let ratio = set.sensitivity.lsb_per_g() / plan.sensor.sensitivity.lsb_per_g();
        let known = (self.shared).with_published(|published| published.hello.sensitivity_known);
        if known && !SENSITIVITY_RATIO.contains(&ratio) {
            return Err(Refusal::WrongSensitivity {
                parameters_lsb_per_g: set.sensitivity.lsb_per_g(),
                device_lsb_per_g: plan.sensor.sensitivity.lsb_per_g(),
            });
        }
        Ok(staging.set.encode(&wire))
    }

    /// Why a stored set cannot be used for a range, ± *g*.
    #[inline(never)] // Keeps the decoded set off the stack afterwards.
    pub(super) fn fault_of(&self, stored: EncodedParameters, range_g: u8) -> Option<Event> {
        let mut wire = WireParameters::BLANK;
        if wire.read(stored.0).is_err() || wire.range_g != range_g {
            return Some(Event::StoreUnreadable);
        }
        let fault = match A::Sample::decode(&wire) {
            Ok(_) => self.check_sensor(&wire).err(),
            Err(fault) => Some(fault),
        };
        fault.map(Event::ModelRejected)
    }

    /// Checks that a set was made for sensor 0 and this model of accelerometer.
    fn check_sensor(&self, wire: &WireParameters) -> Result<(), ParameterFault> {
        if wire.sensor_index != CORRECTED {
            return Err(ParameterFault::OtherSensorIndex {
                parameters: wire.sensor_index,
                device: CORRECTED,
            });
        }
        let device = self.shared.with_published(|published| published.hello.sensor.number);
        match wire.sensor {
            Some(parameters) if parameters != device && sensor::is_one_model(device) => {
                Err(ParameterFault::OtherSensor { parameters, device })
            }
            _ => Ok(()),
        }
    }
}
