//! Everything a device needs to turn counts into specific force in the axes of its body.

use core::fmt;

use crate::matrix::{self, Matrix3};
use crate::root;
use crate::{
    CalibrationQuality, Counts, ErrorModel, MagneticFieldNt, MagnetometerModel, RotationCovariance,
    Sensitivity, SpecificForceMps2,
};

/// The rotation from the sensor's axes to those of the body it is mounted on, as a unit
/// quaternion.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "serde", serde(try_from = "[f64; 4]", into = "[f64; 4]"))]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Alignment([f64; 4]);

impl Alignment {
    /// Sensor axes are body axes.
    pub const IDENTITY: Self = Self([1.0, 0.0, 0.0, 0.0]);

    /// From a quaternion W, X, Y, Z of any positive length; it is normalised.
    ///
    /// # Errors
    /// [`AlignmentError`] when it is not finite or its length is outside 0.5..=2.
    pub fn from_quaternion(wxyz: [f64; 4]) -> Result<Self, AlignmentError> {
        let [w, x, y, z] = wxyz;
        let norm = root::sqrt(w * w + x * x + y * y + z * z);
        if (0.5..=2.0).contains(&norm) {
            Ok(Self(wxyz.map(|q| q / norm)))
        } else {
            Err(AlignmentError { norm })
        }
    }

    /// The unit quaternion, W, X, Y, Z.
    pub fn quaternion(self) -> [f64; 4] {
        self.0
    }

    /// Rotates a vector from the axes that the rotation leads from to those that it leads to.
    pub fn rotate(self, vector: [f64; 3]) -> [f64; 3] {
        matrix::apply(&self.matrix(), vector)
    }

    /// The rotation as a matrix, row by row.
    pub fn matrix(self) -> Matrix3 {
        let [w, x, y, z] = self.0;
        [
            [
                1.0 - 2.0 * (y * y + z * z),
                2.0 * (x * y - w * z),
                2.0 * (x * z + w * y),
            ],
            [
                2.0 * (x * y + w * z),
                1.0 - 2.0 * (x * x + z * z),
                2.0 * (y * z - w * x),
            ],
            [
                2.0 * (x * z - w * y),
                2.0 * (y * z + w * x),
                1.0 - 2.0 * (x * x + y * y),
            ],
        ]
    }
}

impl Default for Alignment {
    fn default() -> Self {
        Self::IDENTITY
    }
}

impl TryFrom<[f64; 4]> for Alignment {
    type Error = AlignmentError;

    fn try_from(wxyz: [f64; 4]) -> Result<Self, AlignmentError> {
        // A unit quaternion is kept as it is, so that a stored one comes back bit for bit.
        let [w, x, y, z] = wxyz;
        let square = w * w + x * x + y * y + z * z;
        if (square - 1.0).abs() <= 1e-12 {
            Ok(Self(wxyz))
        } else {
            Self::from_quaternion(wxyz)
        }
    }
}

impl From<Alignment> for [f64; 4] {
    fn from(alignment: Alignment) -> [f64; 4] {
        alignment.0
    }
}

/// A quaternion that is no rotation.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct AlignmentError {
    /// Its length; 0.5 to 2 is accepted.
    pub norm: f64,
}

impl fmt::Display for AlignmentError {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            out,
            "the alignment's quaternion has length {}, a rotation has 1",
            self.norm
        )
    }
}

impl core::error::Error for AlignmentError {}

/// Names a parameter set by the CRC-32C of its wire form; 0 is the uncalibrated set.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct ParameterId(pub u32);

impl ParameterId {
    /// The id of a device without calibration.
    pub const UNCALIBRATED: Self = Self(0);
}

impl fmt::Display for ParameterId {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(out, "{:08x}", self.0)
    }
}

/// Names a model of accelerometer by the number that a device's greeting has for it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct SensorId(pub u16);

/// A calibration as a device holds it: error model, the sensitivity and range it was estimated
/// at, what it says of itself, the alignment to the body, and the magnetometer's model.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct ParameterSet {
    /// Full-scale range at which the set holds, ± *g*.
    pub range_g: u8,
    /// Nominal sensitivity that turns counts into the model's output y.
    pub sensitivity: Sensitivity,
    /// The error model.
    pub model: ErrorModel,
    /// How the model was estimated and how good it is; `None` for one that nobody estimated.
    #[cfg_attr(feature = "serde", serde(default))]
    pub quality: Option<CalibrationQuality>,
    /// Sensor axes to body axes.
    pub alignment: Alignment,
    /// Covariance of the alignment's error about body axes; `None` where nobody measured it.
    #[cfg_attr(feature = "serde", serde(default))]
    pub alignment_covariance: Option<RotationCovariance>,
    /// The magnetometer's model; `None` as long as it is uncalibrated, and heading with it.
    #[cfg_attr(feature = "serde", serde(default))]
    pub magnetometer: Option<MagnetometerModel>,
    /// The accelerometer that was calibrated; `None` where that is not known, and any one with this
    /// range and sensitivity may take the set.
    #[cfg_attr(feature = "serde", serde(default))]
    pub sensor: Option<SensorId>,
}

impl ParameterSet {
    /// The set of a device without calibration: a perfect sensor in body axes.
    pub fn uncalibrated(range_g: u8, sensitivity: Sensitivity) -> Self {
        Self {
            range_g,
            sensitivity,
            model: ErrorModel::default(),
            quality: None,
            alignment: Alignment::IDENTITY,
            alignment_covariance: None,
            magnetometer: None,
            sensor: None,
        }
    }

    /// Specific force in body axes, m/s², from `counts`, in f64 with all terms: what
    /// [`Corrector`](crate::Corrector) computes in integers, which leaves the nonlinearity out.
    pub fn correct(
        &self,
        counts: Counts,
        temperature: Option<crate::CentiCelsius>,
    ) -> SpecificForceMps2 {
        let sensed = self.sensitivity.to_mps2(counts);
        let force = self.model.correct(sensed, temperature);
        SpecificForceMps2(self.alignment.rotate(force.0))
    }

    /// The magnetic field in body axes, nT, from what the magnetometer put out; `None` as long as
    /// it is uncalibrated or its rotation to the accelerometer is not known.
    pub fn correct_field(&self, output: MagneticFieldNt) -> Option<[f64; 3]> {
        let field = self.magnetometer?.correct_to_accelerometer(output)?;
        Some(self.alignment.rotate(field))
    }
}
