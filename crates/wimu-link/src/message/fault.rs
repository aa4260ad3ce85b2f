//! Faults of parameter sets.

use core::fmt;

use serde::{Deserialize, Serialize};
use wimu_model::{
    AlignmentError, CompileError, CovarianceError, GyroscopeError, GyroscopeTerm,
    MagnetometerError, ModelError, QualityError, SensitivityError, Term,
};

use super::MessageError;
use crate::hello::sensor;

/// The wire form of an enum of the model, with both conversions. The wire holds the variant's index, so
/// variants are only appended.
macro_rules! mirrored {
    ($(#[$attribute:meta])* $wire:ident of $model:ident { $($name:ident),+ $(,)? }) => {
        $(#[$attribute])*
        #[derive(Clone, Copy, Debug, PartialEq, Eq)]
        #[cfg_attr(feature = "defmt", derive(defmt::Format))]
        #[allow(missing_docs, reason = "the names are those of the model's enum")]
        pub enum $wire { $($name),+ }

        impl From<$model> for $wire {
            fn from(model: $model) -> Self {
                match model { $($model::$name => Self::$name),+ }
            }
        }

        impl From<$wire> for $model {
            fn from(wire: $wire) -> Self {
                match wire { $($wire::$name => Self::$name),+ }
            }
        }
    };
}
pub(super) use mirrored;

mirrored! {
    /// A term of the error model. Append only.
    #[derive(Serialize, Deserialize)]
    WireTerm of Term {
        Bias,
        Scale,
        Misalignment,
        ReferenceTemperature,
        BiasSlope,
        BiasCurvature,
        ScaleSlope,
        Nonlinearity,
    }
}

mirrored! {
    /// A term of the gyroscope's error model. Append only.
    #[derive(Serialize, Deserialize)]
    WireGyroscopeTerm of GyroscopeTerm {
        Bias,
        Scale,
        Misalignment,
        GSensitivity,
        ReferenceTemperature,
        BiasSlope,
        ScaleSlope,
        Sensitivity,
        Range,
        Deviation,
    }
}

mirrored! {
    /// Wire form of [`QualityError`]. Append only.
    #[derive(Serialize, Deserialize)]
    WireQualityFault of QualityError { Temperature, Residual, Condition, Deviation }
}

mirrored! {
    /// Wire form of [`MagnetometerError`]. Append only.
    #[derive(Serialize, Deserialize)]
    WireMagnetometerFault of MagnetometerError { HardIron, SoftIron, Field, Quality, Dip }
}

/// Why a parameter set is invalid. Append only.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum ParameterFault {
    /// A term is infinite or not a number.
    NotFinite {
        /// Which term.
        term: WireTerm,
        /// Its axis (its row in A), 0 = X.
        axis: u8,
    },
    /// A term is outside its physical bounds.
    OutOfBounds {
        /// Which term.
        term: WireTerm,
        /// Its axis (its row in A), 0 = X.
        axis: u8,
        /// Its value, in the term's unit.
        value: f64,
        /// The lowest allowed.
        low: f64,
        /// The highest allowed.
        high: f64,
    },
    /// The matrix is singular or a reflection; holds its determinant.
    Singular(f64),
    /// The sensitivity is out of bounds; holds its value, LSB/*g*.
    Sensitivity(f64),
    /// The alignment is not a rotation; holds the quaternion's norm.
    Alignment(f64),
    /// Corrected samples would overflow 32 bits.
    Overflow,
    /// The matrix is singular at the device's temperature.
    SingularAtTemperature,
    /// A covariance is invalid: not finite, or without a Cholesky factor.
    Covariance,
    /// The quality of the calibration is invalid.
    Quality(WireQualityFault),
    /// The magnetometer's model is invalid.
    Magnetometer(WireMagnetometerFault),
    /// The parameters were made for another model of accelerometer.
    OtherSensor {
        /// That of the parameters, a number of [`sensor`](crate::hello::sensor).
        parameters: u16,
        /// The device's, likewise.
        device: u16,
    },
    /// The parameters are for a sensor of another index.
    OtherSensorIndex {
        /// That of the parameters.
        parameters: u8,
        /// That of the sensor which the device corrects.
        device: u8,
    },
    /// A term of the gyroscope's model is not a number, or outside its bounds.
    Gyroscope {
        /// Which term.
        term: WireGyroscopeTerm,
        /// Its axis (its row in a matrix), 0 = X.
        axis: u8,
        /// Its value, in the term's unit.
        value: f64,
        /// The lowest allowed.
        low: f64,
        /// The highest allowed.
        high: f64,
    },
    /// The gyroscope's matrix is singular or a reflection; holds its determinant.
    GyroscopeSingular(f64),
    /// The set has fields or values that the firmware does not know, or is truncated.
    Unknown {
        /// Number of bytes beyond the fields that the firmware knows.
        bytes: u16,
    },
}

impl From<GyroscopeError> for ParameterFault {
    fn from(error: GyroscopeError) -> Self {
        match error {
            GyroscopeError::OutOfBounds { term, axis, value, low, high } => {
                Self::Gyroscope { term: term.into(), axis: axis as u8, value, low, high }
            }
            GyroscopeError::Singular { determinant } => Self::GyroscopeSingular(determinant),
        }
    }
}

impl From<MessageError> for ParameterFault {
    fn from(error: MessageError) -> Self {
        let bytes = match error {
            MessageError::TooLong { extra } => u16::try_from(extra).unwrap_or(u16::MAX),
            _ => 0,
        };
        Self::Unknown { bytes }
    }
}

impl From<QualityError> for ParameterFault {
    fn from(error: QualityError) -> Self {
        Self::Quality(error.into())
    }
}

impl From<MagnetometerError> for ParameterFault {
    fn from(error: MagnetometerError) -> Self {
        Self::Magnetometer(error.into())
    }
}

impl From<CovarianceError> for ParameterFault {
    fn from(_: CovarianceError) -> Self {
        Self::Covariance
    }
}

impl From<ModelError> for ParameterFault {
    fn from(error: ModelError) -> Self {
        match error {
            ModelError::NotFinite { term, axis } => {
                Self::NotFinite { term: term.into(), axis: axis as u8 }
            }
            ModelError::OutOfBounds { term, axis, value, low, high } => {
                Self::OutOfBounds { term: term.into(), axis: axis as u8, value, low, high }
            }
            ModelError::Singular { determinant } => Self::Singular(determinant),
        }
    }
}

impl From<SensitivityError> for ParameterFault {
    fn from(error: SensitivityError) -> Self {
        Self::Sensitivity(error.0)
    }
}

impl From<AlignmentError> for ParameterFault {
    fn from(error: AlignmentError) -> Self {
        Self::Alignment(error.norm)
    }
}

impl From<CompileError> for ParameterFault {
    fn from(error: CompileError) -> Self {
        match error {
            CompileError::Overflow => Self::Overflow,
            CompileError::Singular => Self::SingularAtTemperature,
        }
    }
}

impl fmt::Display for ParameterFault {
    /// The messages of the model's errors.
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        match *self {
            Self::NotFinite { term, axis } => ModelError::NotFinite {
                term: term.into(),
                axis: axis.into(),
            }
            .fmt(out),
            Self::OutOfBounds {
                term,
                axis,
                value,
                low,
                high,
            } => ModelError::OutOfBounds {
                term: term.into(),
                axis: axis.into(),
                value,
                low,
                high,
            }
            .fmt(out),
            Self::Singular(determinant) => ModelError::Singular { determinant }.fmt(out),
            Self::Sensitivity(lsb_per_g) => SensitivityError(lsb_per_g).fmt(out),
            Self::Alignment(norm) => AlignmentError { norm }.fmt(out),
            Self::Overflow => CompileError::Overflow.fmt(out),
            Self::SingularAtTemperature => CompileError::Singular.fmt(out),
            Self::Covariance => CovarianceError.fmt(out),
            Self::Quality(fault) => QualityError::from(fault).fmt(out),
            Self::Magnetometer(fault) => MagnetometerError::from(fault).fmt(out),
            Self::OtherSensor { parameters, device } => write!(
                out,
                "made for sensor {parameters} ({}), but the device has {device} ({})",
                sensor::name(parameters),
                sensor::name(device)
            ),
            Self::OtherSensorIndex { parameters, device } => write!(
                out,
                "made for the sensor with index {parameters}, but the device corrects that with index {device}"
            ),
            Self::Gyroscope {
                term,
                axis,
                value,
                low,
                high,
            } => GyroscopeError::OutOfBounds {
                term: term.into(),
                axis: axis.into(),
                value,
                low,
                high,
            }
            .fmt(out),
            Self::GyroscopeSingular(determinant) => GyroscopeError::Singular { determinant }.fmt(out),
            Self::Unknown { bytes: 0 } => out.write_str(
                "the set is truncated or has values unknown to the device's firmware; update the firmware",
            ),
            Self::Unknown { bytes } => write!(
                out,
                "{bytes} bytes of the set are unknown to the device's firmware; update the firmware"
            ),
        }
    }
}

impl core::error::Error for ParameterFault {}
