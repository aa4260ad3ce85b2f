//! y = b(T) + A(T) u, u = f + q ∘ f ∘ f: equation (1) of docs/EQUATIONS.md.

use core::fmt;

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
        check(Term::ReferenceTemperature, &[t.reference_c], -60.0, 150.0)?;
        check(Term::Bias, &terms.bias_mps2, -5.0, 5.0)?;
        for (row, values) in terms.matrix.iter().enumerate() {
            for (column, value) in values.iter().enumerate() {
                let (term, low, high) = if row == column {
                    (Term::Scale, 0.5, 1.5)
                } else {
                    (Term::Misalignment, -0.3, 0.3)
                };
                check_one(term, row, *value, low, high)?;
            }
        }
        check(Term::BiasSlope, &t.bias_mps2_per_k, -0.2, 0.2)?;
        check(Term::BiasCurvature, &t.bias_mps2_per_k2, -0.01, 0.01)?;
        check(Term::ScaleSlope, &t.scale_per_k, -0.01, 0.01)?;
        check(Term::Nonlinearity, &terms.nonlinearity, -0.01, 0.01)?;
        let determinant = matrix::determinant(&terms.matrix);
        if determinant < 0.05 {
            return Err(ModelError::Singular { determinant });
        }
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

fn check(term: Term, values: &[f64], low: f64, high: f64) -> Result<(), ModelError> {
    values.iter().enumerate().try_for_each(|(axis, &value)| check_one(term, axis, value, low, high))
}

fn check_one(term: Term, axis: usize, value: f64, low: f64, high: f64) -> Result<(), ModelError> {
    if !value.is_finite() {
        Err(ModelError::NotFinite { term, axis })
    } else if value < low || value > high {
        Err(ModelError::OutOfBounds { term, axis, value, low, high })
    } else {
        Ok(())
    }
}

/// A term of the error model, for error messages.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Term {
    /// b₀.
    Bias,
    /// S, the diagonal of A.
    Scale,
    /// m, A off its diagonal.
    Misalignment,
    /// T₀.
    ReferenceTemperature,
    /// b₁.
    BiasSlope,
    /// b₂.
    BiasCurvature,
    /// s₁.
    ScaleSlope,
    /// q.
    Nonlinearity,
}

impl Term {
    fn name_and_unit(self) -> (&'static str, &'static str) {
        match self {
            Self::Bias => ("bias", " m/s²"),
            Self::Scale => ("scale factor", ""),
            Self::Misalignment => ("misalignment", " rad"),
            Self::ReferenceTemperature => ("reference temperature", " °C"),
            Self::BiasSlope => ("bias slope", " m/s²/K"),
            Self::BiasCurvature => ("bias curvature", " m/s²/K²"),
            Self::ScaleSlope => ("scale-factor slope", " 1/K"),
            Self::Nonlinearity => ("nonlinearity", " s²/m"),
        }
    }
}

/// Why the parameters of an error model are refused.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum ModelError {
    /// A term is infinite or not a number.
    NotFinite {
        /// Which term.
        term: Term,
        /// Its axis (its row in A), 0 = X.
        axis: usize,
    },
    /// A term is outside its physical bounds.
    OutOfBounds {
        /// Which term.
        term: Term,
        /// Its axis (its row in A), 0 = X.
        axis: usize,
        /// Its value, in the term's unit.
        value: f64,
        /// The lowest allowed.
        low: f64,
        /// The highest allowed.
        high: f64,
    },
    /// A cannot be inverted, or is mirrored.
    Singular {
        /// det A; the minimum is 0.05.
        determinant: f64,
    },
}

impl fmt::Display for ModelError {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let axis_name = |axis: usize| ["X", "Y", "Z"].get(axis).copied().unwrap_or("?");
        match *self {
            Self::NotFinite { term, axis } => {
                let (name, _) = term.name_and_unit();
                write!(out, "{name} {} is not a finite number", axis_name(axis))
            }
            Self::OutOfBounds { term, axis, value, low, high } => {
                let (name, unit) = term.name_and_unit();
                let axis = axis_name(axis);
                write!(out, "{name} {axis} = {value}{unit} is outside {low} to {high}{unit}")
            }
            Self::Singular { determinant } => write!(
                out,
                "the matrix cannot be inverted or is mirrored: its determinant is {determinant}, at least 0.05 is needed"
            ),
        }
    }
}

impl core::error::Error for ModelError {}
