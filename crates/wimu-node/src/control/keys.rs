//! The key.

use embassy_sync::blocking_mutex::raw::RawMutex;
use wimu_link::auth::KeyState;
use wimu_link::message::{Event, Settings};
#[cfg(feature = "auth")]
use wimu_link::{
    auth::DeviceKey,
    message::{Payload, Refusal},
};

use super::{Control, plan};
use crate::sensor::{InertialSensor, Plan};
use crate::shared::{PersistentFault, ROLES};
use crate::slot::put;
#[cfg(feature = "auth")]
use crate::store::StoreFault;
use crate::store::{Key, Store};
use crate::timer::Timer;

impl<A: InertialSensor, T: Timer, S: Store, M: RawMutex> Control<'_, A, T, S, M> {
    /// Removes the key and the settings after the owner's gesture at the board.
    pub(super) async fn forget_lost_key(&mut self, plan: &mut Plan) {
        self.announce_pause().await;
        let removed = self.store.remove(|key| matches!(key, Key::DeviceKey | Key::Settings)).await;
        if removed.is_err() {
            self.shared.report(self.timer.now(), Event::StoreUnreadable);
            return;
        }
        if let Some(new) = plan::nearest(&self.planner, &Settings::default()) {
            let parameters = self.load_parameters(new.settings.range_g);
            // A failed sensor is restarted with these settings later.
            let _ = self.configure(&new, &parameters).await;
            put(plan, &new);
            self.activate(&parameters);
            self.shared.publish(|published| published.settings = new.settings);
            self.clear_fault(PersistentFault::Settings);
        }
        self.use_key(KeyState::None);
    }

    /// Stores a key and uses it. If the boot count could not be read, it restarts with a different key:
    /// sessions of earlier starts are not valid with that key.
    #[cfg(feature = "auth")]
    pub(super) async fn set_key(&mut self, key: DeviceKey) -> Result<Payload, Refusal> {
        self.save(Key::DeviceKey, key.expose()).await?;
        let lock = self.shared.lock();
        if lock.boot_count.is_none() && lock.key != KeyState::Set(key) {
            let boot_count = self.store.count_start().await.ok();
            self.shared.publish(|published| {
                published.hello.boot_count = boot_count.unwrap_or(0);
                published.lock.boot_count = boot_count;
            });
            if boot_count.is_some() {
                self.clear_fault(PersistentFault::BootCount);
            }
        }
        self.use_key(KeyState::Set(key));
        Ok(self.key_status())
    }

    /// Forgets the key.
    #[cfg(feature = "auth")]
    pub(super) async fn forget_key(&mut self) -> Result<Payload, Refusal> {
        self.announce_pause().await;
        let removed = self.store.remove(|key| key == Key::DeviceKey).await;
        removed.map_err(|StoreFault| Refusal::StoreFailed)?;
        self.use_key(KeyState::None);
        Ok(self.key_status())
    }

    /// Uses this key from now on, and announces it.
    fn use_key(&mut self, key: KeyState) {
        self.shared.publish(|published| published.lock.key = key);
        self.clear_fault(PersistentFault::DeviceKey);
        for role in ROLES {
            self.shared.introduce(role, self.timer.now());
        }
    }
}
