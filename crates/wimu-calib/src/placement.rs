//! How accurately a sensor is placed in an orientation.

use core::fmt;

/// Largest accepted placement error, rad: 5°, which changes the scale factor by 0.4 %.
pub(crate) const MOST_PLACEMENT_RAD: f64 = 0.0873;

/// Placement error of the sensor in known orientations.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Placement {
    sd_rad: f64,
}

impl Placement {
    /// 1° (1 σ) about each horizontal axis: by hand, on a table, in a box with square corners.
    pub const BY_HAND: Self = Self { sd_rad: core::f64::consts::PI / 180.0 };

    /// Standard deviation of the tilt about each horizontal axis, rad, 0..=0.0873 (5°).
    ///
    /// # Errors
    /// [`PlacementError`] when it is outside.
    pub fn new(sd_rad: f64) -> Result<Self, PlacementError> {
        if (0.0..=MOST_PLACEMENT_RAD).contains(&sd_rad) {
            Ok(Self { sd_rad })
        } else {
            Err(PlacementError { sd_rad })
        }
    }

    /// Standard deviation of the tilt about each horizontal axis, rad.
    pub fn sd_rad(self) -> f64 {
        self.sd_rad
    }
}

impl Default for Placement {
    fn default() -> Self {
        Self::BY_HAND
    }
}

/// A placement error outside 0..=0.0873 rad.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PlacementError {
    /// The given standard deviation, rad.
    pub sd_rad: f64,
}

impl fmt::Display for PlacementError {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            out,
            "the standard deviation of the placement, {} rad, is outside 0 to {MOST_PLACEMENT_RAD} rad \
             (5°): place the sensor more accurately, or use multi-position",
            self.sd_rad
        )
    }
}

impl core::error::Error for PlacementError {}
