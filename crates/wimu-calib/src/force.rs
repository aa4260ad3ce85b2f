//! Specific force from an output under given parameters, and its derivatives.

use nalgebra::{Matrix3, Vector3};
use wimu_model::TemperatureTerms;

use crate::terms::{Slot, Theta};
use crate::{Orientation, Pose};

/// Reference time and temperature of the terms.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Conditions {
    /// Time of the last pose, s.
    pub end_s: f64,
    /// 1 / time from the first to the last pose, 1/s; 0 without drift.
    pub per_span: f64,
    /// T₀, °C.
    pub reference_c: f64,
}

impl Conditions {
    /// Those of a fit without terms.
    pub fn none() -> Self {
        Self { end_s: 0.0, per_span: 0.0, reference_c: TemperatureTerms::default().reference_c }
    }

    /// Time relative to the session: −1 at the first pose, 0 at the last.
    pub fn progress(&self, pose: &Pose) -> f64 {
        (pose.time_s - self.end_s) * self.per_span
    }

    pub fn warmer(&self, pose: &Pose) -> f64 {
        pose.temperature_c.map_or(0.0, |celsius| celsius - self.reference_c)
    }
}

/// Parameters prepared for application to poses.
pub(crate) struct Evaluated<'a> {
    theta: &'a Theta,
    /// A⁻¹ at T₀.
    inverse: Matrix3<f64>,
    invert: Invert,
    /// Whether A depends on temperature.
    warms: bool,
    /// Whether terms beyond the first twelve parameters are evaluated.
    pub terms: bool,
}

/// A⁻¹ of a matrix with positive determinant. A mirrored A gives the same magnitudes; a step that
/// leads to one was too long.
type Invert = fn(&Matrix3<f64>) -> Option<Matrix3<f64>>;

fn general(a: &Matrix3<f64>) -> Option<Matrix3<f64>> {
    let minor = |r: usize, c: usize| {
        let (i, j) = ((r + 1) % 3, (r + 2) % 3);
        let (k, l) = ((c + 1) % 3, (c + 2) % 3);
        a[(i, k)] * a[(j, l)] - a[(i, l)] * a[(j, k)]
    };
    let minors = Matrix3::from_fn(|r, c| minor(c, r));
    let determinant =
        a[(0, 0)] * minors[(0, 0)] + a[(0, 1)] * minors[(1, 0)] + a[(0, 2)] * minors[(2, 0)];
    let factor = 1.0 / determinant;
    (determinant > 0.0 && factor.is_finite()).then(|| minors * factor)
}

/// Of a lower triangular A, as determined by gravity alone.
#[cfg_attr(not(target_os = "none"), inline(always))]
fn triangular(a: &Matrix3<f64>) -> Option<Matrix3<f64>> {
    let (zero, one) = (0.0, 1.0);
    // The divisions are independent of each other.
    let [x, y, z] = [one / a[(0, 0)], one / a[(1, 1)], one / a[(2, 2)]];
    let yx = -a[(1, 0)] * x * y;
    let zy = -a[(2, 1)] * y * z;
    let zx = -(a[(2, 0)] * x + a[(2, 1)] * yx) * z;
    let size = x * y * z;
    let inverse = Matrix3::new(x, zero, zero, yx, y, zero, zx, zy, z);
    (size > zero && size.is_finite()).then_some(inverse)
}

/// Intermediate results for one pose.
pub(crate) struct Applied {
    inverse: Matrix3<f64>,
    z: Vector3<f64>,
    pub force: Vector3<f64>,
    progress: f64,
    warmer: f64,
}

impl<'a> Evaluated<'a> {
    #[cfg_attr(not(target_os = "none"), inline(always))]
    fn with(theta: &'a Theta, terms: bool, invert: Invert) -> Option<Self> {
        Some(Self {
            theta,
            inverse: invert(&Self::matrix(theta, 0.0))?,
            invert,
            warms: terms && Slot::SCALE_SLOPE.iter().any(|slot| theta[slot.index()] != 0.0),
            terms,
        })
    }

    /// Of parameters with a lower triangular A.
    #[cfg_attr(not(target_os = "none"), inline(always))]
    pub fn new(theta: &'a Theta, terms: bool) -> Option<Self> {
        Self::with(theta, terms, triangular)
    }

    fn matrix(theta: &Theta, warmer: f64) -> Matrix3<f64> {
        let mut a = Matrix3::from_fn(|r, c| theta[3 + 3 * r + c]);
        if warmer != 0.0 {
            for axis in 0..3 {
                a[(axis, axis)] *= 1.0 + theta[Slot::SCALE_SLOPE[axis].index()] * warmer;
            }
        }
        a
    }

    /// Specific force from `output`: equation (41).
    #[cfg_attr(not(target_os = "none"), inline(always))]
    pub fn apply(&self, output: [f64; 3], progress: f64, warmer: f64) -> Applied {
        let theta = self.theta;
        let inverse = if self.warms && warmer != 0.0 {
            (self.invert)(&Self::matrix(theta, warmer)).unwrap_or(self.inverse)
        } else {
            self.inverse
        };
        let mut offset = Vector3::from_fn(|i, _| output[i] - theta[i]);
        if self.terms {
            for i in 0..3 {
                offset[i] -= theta[12 + i] * progress + theta[15 + i] * warmer;
            }
        }
        let z = inverse * offset;
        let mut force = z;
        if self.terms {
            for i in 0..3 {
                force[i] -= theta[21 + i] * z[i] * z[i];
            }
        }
        Applied { inverse, z, force, progress, warmer }
    }

    /// Of a given specific force at the last pose and T₀.
    pub fn at(&self, force: Vector3<f64>) -> Applied {
        Applied { inverse: self.inverse, z: force, force, progress: 0.0, warmer: 0.0 }
    }

    /// Common factors of the derivatives of |f|: w = A⁻ᵀ (1 − 2 diag(q ∘ z)) n, and n = f/|f|.
    #[cfg_attr(not(target_os = "none"), inline(always))]
    fn directions(&self, at: &Applied) -> (Vector3<f64>, Vector3<f64>) {
        let mut m = at.force;
        if self.terms {
            for i in 0..3 {
                m[i] *= 1.0 - 2.0 * self.theta[21 + i] * at.z[i];
            }
        }
        // The division by |f| comes last, to overlap with the square root.
        let norm = at.force.norm();
        let per_norm = if norm > 0.0 { 1.0 / norm } else { 1.0 };
        (at.inverse.tr_mul(&m) * per_norm, at.force * per_norm)
    }

    /// ∂|f|/∂θ of all parameters: equations (13) and (41).
    #[cfg_attr(not(target_os = "none"), inline(always))]
    pub fn derivatives(&self, at: &Applied) -> Theta {
        let (w, n) = self.directions(at);
        let z = &at.z;
        let mut d = [0.0; Slot::COUNT];
        for row in 0..3 {
            d[row] = -w[row];
            for column in 0..3 {
                d[3 + 3 * row + column] = -w[row] * z[column];
            }
        }
        if !self.terms {
            return d;
        }
        for row in 0..3 {
            d[12 + row] = -w[row] * at.progress;
            d[15 + row] = -w[row] * at.warmer;
            d[18 + row] = d[3 + 4 * row] * self.theta[3 + 4 * row] * at.warmer;
            d[3 + 4 * row] *= 1.0 + self.theta[18 + row] * at.warmer;
            d[21 + row] = -n[row] * z[row] * z[row];
        }
        d
    }
}

/// |f| from `output` at `warmer` K above T₀, m/s², and its derivatives with respect to the first
/// twelve parameters: equation (13).
pub(crate) fn magnitude(theta: &Theta, output: [f64; 3], warmer: f64) -> Option<(f64, [f64; 12])> {
    let at = Evaluated::with(theta, true, general)?;
    let applied = at.apply(output, 0.0, warmer);
    let all = at.derivatives(&applied);
    Some((applied.force.norm(), core::array::from_fn(|i| all[i])))
}

/// Residual |f| − g of a pose under the first twelve parameters, m/s²; infinite if A is singular.
pub(crate) fn residual(theta: &Theta, pose: &Pose, gravity_mps2: f64) -> f64 {
    Evaluated::with(theta, false, general).map_or(f64::INFINITY, |at| {
        let applied = at.apply(pose.mean_mps2, 0.0, 0.0);
        applied.force.norm() - gravity_mps2
    })
}

/// Standard deviation of |f| − g in the worst of 26 orientations, m/s², from the covariance of the
/// first twelve parameters: equation (17).
pub(crate) fn worst_sd(theta: &Theta, covariance: &crate::Covariance, gravity_mps2: f64) -> f64 {
    let Some(at) = Evaluated::with(theta, true, general) else {
        return f64::INFINITY;
    };
    let covariance = covariance.matrix();
    let variance = |orientation: Orientation| {
        let applied = at.at(Vector3::from(orientation.up().map(|c| c * gravity_mps2)));
        let row = at.derivatives(&applied);
        let mut sum = 0.0;
        for (covariances, d) in covariance.iter().zip(row) {
            for (covariance, e) in covariances.iter().zip(row) {
                sum += d * *covariance * e;
            }
        }
        sum
    };
    let worst = Orientation::ALL.into_iter().map(variance).fold(0.0, f64::max);
    libm::sqrt(worst)
}
