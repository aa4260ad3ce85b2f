//! How a device measures and what it sends.

use serde::{Deserialize, Serialize};

/// What travels on a link.
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
    /// Samples to a batch, 1..=32.
    pub batch: u8,
    /// Of raw and corrected samples only those travel whose sequence number is a multiple of this,
    /// 1..=255; as they are, not filtered.
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

/// Power against noise. Append only.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Resolution {
    /// Least power (8 bits on an LSM303AGR).
    LowPower,
    /// Between (10 bits).
    Normal,
    /// Least noise (12 bits).
    High,
}

/// How a device measures and what it sends.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Settings {
    /// Full-scale range, ± *g*.
    pub range_g: u8,
    /// Output data rate, Hz.
    pub rate_hz: u16,
    /// Power against noise.
    pub resolution: Resolution,
    /// Take the velocity at every rest as zero (ZUPT).
    pub zupt: bool,
    /// Magnitude of local gravity, µm/s².
    pub gravity_um_s2: u32,
    /// What travels on the cable.
    pub cable: Streams,
    /// What travels on the wireless link.
    pub wireless: Streams,
}

impl Default for Settings {
    /// ±2 *g*, 100 Hz, least noise, ZUPT, standard gravity, everything on both links.
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
