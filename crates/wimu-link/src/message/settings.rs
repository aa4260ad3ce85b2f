//! Settings of a device.

use core::fmt;

use serde::{Deserialize, Serialize};

use super::MessageError;

/// The streams of a link.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Streams {
    /// Raw samples.
    pub raw: bool,
    /// Corrected samples.
    pub corrected: bool,
    /// Velocity and position.
    pub navigation: bool,
    /// Magnetic field and temperature.
    pub environment: bool,
    /// Samples per batch, 1..=32.
    pub batch: u8,
    /// Decimation of raw and corrected samples, 1..=255: only samples whose sequence number is a multiple
    /// are sent, without an anti-aliasing filter.
    pub every: u8,
}

impl Default for Streams {
    /// Everything, every sample, in batches of 16.
    fn default() -> Self {
        Self {
            raw: true,
            corrected: true,
            navigation: true,
            environment: true,
            batch: 16,
            every: 1,
        }
    }
}

/// Trade-off between power and noise. Append only.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Resolution {
    /// Lowest power (8 bits on an LSM303AGR).
    LowPower,
    /// Normal mode (10 bits).
    Normal,
    /// Lowest noise (12 bits).
    High,
}

impl fmt::Display for Resolution {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        out.write_str(match self {
            Self::LowPower => "low",
            Self::Normal => "normal",
            Self::High => "high",
        })
    }
}

/// Settings of a device.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Settings {
    /// Full-scale range, ± *g*.
    pub range_g: u8,
    /// Output data rate, Hz.
    pub rate_hz: u16,
    /// Trade-off between power and noise.
    pub resolution: Resolution,
    /// Take the velocity at every rest as zero (ZUPT).
    pub zupt: bool,
    /// Magnitude of local gravity, µm/s².
    pub gravity_um_s2: u32,
    /// Streams of the cable.
    pub cable: Streams,
    /// Streams of the wireless link.
    pub wireless: Streams,
}

impl Settings {
    /// Longest form in bytes.
    pub const MAX_BYTES: usize = 1 + 3 + 1 + 1 + 5 + 2 * 6;

    /// Writes its form in messages, for a store; returns its length, bytes.
    pub fn to_bytes(&self, bytes: &mut [u8; Self::MAX_BYTES]) -> usize {
        postcard::to_slice(self, bytes).map_or(0, |used| used.len())
    }

    /// Reads it.
    ///
    /// # Errors
    /// [`MessageError`] when the bytes are not exactly that.
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, MessageError> {
        super::decode(bytes)
    }
}

impl Default for Settings {
    /// ±2 *g*, 100 Hz, lowest noise, ZUPT, standard gravity, everything on both links.
    fn default() -> Self {
        Self {
            range_g: 2,
            rate_hz: 100,
            resolution: Resolution::High,
            zupt: true,
            gravity_um_s2: 9_806_650,
            cable: Streams::default(),
            wireless: Streams::default(),
        }
    }
}
