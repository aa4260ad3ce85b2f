//! What the node asks of non-volatile memory.

/// What is stored.
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
    /// How often the device has started.
    BootCount,
    /// The key that writes are signed with.
    DeviceKey,
    /// The rate of the cable's line.
    CableRate,
    /// The rate of the wireless link's line.
    WirelessRate,
}

impl Key {
    /// Its number in a store: those below 128 are for one record each, those from there on for the
    /// parameters of a range. Numbers are never used twice. `None` for a range that no sensor has.
    pub const fn number(self) -> Option<u8> {
        match self {
            Self::Settings => Some(2),
            Self::BootCount => Some(3),
            Self::DeviceKey => Some(4),
            Self::CableRate => Some(5),
            Self::WirelessRate => Some(6),
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
            3 => Some(Self::BootCount),
            4 => Some(Self::DeviceKey),
            5 => Some(Self::CableRate),
            6 => Some(Self::WirelessRate),
            129.. => Some(Self::Parameters {
                range_g: number - 128,
            }),
            _ => None,
        }
    }
}

/// Keeps a few records of up to [`MAX_RECORD`] bytes over a restart.
///
/// A `save` or `remove` that power loss interrupts leaves the old records or the new state. Futures
/// are never dropped before they are done. What is in a record is the node's business.
#[allow(async_fn_in_trait)] // Nodes are polled where they are built; nothing needs `Send`.
pub trait Store {
    /// How long a `save` or `remove` may keep the processor, so that nothing is received
    /// meanwhile: it is announced to the hosts. 0 for memory that takes no such time.
    fn pause_ms(&self) -> u16 {
        0
    }

    /// Reads a record into `buffer`, which holds [`MAX_RECORD`] bytes; `None` if there is none.
    ///
    /// # Errors
    /// [`StoreFault`] when the memory cannot be read, or a record that was saved is damaged.
    async fn load(&mut self, key: Key, buffer: &mut [u8]) -> Result<Option<usize>, StoreFault>;

    /// Writes a record, of one byte or more, in place of the one before.
    ///
    /// # Errors
    /// [`StoreFault`] when it could not be written; the old record still stands then.
    async fn save(&mut self, key: Key, record: &[u8]) -> Result<(), StoreFault>;

    /// Removes the records whose keys are among `which`: all of them or none.
    ///
    /// # Errors
    /// [`StoreFault`] when they could not be removed; all still stand then.
    async fn remove(&mut self, which: fn(Key) -> bool) -> Result<(), StoreFault>;
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
