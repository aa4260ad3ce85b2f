//! Segments of a path, and whether the measurements in them confirm its covariance: equation (189).

use wimu_nav::consistency::Consistency;
use wimu_nav::filter::Innovation;

use super::{Move, PathPoint};
use crate::digits::significant;
use crate::stats::{IMPROBABLE, quantile};
use crate::{Code, Problem, Severity};

/// Shortest segment, s: ten steps of a foot.
const SEGMENT_S: f64 = 10.0;
/// Variance factor beyond which a path is lost: σ is ten times too small, and the cause is no noise.
const LOST: f64 = 100.0;

/// Upper quartile of the standard normal distribution.
const UPPER_QUARTILE: f64 = 0.6745;

/// Variance factor of innovations up to a quarter of which are outliers: their upper quartile, if a sign test shows that
/// it is above that of the distribution.
fn robust_factor(ratios: &[f64]) -> f64 {
    let above = ratios.iter().filter(|ratio| **ratio > 1.0).count() as f64;
    let count = ratios.len() as f64;
    if above - 0.25 * count <= IMPROBABLE * (0.25 * 0.75 * count).sqrt() {
        return 1.0;
    }
    quartile(ratios)
}

/// Upper quartile.
fn quartile(ratios: &[f64]) -> f64 {
    -quantile(ratios.iter().map(|ratio| -ratio), 4).unwrap_or(-1.0)
}

/// Upper quartile of χ² (Wilson and Hilferty).
fn quartile_chi_square(dof: usize) -> f64 {
    let spread = 2.0 / (9.0 * dof as f64);
    dof as f64 * (1.0 - spread + UPPER_QUARTILE * spread.sqrt()).powi(3)
}

/// Fixes that were used, against their standard deviations.
#[derive(Clone, Copy, Debug, Default)]
struct Scatter {
    /// Sums of the squared innovations over their covariance, and of their degrees of freedom.
    statistic: f64,
    dof: f64,
    /// Sum of the variances as stated, m², and number of each.
    stated_m2: [f64; 3],
    counts: [f64; 3],
}

impl Scatter {
    fn see(&mut self, innovation: &Innovation, sd_m: [f64; 3]) {
        self.statistic += innovation.statistic;
        self.dof += innovation.dof as f64;
        for axis in (0..3).filter(|axis| sd_m[*axis].is_finite()) {
            self.stated_m2[axis] += sd_m[axis] * sd_m[axis];
            self.counts[axis] += 1.0;
        }
    }

    /// Variances of an error that all fixes have in common, m²: what is stated beyond the scatter that they show. It does not
    /// average out, as the filter assumes of theirs. Equation (175).
    fn common_m2(&self) -> Option<[f64; 3]> {
        let share = self.statistic / self.dof;
        let is_shown = share < 1.0 - IMPROBABLE * (2.0 / self.dof).sqrt();
        let stated_m2 = |axis: usize| self.stated_m2[axis] / self.counts[axis].max(1.0);
        is_shown.then(|| [0, 1, 2].map(|axis| (1.0 - share) * stated_m2(axis)))
    }
}

/// Samples up to the rest or the stance that tests them.
#[derive(Clone, Copy, Debug)]
struct Segment {
    /// Times of its first sample and of that after it, s.
    from_s: f64,
    to_s: f64,
    /// Number of the sample after it.
    end: usize,
    /// Variance factor of its points: an error of the position stays until it is measured.
    factor: f64,
}

/// The segments of a path, sample by sample.
#[derive(Clone, Debug)]
pub(super) struct Segments {
    ended: Vec<Segment>,
    open: Consistency,
    /// Of all rests and stances.
    all: Consistency,
    /// Squared innovations of fixes over the upper quartile of their distribution.
    fixes: Vec<f64>,
    scatter: Scatter,
    from_s: f64,
    samples: usize,
    /// Whether the position was measured since the segment began, or its covariance enlarged.
    is_located: bool,
    /// Whether the path did not agree with the last rest.
    is_doubted: bool,
}

impl Segments {
    /// Before the first sample, at `time_s`.
    pub fn from(time_s: f64) -> Self {
        Self {
            ended: Vec::new(),
            open: Consistency::new(),
            all: Consistency::new(),
            fixes: Vec::new(),
            scatter: Scatter::default(),
            from_s: time_s,
            samples: 0,
            is_located: false,
            is_doubted: false,
        }
    }

    /// An innovation of a fix with these standard deviations, m, used or not.
    pub fn see_fix(&mut self, innovation: &Innovation, sd_m: [f64; 3]) {
        if innovation.accepted {
            self.scatter.see(innovation, sd_m);
        }
        if innovation.statistic.is_finite() {
            self.fixes.push(innovation.statistic / quartile_chi_square(innovation.dof));
        }
    }

    /// The position was measured at the next sample.
    pub fn locate(&mut self) {
        self.is_located = true;
    }

    /// The next sample with its innovations of rests and stances, and, in a rest, whether the path agrees with it. A rest that
    /// it does not agree with tests it no better than a slow motion, and does not end a segment.
    pub fn see(&mut self, time_s: f64, found: &Consistency, rests: Option<bool>) {
        self.is_doubted = rests.map_or(self.is_doubted, |agrees| !agrees);
        let is_tested = self.open.checks() + self.fixes.len() > 0 && found.checks() == 0;
        let ends = is_tested && rests.is_none() && !self.is_doubted;
        if ends && time_s - self.from_s >= SEGMENT_S {
            self.end(time_s);
        }
        self.samples += 1;
        self.open.merge(found);
        self.all.merge(found);
    }

    /// The same of a sample from which on the covariance is enlarged, since a rest contradicted the motion before. Where that is
    /// lost, so is what follows, until the position is measured.
    pub fn recover(&mut self, time_s: f64, found: &Consistency) {
        self.open.merge(found);
        self.all.merge(found);
        let is_lost = self.factor() > LOST;
        self.end(time_s);
        (self.is_located, self.is_doubted) = (!is_lost, false);
        self.samples += 1;
    }

    fn end(&mut self, time_s: f64) {
        let factor = self.factor();
        self.ended.push(Segment { from_s: self.from_s, to_s: time_s, end: self.samples, factor });
        self.open = Consistency::new();
        self.fixes.clear();
        self.from_s = time_s;
        self.is_located = false;
    }

    /// Mean square of the normalised innovations of rests and stances, with their degrees of freedom.
    pub fn mean_square(&self) -> Option<(f64, usize)> {
        self.all.mean_square()
    }

    /// Variance factor of the newest point.
    fn factor(&self) -> f64 {
        let before = self.ended.last().filter(|_| !self.is_located);
        let factor = self.open.variance_factor().max(robust_factor(&self.fixes));
        factor.max(before.map_or(1.0, |segment| segment.factor))
    }

    /// Applies the factor of the newest point to it, and the common error of the fixes.
    pub fn scale(&self, point: &mut PathPoint) {
        scale(point, self.factor());
        add(point, self.scatter.common_m2().unwrap_or_default());
    }

    /// Ends the path: applies the factors to its points and moves, and the common error of the fixes to the points. Returns what
    /// is said of them.
    pub fn finish(mut self, points: &mut [PathPoint], moves: &mut [Move]) -> Vec<Problem> {
        let Some(last) = points.last() else { return Vec::new() };
        self.end(last.time_s);
        self.lose_before();
        let mut from = 0;
        for segment in &self.ended {
            for point in &mut points[from..segment.end] {
                scale(point, segment.factor);
            }
            from = segment.end;
        }
        for one in moves {
            let at = self.ended.partition_point(|segment| segment.to_s < one.to_s);
            let factor = self.ended.get(at).map_or(1.0, |segment| segment.factor);
            one.length_sd_m *= factor.sqrt();
            one.valid &= factor <= LOST;
        }
        let common_m2 = self.scatter.common_m2();
        for point in points {
            add(point, common_m2.unwrap_or_default());
        }
        self.findings().into_iter().chain(common_m2.map(correlated)).collect()
    }

    /// A sensor that a segment proves to be faulty is so in those before which contradict it less.
    fn lose_before(&mut self) {
        let mut is_lost = false;
        for segment in self.ended.iter_mut().rev() {
            is_lost = segment.factor > LOST || (is_lost && segment.factor > 1.0);
            if is_lost {
                segment.factor = segment.factor.max(LOST.next_up());
            }
        }
    }

    /// Where it is lost, else where its covariance is enlarged.
    fn findings(&self) -> Option<Problem> {
        let worst = self.ended.iter().map(|segment| segment.factor).fold(1.0, f64::max);
        let is_lost = worst > LOST;
        let least = if is_lost { LOST } else { 1.0 };
        let mut named = self.ended.iter().filter(|segment| segment.factor > least);
        let first = named.next()?;
        let times = significant(worst.sqrt(), 2);
        let finding = if is_lost {
            let text =
                format!("rests or fixes contradict the path by {times} times its σ: not valid");
            Problem::new(Code::Residuals, Severity::Error, text)
        } else {
            Code::Residuals.warning(format!(
                "rests or fixes contradict the path: its σ is enlarged up to {times} times"
            ))
        };
        let until_s = named.next_back().unwrap_or(first).to_s;
        let remedy = "check axes, signs, units and times of the sensors";
        Some(finding.between(first.from_s, until_s).remedy(remedy))
    }
}

/// What is said of a common error of the fixes with these variances, m².
fn correlated(common_m2: [f64; 3]) -> Problem {
    let sd_m = significant(common_m2.iter().sum::<f64>().sqrt(), 2);
    let text = format!(
        "the fixes scatter less than their standard deviations say: an error of ± {sd_m} m that they have in common is allowed for"
    );
    let remedy = "if they have no such error, give the smaller standard deviations";
    Code::Residuals.note(text).remedy(remedy)
}

/// Adds the variances of an error of the position, m².
fn add(point: &mut PathPoint, common_m2: [f64; 3]) {
    for axis in 0..3 {
        point.covariance_m2[axis][axis] += common_m2[axis];
    }
    point.filtered_sd_m = point.filtered_sd_m.hypot(common_m2.iter().sum::<f64>().sqrt());
}

fn scale(point: &mut PathPoint, factor: f64) {
    let root = factor.sqrt();
    point.covariance_m2 = point.covariance_m2.map(|row| row.map(|c| c * factor));
    point.velocity_sd_mps = point.velocity_sd_mps.map(|sd| sd * root);
    point.attitude_sd_rad = point.attitude_sd_rad.map(|sd| sd * root);
    point.filtered_sd_m *= root;
    point.valid &= factor <= LOST;
}
