//! How accurately a sensor is placed in an orientation.

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

    /// Standard deviation of the tilt about each horizontal axis, rad; `None` outside 0..=0.0873 (5°).
    pub fn new(sd_rad: f64) -> Option<Self> {
        (0.0..=MOST_PLACEMENT_RAD).contains(&sd_rad).then_some(Self { sd_rad })
    }

    /// Standard deviation of the tilt about each horizontal axis, rad.
    pub fn sd_rad(self) -> f64 {
        self.sd_rad
    }
}
