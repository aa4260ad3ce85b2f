//! Test of the residuals for a change of the sensor during the session: equation (43a).

use nalgebra::{DMatrix, DVector};
use wimu_calib::{Estimate, Method, POSE_SCATTER_DOF, POSE_SCATTER_MPS2, Pose, Term};
use wimu_model::STANDARD_GRAVITY_MPS2 as G;

use super::magnitude;
use super::poses::same_orientation;
use crate::{Code, Problem};

/// Probability of a finding in a session without a change, for drifts: a cold start is more frequent than a step.
const FALSE_ALARM_DRIFT: f64 = 0.006;
/// The same for steps.
const FALSE_ALARM_STEP: f64 = 0.002;
/// Fewest poses before and after a step.
const MIN_SIDE: usize = 3;
/// Largest number of times at which a step is tested.
const MAX_TIMES: usize = 100;
/// Time constants of a drift, fractions of the session: of a warm-up, and linear.
const TIME_CONSTANTS: [f64; 2] = [0.3, f64::INFINITY];
/// Smallest residual that is tested, m/s²: of data without noise, the rounding is not a drift.
const FLOOR_MPS2: f64 = 1e-4;
/// A column with a smaller fraction independent of the others is not tested: of an exponential beside a line 0.01 is.
const MIN_INDEPENDENT: f64 = 0.001;

#[derive(Clone, Copy, PartialEq)]
enum Kind {
    /// Of the bias.
    Drift,
    /// Of the bias, or with the scale factor and misalignments, of an axis.
    Bias(usize),
    /// Of the scale factor of an axis.
    Gain(usize),
    /// Of the sign of an axis.
    Sign(usize),
}

/// A change that explains the residuals.
#[derive(Clone, Copy)]
struct Change {
    kind: Kind,
    /// First pose after a step.
    after: usize,
    /// m/s², or relative for a scale factor; the largest component.
    size: f64,
    /// Bayesian information criterion; lower is better.
    score: f64,
}

/// Most likely change of the sensor during the session, if there is a significant one. `refit` is the fit of other poses;
/// `since_start_s` the time of a pose, s since the start of the data.
pub(super) fn finding(
    poses: &[Pose],
    estimate: &Estimate,
    refit: impl Fn(&[Pose]) -> Option<Estimate>,
    since_start_s: impl Fn(&Pose) -> f64,
) -> Option<Problem> {
    // A model that violates a bound explains the residuals already.
    if !matches!(estimate.method, Method::MultiPosition(_)) || estimate.beyond_bounds.is_some() {
        return None;
    }
    let rejected = &estimate.rejected;
    let all = rejected.is_empty();
    // A step may have caused the rejection of the poses beyond it.
    let of = |all| Rows::new(poses, estimate, all).and_then(|rows| Some((rows.change()?, rows)));
    let beyond_step = rejected.len() >= MIN_SIDE;
    let (mut change, rows) = of(all).or_else(|| of(true).filter(|_| beyond_step))?;
    let after_s = rows.time_s.get(change.after).copied().unwrap_or(0.0);
    if let Kind::Bias(axis) = change.kind {
        let flipped = |pose: &Pose| {
            let mut pose = *pose;
            if pose.time_s >= after_s {
                pose.mean_mps2[axis] = -pose.mean_mps2[axis];
            }
            pose
        };
        let flipped: Vec<Pose> = poses.iter().map(flipped).collect();
        let better = refit(&flipped).is_some_and(|fit| {
            let squares = fit.fitted_rms_mps2.powi(2) * fit.poses as f64;
            fit.rejected.len() <= rejected.len() && rows.score(squares, 1) < change.score
        });
        if better {
            change.kind = Kind::Sign(axis);
        }
    }
    let ends = [change.after.saturating_sub(1), change.after].map(|k| rows.poses[k]);
    let ends = match change.kind {
        Kind::Drift => [rows.poses[0], *rows.poses.last()?],
        _ => ends,
    };
    let [from_s, to_s] = ends.map(|k| since_start_s(&poses[k]));
    Some(described(&change, estimate.terms.contains(Term::Drift)).between(from_s, to_s))
}

fn described(change: &Change, drift_fitted: bool) -> Problem {
    let name = |axis: usize| ["X", "Y", "Z"][axis];
    let (mm, percent) = (change.size * 1e3, change.size * 1e2);
    let what = match change.kind {
        Kind::Drift if drift_fitted => {
            let text = "the bias drift was not linear, as during warm-up: the error of the bias at the end exceeds its \
                        interval";
            return Code::Drift.warning(text).remedy(
                "record again when the sensor is warm, or with its temperature and --model auto+temperature",
            );
        }
        Kind::Drift => {
            let text = format!("the bias drifted by {:.0} mm/s²", mm.abs());
            let remedy = "use --model 9+drift, or record again when the sensor is warm";
            return Code::Drift.warning(text).remedy(remedy);
        }
        Kind::Bias(axis) => format!("the bias of {} changed by {mm:+.0} mm/s²", name(axis)),
        Kind::Gain(axis) => {
            format!("the scale factor of {} changed by {percent:+.1} %", name(axis))
        }
        Kind::Sign(axis) => format!("the sign of {} changed", name(axis)),
    };
    let finding = Code::Step.warning(what + " between two poses");
    finding.remedy(
        "calibrate the poses before and after it separately; check the mounting and the driver",
    )
}

/// The poses in the order of time, with the derivatives of their residuals.
struct Rows {
    /// Index of the (first) pose of a row.
    poses: Vec<usize>,
    time_s: Vec<f64>,
    up: Vec<[f64; 3]>,
    /// Square root of the weight.
    root: Vec<f64>,
    /// Orthonormal basis of the derivatives by the fitted parameters, weighted.
    basis: DMatrix<f64>,
    /// Weighted residuals, less their projections on the basis.
    left: DVector<f64>,
}

impl Rows {
    /// `None` where the poses have no times or do not exceed the parameters.
    fn new(poses: &[Pose], estimate: &Estimate, all: bool) -> Option<Self> {
        let mut order: Vec<usize> =
            (0..poses.len()).filter(|k| all || !estimate.rejected.contains(k)).collect();
        order.sort_by(|a, b| poses[*a].time_s.total_cmp(&poses[*b].time_s));
        // Poses of one orientation in succession share an error (42b): the first of them stands for all.
        order.dedup_by(|next, pose| same_orientation(&poses[*pose], &poses[*next]));
        let pose = |row: usize| &poses[order[row]];
        let (first_s, last_s) = (pose(0).time_s, poses[*order.last()?].time_s);
        let reference_c = estimate.temperature_c.unwrap_or(0.0);
        let count = order.len();
        let residuals: Vec<f64> = (0..count).map(|row| estimate.residual_mps2(pose(row))).collect();
        let noise: Vec<f64> = (0..count).map(|row| noise(pose(row))).collect();
        let common = estimate.pose_sd_mps2.powi(2);
        let mean_noise = noise.iter().sum::<f64>() / count as f64;
        let root = |row: usize| ((common + mean_noise) / (common + noise[row])).sqrt();
        let bias = estimate.model.terms().bias_mps2;
        let up = |row: usize| {
            let y = pose(row).mean_mps2;
            let f = [0, 1, 2].map(|axis| y[axis] - bias[axis]);
            f.map(|f_axis| f_axis / magnitude(f).max(f64::MIN_POSITIVE))
        };
        let columns = |row: usize| {
            let [x, y, z] = up(row);
            let progress = (pose(row).time_s - first_s) / (last_s - first_s);
            let warmer = pose(row).temperature_c.unwrap_or(reference_c) - reference_c;
            let mut columns = vec![x, y, z, x * x, y * y, z * z, x * y, x * z, y * z];
            for term in estimate.terms.iter() {
                columns.extend([x, y, z].map(|c| match term {
                    Term::Drift => c * progress,
                    Term::BiasTemperature => c * warmer,
                    Term::ScaleTemperature => c * c * warmer,
                    Term::Quadratic => c * c * c,
                }));
            }
            columns
        };
        let parameters = columns(0).len();
        if !(last_s > first_s && count > parameters + 1) {
            return None;
        }
        let root: Vec<f64> = (0..count).map(root).collect();
        let rows: Vec<f64> = (0..count)
            .flat_map(|row| columns(row).into_iter().map(move |c| (row, c)))
            .map(|(row, c)| c * root[row])
            .collect();
        let residuals = DVector::from_fn(count, |row, _| residuals[row] * root[row]);
        let fitted = DMatrix::from_row_slice(count, parameters, &rows).qr();
        let diagonal = fitted.r().diagonal();
        if diagonal.amin() <= 1e-3 * diagonal.amax() {
            return None;
        }
        let basis = fitted.q();
        let left = &residuals - &basis * basis.tr_mul(&residuals);
        Some(Self {
            time_s: (0..count).map(|row| pose(row).time_s).collect(),
            up: (0..count).map(up).collect(),
            poses: order,
            root,
            basis,
            left,
        })
    }

    /// The significant change of the least score.
    fn change(&self) -> Option<Change> {
        let count = self.poses.len();
        let (first_s, last_s) = (self.time_s[0], self.time_s[count - 1]);
        let mut found: Vec<Option<Change>> = Vec::new();
        let alone = FALSE_ALARM_DRIFT / TIME_CONSTANTS.len() as f64;
        for time_constant in TIME_CONSTANTS {
            let shape = |row: usize| {
                let progress = (self.time_s[row] - first_s) / (last_s - first_s);
                match time_constant.is_finite() {
                    true => 1.0 - (-progress / time_constant).exp(),
                    false => progress,
                }
            };
            let column = |row: usize, axis: usize| self.up[row][axis] * shape(row);
            found.push(self.tested(Kind::Drift, 0, 3, column, alone));
        }
        let last = count.checked_sub(MIN_SIDE)?;
        let times: Vec<usize> = (MIN_SIDE..=last).step_by(count.div_ceil(MAX_TIMES)).collect();
        let alone = FALSE_ALARM_STEP / (9 * times.len()) as f64;
        for after in times {
            let late = |row: usize| f64::from(u8::from(row >= after));
            for axis in 0..3 {
                let up =
                    |row: usize, other: usize| self.up[row][axis] * self.up[row][other] * late(row);
                let bias = |row: usize, _: usize| self.up[row][axis] * late(row);
                let gain = |row: usize, _: usize| G * up(row, axis);
                // A changed sign is a step of the bias and of the misalignments.
                let sign = |row: usize, c: usize| match c {
                    0 => bias(row, 0),
                    c => G * up(row, (axis + c) % 3),
                };
                found.push(self.tested(Kind::Bias(axis), after, 1, bias, alone));
                found.push(self.tested(Kind::Gain(axis), after, 1, gain, alone));
                found.push(self.tested(Kind::Bias(axis), after, 3, sign, alone));
            }
        }
        (found.into_iter().flatten()).min_by(|a, b| a.score.total_cmp(&b.score))
    }

    /// The change whose derivatives are `column(row, k)`, if Fisher's variance ratio has a probability below
    /// `false_alarm` without it.
    fn tested(
        &self,
        kind: Kind,
        after: usize,
        columns: usize,
        column: impl Fn(usize, usize) -> f64,
        false_alarm: f64,
    ) -> Option<Change> {
        let count = self.poses.len();
        let whole = DMatrix::from_fn(count, columns, |row, c| self.root[row] * column(row, c));
        let own = &whole - &self.basis * self.basis.tr_mul(&whole);
        let normal = own.tr_mul(&own).cholesky()?;
        let pivots = normal.l_dirty().diagonal();
        let independent =
            |c: usize| pivots[c] * pivots[c] > MIN_INDEPENDENT * whole.column(c).norm_squared();
        if !(0..columns).all(independent) {
            return None;
        }
        let right = own.tr_mul(&self.left);
        let sizes = normal.solve(&right);
        let gain = sizes.dot(&right);
        let freedom = count.checked_sub(self.basis.ncols() + columns).filter(|f| *f > 0)?;
        let rest = (self.left.norm_squared() - gain).max(0.0);
        let located = usize::from(after > 0);
        // The many hypotheses of a step need the scatter that sensors have. It would hide the drift of those with less.
        let chance = match kind {
            Kind::Drift => {
                let floor = freedom as f64 * FLOOR_MPS2 * FLOOR_MPS2;
                fisher_tail(gain / (rest + floor), columns, freedom)
            }
            _ => fisher_tail(gain / with_prior(rest), columns, freedom + POSE_SCATTER_DOF),
        };
        let largest = |a: f64, b: &f64| if b.abs() > a.abs() { *b } else { a };
        (chance < false_alarm).then(|| Change {
            kind,
            after,
            size: match kind {
                Kind::Drift => sizes.iter().fold(0.0, largest),
                _ => sizes[0],
            },
            score: self.score(rest, columns + located),
        })
    }

    /// Bayesian information criterion of `parameters` beyond the fitted ones that leave `squares`, (m/s²)².
    fn score(&self, squares: f64, parameters: usize) -> f64 {
        let count = self.poses.len() as f64;
        (count + POSE_SCATTER_DOF as f64) * with_prior(squares).ln()
            + parameters as f64 * count.ln()
    }
}

/// Variance of the mean of a pose from white noise, (m/s²)²; 0 if it is unknown.
fn noise(pose: &Pose) -> f64 {
    let squares: f64 = pose.sd_mps2.iter().map(|sd| sd * sd).sum();
    squares / (3.0 * f64::from(pose.samples.max(1)))
}

/// A sum of squares with that of the prior, (m/s²)².
fn with_prior(squares: f64) -> f64 {
    squares + POSE_SCATTER_DOF as f64 * POSE_SCATTER_MPS2 * POSE_SCATTER_MPS2
}

/// Probability that the ratio of two sums of squares with `a` and `b` degrees of freedom exceeds `ratio`: the regularised
/// incomplete beta function of b/2, a/2 by its power series (DLMF 8.17.8).
fn fisher_tail(ratio: f64, a: usize, b: usize) -> f64 {
    let x = 1.0 / (1.0 + ratio);
    let [p, q] = [b, a].map(|freedom| 0.5 * freedom as f64);
    let mut term = 1.0;
    let mut sum = 1.0;
    for k in 0..1000 {
        term *= (p + q + f64::from(k)) / (p + 1.0 + f64::from(k)) * x;
        sum += term;
        if term < 1e-9 * sum {
            break;
        }
    }
    let ln_beta = ln_gamma_of_half(a) + ln_gamma_of_half(b) - ln_gamma_of_half(a + b);
    (p * x.ln() + q * (1.0 - x).ln() - ln_beta).exp() / p * sum
}

/// ln Γ(n/2).
fn ln_gamma_of_half(n: usize) -> f64 {
    let begin = if n % 2 == 1 { 0.5 * std::f64::consts::PI.ln() } else { 0.0 };
    let factors = (2 - n % 2..n).step_by(2);
    begin + factors.map(|m| (0.5 * m as f64).ln()).sum::<f64>()
}
