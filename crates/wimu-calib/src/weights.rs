//! Rejected poses and weights of the others.

use crate::Pose;
use crate::least_squares::Magnitude;
use crate::terms::Theta;

/// Prior of the residuals' variance: scatter of the poses of a consumer sensor besides noise, m/s²,
/// 1 σ, and its degrees of freedom. Chosen on runs 1 and 2 of the MPU-9150, see VALIDATION.
pub const POSE_SCATTER_MPS2: f64 = 0.004;
/// Degrees of freedom of [`POSE_SCATTER_MPS2`].
pub const POSE_SCATTER_DOF: usize = 6;

/// Poses rejected as outliers. The indices of up to [`Rejected::MOST`] are kept; only sets of more
/// than 320 poses can lose more.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Rejected {
    pub(crate) poses: [usize; Self::MOST],
    pub(crate) count: usize,
    pub(crate) unnamed: usize,
}

/// Rule that rejects distant poses when there are too many to list.
#[derive(Clone, Copy)]
pub(crate) struct FarOff {
    /// Parameters of the fit that the residuals refer to.
    pub theta: Theta,
    /// Standard deviation of the residuals of the other poses, m/s².
    pub sd_mps2: f64,
    /// Threshold, standard deviations.
    pub deviations: f64,
    /// Whether it rejects a pose. A pointer, so that only programs that reject poses contain it.
    pub rejects: fn(&Self, &Magnitude, &Pose) -> bool,
}

impl FarOff {
    pub fn rejects(&self, problem: &Magnitude, pose: &Pose) -> bool {
        let residual = problem.residual(&self.theta, pose);
        residual.is_none_or(|residual| self.has(residual, pose))
    }

    /// Whether a pose with this residual is rejected. The noise of the pose itself is allowed for.
    pub fn has(&self, residual_mps2: f64, pose: &Pose) -> bool {
        let variance = (self.sd_mps2 * self.sd_mps2).max(pose.mean_free_noise());
        let near = self.deviations * self.deviations * variance;
        let square = residual_mps2 * residual_mps2;
        square > near || square.is_nan()
    }
}

impl Rejected {
    /// Largest number of indices kept; up to 320 poses never lose more than this.
    pub const MOST: usize = 16;

    /// Number of rejected poses, including those without an index.
    pub fn count(&self) -> usize {
        self.count + self.unnamed
    }

    /// Indices of the rejected poses, the worst first.
    pub fn as_slice(&self) -> &[usize] {
        self.poses.get(..self.count).unwrap_or(&[])
    }

    /// Whether `pose` is among the indices.
    pub fn contains(&self, pose: usize) -> bool {
        self.as_slice().contains(&pose)
    }

    /// With the k-th entry removed.
    pub(crate) fn without(mut self, place: usize) -> Self {
        if place < self.count {
            self.poses.copy_within(place + 1..self.count, place);
            self.count -= 1;
        }
        self
    }

    /// With one more pose, if there is room.
    pub(crate) fn with(mut self, pose: usize) -> Self {
        if let Some(place) = self.poses.get_mut(self.count) {
            *place = pose;
            self.count += 1;
        }
        self
    }
}

/// Weight of a pose: 1 / (σ₀² + variance of its noise), 1 on average. Equation (40).
#[derive(Clone, Copy, Debug)]
pub(crate) struct Weighting {
    /// σ₀²: variance between poses besides noise, (m/s²)².
    common: f64,
    /// Mean variance of the noise of a pose, (m/s²)²; 0 for equal weights.
    mean_noise: f64,
}

impl Weighting {
    pub const EQUAL: Self = Self { common: 1.0, mean_noise: 0.0 };

    pub fn new(common: f64, mean_noise: f64) -> Self {
        Self { common, mean_noise }
    }

    pub fn is_equal(&self) -> bool {
        self.mean_noise <= 0.0
    }

    /// σ₀, m/s²; `None` for equal weights.
    pub fn common_sd(&self) -> Option<f64> {
        (!self.is_equal()).then(|| libm::sqrt(self.common))
    }

    pub fn of(&self, pose: &Pose) -> f64 {
        if self.mean_noise > 0.0 {
            (self.common + self.mean_noise) / (self.common + pose.mean_free_noise())
        } else {
            1.0
        }
    }
}
