//! m = h + S Rᵀ B: equation (55) of docs/reference/equations.

use crate::error::{Bounds, ModelError};
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
    /// [`ModelError`] names what is not finite or out of the bounds given on
    /// [`MagnetometerTerms`].
    pub fn new(terms: MagnetometerTerms) -> Result<Self, ModelError> {
        let t = &terms;
        Bounds("hard iron", " nT", -2e6, 2e6).check_axes(&t.hard_iron_nt)?;
        let [diagonal, others] = [0, 3].map(|first| [0, 1, 2].map(|k| t.soft_iron[first + k]));
        Bounds("soft iron", "", 0.2, 5.0).check_axes(&diagonal)?;
        Bounds("soft iron", "", -5.0, 5.0).check_axes(&others)?;
        // Positive definite, by its leading minors.
        let s = soft_iron(&terms);
        let minor = s[0][0] * s[1][1] - s[0][1] * s[1][0];
        let determinant = minor.min(matrix::determinant(&s));
        if determinant < 1e-3 {
            return Err(ModelError::Singular { name: "the soft iron", determinant });
        }
        Bounds("field", " nT", 1e3, 1e6).check(t.field_nt)?;
        let sd = Bounds("standard deviation of the magnetometer", "", 0.0, 1e6);
        sd.check_axes(&t.hard_iron_sd_nt)?;
        t.soft_iron_sd.into_iter().try_for_each(|value| sd.check(value))?;
        let residual = Bounds("residual of the magnetometer", " nT", 0.0, 1e6);
        residual.check(t.rms_nt)?;
        residual.check(t.loo_rms_nt)?;
        Bounds("condition", "", 1.0, 1e9).check(t.condition)?;
        if let Some(mounting) = &t.to_accelerometer {
            let right = core::f64::consts::FRAC_PI_2 * 1.000_001;
            Bounds("dip", " rad", -right, right).check(mounting.dip_rad)?;
            Bounds("standard deviation of the dip", " rad", 0.0, 3.2)
                .check(mounting.dip_rms_rad)?;
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
    type Error = ModelError;

    fn try_from(terms: MagnetometerTerms) -> Result<Self, ModelError> {
        Self::new(terms)
    }
}

impl From<MagnetometerModel> for MagnetometerTerms {
    fn from(model: MagnetometerModel) -> Self {
        model.0
    }
}
