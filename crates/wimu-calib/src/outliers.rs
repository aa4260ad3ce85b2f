//! Poses that the others contradict, and how much each counts.

use crate::least_squares::{Fit, Magnitude, Without};
use crate::linear::Real;
use crate::terms::{Theta, USUAL_ACROSS, USUAL_SCALE};
use crate::{Model, Pose, student};

/// Chance that a good set of poses loses one.
const SIGNIFICANCE: f64 = 1e-3;
/// Of more poses the few that may be left out would change nothing.
const MANY: usize = 10_000;
/// Degrees of freedom that must be left for the others to outvote a pose.
const LEAST_DOF: usize = 3;
/// At most every fifth pose is doubted.
const DOUBTED: usize = 5;
/// Residuals beyond so many standard deviations pull ever less on a Cauchy fit, 95 % as good as least
/// squares where there is no bad pose.
const CAUCHY: f64 = 2.385;
/// Standard deviations per median of absolute normal deviates.
const PER_MEDIAN: f64 = 1.4826;
/// Fits with ever better scales; the last hardly differ.
const ROBUST_FITS: usize = 4;

/// The poses that a fit does without, at most [`Rejected::MOST`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Rejected {
    poses: [usize; Self::MOST],
    count: usize,
}

impl Rejected {
    /// More than so many bad poses are not left out: the recording is.
    pub const MOST: usize = 16;

    /// Their indices, the worst first.
    pub fn as_slice(&self) -> &[usize] {
        self.poses.get(..self.count).unwrap_or(&[])
    }

    /// Whether `pose` is one of them.
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

/// Leaves out poses by a forward search: equation (42). A fit that bad poses cannot pull far says
/// which are farthest off; without them the rest is fitted, and one by one they are let in again,
/// the nearest first, until the next would contradict those that are in. Returns the fit; what it
/// did without is in `problem.rejected`.
pub(crate) fn reject<R: Real, const N: usize>(
    problem: &mut Magnitude<N>,
    fit: Fit<R, N>,
    model: Model,
) -> Fit<R, N> {
    let count = problem.poses.len();
    let most = problem
        .visits
        .apart(count)
        .saturating_sub(N + LEAST_DOF)
        .min(count / DOUBTED)
        .min(Rejected::MOST);
    if most == 0 || count > MANY {
        return fit;
    }
    // What the model leaves out is no pose's fault.
    let unfitted_mps2 = problem.gravity_mps2
        * match model {
            Model::Bias3 => USUAL_SCALE,
            Model::BiasScale6 => USUAL_ACROSS,
            Model::Full9 => 0.0,
        };
    problem.rejected = farthest(problem, &robust(problem, &fit), most);
    let Some(mut inner) = problem.solve(&fit.theta, Without::Nothing) else {
        problem.rejected = Rejected::default();
        return fit;
    };
    while let Some((place, deviate)) = nearest(problem, &inner, unfitted_mps2) {
        let dof = problem.visited().apart.saturating_sub(N).max(1);
        let limit = student::two_sided(SIGNIFICANCE / count as f64, dof as f64);
        let known = problem
            .knowledge(&inner)
            .is_some_and(|knowledge| knowledge.suffices());
        if known && deviate > limit {
            return inner;
        }
        problem.rejected = problem.rejected.without(place);
        match problem.solve(&inner.theta, Without::Nothing) {
            Some(wider) => inner = wider,
            None => break,
        }
    }
    problem.rejected = Rejected::default();
    fit
}

/// A Cauchy fit from the least-squares one.
fn robust<R: Real, const N: usize>(problem: &Magnitude<N>, fit: &Fit<R, N>) -> Theta<R> {
    let mut theta = fit.theta;
    let count = problem.poses.len();
    for _ in 0..ROBUST_FITS {
        let median = median_residual(problem, &theta);
        let small_sample = libm::sqrt(count as f64 / (count - N) as f64);
        let scale = CAUCHY * PER_MEDIAN * median * small_sample;
        match problem.solve_robust(&theta, scale) {
            Some(better) => theta = better.theta,
            None => break,
        }
    }
    theta
}

/// Median of |r| to 1 %, by halving an interval: there is no room to sort.
fn median_residual<R: Real, const N: usize>(problem: &Magnitude<N>, theta: &Theta<R>) -> f64 {
    let mut largest = 0.0_f64;
    problem.residuals(theta, |_, residual| largest = largest.max(residual.abs()));
    let (mut low, mut high) = (0.0, largest);
    for _ in 0..60 {
        let middle = 0.5 * (low + high);
        let mut below = 0;
        problem.residuals(theta, |_, residual| {
            below += usize::from(residual.abs() <= middle)
        });
        if 2 * below > problem.poses.len() {
            high = middle;
        } else {
            low = middle;
        }
        if high - low <= 0.01 * high {
            break;
        }
    }
    high
}

/// The `most` poses with the largest residuals.
fn farthest<R: Real, const N: usize>(
    problem: &Magnitude<N>,
    theta: &Theta<R>,
    most: usize,
) -> Rejected {
    let mut worst = [(0.0, 0); Rejected::MOST];
    problem.residuals(theta, |k, residual| {
        let mut candidate = (residual.abs(), k);
        for place in worst.iter_mut().take(most) {
            if candidate.0 > place.0 {
                core::mem::swap(place, &mut candidate);
            }
        }
    });
    worst
        .iter()
        .take(most)
        .filter(|(size, _)| *size > 0.0)
        .fold(Rejected::default(), |all, &(_, pose)| all.with(pose))
}

/// Of the poses left out the one that the fit predicts best: its place among them, and its
/// residual in standard deviations of that prediction.
fn nearest<R: Real, const N: usize>(
    problem: &Magnitude<N>,
    fit: &Fit<R, N>,
    unfitted_mps2: f64,
) -> Option<(usize, f64)> {
    let inside = problem.poses.len() - problem.rejected.as_slice().len();
    let sd = fit.sd(inside - N);
    let mut nearest: Option<(usize, f64)> = None;
    for (place, &pose) in problem.rejected.as_slice().iter().enumerate() {
        let (residual, growth) = problem.predicted(fit, pose)?;
        let variance = sd * sd * (1.0 + growth) + unfitted_mps2 * unfitted_mps2;
        let deviate = residual.abs() / libm::sqrt(variance);
        if nearest.is_none_or(|(_, least)| deviate < least) {
            nearest = Some((place, deviate));
        }
    }
    nearest
}

/// How much each pose should count, from what the fit leaves: σ₀² such that the residuals are as
/// large as it and the poses' noise say. Equation (40).
pub(crate) fn weighting<R: Real, const N: usize>(
    problem: &Magnitude<N>,
    fit: &Fit<R, N>,
) -> Weighting {
    let kept = |k: usize| !problem.rejected.contains(k);
    let (mut count, mut mean_noise) = (0.0, 0.0);
    for (_, pose) in problem.poses.iter().enumerate().filter(|(k, _)| kept(*k)) {
        count += 1.0;
        mean_noise += pose.mean_free_noise();
    }
    mean_noise /= count;
    let dof = count - N as f64;
    let mut common = 0.0;
    // Newton's rule from below on a convex falling function: it never overshoots.
    for _ in 0..30 {
        let (mut excess, mut slope) = (-dof, 0.0);
        problem.residuals(&fit.theta, |k, residual| {
            if kept(k) {
                let variance = common + problem.poses[k].mean_free_noise();
                let share = residual * residual / variance;
                excess += share;
                slope += share / variance;
            }
        });
        if excess <= 1e-6 * dof || slope <= 0.0 {
            break;
        }
        common += excess / slope;
    }
    Weighting::new(common, mean_noise)
}
