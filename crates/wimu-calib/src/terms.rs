//! Further terms of the error model, and the vector of all parameters.

use core::fmt;

use wimu_model::ErrorModel;

use crate::Parameter;

/// All parameters of a fit: the 12 of [`Parameter::ALL`], then three each of the drift of the bias
/// (m/s² from the first pose to the last), b₁, s₁ and q.
pub(crate) type Theta = [f64; COUNT];
pub(crate) const COUNT: usize = 24;

/// The parameter at an index of [`Theta`], for the first twelve.
pub(crate) fn parameter(index: usize) -> Option<Parameter> {
    Parameter::ALL.get(index).copied()
}

/// The term that an index of [`Theta`] belongs to, for the others.
pub(crate) fn term(index: usize) -> Option<Term> {
    Term::ALL.get(index.checked_sub(12)? / 3).copied()
}

/// Prior standard deviation about a perfect sensor, from typical datasheets, at an index of [`Theta`]; `None` for the bias,
/// which has a flat prior.
pub(crate) fn usual_sd(index: usize) -> Option<f64> {
    match index {
        0..3 => None,
        3 | 7 | 11 => Some(USUAL_SCALE),
        3..12 => Some(USUAL_ACROSS),
        // 2 mg over a session, ½ mg/K, 0.02 %/K, 1 mg at 1 g.
        12..15 => Some(0.02),
        15..18 => Some(0.005),
        18..21 => Some(2e-4),
        _ => Some(1e-4),
    }
}

/// Value at an index of [`Theta`] that causes an error of 1 m/s² at 1 g (for temperature terms, 10 K from the reference).
pub(crate) fn per_mps2(index: usize, gravity_mps2: f64) -> f64 {
    match index {
        0..3 | 12..15 => 1.0,
        3..12 => 1.0 / gravity_mps2,
        15..18 => 0.1,
        18..21 => 0.1 / gravity_mps2,
        _ => 1.0 / (gravity_mps2 * gravity_mps2),
    }
}

/// Zero-g offset of a typical sensor, m/s², 1 σ: 50 mg, from datasheets.
pub(crate) const USUAL_BIAS_MPS2: f64 = 0.5;
/// Sensitivity error and cross-axis sensitivity of a typical sensor, 1 σ, from datasheets.
pub(crate) const USUAL_SCALE: f64 = 0.03;
pub(crate) const USUAL_ACROSS: f64 = 0.02;

/// A perfect sensor.
pub(crate) const PERFECT: Theta = {
    let mut theta = [0.0; COUNT];
    theta[3] = 1.0;
    theta[7] = 1.0;
    theta[11] = 1.0;
    theta
};

pub(crate) fn theta_of(model: &ErrorModel) -> Theta {
    let terms = model.terms();
    let mut theta = theta(terms.bias_mps2, terms.matrix);
    theta[15..18].copy_from_slice(&terms.temperature.bias_mps2_per_k);
    theta[18..21].copy_from_slice(&terms.temperature.scale_per_k);
    theta[21..].copy_from_slice(&terms.nonlinearity);
    theta
}

/// Of bias `bias` and matrix `a`, without further terms.
pub(crate) fn theta(bias: [f64; 3], a: [[f64; 3]; 3]) -> Theta {
    let mut theta = PERFECT;
    for axis in 0..3 {
        theta[axis] = bias[axis];
        theta[3 + 3 * axis..6 + 3 * axis].copy_from_slice(&a[axis]);
    }
    theta
}

pub(crate) fn bias(theta: &Theta) -> [f64; 3] {
    triple(theta, 0)
}

pub(crate) fn matrix(theta: &Theta) -> [[f64; 3]; 3] {
    [triple(theta, 3), triple(theta, 6), triple(theta, 9)]
}

/// Three elements, from `first` on.
pub(crate) fn triple(theta: &Theta, first: usize) -> [f64; 3] {
    [theta[first], theta[first + 1], theta[first + 2]]
}

/// A term that [`multi_position`](crate::multi_position) can fit in addition to the nine parameters; three
/// parameters each, one per axis.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Term {
    /// Linear drift of the bias over the session.
    Drift,
    /// Linear temperature dependence of the bias: b₁.
    BiasTemperature,
    /// Linear temperature dependence of the scale factors: s₁.
    ScaleTemperature,
    /// Quadratic nonlinearity: q.
    Quadratic,
}

impl Term {
    /// All of them.
    pub const ALL: [Self; 4] =
        [Self::Drift, Self::BiasTemperature, Self::ScaleTemperature, Self::Quadratic];

    /// Whether it is fitted with a prior where the poses may show it. The quadratic term hardly shows at 1 g: it would only
    /// widen the intervals of the bias.
    pub(crate) fn has_usual_prior(self) -> bool {
        self != Self::Quadratic
    }
}

impl fmt::Display for Term {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        out.write_str(match self {
            Self::Drift => "drift",
            Self::BiasTemperature => "bias against temperature",
            Self::ScaleTemperature => "scale factor against temperature",
            Self::Quadratic => "quadratic",
        })
    }
}

/// A set of terms.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Terms(u8);

crate::set::set!(Terms(u8) of Term);

impl Terms {
    /// The empty set.
    pub const NONE: Self = Self(0);

    pub(crate) const fn moves_with_temperature(self) -> bool {
        self.contains(Term::BiasTemperature) || self.contains(Term::ScaleTemperature)
    }

    /// Number of parameters of the terms.
    pub fn parameters(self) -> usize {
        3 * self.0.count_ones() as usize
    }
}
