//! Weights of poses: equation (40).

use crate::Pose;
use crate::magnitude::{Fit, Magnitude};

/// Prior of the residuals' variance: scatter of the poses of a consumer sensor besides noise, m/s²,
/// 1 σ, and its degrees of freedom. Chosen on runs 1 and 2 of the MPU-9150, see VALIDATION.
pub const POSE_SCATTER_MPS2: f64 = 0.004;
/// Degrees of freedom of [`POSE_SCATTER_MPS2`].
pub const POSE_SCATTER_DOF: usize = 6;

/// Prior of the residuals' variance beside priors of the parameters: deviation between poses besides noise, m/s², 1 σ, as
/// in [`Ageing`](crate::Ageing), and its degrees of freedom. With more than one, ten poses of a sensor of seven times that
/// deviation have intervals that miss the truth once in five.
pub(crate) const USUAL_MPS2: f64 = 0.003;
pub(crate) const USUAL_DOF: usize = 1;

/// Weight of a pose: 1 / (σ₀² + variance of its noise), 1 on average.
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

    /// The variance σ₀² between poses is chosen such that the residuals agree with it and with the noise of the poses.
    pub fn from_residuals(problem: &Magnitude, fit: &Fit) -> Self {
        let of_pose = |k: usize| (fit.rows.residual[k], problem.poses[k].mean_free_noise());
        let count = problem.count() as f64;
        let mean_noise = problem.kept().map(|k| of_pose(k).1).sum::<f64>() / count;
        let usual = if problem.has_priors() { USUAL_DOF } else { 0 };
        let usual_squares = usual as f64 * USUAL_MPS2 * USUAL_MPS2;
        let dof = (count - problem.determined(fit)).max(0.0) + usual as f64;
        let prior = core::iter::repeat_n((USUAL_MPS2, 0.0), usual);
        let kept = || problem.kept().map(of_pose).chain(prior.clone());
        let mut common = usual_squares / dof;
        // Newton's method from below on a convex decreasing function: it does not overshoot.
        for _ in 0..30 {
            let (mut excess, mut slope) = (-dof, 0.0);
            for (residual, noise) in kept() {
                let variance = common + noise;
                let share = residual * residual / variance;
                excess += share;
                slope += share / variance;
            }
            if excess <= 1e-6 * dof || slope <= 0.0 {
                break;
            }
            common += excess / slope;
        }
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
        if self.is_equal() {
            return 1.0;
        }
        (self.common + self.mean_noise) / (self.common + pose.mean_free_noise())
    }
}
