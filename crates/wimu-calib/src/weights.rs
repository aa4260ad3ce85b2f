//! Which poses a fit does without, and how much each of the others counts.

use crate::Pose;
use crate::terms::Theta;

/// The poses that a fit does without: at most [`Rejected::MOST`] by name, more of more than 320 poses.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Rejected {
    pub(crate) poses: [usize; Self::MOST],
    pub(crate) count: usize,
    pub(crate) unnamed: usize,
}

/// What is far off among poses that are too many to name.
#[derive(Clone, Copy)]
pub(crate) struct FarOff {
    /// The parameters that tell,
    pub theta: Theta<f64>,
    /// the scatter of the poses that are not, m/s²,
    pub sd_mps2: f64,
    /// and how many of it are no chance.
    pub deviations: f64,
}

impl FarOff {
    /// Whether a pose is that has this residual; none is for its own noise.
    pub fn has(&self, residual_mps2: f64, pose: &Pose) -> bool {
        let variance = (self.sd_mps2 * self.sd_mps2).max(pose.mean_free_noise());
        let near = self.deviations * self.deviations * variance;
        let square = residual_mps2 * residual_mps2;
        square > near || square.is_nan()
    }
}

impl Rejected {
    /// So many are named; of up to 320 poses no more are left out.
    pub const MOST: usize = 16;

    /// How many there are, named or not.
    pub fn count(&self) -> usize {
        self.count + self.unnamed
    }

    /// Indices of those that are named, the worst first.
    pub fn as_slice(&self) -> &[usize] {
        self.poses.get(..self.count).unwrap_or(&[])
    }

    /// Whether `pose` is one of those that are named.
    pub fn contains(&self, pose: usize) -> bool {
        self.as_slice().contains(&pose)
    }

    /// Without the one at `place`.
    pub(crate) fn without(mut self, place: usize) -> Self {
        if place < self.count {
            self.poses.copy_within(place + 1..self.count, place);
            self.count -= 1;
        }
        self
    }

    /// With one more, if there is room.
    pub(crate) fn with(mut self, pose: usize) -> Self {
        if let Some(place) = self.poses.get_mut(self.count) {
            *place = pose;
            self.count += 1;
        }
        self
    }
}

/// How much each pose counts: 1 / (σ₀² + its noise), 1 on average. Equation (40).
#[derive(Clone, Copy, Debug)]
pub(crate) struct Weighting {
    /// σ₀²: what differs from pose to pose and is no noise, (m/s²)².
    common: f64,
    /// Mean noise of a pose's mean, (m/s²)²; 0 when all count the same.
    mean_noise: f64,
}

impl Weighting {
    pub const EQUAL: Self = Self {
        common: 1.0,
        mean_noise: 0.0,
    };

    pub fn new(common: f64, mean_noise: f64) -> Self {
        Self { common, mean_noise }
    }

    pub fn is_equal(&self) -> bool {
        self.mean_noise <= 0.0
    }

    pub fn of(&self, pose: &Pose) -> f64 {
        if self.mean_noise > 0.0 {
            (self.common + self.mean_noise) / (self.common + pose.mean_free_noise())
        } else {
            1.0
        }
    }
}
