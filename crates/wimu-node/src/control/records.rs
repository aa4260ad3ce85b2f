//! Stored records: read at the start, written on request.

use core::ops::Range;

use embassy_sync::blocking_mutex::raw::RawMutex;
use wimu_link::auth::{DeviceKey, KeyState};
use wimu_link::message::{Event, Refusal, SetBytes, Settings};
use wimu_link::{Kind, LinkRole, frame};

use super::{Control, plan};
use crate::sensor::{InertialSensor, Plan};
use crate::shared::{PersistentFault, ROLES};
use crate::store::{Key, Store, StoreFault};
use crate::timer::Timer;

/// Longest record that holds no parameter set, bytes.
const SHORT_RECORD: usize = 64;

impl<A: InertialSensor, T: Timer, S: Store, M: RawMutex> Control<'_, A, T, S, M> {
    /// Reads the store and starts the sensor. Records that cannot be read or used are reported and ignored.
    pub(super) async fn start(&mut self) -> Plan {
        // A count that cannot be stored must not be used: it would be used again.
        let boot_count = self.store.count_start().await.ok();
        if boot_count.is_none() {
            self.set_fault(PersistentFault::BootCount, Event::StoreUnreadable);
        }
        let mut key = [0; DeviceKey::LENGTH];
        let key = match self.load_raw(Key::DeviceKey, &mut key) {
            _ if !cfg!(feature = "auth") => KeyState::None,
            Ok(false) => KeyState::None,
            Ok(true) => KeyState::Set(DeviceKey::new(key)),
            Err(StoreFault) => {
                self.set_fault(PersistentFault::DeviceKey, Event::StoreUnreadable);
                KeyState::Unreadable
            }
        };
        let is_safe_mode = self.shared.is_safe_mode();
        let loaded = match is_safe_mode {
            true => Ok(None),
            false => self.load(Key::Settings),
        };
        let decode = |at| Settings::from_bytes(self.content(&at).get(1..).unwrap_or_default());
        let mut wanted = match loaded.map(|place| place.map(decode)) {
            Ok(Some(Ok(settings))) => settings,
            // Nothing is stored: the sensor's settings nearest to the default ones are its default.
            Ok(None) => plan::nearest(&self.planner, &Settings::default())
                .map_or_else(Settings::default, |plan| plan.settings),
            _ => {
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
            #[cfg(feature = "line-rates")]
            {
                let mut bytes = [0; 4];
                let stored = self.load_raw(rate_key(role), &mut bytes) == Ok(true);
                let baud = u32::from_le_bytes(bytes);
                let order = crate::shared::RateOrder::Use(stored.then_some(baud));
                self.shared.rate_signals(role).order.signal(order);
            }
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
        let mut bytes = [0; SetBytes::MAX];
        let (set, fault) = match self.store.load(Key::Parameters { range_g }, &mut bytes) {
            Ok(None) => (SetBytes::NONE, None),
            Ok(Some(length)) => {
                let set = SetBytes::new(bytes.get(..length).unwrap_or_default());
                let set = set.unwrap_or_default();
                (set, self.fault_of(&set, range_g))
            }
            Err(StoreFault) => (SetBytes::NONE, Some(Event::StoreUnreadable)),
        };
        self.shared.set_fault(PersistentFault::Parameters, self.timer.now(), fault);
        if fault.is_some() { SetBytes::NONE } else { set }
    }

    /// The content of an opened record. Its first byte is the kind.
    pub(super) fn content(&self, place: &Range<usize>) -> &[u8] {
        self.record.get(place.clone()).unwrap_or_default()
    }

    /// Reads a record; returns the position of its content in `record`. A damaged record is an error.
    pub(super) fn load(&mut self, key: Key) -> Result<Option<Range<usize>>, StoreFault> {
        let Some(length) = self.store.load(key, &mut self.record)? else {
            return Ok(None);
        };
        let record = self.record.get_mut(..length).unwrap_or_default();
        let opened = frame::open(record).map_err(|_| StoreFault)?;
        Ok(Some(0..opened))
    }

    pub(super) async fn save_settings(&mut self, settings: Settings) -> Result<(), Refusal> {
        let mut bytes = [0; Settings::MAX_BYTES];
        let length = settings.to_bytes(&mut bytes);
        self.announce_pause().await;
        let bytes = bytes.get(..length).unwrap_or_default();
        let saved = self.save_raw(Key::Settings, bytes).await;
        saved.map_err(|StoreFault| Refusal::StoreFailed)
    }

    pub(super) async fn save_parameters(
        &mut self,
        range_g: u8,
        set: &SetBytes,
    ) -> Result<(), Refusal> {
        let saved = self.store.save(Key::Parameters { range_g }, set.as_bytes()).await;
        saved.map_err(|StoreFault| Refusal::StoreFailed)
    }

    pub(super) async fn save_rate(&mut self, line: LinkRole, baud: u32) -> Result<(), Refusal> {
        self.announce_pause().await;
        let saved = self.save_raw(rate_key(line), &baud.to_le_bytes()).await;
        saved.map_err(|_| Refusal::StoreFailed)
    }

    /// Reads a record of exactly as many bytes as `bytes` has; returns whether there is one.
    pub(super) fn load_raw(&mut self, key: Key, bytes: &mut [u8]) -> Result<bool, StoreFault> {
        let Some(place) = self.load(key)? else {
            return Ok(false);
        };
        match self.content(&place).split_first() {
            Some((_, stored)) if stored.len() == bytes.len() => bytes.copy_from_slice(stored),
            _ => return Err(StoreFault),
        }
        Ok(true)
    }

    pub(super) async fn save_raw(&mut self, key: Key, content: &[u8]) -> Result<(), StoreFault> {
        let mut record = [0; SHORT_RECORD];
        let length = frame::encode(Kind::Telemetry, content, &mut record);
        let length = length.map_err(|_| StoreFault)?;
        let record = record.get(..length).unwrap_or_default();
        self.store.save(key, record).await
    }
}

fn rate_key(line: LinkRole) -> Key {
    match line {
        LinkRole::Cable => Key::CableRate,
        _ => Key::WirelessRate,
    }
}
