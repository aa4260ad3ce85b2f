//! Non-volatile memory of a node.

/// The key of a record.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Key {
    /// The committed parameter set of a full-scale range.
    Parameters {
        /// The range, ± *g*.
        range_g: u8,
    },
    /// The settings.
    Settings,
    /// The key that writes are signed with.
    DeviceKey,
    /// The rate of the wireless link's serial line.
    LineRate,
}

impl Key {
    /// Its number in a store: below 128 for single records, 128 + range for parameters. `None` for an invalid range.
    pub const fn number(self) -> Option<u8> {
        match self {
            Self::Settings => Some(2),
            Self::DeviceKey => Some(4),
            Self::LineRate => Some(5),
            Self::Parameters { range_g } => match range_g.checked_add(128) {
                Some(number) if range_g > 0 => Some(number),
                _ => None,
            },
        }
    }

    /// The key of a number.
    pub const fn from_number(number: u8) -> Option<Self> {
        match number {
            2 => Some(Self::Settings),
            4 => Some(Self::DeviceKey),
            5 => Some(Self::LineRate),
            129.. => Some(Self::Parameters { range_g: number - 128 }),
            _ => None,
        }
    }
}

/// Stores a few records of up to [`MAX_RECORD`] bytes, which survive a restart.
///
/// A `save` or `remove` interrupted by power loss leaves either the old or the new state. The node never drops
/// the futures before they complete.
#[allow(async_fn_in_trait)] // Nodes are polled where they are built; nothing needs `Send`.
pub trait Store {
    /// Longest time for which a `save` or `remove` may stall the processor, ms; announced to the hosts. 0 if it
    /// does not.
    fn pause_ms(&self) -> u16 {
        0
    }

    /// Reads a record into `buffer`, which holds [`MAX_RECORD`] bytes; `None` if it does not exist.
    ///
    /// # Errors
    /// [`StoreFault`] when the memory cannot be read, or a record that was saved is damaged.
    fn load(&mut self, key: Key, buffer: &mut [u8]) -> Result<Option<usize>, StoreFault>;

    /// Writes a record of at least one byte, replacing the old one.
    ///
    /// # Errors
    /// [`StoreFault`] when it could not be written; the old record is unchanged then.
    async fn save(&mut self, key: Key, record: &[u8]) -> Result<(), StoreFault>;

    /// Counts a start of the device; returns the number of starts so far, which is never returned again.
    ///
    /// # Errors
    /// [`StoreFault`] when the number is unreadable, or could not be written.
    async fn count_start(&mut self) -> Result<u32, StoreFault>;

    /// Removes the records whose keys are among `which`: all of them or none.
    ///
    /// # Errors
    /// [`StoreFault`] when they could not be removed; all are unchanged then.
    async fn remove(&mut self, which: fn(Key) -> bool) -> Result<(), StoreFault>;
}

/// The stored rate of the wireless link's serial line, bit/s, at which a board opens it; `None` without one that can be
/// read.
pub fn line_rate(store: &mut impl Store) -> Option<u32> {
    let mut record = [0; MAX_RECORD];
    let length = store.load(Key::LineRate, &mut record).ok()??;
    let baud = record.get(..length)?.try_into().ok()?;
    Some(u32::from_le_bytes(baud))
}

/// What the node keeps its records in: the board's store, or, without the feature `store`, nothing.
#[cfg(feature = "store")]
pub(crate) type Records<S> = S;
#[cfg(feature = "store")]
pub(crate) fn records<S>(store: S) -> Records<S> {
    store
}
#[cfg(not(feature = "store"))]
pub(crate) type Records<S> = Volatile<S>;

/// Keeps nothing: parameters and settings are lost at a restart.
#[cfg(not(feature = "store"))]
pub struct Volatile<S>(core::marker::PhantomData<S>);

#[cfg(not(feature = "store"))]
pub(crate) fn records<S>(_: S) -> Records<S> {
    Volatile(core::marker::PhantomData)
}

#[cfg(not(feature = "store"))]
impl<S> Store for Volatile<S> {
    fn load(&mut self, _: Key, _: &mut [u8]) -> Result<Option<usize>, StoreFault> {
        Ok(None)
    }

    async fn save(&mut self, _: Key, _: &[u8]) -> Result<(), StoreFault> {
        Ok(())
    }

    async fn count_start(&mut self) -> Result<u32, StoreFault> {
        Ok(0)
    }

    async fn remove(&mut self, _: fn(Key) -> bool) -> Result<(), StoreFault> {
        Ok(())
    }
}

/// Longest record, bytes.
pub const MAX_RECORD: usize = wimu_model::CompiledSet::MAX_BYTES;

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
