//! Alignment of the sensor with the body that it is mounted on.

use alloc::format;
use alloc::vec::Vec;

use nalgebra::{Matrix3, Rotation3, UnitQuaternion, Vector3};
use wimu_model::{Alignment, RotationCovariance};

use crate::{Reason, Refusal};

/// Smallest angle between directions, rad: 10°. Nearly parallel directions do not determine the
/// rotation about them.
const LEAST_ANGLE_RAD: f64 = 0.175;
/// Largest residual of a direction, standard deviations.
const MOST_DISAGREEMENT: f64 = 5.0;
/// Smallest displacement of a straight movement, m.
const LEAST_DISPLACEMENT_M: f64 = 0.05;
/// Smallest acceleration of a straight movement, m/s² rms.
const LEAST_ACCELERATION_MPS2: f64 = 0.1;
/// Largest ratio of transverse to longitudinal acceleration.
const MOST_TRANSVERSE: f64 = 0.35;

/// A direction that is known in body axes and was measured in sensor axes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct KnownDirection {
    /// In sensor axes, of any length: the corrected specific force at rest, which points up, or a
    /// [`straight_move`].
    pub sensor: [f64; 3],
    /// The same direction in body axes, of any length.
    pub body: [f64; 3],
    /// Standard deviation of the direction, rad, about each perpendicular axis.
    pub sd_rad: f64,
}

/// The rotation from the sensor's axes to those of the body.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AlignmentEstimate {
    /// The rotation.
    pub alignment: Alignment,
    /// Covariance of its error about body axes, rad².
    pub covariance: RotationCovariance,
    /// Largest residual angle of a direction, rad.
    pub residual_rad: f64,
}

/// The rotation from the sensor's axes to those of the body that best agrees with two or more known
/// directions. Equation (54) of docs/reference/equations.
///
/// ```
/// use wimu_calib::{KnownDirection, align};
///
/// let sd_rad = 0.5_f64.to_radians();
/// // Level, the sensor's y points down; pushed ahead, it accelerates along its z.
/// let level = KnownDirection { sensor: [0.0, -9.81, 0.0], body: [0.0, 0.0, 1.0], sd_rad };
/// let ahead = KnownDirection { sensor: [0.0, 0.0, 0.8], body: [1.0, 0.0, 0.0], sd_rad };
/// let found = align(&[level, ahead])?;
/// let [x, y, z] = found.alignment.rotate([0.0, 0.0, 1.0]);
/// assert!((x - 1.0).abs() < 1e-9 && y.abs() < 1e-9 && z.abs() < 1e-9);
/// // Heading is known from `ahead` alone, roll from `level` alone, pitch from both.
/// let sd = [0, 1, 2].map(|axis| found.covariance.sd(axis));
/// assert!((sd[0] - sd_rad).abs() < 1e-6 && (sd[2] - sd_rad).abs() < 1e-6 && sd[1] < 0.8 * sd_rad);
///
/// assert!(align(&[level, level]).is_err());
/// # Ok::<(), wimu_calib::Refusal>(())
/// ```
///
/// # Errors
/// [`Refusal`].
pub fn align(directions: &[KnownDirection]) -> Result<AlignmentEstimate, Refusal> {
    if directions.len() < 2 {
        let have = directions.len();
        let text = format!(
            "{have} known direction, 2 are needed: a level rest and another one, or a straight move"
        );
        return Err(Refusal::new(Reason::TooFew { have, need: 2 }, text));
    }
    let mut attitude = Matrix3::<f64>::zeros();
    let mut information = Matrix3::<f64>::zeros();
    let mut weights = 0.0;
    // Unit vectors, sensor and body axes.
    let mut pairs = Vec::new();
    for (direction, known) in directions.iter().enumerate() {
        let weight = 1.0 / (known.sd_rad * known.sd_rad);
        // A value that is not a number has no length.
        let unit = |v: [f64; 3]| Vector3::from(v).try_normalize(1e-9).filter(|u| u.norm() > 0.5);
        let (v, u) = (unit(known.sensor), unit(known.body));
        let (Some(v), Some(u), true) = (v, u, weight.is_finite() && weight > 0.0) else {
            return Err(no_direction(direction));
        };
        attitude += u * v.transpose() * weight;
        information += (Matrix3::identity() - u * u.transpose()) * weight;
        weights += weight;
        pairs.push([v, u]);
    }
    for side in 0..2 {
        check_spread(pairs.iter().map(|pair| pair[side]))?;
    }
    let turn = rotation(attitude / weights);
    let none = || no_direction(0);
    let alignment =
        Alignment::from_quaternion([turn.w, turn.i, turn.j, turn.k]).map_err(|_| none())?;
    let inverse = information.try_inverse().ok_or_else(none)?;
    let covariance: [[f64; 3]; 3] =
        core::array::from_fn(|r| core::array::from_fn(|c| inverse[(r, c)]));
    let covariance = RotationCovariance::from_matrix(&covariance).map_err(|_| none())?;
    let off = pairs.iter().map(|[v, u]| angle(&(turn * v), u));
    let deviations = off.zip(directions).map(|(off, known)| (off, off / known.sd_rad));
    let worst = deviations.enumerate().max_by(|a, b| a.1.1.total_cmp(&b.1.1));
    let (direction, (residual_rad, deviations)) = worst.ok_or_else(none)?;
    if deviations > MOST_DISAGREEMENT {
        let text = format!(
            "direction {direction} (from 0) has a residual of {:.1}°: check which side of the body was where, and calibrate \
             the sensor first",
            residual_rad.to_degrees()
        );
        return Err(Refusal::new(Reason::PoorFit { rms: residual_rad, index: direction }, text));
    }
    Ok(AlignmentEstimate { alignment, covariance, residual_rad })
}

/// Refuses directions that are all along one line.
fn check_spread(units: impl Iterator<Item = Vector3<f64>> + Clone) -> Result<(), Refusal> {
    // The principal axis of the directions is the eigenvector of the largest eigenvalue.
    let line = main_axis(units.clone().map(|u| u * u.transpose()).sum());
    let angle_rad = units.map(|u| from_line(&line, &u)).fold(0.0, f64::max);
    if angle_rad >= LEAST_ANGLE_RAD / 2.0 {
        return Ok(());
    }
    let text = format!(
        "the directions are {:.1}° from one line: the rotation about it is undetermined; rest the body on another side, or \
         move it straight ahead",
        angle_rad.to_degrees()
    );
    Err(Refusal::new(Reason::NotObservable, text))
}

/// The rotation nearest to an attitude profile matrix: Wahba's problem by the singular value decomposition.
fn rotation(profile: Matrix3<f64>) -> UnitQuaternion<f64> {
    let svd = profile.svd(true, true);
    let (u, v_t) = (svd.u.unwrap_or_default(), svd.v_t.unwrap_or_default());
    // A product of determinant −1 is a reflection: the direction that shows least is turned.
    let mut signs = Vector3::repeat(1.0);
    signs[svd.singular_values.imin()] = (u * v_t).determinant().signum();
    let turn = Rotation3::from_matrix_unchecked(u * Matrix3::from_diagonal(&signs) * v_t);
    UnitQuaternion::from_rotation_matrix(&turn)
}

fn no_direction(index: usize) -> Refusal {
    let text =
        format!("direction {index} (from 0) or its standard deviation is zero or not finite");
    Refusal::new(Reason::Input { index }, text)
}

/// The angle between two vectors, rad.
fn angle(a: &Vector3<f64>, b: &Vector3<f64>) -> f64 {
    libm::atan2(a.cross(b).norm(), a.dot(b))
}

/// Angle of a vector from the line along `line`, rad, 0..=π/2.
fn from_line(line: &Vector3<f64>, v: &Vector3<f64>) -> f64 {
    libm::atan2(line.cross(v).norm(), line.dot(v).abs())
}

/// The eigenvector of the largest eigenvalue of a symmetric matrix.
fn main_axis(matrix: Matrix3<f64>) -> Vector3<f64> {
    let eigen = matrix.symmetric_eigen();
    eigen.eigenvectors.column(eigen.eigenvalues.imax()).into_owned()
}

/// Direction of a straight movement from rest to rest, in sensor axes, and its standard deviation,
/// rad, which does not include that of the guide. Equation (54).
///
/// `before` and `after` are the mean specific force at the rests, m/s²; `samples` the specific
/// force between them at `rate_hz`.
///
/// ```
/// use wimu_calib::straight_move;
///
/// // Pushed along the sensor's x and stopped again, on a level table, in a second.
/// let rest = [0.0, 0.0, 9.81];
/// let push = (0..100).map(|k| [2.0 * f64::sin(0.0628 * f64::from(k)), 0.0, 9.81]);
/// let (ahead, sd_rad) = straight_move(rest, rest, push, 100.0)?;
/// assert!(ahead[0] > 0.999 && sd_rad < 0.02);
/// # Ok::<(), wimu_calib::Refusal>(())
/// ```
///
/// # Errors
/// [`Refusal`] of a movement that is too short or not straight.
pub fn straight_move(
    before: [f64; 3],
    after: [f64; 3],
    samples: impl Iterator<Item = [f64; 3]>,
    rate_hz: f64,
) -> Result<([f64; 3], f64), Refusal> {
    let rest = (Vector3::from(before) + Vector3::from(after)) * 0.5;
    let step = 1.0 / rate_hz;
    let (mut velocity, mut position) = (Vector3::<f64>::zeros(), Vector3::<f64>::zeros());
    let mut scatter = Matrix3::<f64>::zeros();
    let mut count = 0.0;
    for sample in samples {
        let acceleration = Vector3::from(sample) - rest;
        scatter += acceleration * acceleration.transpose();
        position += (velocity + acceleration * (step * 0.5)) * step;
        velocity += acceleration * step;
        count += 1.0;
    }
    // The velocity at the end is zero: the remaining error is distributed linearly in time.
    let distance = position - velocity * (count * step * 0.5);
    let distance_m = distance.norm();
    let rms = libm::sqrt(scatter.trace() / count);
    let moved = distance_m >= LEAST_DISPLACEMENT_M && rms >= LEAST_ACCELERATION_MPS2;
    if !moved {
        let distance_m = if distance_m.is_finite() { distance_m } else { 0.0 };
        let text = format!(
            "the displacement is only {distance_m:.2} m: push the body ahead briskly, by half a metre or more"
        );
        return Err(Refusal::new(Reason::NotObservable, text));
    }
    let ahead = distance / distance_m;
    let along = ahead.dot(&(scatter * ahead));
    let crookedness = libm::sqrt((scatter.trace() / along - 1.0).max(0.0));
    if crookedness > MOST_TRANSVERSE || crookedness.is_nan() {
        let text = format!(
            "the movement was not straight: {:.0} % of the acceleration was transverse; push the body along a straight edge \
             without rotating or tilting it",
            crookedness * 100.0
        );
        return Err(Refusal::new(Reason::PoorFit { rms: crookedness, index: 0 }, text));
    }
    // The principal axis of the acceleration is an independent estimate of the direction: noise and
    // vibration do not change it.
    let apart = from_line(&main_axis(scatter), &ahead);
    let shaken = crookedness / libm::sqrt((count / 8.0).max(1.0));
    Ok(([0, 1, 2].map(|axis| ahead[axis]), libm::sqrt(apart * apart + shaken * shaken)))
}
