//! Calibration from six known orientations: each side of the sensor up once.

use alloc::format;
use alloc::vec::Vec;

use wimu_model::{CalibrationMethod, ErrorModel, ErrorTerms};

use crate::estimate::Residuals;
use crate::placement::MOST_PLACEMENT_RAD;
use crate::pose::mean_temperature;
use crate::terms;
use crate::{
    Covariance, Estimate, Face, Gravity, Parameter, Placement, Pose, Reason, Refusal, Sides, force,
    input, student,
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
/// `sides` is the record of which side was up in each pose, if there is one: without it, swapped or negated axes are not
/// detected.
///
/// # Errors
/// [`Refusal`] when the poses do not determine the model, or contradict the recorded sides. Its text says what to do.
pub fn six_position(
    poses: &[Pose],
    sides: Option<&[Face]>,
    gravity: Gravity,
    placement: Placement,
) -> Result<Estimate, Refusal> {
    input::check(poses.iter(), gravity)?;
    check_labels(poses, sides.unwrap_or_default())?;
    estimate(poses, gravity, placement)
}

/// Refuses recorded sides that contradict the readings.
fn check_labels(poses: &[Pose], sides: &[Face]) -> Result<(), Refusal> {
    let read = || sides.iter().zip(poses.iter().map(Face::of));
    let mut wrong = (0..).zip(read()).filter(|(_, (face, reads))| *reads != Some(**face));
    let Some((index, (face, reads))) = wrong.next() else { return Ok(()) };
    let Some(reads) = reads else {
        let text =
            format!("a pose recorded as {face} has no axis within 20° of the vertical: repeat it");
        return Err(Refusal::new(Reason::Placement { index, steps: 6 }, text));
    };
    let is_negated = |(face, reads): (&Face, Option<Face>)| {
        reads.is_some_and(|reads| reads.axis() == face.axis() && reads != *face)
    };
    let text = if read().all(is_negated) {
        "every axis recorded as up reads down: the output is minus the specific force; negate it, or record the opposite \
         side"
            .into()
    } else {
        format!(
            "a pose recorded as {face} reads {reads}: check which side was up, and that the driver keeps the axes in order"
        )
    };
    Err(Refusal::new(Reason::Axes, text))
}

/// A pose of a side and its factors in the bias of the vertical axis, and in its column of A, 1/(m/s²): equation (18).
struct Used<'a> {
    pose: &'a Pose,
    axis: usize,
    of_bias: f64,
    of_column: f64,
}

/// Poses of one side are averaged, weighted by their samples; both sides of an axis count alike.
fn factors<'a>(poses: &[(Face, &'a Pose)], g: f64) -> Vec<Used<'a>> {
    let of_pose = |&(face, pose): &(Face, &'a Pose)| {
        let same = poses.iter().filter(|(other, _)| *other == face);
        let of_bias = 0.5 * pose.weight() / same.map(|(_, pose)| pose.weight()).sum::<f64>();
        Used { pose, axis: face.axis(), of_bias, of_column: face.sign() * of_bias / g }
    };
    poses.iter().map(of_pose).collect()
}

/// A by rows.
type Matrix = [[f64; 3]; 3];

/// b and A.
fn solve(used: &[Used<'_>], start: &Pose) -> ([f64; 3], Matrix) {
    let (mut bias, mut a) = ([0.0; 3], [[0.0; 3]; 3]);
    for Used { pose, axis, of_bias, of_column } in used {
        // Differences from one pose keep their digits.
        let y = |row: usize| pose.mean_mps2[row] - start.mean_mps2[row];
        bias[*axis] += of_bias * y(*axis);
        for row in 0..3 {
            a[row][*axis] += of_column * y(row);
        }
    }
    ([0, 1, 2].map(|axis: usize| bias[axis] + start.mean_mps2[axis]), a)
}

fn estimate(poses: &[Pose], gravity: Gravity, placement: Placement) -> Result<Estimate, Refusal> {
    let placed: Vec<_> = poses.iter().filter_map(|pose| Some((Face::of(pose)?, pose))).collect();
    let g = gravity.mps2();
    let missing =
        Face::ALL.into_iter().filter(|face| placed.iter().all(|(placed, _)| placed != face));
    if let Some(face) = missing.clone().next() {
        let have = 6 - missing.count();
        let text = format!(
            "no pose has {face}: put the sensor down with {face}, within 20°, and hold it still"
        );
        return Err(Refusal::new(Reason::TooFew { have, need: 6 }, text));
    }
    let used = factors(&placed, g);
    let (bias, a) = solve(&used, placed[0].1);
    let model = ErrorModel::new(ErrorTerms { bias_mps2: bias, matrix: a, ..ErrorTerms::default() })
        .map_err(|error| Refusal::out_of_bounds(error, "an accelerometer"))?;
    let theta = terms::theta_of(&model);
    let shown = placement_squares(&used, &bias, &a, g);
    let shown_rad = libm::sqrt(shown / PLACEMENT_DOF as f64);
    if shown_rad > MOST_PLACEMENT_RAD {
        return Err(not_square(shown_rad));
    }
    // The declared value is used unless the poses contradict it significantly.
    let declared = placement.sd_rad() * placement.sd_rad();
    let contradicted = shown > student::chi_squared_half_percent(PLACEMENT_DOF) * declared;
    let placement_sd_rad = if contradicted { shown_rad } else { placement.sd_rad() };
    let visits = placed.len();
    let squares: f64 = Face::ALL.into_iter().map(|face| revisit_squares(&placed, face)).sum();
    let revisit_dof = visits as f64 - 6.0 + REVISIT_DOF;
    let revisit = (squares + REVISIT_DOF * REVISIT_MPS2 * REVISIT_MPS2) / revisit_dof;
    let covariance_with = |revisit: f64| covariance(&used, &a, g, placement_sd_rad, revisit);
    let mut covariance = covariance_with(revisit);
    let mut interval_dof = interval_dof(revisit_dof, &covariance, &covariance_with(0.0));
    if contradicted {
        interval_dof = interval_dof.min(PLACEMENT_DOF as f64);
    }
    let worst_sd_mps2 = force::worst_sd(&theta, &covariance, g);
    covariance.add_gravity(&theta, gravity);

    let residuals = Residuals::of(force::residuals(&theta, poses, g));
    let rejected = (0..poses.len()).filter(|k| Face::of(&poses[*k]).is_none()).collect();
    let sides = Sides {
        placement_sd_rad,
        declared_sd_rad: placement.sd_rad(),
        revisit_sd_mps2: libm::sqrt(revisit),
        revisits: visits - 6,
    };
    Ok(Estimate {
        covariance,
        poses: visits,
        orientations: 6,
        dof: 3 * visits - Parameter::COUNT,
        interval_dof: Some(interval_dof),
        rejected,
        worst_sd_mps2,
        temperature_c: mean_temperature(placed.iter().map(|(_, pose)| *pose)),
        sides: Some(sides),
        ..Estimate::orthogonal(model, CalibrationMethod::SixPosition, gravity, &residuals)
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

/// Sum of squared deviations of the vertical axis from its mean over the visits of a side, (m/s²)².
fn revisit_squares(placed: &[(Face, &Pose)], face: Face) -> f64 {
    let visits = placed.iter().filter(|(other, _)| *other == face);
    let upright = visits.map(|(_, pose)| pose.mean_mps2[face.axis()]);
    let mean = upright.clone().sum::<f64>() / upright.clone().count() as f64;
    upright.map(|y| (y - mean) * (y - mean)).sum()
}

/// Sum of the squared placement errors that the pairs of sides show, two degrees of freedom each, rad²: the mean of the two
/// off-axis readings differs from the bias by the tilts.
fn placement_squares(used: &[Used<'_>], bias: &[f64; 3], a: &Matrix, gravity_mps2: f64) -> f64 {
    let mut squares = 0.0;
    for axis in 0..3 {
        let pair = || used.iter().filter(|used| used.axis == axis);
        // Variance of the mean tilt of the pair, relative to that of one tilt.
        let share: f64 = pair().map(|used| used.of_bias * used.of_bias).sum();
        for other in (0..3).filter(|&other| other != axis) {
            let off = pair().map(|used| used.of_bias * (used.pose.mean_mps2[other] - bias[other]));
            let tilt = off.sum::<f64>() / (a[other][other] * gravity_mps2);
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
fn covariance(
    used: &[Used<'_>],
    a: &Matrix,
    g: f64,
    placement_rad: f64,
    revisit: f64,
) -> Covariance {
    let mut covariance = Covariance::ZERO;
    let tilt = placement_rad * placement_rad;
    for &Used { pose, axis, of_bias, of_column } in used {
        // Covariance of two components of the output of a pose. A tilt adds the other two columns of A in first order and
        // shortens this one in second order.
        let of = |r: usize, c: usize| {
            let across = (0..3).filter(|&other| other != axis);
            let first = across.map(|other| a[r][other] * a[c][other]).sum::<f64>();
            let noise = if r == c { pose.noise(r) + revisit } else { 0.0 };
            tilt * (first + tilt * a[r][axis] * a[c][axis]) * g * g + noise
        };
        let bias = Parameter::ALL[axis];
        let column = |row: usize| Parameter::ALL[3 + 3 * row + axis];
        covariance.add(bias, bias, of_bias * of_bias * of(axis, axis));
        for r in 0..3 {
            covariance.add(bias, column(r), of_bias * of_column * of(axis, r));
            covariance.add(column(r), bias, of_bias * of_column * of(axis, r));
            for c in 0..3 {
                covariance.add(column(r), column(c), of_column * of_column * of(r, c));
            }
        }
    }
    for (axis, r, c) in (0..27).map(|k| (k / 9, k / 3 % 3, k % 3)) {
        let [row, column] = [r, c].map(|i| Parameter::ALL[3 + 3 * i + axis]);
        covariance.add(row, column, tilt * tilt * a[r][axis] * a[c][axis]);
    }
    covariance
}
