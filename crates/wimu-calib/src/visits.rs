//! Grouping of poses by orientation.

use crate::Pose;

/// cos 10°: poses whose outputs differ by less have the same orientation.
const ALIKE: f32 = 0.984_8;
/// Repetition counts as such when at least one pose in five repeats an orientation: a few random
/// poses may be close to each other, and they do not show how repeated poses differ.
const FIFTH: usize = 5;
/// Largest number of orientations; further poses belong to the nearest one.
pub(crate) const MOST: usize = 256;

/// The poses by orientation: each belongs to the first orientation within 10°.
pub(crate) struct Visits {
    /// Direction of the first pose of each orientation.
    first: heapless::Vec<[f32; 3], MOST>,
    /// Orientation of each of the first poses.
    group: heapless::Vec<u8, MOST>,
}

impl Visits {
    pub fn of(poses: &[Pose]) -> Self {
        let mut visits = Self { first: heapless::Vec::new(), group: heapless::Vec::new() };
        for pose in poses {
            let up = direction(pose);
            let group = visits.alike(up).unwrap_or_else(|| {
                let new = visits.first.len();
                match visits.first.push(up) {
                    Ok(()) => new,
                    Err(_) => visits.nearest(up),
                }
            });
            let _ = visits.group.push(group as u8);
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

    /// Orientation of `pose`, the k-th.
    pub fn group(&self, k: usize, pose: &Pose) -> usize {
        match self.group.get(k) {
            Some(&group) => usize::from(group),
            None => {
                let up = direction(pose);
                self.alike(up).unwrap_or_else(|| self.nearest(up))
            }
        }
    }

    /// The first orientation within 10°.
    #[cfg_attr(not(target_os = "none"), inline(always))]
    fn alike(&self, up: [f32; 3]) -> Option<usize> {
        let near = |first: &[f32; 3]| cosine(up, *first) > ALIKE;
        // Without a branch for each orientation: most poses have a new one.
        let any = self.first.iter().fold(false, |any, first| any | near(first));
        any.then(|| self.first.iter().position(near)).flatten()
    }

    fn nearest(&self, up: [f32; 3]) -> usize {
        let mut nearest = (f32::NEG_INFINITY, 0);
        for (group, first) in self.first.iter().enumerate() {
            let cosine = cosine(up, *first);
            if cosine > nearest.0 {
                nearest = (cosine, group);
            }
        }
        nearest.1
    }
}

#[cfg_attr(not(target_os = "none"), inline(always))]
fn cosine(a: [f32; 3], b: [f32; 3]) -> f32 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

fn direction(pose: &Pose) -> [f32; 3] {
    let [x, y, z] = pose.mean_mps2.map(|y| y as f32);
    let per_norm = 1.0 / libm::sqrtf(x * x + y * y + z * z);
    [x * per_norm, y * per_norm, z * per_norm]
}

pub(crate) fn apart(poses: usize, orientations: usize) -> usize {
    if FIFTH * (poses - orientations.min(poses)) < poses { poses } else { orientations }
}
