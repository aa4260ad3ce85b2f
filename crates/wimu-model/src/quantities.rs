//! Vectors and scalars that carry their unit in their name.

use core::fmt;

/// The unit *g*, m/s²: exact by definition (CGPM 1901), everywhere in wimu.
pub const STANDARD_GRAVITY_MPS2: f64 = 9.80665;

/// Output of an accelerometer as read: X, Y, Z in LSB, sensor axes, −32768..=32767.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Counts(pub [i16; 3]);

impl Counts {
    /// Whether any axis is at or beyond `full_scale`, LSB, or the negative limit.
    ///
    /// A sensor that sends 12 bits left-justified saturates at 32752 and −32768: its `full_scale`
    /// is 32752.
    #[inline]
    pub fn saturated(self, full_scale: i32) -> bool {
        WideCounts::from(self).saturated(full_scale)
    }
}

/// Output of a sensor of up to 20 bits as read: X, Y, Z in LSB, sensor axes,
/// [`MIN`](Self::MIN)..=[`MAX`](Self::MAX).
///
/// Values outside that range are possible in the type. Correction and the wire clamp them to it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct WideCounts(pub [i32; 3]);

impl WideCounts {
    /// The lowest count: −2¹⁹.
    pub const MIN: i32 = -(1 << 19);

    /// The highest count: 2¹⁹ − 1.
    pub const MAX: i32 = (1 << 19) - 1;

    /// Whether any axis is at or beyond ± `full_scale`, LSB.
    #[inline]
    pub fn saturated(self, full_scale: i32) -> bool {
        self.0.iter().any(|&c| c >= full_scale || c <= full_scale.saturating_neg())
    }

    /// The nearest counts of 20 bits.
    #[inline]
    pub fn clamped(self) -> Self {
        Self(self.0.map(|c| c.clamp(Self::MIN, Self::MAX)))
    }
}

impl From<Counts> for WideCounts {
    #[inline]
    fn from(counts: Counts) -> Self {
        Self(counts.0.map(i32::from))
    }
}

/// Specific force, m/s², f64: +g upward at rest.
///
/// In sensor axes before correction, in body axes (right-handed, REP 103) after it.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct SpecificForceMps2(pub [f64; 3]);

impl SpecificForceMps2 {
    /// Magnitude |f|, m/s².
    pub fn norm(self) -> f64 {
        let [x, y, z] = self.0;
        libm::sqrt(x * x + y * y + z * z)
    }
}

/// Specific force in body axes in fixed point: i32 with 2⁻¹⁶ m/s² per LSB.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct SpecificForceQ16(pub [i32; 3]);

impl SpecificForceQ16 {
    /// LSB per m/s²: 2¹⁶.
    pub const LSB_PER_MPS2: f64 = 65536.0;

    /// The same specific force in m/s²; exact.
    pub fn to_mps2(self) -> SpecificForceMps2 {
        SpecificForceMps2(self.0.map(|lsb| lsb as f64 / Self::LSB_PER_MPS2))
    }
}

/// Angular rate of the body against inertial space, body axes, 2⁻²⁰ rad/s: ± 2048 rad/s, a step of
/// 0.2 °/h.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct AngularRateQ20(pub [i32; 3]);

impl AngularRateQ20 {
    /// LSB per rad/s: 2²⁰.
    pub const LSB_PER_RAD_S: f64 = 1_048_576.0;

    /// The nearest angular rate; saturates at the ends of the range.
    pub fn from_rad_s(rate: [f64; 3]) -> Self {
        Self(rate.map(|axis| {
            let lsb = axis * Self::LSB_PER_RAD_S;
            (lsb + if lsb < 0.0 { -0.5 } else { 0.5 }) as i32
        }))
    }

    /// The same angular rate in rad/s; exact.
    pub fn to_rad_s(self) -> [f64; 3] {
        self.0.map(|lsb| f64::from(lsb) / Self::LSB_PER_RAD_S)
    }
}

/// Velocity in the navigation frame (east-north-up), nm/s.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct VelocityNmps(pub [i64; 3]);

impl VelocityNmps {
    /// The same velocity in m/s.
    pub fn to_mps(self) -> [f64; 3] {
        self.0.map(|nm| nm as f64 * 1e-9)
    }
}

/// Position in the navigation frame (east-north-up), nm.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct PositionNm(pub [i64; 3]);

impl PositionNm {
    /// The same position in m.
    pub fn to_m(self) -> [f64; 3] {
        self.0.map(|nm| nm as f64 * 1e-9)
    }
}

/// Magnetic flux density, nT, in the magnetometer's axes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct MagneticFieldNt(pub [i32; 3]);

/// Temperature in hundredths of a degree Celsius, −327.68..=327.67 °C.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct CentiCelsius(pub i16);

impl CentiCelsius {
    /// The same temperature in °C.
    pub fn to_celsius(self) -> f64 {
        self.0 as f64 / 100.0
    }

    /// The nearest representable temperature; not-a-number gives 0 °C, others saturate.
    pub fn from_celsius(celsius: f64) -> Self {
        let scaled = celsius * 100.0;
        Self((scaled + if scaled < 0.0 { -0.5 } else { 0.5 }) as i16)
    }
}

/// A moment on the device's clock, µs since its start.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct DeviceTimeUs(pub u64);

impl DeviceTimeUs {
    /// The same moment in seconds since the device's start.
    pub fn to_seconds(self) -> f64 {
        self.0 as f64 * 1e-6
    }
}

/// Time between two samples, ns: constant within an epoch.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct PeriodNs(pub u32);

impl PeriodNs {
    /// The same period in seconds.
    pub fn to_seconds(self) -> f64 {
        self.0 as f64 * 1e-9
    }
}

/// Nominal sensitivity of a sensor at its current range, LSB per unit *g* (9.80665 m/s²).
///
/// Always finite and within 160..=1048576: below, one count is worth more than the corrector's
/// fixed point can hold to one LSB over 16 bits of input; above, ±½ g would saturate 20 bits.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "serde", serde(try_from = "f64", into = "f64"))]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Sensitivity(f64);

impl Sensitivity {
    /// A sensitivity in LSB per *g*.
    ///
    /// # Errors
    /// [`SensitivityError`] when it is not finite or outside 160..=1048576.
    pub const fn from_lsb_per_g(lsb_per_g: f64) -> Result<Self, SensitivityError> {
        if 160.0 <= lsb_per_g && lsb_per_g <= 1_048_576.0 {
            Ok(Self(lsb_per_g))
        } else {
            Err(SensitivityError(lsb_per_g))
        }
    }

    /// LSB per *g*.
    pub const fn lsb_per_g(self) -> f64 {
        self.0
    }

    /// m/s² per LSB.
    pub fn mps2_per_lsb(self) -> f64 {
        STANDARD_GRAVITY_MPS2 / self.0
    }

    /// Specific force, m/s², by this sensitivity.
    pub fn to_mps2(self, counts: Counts) -> SpecificForceMps2 {
        let scale = self.mps2_per_lsb();
        SpecificForceMps2(counts.0.map(|c| c as f64 * scale))
    }
}

impl TryFrom<f64> for Sensitivity {
    type Error = SensitivityError;

    fn try_from(lsb_per_g: f64) -> Result<Self, SensitivityError> {
        Self::from_lsb_per_g(lsb_per_g)
    }
}

impl From<Sensitivity> for f64 {
    fn from(sensitivity: Sensitivity) -> f64 {
        sensitivity.0
    }
}

/// A sensitivity outside 160..=1048576 LSB/g; holds the value, LSB/g.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct SensitivityError(pub f64);

impl fmt::Display for SensitivityError {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(out, "sensitivity {} LSB/g is outside 160 to 1048576 LSB/g", self.0)
    }
}

impl core::error::Error for SensitivityError {}
