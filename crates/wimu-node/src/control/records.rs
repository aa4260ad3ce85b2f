//! Stored records: read at the start, written on request.

use core::ops::Range;

use embassy_sync::blocking_mutex::raw::RawMutex;
use wimu_link::auth::{DeviceKey, KeyState};
use wimu_link::message::{EncodedParameters, Event, Record, Refusal, Settings};
use wimu_link::{Kind, LinkRole, frame};

use super::{Control, plan};
use crate::sensor::{InertialSensor, Plan};
use crate::shared::{Message, PersistentFault, ROLES};
use crate::store::{Key, Store, StoreFault};
use crate::timer::Timer;

/// Longest record that holds no parameter set, bytes.
const SHORT_RECORD: usize = 64;

impl<A: InertialSensor, T: Timer, S: Store, M: RawMutex> Control<'_, A, T, S, M> {
    /// Reads the store and starts the sensor. Records that cannot be read or used are reported and ignored.
    pub(super) async fn start(&mut self) -> Plan {
        let mut bytes = [0; 4];
        let boot_count = match self.load_raw(Key::BootCount, &mut bytes).await {
            _ if !cfg!(feature = "store") => Some(0),
            // A count that cannot be stored must not be used: it would be used again.
            Ok(_) => self.count_start(u32::from_le_bytes(bytes)).await,
            Err(StoreFault) => None,
        };
        if boot_count.is_none() {
            self.set_fault(PersistentFault::BootCount, Event::StoreUnreadable);
        }
        let mut key = [0; DeviceKey::LENGTH];
        let key = match self.load_raw(Key::DeviceKey, &mut key).await {
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
            false => self.load(Key::Settings).await,
        };
        let mut wanted = match loaded.map(|place| place.map(|at| Record::decode(self.content(&at))))
        {
            Ok(Some(Ok(Record::Settings(settings)))) => settings,
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
        let parameters = self.load_parameters(plan.settings.range_g).await;
        self.shared.activate(self.set_at(&parameters));
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
                let stored = self.load_raw(rate_key(role), &mut bytes).await == Ok(true);
                let baud = u32::from_le_bytes(bytes);
                let order = crate::shared::RateOrder::Use(stored.then_some(baud));
                self.shared.rate_signals(role).order.signal(order);
            }
            self.shared.introduce(role, self.timer.now());
        }
        // The sampler reports a sensor that does not start, and retries.
        let _ = self.configure(&plan, None).await;
        plan
    }

    #[cfg(not(feature = "correction"))]
    pub(super) async fn load_parameters(&mut self, _: u8) -> Option<Range<usize>> {
        None
    }

    /// Loads the set committed for a range; returns its position in `record`. A set that cannot be read or
    /// used is reported. None in safe mode.
    #[cfg(feature = "correction")]
    pub(super) async fn load_parameters(&mut self, range_g: u8) -> Option<Range<usize>> {
        if self.shared.is_safe_mode() {
            return None;
        }
        let loaded = self.load(Key::Parameters { range_g }).await;
        let place = match loaded {
            Ok(place) => place,
            Err(StoreFault) => {
                self.set_fault(PersistentFault::Parameters, Event::StoreUnreadable);
                return None;
            }
        };
        let fault = match place.clone().map(|place| Record::decode(self.content(&place))) {
            None => None,
            Some(Ok(Record::Parameters(stored))) => self.fault_of(stored, range_g),
            Some(_) => Some(Event::StoreUnreadable),
        };
        let now = self.timer.now();
        self.shared.set_fault(PersistentFault::Parameters, now, fault);
        if fault.is_some() { None } else { place }
    }

    /// The parameter set at a position in `record`.
    pub(super) fn set_at(&self, place: &Option<Range<usize>>) -> Option<EncodedParameters<'_>> {
        match Record::decode(self.content(place.as_ref()?)) {
            Ok(Record::Parameters(set)) => Some(set),
            _ => None,
        }
    }

    /// The content of an opened record. Its first byte is the kind.
    pub(super) fn content(&self, place: &Range<usize>) -> &[u8] {
        self.record.get(place.clone()).unwrap_or_default()
    }

    /// Reads a record; returns the position of its content in `record`. A damaged record is an error.
    pub(super) async fn load(&mut self, key: Key) -> Result<Option<Range<usize>>, StoreFault> {
        let Some(length) = self.store.load(key, &mut self.record).await? else {
            return Ok(None);
        };
        let record = self.record.get_mut(..length).unwrap_or_default();
        let opened = frame::open(record).map_err(|_| StoreFault)?;
        Ok(Some(0..opened))
    }

    pub(super) async fn save_settings(&mut self, settings: Settings) -> Result<(), Refusal> {
        let mut record = [0; SHORT_RECORD];
        let length = settings_record(settings, &mut record);
        self.announce_pause().await;
        let record = record.get(..length).unwrap_or_default();
        let saved = self.store.save(Key::Settings, record).await;
        saved.map_err(|StoreFault| Refusal::StoreFailed)
    }

    pub(super) async fn save_record(&mut self, key: Key, length: usize) -> Result<(), Refusal> {
        let record = self.record.get(..length).unwrap_or_default();
        let saved = self.store.save(key, record).await;
        saved.map_err(|StoreFault| Refusal::StoreFailed)
    }

    pub(super) async fn save_rate(&mut self, line: LinkRole, baud: u32) -> Result<(), Refusal> {
        self.announce_pause().await;
        let saved = self.save_raw(rate_key(line), &baud.to_le_bytes()).await;
        saved.map_err(|_| Refusal::StoreFailed)
    }

    /// Stores the next boot count; `None` if it cannot be stored.
    pub(super) async fn count_start(&mut self, before: u32) -> Option<u32> {
        let count = before.wrapping_add(1).max(1);
        let saved = self.save_raw(Key::BootCount, &count.to_le_bytes()).await;
        saved.is_ok().then_some(count)
    }

    /// Reads a record of exactly as many bytes as `bytes` has; returns whether there is one.
    pub(super) async fn load_raw(
        &mut self,
        key: Key,
        bytes: &mut [u8],
    ) -> Result<bool, StoreFault> {
        let Some(place) = self.load(key).await? else {
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

// Not async: an async function would keep the message in the task. It fits.

fn settings_record(settings: Settings, record: &mut [u8]) -> usize {
    Message::Settings(settings).encode(record).unwrap_or(0)
}

fn rate_key(line: LinkRole) -> Key {
    match line {
        LinkRole::Cable => Key::CableRate,
        _ => Key::WirelessRate,
    }
}
