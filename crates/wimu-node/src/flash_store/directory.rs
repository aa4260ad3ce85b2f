//! The latest generation of every record.

use heapless::Vec;

use super::DIRECTORY;
use super::recovery::Rank;
use crate::store::StoreFault;

/// Records that a store can hold, removed ones included until their slot is needed.
pub(super) const KEYS: usize = 16;
/// Bytes of an entry in flash: key, whether the record exists, generation.
pub(super) const ENTRY_BYTES: usize = 6;
/// Bytes of the longest directory in flash.
pub(super) const MAX_BYTES: usize = KEYS * ENTRY_BYTES;

/// The latest generation of every record that is or was in the store.
#[derive(Clone)]
pub(super) struct Directory {
    pub(super) entries: Vec<Entry, KEYS>,
}

/// A generation of a record.
#[derive(Clone, Copy)]
pub(super) struct Entry {
    pub(super) key: u8,
    /// Whether this generation saved the record (or removed it).
    pub(super) exists: bool,
    pub(super) generation: u32,
    /// Address of its item; 0 if none has been found.
    pub(super) at: u32,
    /// Length of the record, bytes.
    pub(super) length: u16,
    /// Reliability of the item at `at`.
    pub(super) rank: Rank,
}

impl Entry {
    /// A record that has never been saved.
    pub(super) const fn unknown(key: u8) -> Self {
        Self { key, exists: false, generation: 0, at: 0, length: 0, rank: Rank::None }
    }

    /// The next generation, which saves the record or removes it.
    pub(super) fn followed_by(self, exists: bool) -> Self {
        Self { exists, generation: self.generation.saturating_add(1), ..Self::unknown(self.key) }
    }

    /// The same generation without an item.
    pub(super) fn without_item(self) -> Self {
        Self { exists: self.exists, generation: self.generation, ..Self::unknown(self.key) }
    }

    pub(super) fn from_bytes(&[key, exists, a, b, c, d]: &[u8; ENTRY_BYTES]) -> Self {
        Self {
            exists: exists != 0,
            generation: u32::from_le_bytes([a, b, c, d]),
            ..Self::unknown(key)
        }
    }

    fn to_bytes(self) -> [u8; ENTRY_BYTES] {
        let [a, b, c, d] = self.generation.to_le_bytes();
        [self.key, self.exists.into(), a, b, c, d]
    }
}

impl Directory {
    pub(super) const EMPTY: Self = Self { entries: Vec::new() };

    pub(super) fn entry(&self, key: u8) -> Entry {
        let mut entries = self.entries.iter();
        let known = entries.find(|entry| entry.key == key);
        known.copied().unwrap_or(Entry::unknown(key))
    }

    /// Takes an entry of a later generation than the known one.
    pub(super) fn insert_newer(&mut self, entry: Entry) -> Result<(), StoreFault> {
        if entry.key == DIRECTORY || entry.generation <= self.entry(entry.key).generation {
            return Ok(());
        }
        self.insert(entry)
    }

    /// Replaces the key's entry, or appends one, or replaces that of a removed record.
    pub(super) fn insert(&mut self, entry: Entry) -> Result<(), StoreFault> {
        if let Some(known) = self.entries.iter_mut().find(|known| known.key == entry.key) {
            *known = entry;
        } else if self.entries.push(entry).is_err() {
            let removed = self.entries.iter_mut().find(|known| !known.exists);
            *removed.ok_or(StoreFault)? = entry;
        }
        Ok(())
    }

    /// The directory as it is stored. An empty one has one entry of zeros, because an empty item is a
    /// seal.
    pub(super) fn to_bytes(&self) -> Vec<u8, MAX_BYTES> {
        let mut bytes = Vec::new();
        for entry in &self.entries {
            let _ = bytes.extend_from_slice(&entry.to_bytes());
        }
        if bytes.is_empty() {
            let _ = bytes.extend_from_slice(&[0; ENTRY_BYTES]);
        }
        bytes
    }
}
