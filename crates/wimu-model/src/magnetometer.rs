//! m = h + S Rᵀ B: equation (55) of docs/EQUATIONS.md.

use core::fmt;

use crate::matrix::{self, Matrix3};
use crate::{Alignment, MagneticFieldNt, RotationCovariance};

/// The rotation between a magnetometer and an accelerometer.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct MagnetometerRotation {
    /// From magnetometer axes to accelerometer axes.
    pub rotation: Alignment,
    /// Covariance of its error about the accelerometer's axes.
    pub covariance: RotationCovariance,
    /// Angle of the field below the horizontal where it was calibrated, rad, ±π/2.
    pub dip_rad: f32,
    /// Standard deviation of the dip over the poses, rad, 0..=π.
    pub dip_rms_rad: f32,
}

/// The parameters of a magnetometer model; [`MagnetometerModel::new`] checks them.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct MagnetometerTerms {
    /// h, hard iron, nT, magnetometer axes, each within ±2·10⁶.
    pub hard_iron_nt: [f32; 3],
    /// Its standard deviation, nT.
    pub hard_iron_sd_nt: [f32; 3],
    /// S, soft iron and scale, symmetric: xx, yy, zz, xy, xz, yz; the first three within 0.2..=5.
    pub soft_iron: [f32; 6],
    /// Its standard deviation.
    pub soft_iron_sd: [f32; 6],
    /// Field magnitude |B| at the calibration, nT, 1000..=10⁶.
    pub field_nt: f32,
    /// Number of fitted orientations.
    pub poses: u32,
    /// Residual of |B|, nT rms.
    pub rms_nt: f32,
    /// Leave-one-out error of |B|, nT rms.
    pub loo_rms_nt: f32,
    /// Condition number, 1..=10⁹, 1 is best.
    pub condition: f32,
    /// Rotation to the accelerometer; `None` if unknown, and then no heading is available.
    pub to_accelerometer: Option<MagnetometerRotation>,
}

/// Error model of a three-axis magnetometer: hard iron, soft iron with scale factors, and mounting.
///
/// Always finite, within bounds and invertible.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "serde", serde(try_from = "MagnetometerTerms", into = "MagnetometerTerms"))]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct MagnetometerModel(MagnetometerTerms);

impl MagnetometerModel {
    /// Checks the parameters.
    ///
    /// # Errors
    /// [`MagnetometerError`] names what is not finite or out of the bounds given on
    /// [`MagnetometerTerms`].
    pub fn new(terms: MagnetometerTerms) -> Result<Self, MagnetometerError> {
        let within = |value: f32, low: f32, high: f32| (low..=high).contains(&value);
        let t = &terms;
        if !t.hard_iron_nt.iter().all(|h| within(*h, -2e6, 2e6)) {
            return Err(MagnetometerError::HardIron);
        }
        let [xx, yy, zz, xy, xz, yz] = t.soft_iron;
        if ![xx, yy, zz].iter().all(|s| within(*s, 0.2, 5.0))
            || ![xy, xz, yz].iter().all(|s| within(*s, -5.0, 5.0))
        {
            return Err(MagnetometerError::SoftIron);
        }
        // Positive definite, by its leading minors.
        let s = soft_iron(&terms);
        if s[0][0] * s[1][1] - s[0][1] * s[1][0] < 1e-3 || matrix::determinant(&s) < 1e-3 {
            return Err(MagnetometerError::SoftIron);
        }
        if !within(t.field_nt, 1e3, 1e6) {
            return Err(MagnetometerError::Field);
        }
        let sds = t.hard_iron_sd_nt.into_iter().chain(t.soft_iron_sd);
        let mut figures = sds.chain([t.rms_nt, t.loo_rms_nt]);
        if !figures.all(|figure| within(figure, 0.0, 1e6)) || !within(t.condition, 1.0, 1e9) {
            return Err(MagnetometerError::Quality);
        }
        if let Some(mounting) = &t.to_accelerometer {
            let right = core::f32::consts::FRAC_PI_2 * 1.000_001;
            if !within(mounting.dip_rad, -right, right) || !within(mounting.dip_rms_rad, 0.0, 3.2) {
                return Err(MagnetometerError::Dip);
            }
        }
        Ok(Self(terms))
    }

    /// The parameters.
    pub fn terms(&self) -> &MagnetometerTerms {
        &self.0
    }

    /// S, row by row.
    pub fn soft_iron(&self) -> Matrix3 {
        soft_iron(&self.0)
    }

    /// The field, nT, magnetometer axes: S⁻¹ (m − h). Equation (55).
    pub fn correct(&self, output: MagneticFieldNt) -> [f64; 3] {
        let mut rest = [0.0; 3];
        for (axis, rest) in rest.iter_mut().enumerate() {
            *rest = f64::from(output.0[axis]) - f64::from(self.0.hard_iron_nt[axis]);
        }
        matrix::apply(&matrix::inverse(&self.soft_iron()), rest)
    }

    /// The field, nT, accelerometer axes; `None` if the rotation is unknown.
    pub fn correct_to_accelerometer(&self, output: MagneticFieldNt) -> Option<[f64; 3]> {
        let mounting = self.0.to_accelerometer?;
        Some(mounting.rotation.rotate(self.correct(output)))
    }
}

fn soft_iron(terms: &MagnetometerTerms) -> Matrix3 {
    let [xx, yy, zz, xy, xz, yz] = terms.soft_iron.map(f64::from);
    [[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]
}

impl TryFrom<MagnetometerTerms> for MagnetometerModel {
    type Error = MagnetometerError;

    fn try_from(terms: MagnetometerTerms) -> Result<Self, MagnetometerError> {
        Self::new(terms)
    }
}

impl From<MagnetometerModel> for MagnetometerTerms {
    fn from(model: MagnetometerModel) -> Self {
        model.0
    }
}

/// Why the parameters of a magnetometer model are refused.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum MagnetometerError {
    /// The hard iron is not finite or beyond ±2 mT.
    HardIron,
    /// The soft iron is out of bounds or not positive definite.
    SoftIron,
    /// The field is outside 1 µT to 1 mT.
    Field,
    /// A standard deviation, residual or the condition is out of bounds.
    Quality,
    /// The dip is not an angle within ±π/2.
    Dip,
}

impl fmt::Display for MagnetometerError {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        out.write_str(match self {
            Self::HardIron => "the magnetometer's hard iron is beyond ±2 mT",
            Self::SoftIron => {
                "the magnetometer's soft iron has a scale outside 0.2 to 5, or is not positive definite"
            }
            Self::Field => "the magnetometer's field is outside 1 µT to 1 mT",
            Self::Quality => {
                "a standard deviation, residual or the condition of the magnetometer is out of bounds"
            }
            Self::Dip => "the dip of the magnetometer's calibration is outside ±90°",
        })
    }
}

impl core::error::Error for MagnetometerError {}
