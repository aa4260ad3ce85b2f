//! What the node asks of non-volatile memory.

/// What is stored.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Key {
    /// The committed parameter set.
    Parameters,
    /// The settings.
    Settings,
    /// How often the device has started.
    BootCount,
}

impl Key {
    /// All of them.
    pub const ALL: [Self; 3] = [Self::Parameters, Self::Settings, Self::BootCount];
}

/// Keeps a few records of up to [`MAX_RECORD`] bytes over a restart.
///
/// A `save` that power loss interrupts leaves the old record or the new one. What is in a record,
/// and whether it is intact, is the node's business: each is a frame of the wire, with its version
/// and its CRC.
#[allow(async_fn_in_trait)] // Nodes are polled where they are built; nothing needs `Send`.
pub trait Store {
    /// Reads a record into `buffer`, which holds [`MAX_RECORD`] bytes; `None` if there is none.
    ///
    /// # Errors
    /// [`StoreFault`] when the memory cannot be read.
    async fn load(&mut self, key: Key, buffer: &mut [u8]) -> Result<Option<usize>, StoreFault>;

    /// Writes a record in place of the one before.
    ///
    /// # Errors
    /// [`StoreFault`] when it could not be written; the old record still stands then.
    async fn save(&mut self, key: Key, record: &[u8]) -> Result<(), StoreFault>;

    /// Removes a record; none is there afterwards.
    ///
    /// # Errors
    /// [`StoreFault`] when it could not be removed; it still stands then.
    async fn remove(&mut self, key: Key) -> Result<(), StoreFault>;
}

/// Longest record, bytes.
pub const MAX_RECORD: usize = wimu_link::frame::MAX_FRAME;

/// The memory could not be read or written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct StoreFault;

impl core::fmt::Display for StoreFault {
    fn fmt(&self, out: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        out.write_str("the device's memory could not be read or written")
    }
}

impl core::error::Error for StoreFault {}
