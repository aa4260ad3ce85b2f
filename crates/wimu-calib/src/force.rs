//! Specific force from an output under given parameters, and its derivatives.

use nalgebra::{Matrix3, Vector3};
use wimu_model::TemperatureTerms;

use crate::linear::{Real, double, real};
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
pub(crate) struct Evaluated<'a, R: Real> {
    theta: &'a Theta<R>,
    /// A⁻¹ at T₀.
    inverse: Matrix3<R>,
    invert: Invert<R>,
    /// Whether A depends on temperature.
    warms: bool,
    /// Whether terms beyond the first twelve parameters are evaluated.
    pub terms: bool,
}

/// A⁻¹ of a matrix with positive determinant. A mirrored A gives the same magnitudes; a step that
/// leads to one was too long.
type Invert<R> = fn(&Matrix3<R>) -> Option<Matrix3<R>>;

fn general<R: Real>(a: &Matrix3<R>) -> Option<Matrix3<R>> {
    let minor = |r: usize, c: usize| {
        let (i, j) = ((r + 1) % 3, (r + 2) % 3);
        let (k, l) = ((c + 1) % 3, (c + 2) % 3);
        a[(i, k)] * a[(j, l)] - a[(i, l)] * a[(j, k)]
    };
    let minors = Matrix3::from_fn(|r, c| minor(c, r));
    let determinant =
        a[(0, 0)] * minors[(0, 0)] + a[(0, 1)] * minors[(1, 0)] + a[(0, 2)] * minors[(2, 0)];
    let factor = R::one() / determinant;
    (determinant > R::zero() && factor.is_finite()).then(|| minors * factor)
}

/// Of a lower triangular A, as determined by gravity alone.
#[cfg_attr(not(target_os = "none"), inline(always))]
fn triangular<R: Real>(a: &Matrix3<R>) -> Option<Matrix3<R>> {
    let (zero, one) = (R::zero(), R::one());
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
pub(crate) struct Applied<R: Real> {
    inverse: Matrix3<R>,
    z: Vector3<R>,
    pub force: Vector3<R>,
    progress: R,
    warmer: R,
}

impl<'a, R: Real> Evaluated<'a, R> {
    #[cfg_attr(not(target_os = "none"), inline(always))]
    fn with(theta: &'a Theta<R>, terms: bool, invert: Invert<R>) -> Option<Self> {
        Some(Self {
            theta,
            inverse: invert(&Self::matrix(theta, R::zero()))?,
            invert,
            warms: terms && Slot::SCALE_SLOPE.iter().any(|slot| !theta[slot.index()].is_zero()),
            terms,
        })
    }

    /// Of parameters with a lower triangular A.
    #[cfg_attr(not(target_os = "none"), inline(always))]
    pub fn new(theta: &'a Theta<R>, terms: bool) -> Option<Self> {
        Self::with(theta, terms, triangular)
    }

    fn matrix(theta: &Theta<R>, warmer: R) -> Matrix3<R> {
        let mut a = Matrix3::from_fn(|r, c| theta[3 + 3 * r + c]);
        if !warmer.is_zero() {
            for axis in 0..3 {
                a[(axis, axis)] *= R::one() + theta[Slot::SCALE_SLOPE[axis].index()] * warmer;
            }
        }
        a
    }

    /// Specific force from `output`: equation (41).
    #[cfg_attr(not(target_os = "none"), inline(always))]
    pub fn apply(&self, output: [R; 3], progress: R, warmer: R) -> Applied<R> {
        let theta = self.theta;
        let inverse = if self.warms && !warmer.is_zero() {
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
    pub fn at(&self, force: Vector3<R>) -> Applied<R> {
        Applied { inverse: self.inverse, z: force, force, progress: R::zero(), warmer: R::zero() }
    }

    /// Common factors of the derivatives of |f|: w = A⁻ᵀ (1 − 2 diag(q ∘ z)) n, and n = f/|f|.
    #[cfg_attr(not(target_os = "none"), inline(always))]
    fn directions(&self, at: &Applied<R>) -> (Vector3<R>, Vector3<R>) {
        let mut m = at.force;
        if self.terms {
            let two: R = real(2.0);
            for i in 0..3 {
                m[i] *= R::one() - two * self.theta[21 + i] * at.z[i];
            }
        }
        // The division by |f| comes last, to overlap with the square root.
        let norm = at.force.norm();
        let per_norm = if norm > R::zero() { R::one() / norm } else { R::one() };
        (at.inverse.tr_mul(&m) * per_norm, at.force * per_norm)
    }

    /// ∂|f|/∂θ of all parameters: equations (13) and (41).
    #[cfg_attr(not(target_os = "none"), inline(always))]
    pub fn derivatives(&self, at: &Applied<R>) -> Theta<R> {
        let (w, n) = self.directions(at);
        let z = &at.z;
        let mut d = [R::zero(); Slot::COUNT];
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
            d[3 + 4 * row] *= R::one() + self.theta[18 + row] * at.warmer;
            d[21 + row] = -n[row] * z[row] * z[row];
        }
        d
    }
}

/// |f| from `output` at `warmer` K above T₀, m/s², and its derivatives with respect to the first
/// twelve parameters: equation (13).
pub(crate) fn magnitude<R: Real>(
    theta: &Theta<R>,
    output: [R; 3],
    warmer: R,
) -> Option<(R, [R; 12])> {
    let at = Evaluated::with(theta, true, general)?;
    let applied = at.apply(output, R::zero(), warmer);
    let all = at.derivatives(&applied);
    Some((applied.force.norm(), core::array::from_fn(|i| all[i])))
}

/// Residual |f| − g of a pose under the first twelve parameters, m/s²; infinite if A is singular.
pub(crate) fn residual<R: Real>(theta: &Theta<R>, pose: &Pose, gravity_mps2: f64) -> f64 {
    Evaluated::with(theta, false, general).map_or(f64::INFINITY, |at| {
        let applied = at.apply(pose.mean_mps2.map(real), R::zero(), R::zero());
        double(applied.force.norm() - real(gravity_mps2))
    })
}

/// Standard deviation of |f| − g in the worst of 26 orientations, m/s², from the covariance of the
/// first twelve parameters: equation (17).
pub(crate) fn worst_sd<R: Real>(
    theta: &Theta<R>,
    covariance: &crate::Covariance,
    gravity_mps2: f64,
) -> f64 {
    let Some(at) = Evaluated::with(theta, true, general) else {
        return f64::INFINITY;
    };
    let covariance = covariance.matrix().map(|row| row.map(real::<R>));
    let variance = |orientation: Orientation| {
        let applied = at.at(Vector3::from(orientation.up().map(|c| real(c * gravity_mps2))));
        let row = at.derivatives(&applied);
        let mut sum = R::zero();
        for (covariances, d) in covariance.iter().zip(row) {
            for (covariance, e) in covariances.iter().zip(row) {
                sum += d * *covariance * e;
            }
        }
        sum
    };
    let worst =
        Orientation::ALL.into_iter().map(variance).fold(R::zero(), |most, one| most.max(one));
    double(worst.sqrt())
}
