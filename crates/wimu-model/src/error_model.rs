//! y = b(T) + A(T) u, u = f + q ∘ f ∘ f: equation (1) of docs/reference/equations.

use crate::error::{Bounds, ModelError, check_matrix};
use crate::matrix::{self, Matrix3};
use crate::{CentiCelsius, SpecificForceMps2};

/// Temperature dependence of bias and scale factor about a reference temperature T₀: b(T) = b₀ + b₁
/// (T−T₀) + b₂ (T−T₀)², S(T) = S₀ (1 + s₁ (T−T₀)).
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct TemperatureTerms {
    /// T₀, °C, −60..=150.
    pub reference_c: f64,
    /// b₁, m/s² per K, |b₁| ≤ 0.2.
    pub bias_mps2_per_k: [f64; 3],
    /// b₂, m/s² per K², |b₂| ≤ 0.01.
    pub bias_mps2_per_k2: [f64; 3],
    /// s₁, 1/K, |s₁| ≤ 0.01.
    pub scale_per_k: [f64; 3],
}

impl Default for TemperatureTerms {
    /// No temperature effect, about 25 °C.
    fn default() -> Self {
        Self {
            reference_c: 25.0,
            bias_mps2_per_k: [0.0; 3],
            bias_mps2_per_k2: [0.0; 3],
            scale_per_k: [0.0; 3],
        }
    }
}

/// The parameters of an error model; [`ErrorModel::new`] checks them.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct ErrorTerms {
    /// b₀, m/s², sensor axes, each within ±5.
    #[cfg_attr(feature = "serde", serde(rename = "bias_m_s2"))]
    pub bias_mps2: [f64; 3],
    /// A at T₀ = [[S_x, m_yx, m_zx], [m_xy, S_y, m_zy], [m_xz, m_yz, S_z]], dimensionless:
    /// scale factors within 0.5..=1.5, misalignments within ±0.3 rad.
    pub matrix: Matrix3,
    /// Temperature terms.
    #[cfg_attr(feature = "serde", serde(default))]
    pub temperature: TemperatureTerms,
    /// q, scale-factor nonlinearity, s²/m, each within ±0.01; applied on the host only.
    #[cfg_attr(feature = "serde", serde(default))]
    pub nonlinearity: [f64; 3],
}

impl Default for ErrorTerms {
    /// A perfect sensor.
    fn default() -> Self {
        Self {
            bias_mps2: [0.0; 3],
            matrix: matrix::IDENTITY,
            temperature: TemperatureTerms::default(),
            nonlinearity: [0.0; 3],
        }
    }
}

/// The error model of a three-axis accelerometer: its output y as a function of the specific force
/// f, both in m/s².
///
/// Always finite, within bounds and invertible.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "serde", serde(try_from = "ErrorTerms", into = "ErrorTerms"))]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct ErrorModel(ErrorTerms);

impl ErrorModel {
    /// Checks the parameters.
    ///
    /// # Errors
    /// [`ModelError`] names the first term that is not finite or outside the bounds given on
    /// [`ErrorTerms`] and [`TemperatureTerms`], or says that A is singular.
    pub fn new(terms: ErrorTerms) -> Result<Self, ModelError> {
        let t = &terms.temperature;
        Bounds("reference temperature", " °C", -60.0, 150.0).check(t.reference_c)?;
        Bounds("bias", " m/s²", -5.0, 5.0).check_axes(&terms.bias_mps2)?;
        check_matrix("the accelerometer's matrix", &terms.matrix)?;
        Bounds("bias slope", " m/s²/K", -0.2, 0.2).check_axes(&t.bias_mps2_per_k)?;
        Bounds("bias curvature", " m/s²/K²", -0.01, 0.01).check_axes(&t.bias_mps2_per_k2)?;
        Bounds("scale-factor slope", " 1/K", -0.01, 0.01).check_axes(&t.scale_per_k)?;
        Bounds("nonlinearity", " s²/m", -0.01, 0.01).check_axes(&terms.nonlinearity)?;
        Ok(Self(terms))
    }

    /// The parameters.
    pub fn terms(&self) -> &ErrorTerms {
        &self.0
    }

    /// Output of the sensor, m/s², sensor axes, for specific force `force` at `temperature`,
    /// without noise. Equation (1).
    pub fn distort(
        &self,
        force: SpecificForceMps2,
        temperature: Option<CentiCelsius>,
    ) -> SpecificForceMps2 {
        let (bias, a) = self.at(temperature);
        let mut u = force.0;
        for (axis, q) in self.0.nonlinearity.iter().enumerate() {
            u[axis] += q * force.0[axis] * force.0[axis];
        }
        let au = matrix::apply(&a, u);
        SpecificForceMps2([au[0] + bias[0], au[1] + bias[1], au[2] + bias[2]])
    }

    /// Specific force from the output of the sensor, both m/s², at `temperature` (T₀ if `None`): z
    /// = A(T)⁻¹ (y − b(T)), f = z − q ∘ z ∘ z. Equation (2), valid in the calibrated range.
    pub fn correct(
        &self,
        output: SpecificForceMps2,
        temperature: Option<CentiCelsius>,
    ) -> SpecificForceMps2 {
        let (bias, a) = self.at(temperature);
        let y = output.0;
        let mut f =
            matrix::apply(&matrix::inverse(&a), [y[0] - bias[0], y[1] - bias[1], y[2] - bias[2]]);
        for (axis, q) in self.0.nonlinearity.iter().enumerate() {
            f[axis] -= q * f[axis] * f[axis];
        }
        SpecificForceMps2(f)
    }

    /// b(T) in m/s² and A(T).
    pub(crate) fn at(&self, temperature: Option<CentiCelsius>) -> ([f64; 3], Matrix3) {
        let terms = &self.0;
        let t = &terms.temperature;
        let dt = temperature.map_or(0.0, |now| now.to_celsius() - t.reference_c);
        let mut bias = terms.bias_mps2;
        let mut a = terms.matrix;
        for axis in 0..3 {
            bias[axis] += (t.bias_mps2_per_k[axis] + t.bias_mps2_per_k2[axis] * dt) * dt;
            a[axis][axis] *= 1.0 + t.scale_per_k[axis] * dt;
        }
        (bias, a)
    }
}

impl TryFrom<ErrorTerms> for ErrorModel {
    type Error = ModelError;

    fn try_from(terms: ErrorTerms) -> Result<Self, ModelError> {
        Self::new(terms)
    }
}

impl From<ErrorModel> for ErrorTerms {
    fn from(model: ErrorModel) -> ErrorTerms {
        model.0
    }
}
