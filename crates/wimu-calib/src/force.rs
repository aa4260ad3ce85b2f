//! Specific force from an output under given parameters, and its derivatives: equations (13) and (41).

use nalgebra::{Matrix3, Vector3};
use wimu_model::TemperatureTerms;

use crate::terms::{self, Theta};
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
    fn progress(&self, pose: &Pose) -> f64 {
        (pose.time_s - self.end_s) * self.per_span
    }

    fn warmer(&self, pose: &Pose) -> f64 {
        pose.temperature_c.map_or(0.0, |celsius| celsius - self.reference_c)
    }
}

/// Parameters prepared for application to outputs.
pub(crate) struct Evaluated<'a> {
    theta: &'a Theta,
    /// A⁻¹ at T₀.
    inverse: Matrix3<f64>,
    /// Whether A depends on temperature.
    warms: bool,
}

/// Intermediate results for one output.
pub(crate) struct Applied {
    inverse: Matrix3<f64>,
    z: Vector3<f64>,
    pub force: Vector3<f64>,
    progress: f64,
    warmer: f64,
}

impl<'a> Evaluated<'a> {
    /// `None` unless A has a positive determinant. A mirrored A gives the same magnitudes; a step that leads to one
    /// was too long.
    pub fn new(theta: &'a Theta) -> Option<Self> {
        let warms = terms::triple(theta, 18) != [0.0; 3];
        Some(Self { theta, inverse: inverse(theta, 0.0)?, warms })
    }

    /// Specific force from `output`: equation (41).
    #[inline]
    fn apply(&self, output: [f64; 3], progress: f64, warmer: f64) -> Applied {
        let theta = self.theta;
        let warm = (self.warms && warmer != 0.0).then(|| inverse(theta, warmer)).flatten();
        let inverse = warm.unwrap_or(self.inverse);
        let offset = Vector3::from_fn(|i, _| {
            output[i] - theta[i] - theta[12 + i] * progress - theta[15 + i] * warmer
        });
        let z = inverse * offset;
        let force = Vector3::from_fn(|i, _| z[i] - theta[21 + i] * z[i] * z[i]);
        Applied { inverse, z, force, progress, warmer }
    }

    /// Of a pose.
    #[inline]
    pub fn pose(&self, pose: &Pose, conditions: &Conditions) -> Applied {
        self.apply(pose.mean_mps2, conditions.progress(pose), conditions.warmer(pose))
    }

    /// Of a given specific force at the last pose and T₀.
    pub fn at(&self, force: Vector3<f64>) -> Applied {
        Applied { inverse: self.inverse, z: force, force, progress: 0.0, warmer: 0.0 }
    }

    /// ∂|f|/∂θ of all parameters: equations (13) and (41).
    #[inline]
    pub fn derivatives(&self, at: &Applied) -> Theta {
        let theta = self.theta;
        let m = Vector3::from_fn(|i, _| at.force[i] * (1.0 - 2.0 * theta[21 + i] * at.z[i]));
        let norm = at.force.norm();
        let per_norm = if norm > 0.0 { 1.0 / norm } else { 1.0 };
        // w = A⁻ᵀ (1 − 2 diag(q ∘ z)) n, and n = f/|f|.
        let (w, n) = (at.inverse.tr_mul(&m) * per_norm, at.force * per_norm);
        let z = &at.z;
        let mut d = [0.0; terms::COUNT];
        for row in 0..3 {
            d[row] = -w[row];
            for column in 0..3 {
                d[3 + 3 * row + column] = -w[row] * z[column];
            }
            d[12 + row] = -w[row] * at.progress;
            d[15 + row] = -w[row] * at.warmer;
            d[18 + row] = d[3 + 4 * row] * theta[3 + 4 * row] * at.warmer;
            d[3 + 4 * row] *= 1.0 + theta[18 + row] * at.warmer;
            d[21 + row] = -n[row] * z[row] * z[row];
        }
        d
    }
}

/// A⁻¹ at `warmer` K above T₀.
fn inverse(theta: &Theta, warmer: f64) -> Option<Matrix3<f64>> {
    let mut a = Matrix3::from_fn(|r, c| theta[3 + 3 * r + c]);
    for axis in 0..3 {
        a[(axis, axis)] *= 1.0 + theta[18 + axis] * warmer;
    }
    a.try_inverse().filter(|_| a.determinant() > 0.0)
}

/// |f| from `output` at `warmer` K above T₀, m/s², and its derivatives with respect to the first
/// twelve parameters: equation (13).
pub(crate) fn magnitude(theta: &Theta, output: [f64; 3], warmer: f64) -> Option<(f64, [f64; 12])> {
    let at = Evaluated::new(theta)?;
    let applied = at.apply(output, 0.0, warmer);
    let all = at.derivatives(&applied);
    Some((applied.force.norm(), core::array::from_fn(|i| all[i])))
}

/// Residual |f| − g of each pose under the first twelve parameters, m/s²; infinite if A is singular.
pub(crate) fn residuals(
    theta: &Theta,
    poses: &[Pose],
    gravity_mps2: f64,
) -> impl Iterator<Item = (usize, f64)> {
    let at = Evaluated::new(theta);
    poses.iter().enumerate().map(move |(k, pose)| {
        let force = at.as_ref().map(|at| at.apply(pose.mean_mps2, 0.0, 0.0).force);
        (k, force.map_or(f64::INFINITY, |force| force.norm() - gravity_mps2))
    })
}

/// Standard deviation of |f| − g in the worst of 26 orientations, m/s², from the covariance of the
/// first twelve parameters: equation (17).
pub(crate) fn worst_sd(theta: &Theta, covariance: &crate::Covariance, gravity_mps2: f64) -> f64 {
    let Some(at) = Evaluated::new(theta) else {
        return f64::INFINITY;
    };
    let covariance = nalgebra::SMatrix::<f64, 12, 12>::from(*covariance.matrix());
    let variance = |orientation: Orientation| {
        let applied = at.at(Vector3::from(orientation.up().map(|c| c * gravity_mps2)));
        let all = at.derivatives(&applied);
        let row = nalgebra::SVector::<f64, 12>::from_fn(|i, _| all[i]);
        row.dot(&(covariance * row))
    };
    let worst = Orientation::ALL.into_iter().map(variance).fold(0.0, f64::max);
    libm::sqrt(worst)
}
