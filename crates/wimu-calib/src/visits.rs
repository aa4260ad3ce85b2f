//! Grouping of poses by orientation.

use alloc::vec::Vec;

use nalgebra::Vector3;

use crate::Pose;
use crate::pose::SAME_ORIENTATION_COS;

/// Repetition counts as such when at least one pose in five repeats an orientation: a few random
/// poses may be close to each other, and they do not show how repeated poses differ.
const FIFTH: usize = 5;

/// The poses by orientation: each belongs to the first orientation within 10°.
pub(crate) struct Visits {
    /// Direction of the first pose of each orientation.
    first: Vec<Vector3<f64>>,
    /// Orientation of each pose.
    group: Vec<usize>,
}

impl Visits {
    pub fn of(poses: &[Pose]) -> Self {
        let count = poses.len();
        let mut visits =
            Self { first: Vec::with_capacity(count), group: Vec::with_capacity(count) };
        for pose in poses {
            let up = Vector3::from(pose.mean_mps2).normalize();
            let known = visits.first.iter().position(|first| first.dot(&up) > SAME_ORIENTATION_COS);
            visits.group.push(known.unwrap_or(visits.first.len()));
            if known.is_none() {
                visits.first.push(up);
            }
        }
        visits
    }

    /// Number of orientations.
    pub fn orientations(&self) -> usize {
        self.first.len()
    }

    /// Number of independent observations among `poses` poses.
    pub fn apart(&self, poses: usize) -> usize {
        apart(poses, self.first.len())
    }

    /// Orientation of a pose, by its index.
    pub fn group(&self, pose: usize) -> usize {
        self.group[pose]
    }
}

pub(crate) fn apart(poses: usize, orientations: usize) -> usize {
    if FIFTH * (poses - orientations.min(poses)) < poses { poses } else { orientations }
}
