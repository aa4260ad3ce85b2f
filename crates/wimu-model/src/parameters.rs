//! Calibration parameters of a device.

use core::fmt;

use crate::error::Bounds;
use crate::matrix::{self, Matrix3};
use crate::root;
use crate::{
    CalibrationQuality, Counts, ErrorModel, GyroscopeModel, MagneticFieldNt, MagnetometerModel,
    ModelError, RotationCovariance, Sensitivity, SpecificForceMps2,
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

    /// From a rotation as a matrix, row by row [Shepperd 1978].
    pub(crate) fn from_matrix(m: &Matrix3) -> Self {
        let trace = m[0][0] + m[1][1] + m[2][2];
        let differences = [m[2][1] - m[1][2], m[0][2] - m[2][0], m[1][0] - m[0][1]];
        // 4 q q_i for the largest component q.
        let column = if trace > 0.0 {
            [1.0 + trace, differences[0], differences[1], differences[2]]
        } else {
            let i = (0..3).fold(0, |l, i| if m[i][i] > m[l][l] { i } else { l });
            let mut column = [differences[i], 0.0, 0.0, 0.0];
            for j in 0..3 {
                column[1 + j] = m[i][j] + m[j][i];
            }
            column[1 + i] = 1.0 + 2.0 * m[i][i] - trace;
            column
        };
        let norm = root::sqrt(column.iter().map(|q| q * q).sum());
        Self(column.map(|q| q / norm))
    }

    /// The unit quaternion, W, X, Y, Z.
    pub fn quaternion(self) -> [f64; 4] {
        self.0
    }

    /// Rotates a vector from the initial to the final axes.
    pub fn rotate(self, vector: [f64; 3]) -> [f64; 3] {
        matrix::apply(&self.matrix(), vector)
    }

    /// The rotation as a matrix, row by row.
    pub fn matrix(self) -> Matrix3 {
        let [w, x, y, z] = self.0;
        [
            [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)],
            [2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)],
            [2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)],
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
        // A unit quaternion is not normalised again, so that a stored one is reproduced exactly.
        let [w, x, y, z] = wxyz;
        let square = w * w + x * x + y * y + z * z;
        if (square - 1.0).abs() <= 1e-12 { Ok(Self(wxyz)) } else { Self::from_quaternion(wxyz) }
    }
}

impl From<Alignment> for [f64; 4] {
    fn from(alignment: Alignment) -> [f64; 4] {
        alignment.0
    }
}

/// A quaternion that is not a rotation.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct AlignmentError {
    /// Its length; 0.5 to 2 is accepted.
    pub norm: f64,
}

impl fmt::Display for AlignmentError {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(out, "the quaternion of the alignment has length {} instead of 1", self.norm)
    }
}

impl core::error::Error for AlignmentError {}

/// Identifies a parameter set by the CRC-32C of its encoded form; 0 is the uncalibrated set.
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

/// Identifies an accelerometer type by its number in the protocol.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct SensorId(pub u16);

/// The calibration of the gyroscope beside an accelerometer.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub struct GyroscopeParameters {
    /// Full-scale range of the calibration, ± °/s.
    pub range_dps: u16,
    /// Nominal sensitivity that turns counts into the model's output y, rad/s per LSB,
    /// 10⁻⁸..=10⁻².
    pub rad_s_per_lsb: f64,
    /// The error model, gyroscope axes, which are those of the accelerometer.
    pub model: GyroscopeModel,
    /// Standard deviations, 1 σ, each 0..=1: the bias X, Y, Z, rad/s, then A row by row; `None` if not
    /// estimated.
    #[cfg_attr(feature = "serde", serde(default))]
    pub sd: Option<[f32; 12]>,
}

impl GyroscopeParameters {
    /// Checks the values; those of the model have been checked.
    ///
    /// # Errors
    /// [`ModelError::OutOfBounds`] names the value that is out of bounds (a NaN is).
    pub fn new(
        range_dps: u16,
        rad_s_per_lsb: f64,
        model: GyroscopeModel,
        sd: Option<[f32; 12]>,
    ) -> Result<Self, ModelError> {
        Bounds("gyroscope range", " °/s", 1.0, 65535.0).check(range_dps)?;
        Bounds("gyroscope sensitivity", " rad/s/LSB", 1e-8, 1e-2).check(rad_s_per_lsb)?;
        let deviation = Bounds("standard deviation of the gyroscope", "", 0.0, 1.0);
        sd.iter().flatten().try_for_each(|sd| deviation.check(*sd))?;
        Ok(Self { range_dps, rad_s_per_lsb, model, sd })
    }
}

/// A calibration as stored on a device: error model, sensitivity and range at the calibration,
/// quality record, alignment to the body, gyroscope and magnetometer model.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct ParameterSet {
    /// Full-scale range of the calibration, ± *g*.
    pub range_g: u8,
    /// Nominal sensitivity that turns counts into the model's output y.
    pub sensitivity: Sensitivity,
    /// The error model.
    pub model: ErrorModel,
    /// Quality record; `None` if the model was not estimated.
    #[cfg_attr(feature = "serde", serde(default))]
    pub quality: Option<CalibrationQuality>,
    /// Sensor axes to body axes.
    pub alignment: Alignment,
    /// Covariance of the alignment error about body axes; `None` if not measured.
    #[cfg_attr(feature = "serde", serde(default))]
    pub alignment_covariance: Option<RotationCovariance>,
    /// Magnetometer model; `None` without a calibration, and then no heading is available.
    #[cfg_attr(feature = "serde", serde(default))]
    pub magnetometer: Option<MagnetometerModel>,
    /// Type of the calibrated accelerometer; `None` if unknown: the set then applies to any sensor
    /// of this range and sensitivity.
    #[cfg_attr(feature = "serde", serde(default))]
    pub sensor: Option<SensorId>,
    /// Index of the sensor on its board; a device corrects with the set of sensor 0.
    #[cfg_attr(feature = "serde", serde(default))]
    pub sensor_index: u8,
    /// The gyroscope of the sensor; `None` if it has none, or one that is uncalibrated.
    #[cfg_attr(feature = "serde", serde(default))]
    pub gyroscope: Option<GyroscopeParameters>,
}

impl ParameterSet {
    /// The parameters of an uncalibrated device: a perfect sensor in body axes.
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
            sensor_index: 0,
            gyroscope: None,
        }
    }

    /// Specific force in body axes, m/s², from `counts`, in f64 with all terms.
    /// [`Corrector`](crate::Corrector) computes the same in integers without the nonlinearity.
    pub fn correct(
        &self,
        counts: Counts,
        temperature: Option<crate::CentiCelsius>,
    ) -> SpecificForceMps2 {
        let sensed = self.sensitivity.to_mps2(counts);
        let force = self.model.correct(sensed, temperature);
        SpecificForceMps2(self.alignment.rotate(force.0))
    }

    /// Magnetic field in body axes, nT, from the output of the magnetometer; `None` if it is
    /// uncalibrated or its rotation to the accelerometer is unknown.
    pub fn correct_field(&self, output: MagneticFieldNt) -> Option<[f64; 3]> {
        let field = self.magnetometer?.correct_to_accelerometer(output)?;
        Some(self.alignment.rotate(field))
    }
}
