//! Local gravity, the reference of a calibration.

use core::fmt;

use wimu_model::STANDARD_GRAVITY_MPS2;

/// Local gravity and its standard deviation.
///
/// 9.7..=9.9 m/s², which covers the surface of the Earth (9.764 to 9.834).
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Gravity {
    mps2: f64,
    sd_mps2: f64,
}

impl Gravity {
    /// 9.80665 ± 0.015 m/s² (1 σ): an unknown location on Earth.
    pub const UNKNOWN_PLACE: Self = Self {
        mps2: STANDARD_GRAVITY_MPS2,
        sd_mps2: 0.015,
    };

    /// Gravity in m/s² and its standard deviation in m/s² (0 where it is taken as exact).
    ///
    /// # Errors
    /// [`GravityError`] when gravity is outside 9.7..=9.9 m/s² or the deviation outside 0..=0.1.
    pub fn new(mps2: f64, sd_mps2: f64) -> Result<Self, GravityError> {
        if !(9.7..=9.9).contains(&mps2) {
            Err(GravityError::OutOfBounds { mps2 })
        } else if !(0.0..=0.1).contains(&sd_mps2) {
            Err(GravityError::DeviationOutOfBounds { sd_mps2 })
        } else {
            Ok(Self { mps2, sd_mps2 })
        }
    }

    /// Gravity, m/s².
    pub fn mps2(self) -> f64 {
        self.mps2
    }

    /// Its standard deviation, m/s².
    pub fn sd_mps2(self) -> f64 {
        self.sd_mps2
    }
}

impl Default for Gravity {
    fn default() -> Self {
        Self::UNKNOWN_PLACE
    }
}

/// A value that cannot be local gravity.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum GravityError {
    /// Gravity is outside the range on Earth.
    OutOfBounds {
        /// What was given, m/s².
        mps2: f64,
    },
    /// The standard deviation is negative, too large or not a number.
    DeviationOutOfBounds {
        /// What was given, m/s².
        sd_mps2: f64,
    },
}

impl fmt::Display for GravityError {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        match *self {
            Self::OutOfBounds { mps2 } if (0.5..2.0).contains(&mps2) => write!(
                out,
                "gravity {mps2} looks like g: give local gravity in m/s², 9.764 to 9.834 on Earth"
            ),
            Self::OutOfBounds { mps2 } => write!(
                out,
                "gravity {mps2} m/s² is outside 9.7 to 9.9: give local gravity in m/s², 9.764 to \
                 9.834 on Earth"
            ),
            Self::DeviationOutOfBounds { sd_mps2 } => write!(
                out,
                "the standard deviation of gravity, {sd_mps2} m/s², is outside 0 to 0.1 m/s²"
            ),
        }
    }
}

impl core::error::Error for GravityError {}
