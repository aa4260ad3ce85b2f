//! Experimental design, choice of the next orientations: equation (44).

use alloc::vec::Vec;

use nalgebra::{SMatrix, SVector, Vector3};

use crate::{Orientation, Parameter, Parameters, Pose};

/// Prior information per parameter, relative to that of one pose: 0.3 m/s² at 1 g against 3 mm/s².
const PRIOR: f64 = 1e-4;
/// Smallest relative decrease of the expected error that justifies a pose.
const WORTH: f64 = 0.03;
/// Largest number of exchange iterations; the third hardly changes a plan.
const MOST_EXCHANGES: usize = 4;
/// Largest number of recommended poses.
const MOST_ADVISED: usize = 60;

/// Poses planned together.
type Plan = Vec<Orientation>;

/// Recommends the next orientation: the one that adds most information on the parameters (D-optimal
/// design), given those taken so far. If the number of further poses is known,
/// [`next_of`](Self::next_of) plans them together.
///
/// ```
/// use wimu_calib::{Guide, Parameter};
///
/// let mut guide = Guide::default();
/// for remaining in (1..=12).rev() {
///     let next = guide.next_of(remaining, |_| true).expect("every orientation can be reached");
///     println!("{}", next.instruction());
///     guide.take(next.up());
/// }
/// assert!(guide.sd(Parameter::BiasX) < 0.51);
/// ```
#[derive(Clone, Debug)]
pub struct Guide {
    /// Inverse of the information matrix of all twelve parameters, for poses of unit variance.
    inverse: SMatrix<f64, 12, 12>,
}

impl Default for Guide {
    /// A guide without poses.
    fn default() -> Self {
        Self { inverse: SMatrix::identity() / PRIOR }
    }
}

impl Guide {
    /// A guide after `poses`.
    pub fn after(poses: &[Pose]) -> Self {
        let mut guide = Self::default();
        for pose in poses {
            guide.take(pose.mean_mps2);
        }
        guide
    }

    /// Adds a pose with `up` upward, of any length, sensor axes; ignored without a direction.
    pub fn take(&mut self, up: [f64; 3]) {
        let up = Vector3::from(up).normalize();
        if up.iter().all(|axis| axis.is_finite()) {
            self.change(up.into(), 1.0);
        }
    }

    /// Adds a pose, or removes it with `sign` −1.
    fn change(&mut self, up: [f64; 3], sign: f64) {
        let row = row(up);
        let along = self.inverse * row;
        let variance = row.dot(&along);
        self.inverse.ger(-sign / (1.0 + sign * variance), &along, &along, 1.0);
    }

    /// The next orientation, of those that `reachable` admits.
    ///
    /// Of orientations within 1 % of the best, the one that is easiest to hold: faces before edges before corners.
    pub fn next(&self, reachable: impl Fn(Orientation) -> bool) -> Option<Orientation> {
        let mut best: Option<(f64, Orientation)> = None;
        let all = Orientation::ALL.into_iter();
        let by_ease = (1..=3).flat_map(|axes| all.clone().filter(move |o| o.axes() == axes));
        for orientation in by_ease.filter(|o| reachable(*o)) {
            let gain = libm::log(1.0 + self.variance(orientation.up()));
            if best.is_none_or(|(most, _)| gain > 1.01 * most) {
                best = Some((gain, orientation));
            }
        }
        best.map(|(_, orientation)| orientation)
    }

    /// The next orientation of a plan of `remaining` more poses, at most [`Guide::MOST_PLANNED`]:
    /// equation (44). Choosing the best pose one by one does not give the best set.
    ///
    /// Twelve poses from the start are the twelve edges.
    pub fn next_of(
        &self,
        remaining: usize,
        reachable: impl Fn(Orientation) -> bool,
    ) -> Option<Orientation> {
        let count = remaining.clamp(1, Self::MOST_PLANNED);
        // The exchange algorithm finds a local optimum near its start.
        let starts = [1..4, 1..2, 2..3, 3..4];
        let mut best: Option<(f64, Plan)> = None;
        for axes in starts {
            let of_start = |o: Orientation| axes.contains(&o.axes()) && reachable(o);
            let Some(plan) = self.plan(count, of_start, &reachable) else {
                continue;
            };
            // Of plans equal to rounding, the first, which is easier.
            if best.as_ref().is_none_or(|(most, _)| plan.0 > most + 1e-6) {
                best = Some(plan);
            }
        }
        let (_, plan) = best?;
        self.next(|orientation| plan.contains(&orientation))
    }

    /// Largest number of poses in a plan.
    pub const MOST_PLANNED: usize = 24;

    /// `count` poses with the largest information, and ln det of their information matrix: started
    /// with poses of `start`, improved by exchange [F].
    fn plan(
        &self,
        count: usize,
        start: impl Fn(Orientation) -> bool,
        reachable: impl Fn(Orientation) -> bool,
    ) -> Option<(f64, Plan)> {
        let mut guide = self.clone();
        let mut plan = Plan::new();
        let mut known = 0.0;
        for _ in 0..count {
            let next = guide.next(&start)?;
            known += libm::log(1.0 + guide.variance(next.up()));
            guide.take(next.up());
            plan.push(next);
        }
        for _ in 0..MOST_EXCHANGES {
            let mut better = false;
            for place in &mut plan {
                let old = place.up();
                guide.change(old, -1.0);
                let without = guide.variance(old);
                let next = guide.next(&reachable)?;
                let with = guide.variance(next.up());
                if with > 1.001 * without {
                    known += libm::log((1.0 + with) / (1.0 + without));
                    *place = next;
                    better = true;
                }
                guide.take(place.up());
            }
            if !better {
                break;
            }
        }
        Some((known, plan))
    }

    /// Number of further poses until the next one reduces the expected error, rms over 26
    /// orientations, by less than 3 %.
    pub fn worth(&self, reachable: impl Fn(Orientation) -> bool) -> usize {
        let mut guide = self.clone();
        let mut expected = guide.expected_error();
        for more in 0..MOST_ADVISED {
            let Some(next) = guide.next(&reachable) else {
                return more;
            };
            guide.take(next.up());
            let with_it = guide.expected_error();
            if with_it > (1.0 - WORTH) * expected {
                return more;
            }
            expected = with_it;
        }
        MOST_ADVISED
    }

    /// Expected standard deviation of a parameter for poses of unit variance, (m/s²)²: of a bias in m/s², of the others at
    /// 1 g in m/s². Before any pose 100.
    pub fn sd(&self, parameter: Parameter) -> f64 {
        let i = parameter.index();
        libm::sqrt(self.inverse[(i, i)])
    }

    fn expected_error(&self) -> f64 {
        let variances = Orientation::ALL.into_iter().map(|o| self.variance(o.up()));
        libm::sqrt(variances.sum::<f64>() / Orientation::ALL.len() as f64)
    }

    /// Variance of |f| − g in direction `up`, for poses of unit variance.
    fn variance(&self, up: [f64; 3]) -> f64 {
        let row = row(up);
        row.dot(&(self.inverse * row))
    }
}

/// Equation (13) for a sensor without errors, in m/s² at 1 g.
fn row(up: [f64; 3]) -> SVector<f64, 12> {
    let mut row = SVector::zeros();
    for parameter in Parameters::OF_GRAVITY.iter() {
        let i = parameter.index();
        row[i] = if i < 3 { -up[i] } else { -up[i / 3 - 1] * up[i % 3] };
    }
    row
}
