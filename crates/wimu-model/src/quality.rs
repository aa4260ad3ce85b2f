//! Quality record of a calibration.

use core::fmt;

use crate::ModelCovariance;
use crate::error::{Bounds, ModelError};

/// How an error model was estimated.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "serde", serde(rename_all = "kebab-case"))]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum CalibrationMethod {
    /// From the magnitude of gravity in any orientations.
    #[default]
    MultiPosition,
    /// From six known orientations.
    SixPosition,
    /// From four orientations about a level axis.
    FourAngle,
    /// From three orientations about a level axis.
    ThreeAngle,
    /// From a reference with the same motion.
    Reference,
    /// An earlier calibration, updated with single poses.
    Updated,
}

impl fmt::Display for CalibrationMethod {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        out.write_str(match self {
            Self::MultiPosition => "multi-position",
            Self::SixPosition => "six-position",
            Self::FourAngle => "four-angle",
            Self::ThreeAngle => "three-angle",
            Self::Reference => "reference",
            Self::Updated => "updated",
        })
    }
}

/// Temperatures of a calibration.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct CalibratedTemperature {
    /// Mean, °C.
    pub mean_c: f32,
    /// The lowest at which the model holds, °C.
    pub lowest_c: f32,
    /// The highest at which the model holds, °C.
    pub highest_c: f32,
}

/// Standard deviations, 1 σ, of the terms beyond the 12 basic parameters; 0 for one that was not
/// estimated.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct TermDeviations {
    /// Of b₁, m/s² per K.
    pub bias_mps2_per_k: [f32; 3],
    /// Of b₂, m/s² per K².
    pub bias_mps2_per_k2: [f32; 3],
    /// Of s₁, 1/K.
    pub scale_per_k: [f32; 3],
    /// Of q, s²/m.
    pub nonlinearity: [f32; 3],
}

/// The values of a quality record; [`CalibrationQuality::new`] checks them.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct QualityTerms {
    /// How the model was estimated.
    pub method: CalibrationMethod,
    /// Time, s since 1970 UTC, if known.
    pub utc_s: Option<u64>,
    /// Temperature, if known: within −60..=150 °C, lowest ≤ mean ≤ highest.
    pub temperature: Option<CalibratedTemperature>,
    /// Poses fitted; for a reference, blocks of samples.
    pub poses: u32,
    /// Degrees of freedom of the covariance, for Student's intervals.
    pub dof: u32,
    /// Residual |f| − g over the poses (for a reference, of the regression), m/s² rms, 0..=100.
    pub rms_mps2: f32,
    /// Leave-one-out error, m/s² rms; `None` if no pose can be left out.
    pub loo_rms_mps2: Option<f32>,
    /// Condition number, 1..=10⁹, 1 is best; `None` for a method without one.
    pub condition: Option<f32>,
    /// Covariance of the 12 basic parameters, including the uncertainty of gravity.
    pub covariance: ModelCovariance,
    /// Standard deviations of the other terms: each 0..=1.
    #[cfg_attr(feature = "serde", serde(default))]
    pub other_sd: TermDeviations,
}

/// Quality record of a calibration: its method and uncertainty.
///
/// Always finite and within the bounds given on [`QualityTerms`].
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "serde", serde(try_from = "QualityTerms", into = "QualityTerms"))]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct CalibrationQuality(QualityTerms);

impl CalibrationQuality {
    /// Checks the values.
    ///
    /// # Errors
    /// [`ModelError`] names the value that is out of bounds.
    pub fn new(terms: QualityTerms) -> Result<Self, ModelError> {
        if let Some(t) = &terms.temperature {
            Bounds("lowest temperature", " °C", -60.0, t.mean_c.into()).check(t.lowest_c)?;
            Bounds("highest temperature", " °C", t.mean_c.into(), 150.0).check(t.highest_c)?;
        }
        let residual = Bounds("residual", " m/s²", 0.0, 100.0);
        residual.check(terms.rms_mps2)?;
        terms.loo_rms_mps2.map_or(Ok(()), |loo| residual.check(loo))?;
        let condition = Bounds("condition", "", 1.0, 1e9);
        terms.condition.map_or(Ok(()), |found| condition.check(found))?;
        let sd = &terms.other_sd;
        let others = [sd.bias_mps2_per_k, sd.bias_mps2_per_k2, sd.scale_per_k, sd.nonlinearity];
        let deviation = Bounds("standard deviation", "", 0.0, 1.0);
        others.as_flattened().iter().try_for_each(|sd| deviation.check(*sd))?;
        Ok(Self(terms))
    }

    /// The values.
    pub fn terms(&self) -> &QualityTerms {
        &self.0
    }
}

impl TryFrom<QualityTerms> for CalibrationQuality {
    type Error = ModelError;

    fn try_from(terms: QualityTerms) -> Result<Self, ModelError> {
        Self::new(terms)
    }
}

impl From<CalibrationQuality> for QualityTerms {
    fn from(quality: CalibrationQuality) -> Self {
        quality.0
    }
}
