//! Calibration from six known orientations: each side of the sensor up once.

use alloc::format;

use wimu_model::{ErrorModel, ErrorTerms};

use crate::estimate::Residuals;
use crate::placement::MOST_PLACEMENT_RAD;
use crate::pose::mean_temperature;
use crate::terms;
use crate::{
    Covariance, Estimate, Face, Gravity, Method, Parameter, Placement, Pose, Reason, Refusal,
    force, input, student,
};

/// Degrees of freedom of the placement error that six sides show.
const PLACEMENT_DOF: usize = 6;
/// Prior of the variance between visits of one side: 2 mm/s², 1 σ (chosen on real sensors, see VALIDATION), and its
/// degrees of freedom.
const REVISIT_MPS2: f64 = 0.002;
const REVISIT_DOF: f64 = 2.0;

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
    /// Of the vertical axis, each pose with the same weight: count, sum and sum of squared differences from the first pose.
    visits: f64,
    upright: f64,
    upright_squares: f64,
}

impl Side {
    /// Adds a pose in which `axis` is vertical.
    fn add(&mut self, pose: &Pose, axis: usize) {
        let w = pose.weight();
        self.weight += w;
        self.weight_squares += w * w;
        let mean = pose.mean_mps2;
        let origin = *self.origin.get_or_insert(mean);
        for axis in 0..3 {
            self.sum[axis] += w * (mean[axis] - origin[axis]);
            self.noise[axis] += w * w * pose.noise(axis);
        }
        let upright = mean[axis] - origin[axis];
        self.visits += 1.0;
        self.upright += upright;
        self.upright_squares += upright * upright;
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

    /// Sum of squared deviations of the vertical axis from its mean over the visits, (m/s²)².
    fn revisit_squares(&self) -> f64 {
        (self.upright_squares - self.upright * self.upright / self.visits).max(0.0)
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
    let used = poses.clone().filter_map(|(face, pose)| Some((face?, pose)));
    let g = gravity.mps2();
    let mut sides = Sides::default();
    for (face, pose) in used.clone() {
        sides[face as usize].add(pose, face.axis());
    }
    if let Some(face) = Face::ALL.into_iter().find(|face| sides[*face as usize].visits == 0.0) {
        let have = sides.iter().filter(|side| side.visits > 0.0).count();
        let text = format!(
            "no pose has {face}: put the sensor down with {face}, within 20°, and hold it still"
        );
        return Err(Refusal::new(Reason::TooFew { have, need: 6 }, text));
    }
    let (bias, a) = solve(&sides, g);
    let model = ErrorModel::new(ErrorTerms { bias_mps2: bias, matrix: a, ..ErrorTerms::default() })
        .map_err(|error| Refusal::out_of_bounds(error, "an accelerometer"))?;
    let theta = terms::theta_of(&model);
    let shown = placement_squares(&sides, &bias, &a, g);
    let shown_rad = libm::sqrt(shown / PLACEMENT_DOF as f64);
    if shown_rad > MOST_PLACEMENT_RAD {
        return Err(not_square(shown_rad));
    }
    // The declared value is used unless the poses contradict it significantly.
    let declared = placement.sd_rad() * placement.sd_rad();
    let contradicted = shown > student::chi_squared_half_percent(PLACEMENT_DOF) * declared;
    let placement_sd_rad = if contradicted { shown_rad } else { placement.sd_rad() };
    let visits: f64 = sides.iter().map(|side| side.visits).sum();
    let squares: f64 = sides.iter().map(Side::revisit_squares).sum();
    let revisit_dof = visits - 6.0 + REVISIT_DOF;
    let revisit = (squares + REVISIT_DOF * REVISIT_MPS2 * REVISIT_MPS2) / revisit_dof;
    let covariance_with = |revisit: f64| covariance(&sides, &a, g, placement_sd_rad, revisit);
    let mut covariance = covariance_with(revisit);
    let mut interval_dof = interval_dof(revisit_dof, &covariance, &covariance_with(0.0));
    if contradicted {
        interval_dof = interval_dof.min(PLACEMENT_DOF as f64);
    }
    let worst_sd_mps2 = force::worst_sd(&theta, &covariance, g);
    covariance.add_gravity(&theta, gravity);

    let all = poses.clone().map(|(_, pose)| pose);
    let residuals = Residuals::of(&theta, all, g);
    let rejected =
        (0..).zip(poses).filter(|(_, (face, _))| face.is_none()).map(|(k, _)| k).collect();
    let method = Method::SixPosition {
        placement_sd_rad,
        declared_sd_rad: placement.sd_rad(),
        revisit_sd_mps2: libm::sqrt(revisit),
        revisits: visits as usize - 6,
    };
    Ok(Estimate {
        covariance,
        poses: visits as usize,
        orientations: 6,
        dof: 3 * visits as usize - Parameter::COUNT,
        interval_dof: Some(interval_dof),
        rejected,
        worst_sd_mps2,
        temperature_c: mean_temperature(used.map(|(_, pose)| pose)),
        ..Estimate::orthogonal(model, method, gravity, &residuals)
    })
}

fn not_square(shown_rad: f64) -> Refusal {
    let text = format!(
        "the placement error of the six sides is {:.1}°: use a box with square corners, or multi-position, which needs no \
         known orientation",
        shown_rad.to_degrees()
    );
    Refusal::new(Reason::Placement { index: 0, steps: 6 }, text)
}

/// Sum of the squared placement errors that the pairs of sides show, two degrees of freedom each, rad²: the mean of the two
/// off-axis readings differs from the bias by the tilts.
fn placement_squares(sides: &Sides, bias: &[f64; 3], a: &Matrix, gravity_mps2: f64) -> f64 {
    let mut squares = 0.0;
    for axis in 0..3 {
        let (up, down) = (&sides[2 * axis], &sides[2 * axis + 1]);
        // Variance of the mean tilt of the pair, relative to that of one tilt.
        let share = 0.25 * (up.share() + down.share());
        for other in (0..3).filter(|&other| other != axis) {
            let middle = 0.5 * (up.mean()[other] + down.mean()[other]);
            let tilt = (middle - bias[other]) / (a[other][other] * gravity_mps2);
            squares += tilt * tilt / share;
        }
    }
    squares
}

/// Fewest degrees of freedom of a bias or scale factor, of whose covariance `all` the part beyond `known` has `dof`.
fn interval_dof(dof: f64, all: &Covariance, known: &Covariance) -> f64 {
    let dof_of = |parameter: Parameter| {
        let variance = all.get(parameter, parameter);
        let share = (variance - known.get(parameter, parameter)) / variance;
        dof / (share * share)
    };
    let diagonal = Parameter::BIAS.into_iter().chain(Parameter::SCALE);
    diagonal.map(dof_of).fold(f64::INFINITY, f64::min)
}

/// Covariance from the placement error, the noise, and `revisit`, the variance between repeated poses: equation (19).
fn covariance(sides: &Sides, a: &Matrix, g: f64, placement_rad: f64, revisit: f64) -> Covariance {
    let mut covariance = Covariance::ZERO;
    let tilt = placement_rad * placement_rad;
    for axis in 0..3 {
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
