//! Parameters and settings in the last 8 KiB of the flash.
use crate::flash::StoreFlash as Flash;
use sequential_storage::cache::{Cache, Uncached};
use sequential_storage::map::{MapConfig, MapStorage};
use wimu_node::{Key, MAX_RECORD, Store, StoreFault};
const RANGE: core::ops::Range<u32> = 0..8192;
pub struct FlashStore {
    map: MapStorage<u8, Flash, Cache<Uncached, Uncached, Uncached, u8>>,
    buffer: [u8; (1 + MAX_RECORD).next_multiple_of(4)],
}
impl FlashStore {
    pub const fn new(flash: Flash) -> Self {
        Self { map: MapStorage::new(flash, const { MapConfig::new(RANGE) }, Cache::new_uncached()), buffer: [0; _] }
    }
}
impl Store for FlashStore {
    async fn load(&mut self, key: Key, buffer: &mut [u8]) -> Result<Option<usize>, StoreFault> {
        let key = key as u8;
        let found = self.map.fetch_item::<&[u8]>(&mut self.buffer, &key);
        let Some(record) = found.await.map_err(|_| StoreFault)? else { return Ok(None); };
        buffer.get_mut(..record.len()).ok_or(StoreFault)?.copy_from_slice(record);
        Ok(Some(record.len()))
    }
    async fn save(&mut self, key: Key, record: &[u8]) -> Result<(), StoreFault> {
        let key = key as u8;
        self.map.store_item(&mut self.buffer, &key, &record).await.map_err(|_| StoreFault)
    }
    async fn remove(&mut self, key: Key) -> Result<(), StoreFault> {
        let key = key as u8;
        self.map.remove_item(&mut self.buffer, &key).await.map_err(|_| StoreFault)
    }
}
