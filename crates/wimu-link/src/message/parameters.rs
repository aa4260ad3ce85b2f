//! Parameter sets on the wire.

use core::fmt;

use serde::{Deserialize, Serialize};
use wimu_model::{
    Alignment, AlignmentError, CompileError, CovarianceError, ErrorModel, ErrorTerms,
    MagnetometerError, ModelError, ParameterId, ParameterSet, QualityError, RotationCovariance,
    Sensitivity, SensitivityError, TemperatureTerms, Term,
};

use super::checksum;
use super::quality::{WireMagnetometer, WireQuality};

/// A [`ParameterSet`] as it travels: plain numbers, in this order, not checked yet.
///
/// ```
/// use wimu_link::message::{ParameterFault, WireParameters};
/// use wimu_model::{ParameterSet, Sensitivity};
///
/// let set = ParameterSet::uncalibrated(2, Sensitivity::from_lsb_per_g(16384.0)?);
/// let mut wire = WireParameters::from(&set);
/// assert_eq!(ParameterSet::try_from(&wire), Ok(set));
///
/// wire.bias_mps2[1] = f64::NAN;
/// let fault = ParameterSet::try_from(&wire).unwrap_err();
/// assert_eq!(fault.to_string(), "bias Y is not a finite number");
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct WireParameters {
    /// Full-scale range, ± *g*.
    pub range_g: u8,
    /// Nominal sensitivity, LSB/*g*.
    pub sensitivity_lsb_per_g: f64,
    /// b₀, m/s².
    pub bias_mps2: [f64; 3],
    /// A, row by row.
    pub matrix: [[f64; 3]; 3],
    /// T₀, °C.
    pub reference_c: f64,
    /// b₁, m/s² per K.
    pub bias_mps2_per_k: [f64; 3],
    /// b₂, m/s² per K².
    pub bias_mps2_per_k2: [f64; 3],
    /// s₁, 1/K.
    pub scale_per_k: [f64; 3],
    /// q, s²/m.
    pub nonlinearity: [f64; 3],
    /// Sensor axes to body axes, quaternion W, X, Y, Z.
    pub alignment_wxyz: [f64; 4],
    /// Covariance of the alignment's error, rad², as the Cholesky factor, row by row.
    pub alignment_factor: Option<[f32; 6]>,
    /// How the model was estimated and how good it is.
    pub quality: Option<WireQuality>,
    /// The magnetometer's model.
    pub magnetometer: Option<WireMagnetometer>,
}

impl From<&ParameterSet> for WireParameters {
    fn from(set: &ParameterSet) -> Self {
        let terms = set.model.terms();
        Self {
            range_g: set.range_g,
            sensitivity_lsb_per_g: set.sensitivity.lsb_per_g(),
            bias_mps2: terms.bias_mps2,
            matrix: terms.matrix,
            reference_c: terms.temperature.reference_c,
            bias_mps2_per_k: terms.temperature.bias_mps2_per_k,
            bias_mps2_per_k2: terms.temperature.bias_mps2_per_k2,
            scale_per_k: terms.temperature.scale_per_k,
            nonlinearity: terms.nonlinearity,
            alignment_wxyz: set.alignment.quaternion(),
            alignment_factor: set.alignment_covariance.map(rotation_factor),
            quality: set.quality.as_ref().map(WireQuality::from),
            magnetometer: set.magnetometer.as_ref().map(WireMagnetometer::from),
        }
    }
}

impl TryFrom<&WireParameters> for ParameterSet {
    type Error = ParameterFault;

    /// Checks every number. Whether the set compiles to integers,
    /// [`Corrector::compile`](wimu_model::Corrector::compile) finds out.
    fn try_from(wire: &WireParameters) -> Result<Self, ParameterFault> {
        Ok(Self {
            range_g: wire.range_g,
            sensitivity: Sensitivity::from_lsb_per_g(wire.sensitivity_lsb_per_g)?,
            model: ErrorModel::new(ErrorTerms {
                bias_mps2: wire.bias_mps2,
                matrix: wire.matrix,
                temperature: TemperatureTerms {
                    reference_c: wire.reference_c,
                    bias_mps2_per_k: wire.bias_mps2_per_k,
                    bias_mps2_per_k2: wire.bias_mps2_per_k2,
                    scale_per_k: wire.scale_per_k,
                },
                nonlinearity: wire.nonlinearity,
            })?,
            quality: wire.quality.as_ref().map(TryInto::try_into).transpose()?,
            alignment: Alignment::try_from(wire.alignment_wxyz)?,
            alignment_covariance: wire.alignment_factor.map(rotation_covariance).transpose()?,
            magnetometer: wire
                .magnetometer
                .as_ref()
                .map(TryInto::try_into)
                .transpose()?,
        })
    }
}

pub(super) fn rotation_factor(covariance: RotationCovariance) -> [f32; 6] {
    let [factor] = covariance.factor();
    factor
}

pub(super) fn rotation_covariance(factor: [f32; 6]) -> Result<RotationCovariance, CovarianceError> {
    RotationCovariance::from_factor([factor])
}

/// The id of `set`: CRC-32C of its wire form, 1 in place of 0, which is the uncalibrated set's.
pub fn parameter_id(set: &ParameterSet) -> ParameterId {
    ParameterId(checksum(&WireParameters::from(set)).max(1))
}

/// A term of the error model, as a fault names it. On the wire: append only.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[allow(missing_docs, reason = "the names are those of wimu_model::Term")]
pub enum WireTerm {
    Bias,
    Scale,
    Misalignment,
    ReferenceTemperature,
    BiasSlope,
    BiasCurvature,
    ScaleSlope,
    Nonlinearity,
}

impl From<Term> for WireTerm {
    fn from(term: Term) -> Self {
        match term {
            Term::Bias => Self::Bias,
            Term::Scale => Self::Scale,
            Term::Misalignment => Self::Misalignment,
            Term::ReferenceTemperature => Self::ReferenceTemperature,
            Term::BiasSlope => Self::BiasSlope,
            Term::BiasCurvature => Self::BiasCurvature,
            Term::ScaleSlope => Self::ScaleSlope,
            Term::Nonlinearity => Self::Nonlinearity,
        }
    }
}

impl From<WireTerm> for Term {
    fn from(term: WireTerm) -> Self {
        match term {
            WireTerm::Bias => Self::Bias,
            WireTerm::Scale => Self::Scale,
            WireTerm::Misalignment => Self::Misalignment,
            WireTerm::ReferenceTemperature => Self::ReferenceTemperature,
            WireTerm::BiasSlope => Self::BiasSlope,
            WireTerm::BiasCurvature => Self::BiasCurvature,
            WireTerm::ScaleSlope => Self::ScaleSlope,
            WireTerm::Nonlinearity => Self::Nonlinearity,
        }
    }
}

/// Why parameters are none. On the wire: append only.
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
    /// The matrix cannot be inverted, or is mirrored; holds its determinant.
    Singular(f64),
    /// The sensitivity is out of bounds; holds it, LSB/*g*.
    Sensitivity(f64),
    /// The alignment is no rotation; holds the quaternion's length.
    Alignment(f64),
    /// Corrected samples would not fit 32 bits.
    Overflow,
    /// The matrix cannot be inverted at the device's temperature.
    SingularAtTemperature,
    /// A covariance is none.
    Covariance,
    /// What the calibration says of itself makes no sense.
    Quality(WireQualityFault),
    /// The magnetometer's model makes no sense.
    Magnetometer(WireMagnetometerFault),
}

/// [`QualityError`] as it travels. Append only.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[allow(
    missing_docs,
    reason = "the names are those of wimu_model::QualityError"
)]
pub enum WireQualityFault {
    Temperature,
    Residual,
    Condition,
    Deviation,
}

/// [`MagnetometerError`] as it travels. Append only.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[allow(
    missing_docs,
    reason = "the names are those of wimu_model::MagnetometerError"
)]
pub enum WireMagnetometerFault {
    HardIron,
    SoftIron,
    Field,
    Quality,
    Dip,
}

impl From<QualityError> for ParameterFault {
    fn from(error: QualityError) -> Self {
        Self::Quality(match error {
            QualityError::Temperature => WireQualityFault::Temperature,
            QualityError::Residual => WireQualityFault::Residual,
            QualityError::Condition => WireQualityFault::Condition,
            QualityError::Deviation => WireQualityFault::Deviation,
        })
    }
}

impl From<WireQualityFault> for QualityError {
    fn from(fault: WireQualityFault) -> Self {
        match fault {
            WireQualityFault::Temperature => Self::Temperature,
            WireQualityFault::Residual => Self::Residual,
            WireQualityFault::Condition => Self::Condition,
            WireQualityFault::Deviation => Self::Deviation,
        }
    }
}

impl From<MagnetometerError> for ParameterFault {
    fn from(error: MagnetometerError) -> Self {
        Self::Magnetometer(match error {
            MagnetometerError::HardIron => WireMagnetometerFault::HardIron,
            MagnetometerError::SoftIron => WireMagnetometerFault::SoftIron,
            MagnetometerError::Field => WireMagnetometerFault::Field,
            MagnetometerError::Quality => WireMagnetometerFault::Quality,
            MagnetometerError::Dip => WireMagnetometerFault::Dip,
        })
    }
}

impl From<WireMagnetometerFault> for MagnetometerError {
    fn from(fault: WireMagnetometerFault) -> Self {
        match fault {
            WireMagnetometerFault::HardIron => Self::HardIron,
            WireMagnetometerFault::SoftIron => Self::SoftIron,
            WireMagnetometerFault::Field => Self::Field,
            WireMagnetometerFault::Quality => Self::Quality,
            WireMagnetometerFault::Dip => Self::Dip,
        }
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
            ModelError::NotFinite { term, axis } => Self::NotFinite {
                term: term.into(),
                axis: axis as u8,
            },
            ModelError::OutOfBounds {
                term,
                axis,
                value,
                low,
                high,
            } => Self::OutOfBounds {
                term: term.into(),
                axis: axis as u8,
                value,
                low,
                high,
            },
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
    /// In the words of the model's own errors.
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
        }
    }
}

impl core::error::Error for ParameterFault {}
