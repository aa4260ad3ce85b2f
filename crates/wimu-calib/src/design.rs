//! Which orientations a set of poses lacks: equation (44).

use nalgebra::{SMatrix, SVector};

use crate::{Model, Orientation, Parameters, Pose};

/// cos 40°: twelve well spread poses cover all 26 orientations, the six sides themselves only.
const NEAR: f64 = 0.766;
/// What is known beforehand: parameters are about a hundred times as uncertain, as errors at 1 g,
/// as one pose tells them (0.3 m/s² against 3 mm/s²).
const PRIOR: f64 = 1e-4;
/// A pose is worth it that lowers the expected error by this share.
const WORTH: f64 = 0.03;
/// Rounds of exchange in a plan; the third hardly changes one.
const MOST_EXCHANGES: usize = 4;
/// More poses than anyone needs.
const MOST_ADVISED: usize = 60;

/// Share of the 26 orientations that are within 40° of a pose's mean output.
pub(crate) fn coverage(poses: &[Pose]) -> f64 {
    let mut missing = Orientation::ALL.map(|orientation| Some(orientation.up()));
    let mut covered = 0_u32;
    for pose in poses {
        let Some(up) = unit(pose.mean_mps2) else {
            continue;
        };
        for direction in &mut missing {
            if direction.is_some_and(|direction| dot(up, direction) >= NEAR) {
                *direction = None;
                covered += 1;
            }
        }
        if covered == Orientation::ALL.len() as u32 {
            break;
        }
    }
    f64::from(covered) / Orientation::ALL.len() as f64
}

fn unit(v: [f64; 3]) -> Option<[f64; 3]> {
    let norm = libm::sqrt(dot(v, v));
    (norm > 0.0 && norm.is_finite()).then(|| v.map(|c| c / norm))
}

fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// Poses planned together.
type Plan = heapless::Vec<Orientation, { Guide::MOST_PLANNED }>;

/// Says which orientation to take next: the one that adds most to what is known of the
/// parameters (D-optimal), given those taken so far, whether or not they suffice for an answer yet.
/// Where it is known how many more will be taken, [`next_of`](Self::next_of) plans them together.
///
/// ```
/// use wimu_calib::{Guide, Model, Orientation};
///
/// let mut guide = Guide::new(Model::Full9);
/// for remaining in (1..=12).rev() {
///     let next = guide.next_of(remaining, |_| true).expect("every orientation can be reached");
///     println!("{}", next.instruction());
///     guide.take(next.up());
/// }
/// assert!(guide.amplification() < 1.2);
/// ```
#[derive(Clone, Debug)]
pub struct Guide {
    fitted: Parameters,
    /// Inverse of the information matrix of all twelve parameters, poses of unit variance.
    inverse: SMatrix<f64, 12, 12>,
}

impl Guide {
    /// One that has seen no pose yet.
    pub fn new(model: Model) -> Self {
        Self {
            fitted: model.fitted(),
            inverse: SMatrix::identity() / PRIOR,
        }
    }

    /// One that has seen `poses`.
    pub fn after(model: Model, poses: &[Pose]) -> Self {
        let mut guide = Self::new(model);
        for pose in poses {
            guide.take(pose.mean_mps2);
        }
        guide
    }

    /// Counts a pose with `up` upward, of any length, sensor axes; nothing if it has no direction.
    pub fn take(&mut self, up: [f64; 3]) {
        if let Some(up) = unit(up) {
            self.change(up, 1.0);
        }
    }

    /// Counts a pose once more, or once less with `sign` −1.
    fn change(&mut self, up: [f64; 3], sign: f64) {
        let row = self.row(up);
        let along = self.inverse * row;
        let variance = row.dot(&along);
        self.inverse
            .ger(-sign / (1.0 + sign * variance), &along, &along, 1.0);
    }

    /// The orientation to take next, of those that `reachable` admits.
    ///
    /// Of orientations that are alike to 1 % the one that is easiest to hold.
    pub fn next(&self, reachable: impl Fn(Orientation) -> bool) -> Option<Orientation> {
        let mut best: Option<(f64, Orientation)> = None;
        for orientation in Orientation::BY_EASE {
            if !reachable(orientation) {
                continue;
            }
            let gain = libm::log(1.0 + self.variance(orientation.up()));
            if best.is_none_or(|(most, _)| gain > 1.01 * most) {
                best = Some((gain, orientation));
            }
        }
        best.map(|(_, orientation)| orientation)
    }

    /// The orientation to take next if `remaining` more poses will be taken, at most
    /// [`Guide::MOST_PLANNED`] of which are planned together: equation (44). One by one, each the best
    /// at its time, are not the best of as many.
    ///
    /// Of twelve from nothing they are the twelve edges.
    pub fn next_of(
        &self,
        remaining: usize,
        reachable: impl Fn(Orientation) -> bool,
    ) -> Option<Orientation> {
        let count = remaining.clamp(1, Self::MOST_PLANNED);
        // Exchange finds the best near where it starts.
        let starts = [1..4, 1..2, 2..3, 3..4];
        let mut best: Option<(f64, Plan)> = None;
        for axes in starts {
            let of_start = |o: Orientation| axes.contains(&o.axes()) && reachable(o);
            let Some(plan) = self.plan(count, of_start, &reachable) else {
                continue;
            };
            // Those that are alike to rounding: the first, which is the easier.
            if best.as_ref().is_none_or(|(most, _)| plan.0 > most + 1e-6) {
                best = Some(plan);
            }
        }
        let (_, plan) = best?;
        self.next(|orientation| plan.contains(&orientation))
    }

    /// Of how many poses a plan is made at the most.
    pub const MOST_PLANNED: usize = 24;

    /// `count` poses that know most together, log det M of them, from those of `start` on by
    /// exchange [F].
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
            let _ = plan.push(next);
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

    /// How many more poses are worth it: until the next would lower the error to be expected, rms
    /// over 26 orientations, by less than 3 %.
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

    /// How much an error in the poses grows in the worst of 26 orientations.
    pub fn amplification(&self) -> f64 {
        let variances = Orientation::ALL.into_iter().map(|o| self.variance(o.up()));
        libm::sqrt(variances.fold(0.0, f64::max))
    }

    fn expected_error(&self) -> f64 {
        let variances = Orientation::ALL.into_iter().map(|o| self.variance(o.up()));
        libm::sqrt(variances.sum::<f64>() / Orientation::ALL.len() as f64)
    }

    /// Variance of |f| − g in direction `up`, for poses of unit variance.
    fn variance(&self, up: [f64; 3]) -> f64 {
        let row = self.row(up);
        row.dot(&(self.inverse * row))
    }

    /// Equation (13) for a sensor without errors, in m/s² at 1 g.
    fn row(&self, up: [f64; 3]) -> SVector<f64, 12> {
        let mut row = SVector::zeros();
        for parameter in self.fitted.iter() {
            let i = parameter.index();
            row[i] = if i < 3 {
                -up[i]
            } else {
                -up[i / 3 - 1] * up[i % 3]
            };
        }
        row
    }
}
