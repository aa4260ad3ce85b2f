//! Stored records: read at the start, written on request.

use embassy_sync::blocking_mutex::raw::RawMutex;
use heapless::Vec;
use wimu_link::auth::{DeviceKey, KeyState};
use wimu_link::message::{Event, Refusal, SetBytes, Settings};

use super::{Control, plan};
use crate::sensor::{InertialSensor, Plan};
use crate::shared::{PersistentFault, ROLES};
use crate::store::{Key, MAX_RECORD, Store, StoreFault};
use crate::timer::Timer;

/// A stored record.
type Record = Vec<u8, MAX_RECORD>;

impl<A: InertialSensor, T: Timer, S: Store, M: RawMutex> Control<'_, A, T, S, M> {
    /// Reads the store and starts the sensor. Records that cannot be read or used are reported and ignored.
    pub(super) async fn start(&mut self) -> Plan {
        // A count that cannot be stored must not be used: it would be used again.
        let boot_count = self.store.count_start().await.ok();
        if boot_count.is_none() {
            self.set_fault(PersistentFault::BootCount, Event::StoreUnreadable);
        }
        let key = match self.load_key() {
            Ok(None) => KeyState::None,
            Ok(Some(key)) => KeyState::Set(key),
            Err(StoreFault) => {
                self.set_fault(PersistentFault::DeviceKey, Event::StoreUnreadable);
                KeyState::Unreadable
            }
        };
        let is_safe_mode = self.shared.is_safe_mode();
        let mut wanted = match self.load_settings() {
            Ok(Some(settings)) => settings,
            // Nothing is stored: the sensor's settings nearest to the default ones are its default.
            Ok(None) => plan::nearest(&self.planner, &Settings::default())
                .map_or_else(Settings::default, |plan| plan.settings),
            Err(StoreFault) => {
                self.set_fault(PersistentFault::Settings, Event::StoreUnreadable);
                Settings::default()
            }
        };
        if is_safe_mode {
            for streams in [&mut wanted.cable, &mut wanted.wireless] {
                (streams.corrected, streams.navigation) = (false, false);
            }
        }
        let plan = match plan::for_settings(&self.planner, &wanted) {
            Ok(plan) => Some(plan),
            Err(nearest) => {
                self.set_fault(PersistentFault::Settings, Event::SettingsAdjusted);
                plan::for_settings(&self.planner, &nearest).ok()
            }
        };
        // Every sensor supports the settings nearest to the default ones.
        let plan = match plan.or_else(|| plan::nearest(&self.planner, &Settings::default())) {
            Some(plan) => plan,
            None => core::future::pending().await,
        };
        let parameters = self.load_parameters(plan.settings.range_g);
        self.activate(&parameters);
        self.shared.publish(|published| {
            published.hello.boot_count = boot_count.unwrap_or(0);
            published.lock.boot_count = boot_count;
            published.lock.key = key;
            published.settings = plan.settings;
            published.ready = true;
        });
        for role in ROLES {
            self.shared.introduce(role, self.timer.now());
        }
        // The sampler reports a sensor that does not start, and retries.
        let _ = self.configure(&plan, &parameters).await;
        plan
    }

    #[cfg(not(feature = "correction"))]
    pub(super) fn load_parameters(&mut self, _: u8) -> SetBytes {
        SetBytes::NONE
    }

    /// The set stored for a range; none in safe mode. One that cannot be read or used is reported.
    #[cfg(feature = "correction")]
    pub(super) fn load_parameters(&mut self, range_g: u8) -> SetBytes {
        if self.shared.is_safe_mode() {
            return SetBytes::NONE;
        }
        let (set, fault) = match self.load(Key::Parameters { range_g }) {
            Ok(None) => (SetBytes::NONE, None),
            Ok(Some(record)) => {
                let set = SetBytes::new(&record).unwrap_or_default();
                (set, self.fault_of(&set, range_g))
            }
            Err(StoreFault) => (SetBytes::NONE, Some(Event::StoreUnreadable)),
        };
        self.shared.set_fault(PersistentFault::Parameters, self.timer.now(), fault);
        if fault.is_some() { SetBytes::NONE } else { set }
    }

    fn load_key(&mut self) -> Result<Option<DeviceKey>, StoreFault> {
        if !cfg!(feature = "auth") {
            return Ok(None);
        }
        let Some(record) = self.load(Key::DeviceKey)? else { return Ok(None) };
        let key = record.as_slice().try_into().map_err(|_| StoreFault)?;
        Ok(Some(DeviceKey::new(key)))
    }

    /// The stored settings; none in safe mode.
    fn load_settings(&mut self) -> Result<Option<Settings>, StoreFault> {
        if self.shared.is_safe_mode() {
            return Ok(None);
        }
        let Some(record) = self.load(Key::Settings)? else { return Ok(None) };
        let settings = Settings::from_bytes(&record).map_err(|_| StoreFault)?;
        Ok(Some(settings))
    }

    /// Reads a record. A damaged one is an error.
    fn load(&mut self, key: Key) -> Result<Option<Record>, StoreFault> {
        let mut bytes = [0; MAX_RECORD];
        let Some(length) = self.store.load(key, &mut bytes)? else { return Ok(None) };
        let record = bytes.get(..length).ok_or(StoreFault)?;
        Record::from_slice(record).map(Some).map_err(|_| StoreFault)
    }

    /// Announces a pause, and writes a record.
    pub(super) async fn save(&mut self, key: Key, record: &[u8]) -> Result<(), Refusal> {
        self.announce_pause().await;
        let saved = self.store.save(key, record).await;
        saved.map_err(|StoreFault| Refusal::StoreFailed)
    }
}
