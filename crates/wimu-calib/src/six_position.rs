//! Calibration from six known orientations: each side of the sensor up once.

use alloc::format;

use wimu_model::{ErrorModel, ErrorTerms};

use crate::estimate::{Misplaced, Residuals};

use crate::placement::MOST_PLACEMENT_RAD;
use crate::pose::mean_temperature;
use crate::terms;
use crate::{
    Covariance, Estimate, Face, Gravity, Method, Parameter, Placement, Pose, Reason, Refusal,
    design, force, input, student,
};

/// Degrees of freedom of the placement error that six sides show.
const PLACEMENT_DOF: usize = 6;

/// Prior standard deviation of the difference between repeated poses of one side, beyond noise and
/// placement, m/s² (chosen on real sensors, see VALIDATION), and its weight in degrees of freedom.
/// The weight decreases to zero at six repeated poses.
const REVISIT_MPS2: f64 = 0.002;
const REVISIT_DOF: f64 = 2.0;
/// 6 / χ² quantile, 6 degrees of freedom, 0.05: upper bound on the true over the observed variance.
const SEEN_AT_MOST: f64 = 3.67;

/// χ² quantiles, 2 degrees of freedom: 0.99 for one pair; 0.995 for one of three pairs. Then the
/// factor on the variance when it is estimated from the other two pairs only.
const PAIR_STANDS_OUT: f64 = 9.2;
const PAIR_MISPLACED: f64 = 12.8;
const OF_FOUR: f64 = 2.7;
/// Smallest ratio of the off-axis readings of two opposite sides that identifies the misplaced one.
const ONE_OF_TWO: f64 = 2.0;

/// Estimates all 12 parameters from poses with one vertical axis each, identified by the dominant
/// component. Equations (18) and (19) of docs/reference/equations.
///
/// `poses` are in m/s² by the nominal sensitivity, sensor axes. Those within 20° of an axis
/// ([`Face::of`]) are used, each of the six sides at least once; several poses of one side are
/// averaged, weighted by their samples. Other poses are not fitted but are included in the
/// residuals. Bias and scale factor of an axis depend on its own pair of sides, where a placement
/// error enters in second order. Misalignments depend on the other pairs, where it enters in first
/// order.
///
/// Swapped or negated axes are not detected here; [`six_position_labelled`] detects them.
///
/// # Errors
/// [`Refusal`] when the poses do not determine the model. Its text says what to do.
pub fn six_position(
    poses: &[Pose],
    gravity: Gravity,
    placement: Placement,
) -> Result<Estimate, Refusal> {
    input::check(poses.iter(), gravity)?;
    let all = poses.iter().map(|pose| (Face::of(pose), pose));
    estimate(all, gravity, placement)
}

/// [`six_position`] for poses with a record of which side was up.
///
/// # Errors
/// [`Refusal`], also when the readings of a pose contradict the recorded side.
pub fn six_position_labelled(
    poses: &[(Face, Pose)],
    gravity: Gravity,
    placement: Placement,
) -> Result<Estimate, Refusal> {
    input::check(poses.iter().map(|(_, pose)| pose), gravity)?;
    check_labels(poses)?;
    let all = poses.iter().map(|(face, pose)| (Some(*face), pose));
    estimate(all, gravity, placement)
}

/// Refuses recorded sides that contradict the readings.
fn check_labels(poses: &[(Face, Pose)]) -> Result<(), Refusal> {
    let Some(index) = poses.iter().position(|(face, pose)| Face::of(pose) != Some(*face)) else {
        return Ok(());
    };
    let (face, first) = poses[index];
    let disagreement = match Face::of(&first) {
        Some(reads) => Refusal::new(
            Reason::Axes,
            format!(
                "a pose recorded as {face} reads {reads}: check which side was up, and that the driver keeps the axes in \
                 order"
            ),
        ),
        None => Refusal::new(
            Reason::Placement { index, steps: 6 },
            format!("a pose recorded as {face} has no axis within 20° of the vertical: repeat it"),
        ),
    };
    // Output for each axis pointing up: a signed permutation, if all poses agree.
    let mut says = [None; 3];
    for (face, pose) in poses {
        let Some(reads) = Face::of(pose) else {
            return Err(disagreement);
        };
        let said = (reads.axis(), reads.sign() * face.sign());
        if *says[face.axis()].get_or_insert(said) != said {
            return Err(disagreement);
        }
    }
    let mut permutation = [[0.0; 3]; 3];
    for (axis, said) in says.into_iter().enumerate() {
        if let Some((row, sign)) = said {
            permutation[row][axis] = sign;
        }
    }
    let [[a, b, c], [d, e, f], [g, h, i]] = permutation;
    if (a, e, i) == (-1.0, -1.0, -1.0) {
        let text = "every axis recorded as up reads down: the output is minus the specific force; negate it, or record \
                    the opposite side";
        return Err(Refusal::new(Reason::Axes, text));
    }
    let determinant = a * (e * i - f * h) - b * (d * i - f * g) + c * (d * h - e * g);
    if determinant >= 0.0 {
        return Err(disagreement);
    }
    let text = "the recorded orientations describe a left-handed sensor: the sides of one axis were exchanged, or the \
                driver negates or swaps an axis";
    Err(Refusal::new(Reason::Axes, text))
}

/// Weighted sums of the poses of one side.
#[derive(Clone, Copy, Default)]
struct Side {
    weight: f64,
    /// Σ w² over the poses.
    weight_squares: f64,
    /// The first pose: sums are of differences from it, to keep their digits.
    origin: Option<[f64; 3]>,
    sum: [f64; 3],
    /// Σ w² times the noise of its mean.
    noise: [f64; 3],
    /// Of the vertical axis, each pose with the same weight: count, sum, and sum of squared
    /// deviations.
    visits: f64,
    upright: f64,
    upright_squares: f64,
}

impl Side {
    /// Adds a pose, or removes it with `sign` −1.
    fn add(&mut self, pose: &Pose, sign: f64) {
        let w = pose.weight();
        self.weight += sign * w;
        self.weight_squares += sign * w * w;
        let mean = pose.mean_mps2;
        let origin = *self.origin.get_or_insert(mean);
        for axis in 0..3 {
            self.sum[axis] += sign * w * (mean[axis] - origin[axis]);
            self.noise[axis] += sign * w * w * pose.noise(axis);
        }
    }

    /// Adds the reading of the vertical axis in one more pose.
    fn visit(&mut self, upright: f64) {
        let before = if self.visits == 0.0 { 0.0 } else { upright - self.upright / self.visits };
        let visits = self.visits + 1.0;
        self.upright_squares += before * before * self.visits / visits;
        self.visits = visits;
        self.upright += upright;
    }

    fn mean(&self) -> [f64; 3] {
        let origin = self.origin.unwrap_or_default();
        core::array::from_fn(|axis| origin[axis] + self.sum[axis] / self.weight)
    }

    /// Variance of the mean from the sensor's noise.
    fn noise_variance(&self) -> [f64; 3] {
        self.noise.map(|n| n / (self.weight * self.weight))
    }

    /// 1 / the number of poses of equal weight with the same variance of the mean.
    fn share(&self) -> f64 {
        self.weight_squares / (self.weight * self.weight)
    }
}

/// The six sides in the order of [`Face::ALL`].
type Sides = [Side; 6];

/// A by rows.
type Matrix = [[f64; 3]; 3];

/// b and A from the six sides: equation (18).
fn solve(sides: &Sides, gravity_mps2: f64) -> ([f64; 3], Matrix) {
    let mut bias = [0.0; 3];
    let mut a = [[0.0; 3]; 3];
    for axis in 0..3 {
        let (up, down) = (sides[2 * axis].mean(), sides[2 * axis + 1].mean());
        bias[axis] = 0.5 * (up[axis] + down[axis]);
        for row in 0..3 {
            a[row][axis] = 0.5 * (up[row] - down[row]) / gravity_mps2;
        }
    }
    (bias, a)
}

fn estimate<'a>(
    poses: impl Iterator<Item = (Option<Face>, &'a Pose)> + Clone,
    gravity: Gravity,
    placement: Placement,
) -> Result<Estimate, Refusal> {
    let used = poses.clone().filter_map(|(face, pose)| Some((face? as usize, pose)));
    let g = gravity.mps2();
    let mut sides = Sides::default();
    let mut counts = [0_usize; 6];
    for (side, pose) in used.clone() {
        sides[side].add(pose, 1.0);
        sides[side].visit(pose.mean_mps2[side / 2]);
        counts[side] += 1;
    }
    let have = counts.iter().filter(|count| **count > 0).count();
    if let Some(missing) = counts.iter().position(|count| *count == 0) {
        let face = Face::ALL[missing];
        let text = format!(
            "no pose has {face}: put the sensor down with {face}, within 20°, and hold it still"
        );
        return Err(Refusal::new(Reason::TooFew { have, need: 6 }, text));
    }
    let (bias, a) = solve(&sides, g);
    let model = ErrorModel::new(ErrorTerms { bias_mps2: bias, matrix: a, ..ErrorTerms::default() })
        .map_err(|error| Refusal::out_of_bounds(error, "an accelerometer"))?;
    let theta = terms::theta_of(&model);
    let shown = pairs_show(&sides, &bias, &a, g);
    let placement_rad = libm::sqrt(shown.iter().sum::<f64>() / PLACEMENT_DOF as f64);
    if placement_rad > MOST_PLACEMENT_RAD {
        let text = format!(
            "the placement error of the six sides is {:.1}°: use a box with square corners, or multi-position, which \
             needs no known orientation",
            placement_rad.to_degrees()
        );
        return Err(Refusal::new(Reason::Placement { index: 0, steps: 6 }, text));
    }
    let Squareness { placement_sd_rad, tilts, contradicted, misplaced } =
        Squareness::of(&sides, &bias, shown, placement, g);
    let revisits = Revisits::of(&sides, &a, g, placement_sd_rad, placement_rad * g);
    let covariance_with = |extra: f64| covariance(&sides, &a, g, tilts, extra);
    let mut covariance = covariance_with(revisits.variance);
    let seen = if contradicted { PLACEMENT_DOF as f64 } else { f64::INFINITY };
    let interval_dof = revisits.interval_dof(&covariance, &covariance_with(0.0)).min(seen);
    let worst_sd_mps2 = force::worst_sd(&theta, &covariance, g);
    covariance.add_gravity(&theta, gravity);

    let all = poses.clone().map(|(_, pose)| pose);
    let residuals = Residuals::of(&theta, all, g);
    let rejected =
        (0..).zip(poses).filter(|(_, (face, _))| face.is_none()).map(|(k, _)| k).collect();
    let fitted: usize = counts.iter().sum();
    let has_others = counts.iter().all(|&count| count > 1);
    let loo_rms_mps2 = has_others.then(|| left_out(used.clone(), &sides, fitted, g));
    let method = Method::SixPosition {
        placement_sd_rad,
        declared_sd_rad: placement.sd_rad(),
        misplaced,
        revisit_sd_mps2: libm::sqrt(revisits.variance),
        revisits: revisits.seen,
        unexplained: revisits.unexplained,
    };
    Ok(Estimate {
        covariance,
        poses: fitted,
        orientations: 6,
        dof: 3 * fitted - Parameter::COUNT,
        interval_dof: Some(interval_dof).filter(|dof| dof.is_finite()),
        loo_rms_mps2,
        rejected,
        worst_sd_mps2,
        coverage: design::coverage(&sides.map(|side| Pose::from_mean(side.mean()))),
        temperature_c: mean_temperature(used.map(|(_, pose)| pose)),
        ..Estimate::orthogonal(model, method, gravity, &residuals)
    })
}

/// Leave-one-out error over the `fitted` poses, m/s² rms.
fn left_out<'a>(
    used: impl Iterator<Item = (usize, &'a Pose)>,
    sides: &Sides,
    fitted: usize,
    gravity_mps2: f64,
) -> f64 {
    let residual = |(side, pose): (usize, &Pose)| {
        let mut others = *sides;
        others[side].add(pose, -1.0);
        let (bias, a) = solve(&others, gravity_mps2);
        force::residual(&terms::theta(bias, a), pose, gravity_mps2)
    };
    let squares: f64 = used.map(residual).map(|left| left * left).sum();
    libm::sqrt(squares / fitted as f64)
}

/// The squared placement error that each pair of sides shows in two degrees of freedom, rad²: the
/// mean of the two off-axis readings differs from the bias by the tilts.
fn pairs_show(sides: &Sides, bias: &[f64; 3], a: &Matrix, gravity_mps2: f64) -> [f64; 3] {
    core::array::from_fn(|axis| {
        let (up, down) = (&sides[2 * axis], &sides[2 * axis + 1]);
        let others = (0..3).filter(|&other| other != axis);
        others.fold(0.0, |squares, other| {
            let middle = 0.5 * (up.mean()[other] + down.mean()[other]);
            let tilt = (middle - bias[other]) / (a[other][other] * gravity_mps2);
            squares + tilt * tilt / pair_share(sides, axis)
        })
    })
}

/// Variance of the mean tilt of a pair, relative to the variance of one tilt.
fn pair_share(sides: &Sides, axis: usize) -> f64 {
    0.25 * (sides[2 * axis].share() + sides[2 * axis + 1].share())
}

/// Placement error: equation (19).
struct Squareness {
    /// Standard deviation, without a pair that is an outlier, rad.
    placement_sd_rad: f64,
    /// Standard deviation used in the covariance for the pair of each axis, rad.
    tilts: [f64; 3],
    /// Whether the poses contradict the declared placement error.
    contradicted: bool,
    misplaced: Option<Misplaced>,
}

impl Squareness {
    /// From the squared placement error of each pair, rad².
    fn of(sides: &Sides, bias: &[f64; 3], shown: [f64; 3], placement: Placement, g: f64) -> Self {
        let declared = placement.sd_rad() * placement.sd_rad();
        let all: f64 = shown.iter().sum();
        let worst = (1..3).fold(0, |worst, k| if shown[k] > shown[worst] { k } else { worst });
        let others = all - shown[worst];
        // The declared value is used unless the poses contradict it significantly.
        let dof = PLACEMENT_DOF - 2;
        let others_bad = others > student::chi_squared_half_percent(dof) * declared;
        let all_bad = all > student::chi_squared_half_percent(PLACEMENT_DOF) * declared;
        let usual = if others_bad { OF_FOUR * others / dof as f64 } else { declared };
        let stands_out = |axis: usize| shown[axis] > PAIR_STANDS_OUT * usual;
        let misplaced = (shown[worst] > PAIR_MISPLACED * usual)
            .then(|| Misplaced::of(sides, bias, worst, shown[worst], g));
        let variance = if others_bad || (all_bad && !stands_out(worst)) {
            all / PLACEMENT_DOF as f64
        } else {
            declared
        };
        let tilts = [0, 1, 2].map(|axis| {
            let share = pair_share(sides, axis);
            let one_side = (shown[axis] + variance) / (2.0 * libm::sqrt(share));
            let tilt = if stands_out(axis) { one_side.max(variance) } else { variance };
            libm::sqrt(tilt)
        });
        Self {
            placement_sd_rad: libm::sqrt(variance),
            tilts,
            contradicted: all_bad || misplaced.is_some(),
            misplaced,
        }
    }
}

impl Misplaced {
    fn of(sides: &Sides, bias: &[f64; 3], axis: usize, shown: f64, g: f64) -> Self {
        let off = |side: usize| {
            let mean = sides[side].mean();
            let others = (0..3).filter(|&other| other != axis);
            let squares = others.fold(0.0, |sum, other| {
                let off = mean[other] - bias[other];
                sum + off * off
            });
            libm::sqrt(squares) / g
        };
        let (up, down) = (off(2 * axis), off(2 * axis + 1));
        let side = 2 * axis + usize::from(down > up);
        Self {
            face: Face::ALL[side],
            or_opposite: up.max(down) < ONE_OF_TWO * up.min(down),
            // Twice the mean of the pair.
            tilt_rad: 2.0 * libm::sqrt(shown * pair_share(sides, axis)),
        }
    }
}

/// Variance between repeated poses of a side, beyond noise and placement: equation (19).
struct Revisits {
    /// (m/s²)².
    variance: f64,
    /// Degrees of freedom, including those of the prior.
    dof: f64,
    /// Poses beyond the first of each side.
    seen: usize,
    /// Whether they differ by more than noise and placement explain.
    unexplained: bool,
}

impl Revisits {
    /// Fewest degrees of freedom of a bias or scale factor, whose covariance without the variance between poses is `known`.
    fn interval_dof(&self, all: &Covariance, known: &Covariance) -> f64 {
        let dof_of = |parameter: Parameter| {
            let variance = all.get(parameter, parameter);
            let share = (variance - known.get(parameter, parameter)) / variance;
            if share > 0.0 { self.dof / (share * share) } else { f64::INFINITY }
        };
        let diagonal = Parameter::BIAS.into_iter().chain(Parameter::SCALE);
        diagonal.map(dof_of).fold(f64::INFINITY, f64::min)
    }

    fn of(sides: &Sides, a: &Matrix, g: f64, placement_rad: f64, seen_mps2: f64) -> Self {
        let tilt = placement_rad * placement_rad;
        let sixth = 1.0 / 6.0;
        let (mut squares, mut dof) = (0.0, 0.0);
        let mut explained = 0.0;
        for (index, side) in sides.iter().enumerate() {
            let axis = index / 2;
            let across = (0..3).fold(0.0, |sum, other| {
                let by = if other == axis { tilt } else { 1.0 };
                sum + by * a[axis][other] * a[axis][other]
            });
            let own = side.noise_variance()[axis] / side.share();
            squares += side.upright_squares;
            dof += side.visits - 1.0;
            explained += (own + g * g * tilt * across) * sixth;
        }
        let usual = REVISIT_MPS2 * REVISIT_MPS2;
        let taken = usual.min(SEEN_AT_MOST * seen_mps2 * seen_mps2);
        let beyond = (squares - dof * explained).max(0.0);
        let seen = dof as usize;
        let more = (REVISIT_DOF * (1.0 - dof * sixth)).max(0.0);
        let most = student::chi_squared_half_percent(seen.max(1)) * explained;
        Self {
            variance: (beyond + more * taken) / (dof + more),
            dof: dof + more,
            seen,
            unexplained: seen > 0 && squares > most,
        }
    }
}

/// Covariance from the placement error of each pair, the noise, and `revisit`, the variance between
/// repeated poses: equation (19).
fn covariance(
    sides: &Sides,
    a: &Matrix,
    g: f64,
    placement_rad: [f64; 3],
    revisit: f64,
) -> Covariance {
    let mut covariance = Covariance::ZERO;
    for axis in 0..3 {
        let tilt = placement_rad[axis] * placement_rad[axis];
        // Covariance of two components of the mean output of a side. A tilt adds the other two
        // columns of A in first order and shortens this one in second order.
        let of = |side: &Side, r: usize, c: usize| {
            let across = (0..3).filter(|&other| other != axis);
            let first = across.fold(0.0, |sum, other| sum + a[r][other] * a[c][other]);
            let second = tilt * a[r][axis] * a[c][axis];
            let noise =
                if r == c { side.noise_variance()[r] + revisit * side.share() } else { 0.0 };
            tilt * (first + second) * g * g * side.share() + noise
        };
        let (up, down) = (&sides[2 * axis], &sides[2 * axis + 1]);
        let both = |r, c| of(up, r, c) + of(down, r, c);
        let bias = Parameter::ALL[axis];
        covariance.add(bias, bias, 0.25 * both(axis, axis));
        for r in 0..3 {
            let row = Parameter::ALL[3 + 3 * r + axis];
            let cross = 0.25 * (of(up, axis, r) - of(down, axis, r)) / g;
            covariance.add(bias, row, cross);
            covariance.add(row, bias, cross);
            for c in 0..3 {
                let column = Parameter::ALL[3 + 3 * c + axis];
                // Both sides are shortened: a systematic error that does not average out.
                let shortened = tilt * tilt * a[r][axis] * a[c][axis];
                let spread = 0.25 * both(r, c) / (g * g);
                covariance.add(row, column, spread + shortened);
            }
        }
    }
    covariance
}
