//! Fits of the iron parameters to the magnitude of the field, and of the rotation to its dip.

use alloc::format;
use alloc::string::String;
use core::cmp::Ordering;

use nalgebra::{Cholesky, Matrix3, Rotation3, SMatrix, SVector, Vector3};
use wimu_model::{
    Alignment, MagnetometerModel, MagnetometerRotation, MagnetometerTerms, RotationCovariance,
};

use super::{EARTHS_NT, MagneticPose, not_earths};

use crate::ellipsoid::ellipsoid;
use crate::{Reason, Refusal, student};

/// Largest condition number.
const MOST_CONDITION: f64 = 30.0;
/// Largest residual, fraction of the field, rms.
const MOST_RMS: f64 = 0.05;
/// Largest leave-one-out error, standard deviations of a residual.
const MOST_LEFT_OUT: f64 = 10.0;
/// Probability that a set without outliers loses a pose.
const SIGNIFICANCE: f64 = 1e-3;
/// Largest standard deviation of the dip, rad.
const MOST_DIP_RMS: f64 = 0.1;

/// Matrix elements of xx, yy, zz, xy, xz, yz.
const PLACES: [(usize, usize); 6] = [(0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)];

fn symmetric(w: &[f64]) -> Matrix3<f64> {
    let mut m = Matrix3::zeros();
    for (&(r, c), value) in PLACES.iter().zip(w) {
        m[(r, c)] = *value;
        m[(c, r)] = *value;
    }
    m
}

/// Normalisation of the outputs by their mean and rms deviation, so that all parameters are of
/// order one.
pub(super) struct Scaled {
    /// The first output, nT: differences from it keep their digits.
    origin: [f64; 3],
    centre: Vector3<f64>,
    pub(super) unit_nt: f64,
}

impl Scaled {
    pub(super) fn of<'a>(poses: impl Iterator<Item = &'a MagneticPose> + Clone) -> Option<Self> {
        let first = poses.clone().next()?;
        let mut scaled = Self { origin: first.output_nt, centre: Vector3::zeros(), unit_nt: 1.0 };
        let (mut sum, mut count) = (Vector3::zeros(), 0.0);
        for pose in poses.clone() {
            sum += scaled.point(pose);
            count += 1.0;
        }
        scaled.centre = sum / count;
        let squares = poses.fold(0.0, |sum, pose| sum + scaled.point(pose).norm_squared());
        scaled.unit_nt = libm::sqrt(squares / count);
        (scaled.unit_nt >= 1.0).then_some(scaled)
    }

    pub(super) fn point(&self, pose: &MagneticPose) -> Vector3<f64> {
        let off = Vector3::from_fn(|k, _| pose.output_nt[k] - self.origin[k]);
        (off - self.centre) / self.unit_nt
    }

    /// The output for a normalised point, nT.
    fn output_nt(&self, point: &Vector3<f64>) -> [f32; 3] {
        let off = self.centre + point * self.unit_nt;
        core::array::from_fn(|k| (self.origin[k] + off[k]) as f32)
    }
}

/// Hard iron, then W, the inverse soft iron relative to the field.
pub(super) type Iron = SVector<f64, 9>;

pub(super) fn hard(theta: &Iron) -> Vector3<f64> {
    Vector3::new(theta[0], theta[1], theta[2])
}

pub(super) fn inverse_soft(theta: &Iron) -> Matrix3<f64> {
    symmetric(&theta.as_slice()[3..])
}

/// Residual |B| − 1 at a point, and its derivatives.
fn row(theta: &Iron, point: Vector3<f64>) -> (f64, Iron) {
    let w = inverse_soft(theta);
    let off = point - hard(theta);
    let field = w * off;
    let size = field.norm();
    let ahead = field / size;
    let back = -(w * ahead);
    let mut row = Iron::zeros();
    for k in 0..3 {
        row[k] = back[k];
    }
    for (k, (r, c)) in PLACES.into_iter().enumerate() {
        row[3 + k] = ahead[r] * off[c];
        if r != c {
            row[3 + k] += ahead[c] * off[r];
        }
    }
    (size - 1.0, row)
}

/// Convergence threshold: smaller steps are rounding.
fn last_step() -> f64 {
    f64::EPSILON * 500.0
}

/// The model of all poses that are not rejected. `suspect` is the most significant outlier, if
/// there is one.
pub(super) fn model(
    all: &[MagneticPose],
    rejected: &[usize],
    suspect: &mut Option<usize>,
) -> Result<MagnetometerModel, Refusal> {
    let poses = || {
        let kept = all.iter().enumerate();
        kept.filter(|(place, _)| !rejected.contains(place))
    };
    let have = poses().count();
    let n = have as f64;
    let none = || not_observable(f64::INFINITY);
    let scaled = Scaled::of(poses().map(|(_, pose)| pose)).ok_or_else(none)?;
    let points = || poses().map(|(place, pose)| (place, scaled.point(pose)));
    let mut theta = start(points().map(|(_, point)| point)).ok_or_else(none)?;
    let mut information = SMatrix::<f64, 9, 9>::zeros();
    for _ in 0..50 {
        information = SMatrix::zeros();
        let mut gradient = Iron::zeros();
        for (_, point) in points() {
            let (residual, row) = row(&theta, point);
            information.ger(1.0, &row, &row, 1.0);
            gradient.axpy(residual, &row, 1.0);
        }
        let step = Cholesky::new(information).ok_or_else(none)?.solve(&gradient);
        theta -= step;
        if step.norm() < last_step() {
            break;
        }
    }
    let inverse = Cholesky::new(information).ok_or_else(none)?.inverse();
    let values = information.symmetric_eigenvalues();
    let condition = libm::sqrt(values.max() / values.min());
    if condition.is_nan() || condition > MOST_CONDITION {
        return Err(not_observable(condition));
    }
    let (mut squares, mut left_out) = (0.0, 0.0);
    let mut worst = Worst::default();
    for (place, point) in points() {
        let (residual, row) = row(&theta, point);
        let left = 1.0 - row.dot(&(inverse * row));
        squares += residual * residual;
        left_out += (residual / left) * (residual / left);
        worst.take(place, residual * residual / left);
    }
    *suspect = worst.beyond_chance(squares, have, 9);
    let (rms, loo) = (libm::sqrt(squares / n), libm::sqrt(left_out / n));
    let variance = squares / (n - 9.0);
    if rms.is_nan() || rms > MOST_RMS {
        return Err(not_constant(rms, &[worst.place]));
    }
    if loo.is_nan() || loo > (MOST_LEFT_OUT * libm::sqrt(variance)).max(1e-4) {
        let text = format!(
            "the leave-one-out error is {:.2} % of the field rms, far above the residual: a single pose dominates the fit; \
             add orientations",
            loo * 100.0
        );
        return Err(Refusal::new(Reason::PoorPrediction { index: worst.place }, text));
    }
    // The scale of the field is not observable: S is normalised to determinant one.
    let w = inverse_soft(&theta);
    let raw = w.try_inverse().ok_or_else(none)?;
    let size = libm::cbrt(raw.determinant());
    // Also if it is NaN.
    if !matches!(size.partial_cmp(&0.0), Some(Ordering::Greater)) {
        return Err(none());
    }
    let s = raw / size;
    let sd = |slope: &Iron| libm::sqrt(variance * slope.dot(&(inverse * slope)));
    let mut soft_sd = [0.0; 6];
    for (sd_of, (r, c)) in soft_sd.iter_mut().zip(PLACES) {
        let mut slope = Iron::zeros();
        for (k, (i, j)) in PLACES.into_iter().enumerate() {
            // dS = −S dW S/det^⅓, and the change of the normalisation.
            let mut along = raw[(r, i)] * raw[(j, c)];
            let mut trace = raw[(i, j)];
            if i != j {
                along += raw[(r, j)] * raw[(i, c)];
                trace += raw[(j, i)];
            }
            slope[3 + k] = (raw[(r, c)] * trace / 3.0 - along) / size;
        }
        *sd_of = sd(&slope);
    }
    let back = w * size;
    let hard = hard(&theta);
    let seen = |(place, pose): (usize, &MagneticPose)| {
        let field = back * (scaled.point(pose) - hard);
        let up = Vector3::from(pose.up);
        (place, field.normalize(), up.normalize())
    };
    let field_nt = size * scaled.unit_nt;
    if !EARTHS_NT.contains(&field_nt) {
        return Err(not_earths(field_nt));
    }
    let (to_accelerometer, bent) = rotation(|| poses().map(seen))?;
    *suspect = suspect.or(bent);
    let unit_nt = scaled.unit_nt;
    let terms = MagnetometerTerms {
        hard_iron_nt: scaled.output_nt(&hard),
        hard_iron_sd_nt: [0, 1, 2]
            .map(|k| (unit_nt * libm::sqrt(variance * inverse[(k, k)])) as f32),
        soft_iron: PLACES.map(|(r, c)| s[(r, c)] as f32),
        soft_iron_sd: soft_sd.map(|sd| sd as f32),
        field_nt: field_nt as f32,
        poses: u32::try_from(have).unwrap_or(u32::MAX),
        rms_nt: (rms * field_nt) as f32,
        loo_rms_nt: (loo * field_nt) as f32,
        condition: condition.max(1.0) as f32,
        to_accelerometer: Some(to_accelerometer),
    };
    MagnetometerModel::new(terms).map_err(|error| Refusal::out_of_bounds(error, "a magnetometer"))
}

fn not_observable(condition: f64) -> Refusal {
    let text = format!(
        "the poses do not determine hard and soft iron (condition {condition:.0}): add orientations unlike those you have, \
         upside down and on every side"
    );
    Refusal::new(Reason::NotObservable, text)
}

/// The refusal of a field that was disturbed in these poses, with a residual as a fraction of the field.
pub(super) fn not_constant(share: f64, disturbed: &[usize]) -> Refusal {
    let mut poses = String::new();
    for (k, pose) in disturbed.iter().enumerate() {
        let before = match k {
            0 if disturbed.len() == 1 => " in pose ",
            0 => " in poses ",
            _ => ", ",
        };
        poses += &format!("{before}{pose}");
    }
    if !disturbed.is_empty() {
        poses += " (from 0)";
    }
    let text = format!(
        "the field was not the same in all poses ({:.0} % rms): it was disturbed{poses}; take these again away from iron, \
         currents and phones, and turn the sensor about one place",
        share * 100.0
    );
    let index = disturbed.first().copied().unwrap_or(0);
    Refusal::new(Reason::PoorFit { rms: share, index }, text)
}

/// Starting values from an ellipsoid fit, equation (11), with the symmetric root.
pub(super) fn start(points: impl Iterator<Item = Vector3<f64>>) -> Option<Iron> {
    let (centre, q) = ellipsoid(points)?;
    let eigen = q.symmetric_eigen();
    let positive = eigen.eigenvalues.iter().all(|value| *value > 0.0);
    let roots = Matrix3::from_diagonal(&eigen.eigenvalues.map(|v| libm::sqrt(v.max(0.0))));
    let w = eigen.eigenvectors * roots * eigen.eigenvectors.transpose();
    let mut theta = Iron::zeros();
    for k in 0..3 {
        theta[k] = centre[k];
    }
    for (k, place) in PLACES.into_iter().enumerate() {
        theta[3 + k] = w[place];
    }
    (positive && theta.iter().all(|t| t.is_finite())).then_some(theta)
}

/// Residual up · R b − level, and its derivatives: a small rotation δ of R b adds δ × R b.
fn level_row(
    turn: &Rotation3<f64>,
    level: f64,
    b: &Vector3<f64>,
    up: &Vector3<f64>,
) -> (f64, SVector<f64, 4>) {
    let turned = turn * b;
    let slope = turned.cross(up);
    let row = SVector::from([slope.x, slope.y, slope.z, -1.0]);
    (up.dot(&turned) - level, row)
}

/// The rotation from magnetometer to accelerometer axes for which up · R b is constant, from the
/// index, field direction b and up of each pose; and the most significant outlier, if there is one.
fn rotation<I: Iterator<Item = (usize, Vector3<f64>, Vector3<f64>)>>(
    seen: impl Fn() -> I,
) -> Result<(MagnetometerRotation, Option<usize>), Refusal> {
    let have = seen().count();
    let n = have as f64;
    let none = || not_observable(f64::INFINITY);
    let mut best: Option<(f64, Rotation3<f64>, f64, SMatrix<f64, 4, 4>)> = None;
    // Starting values: the 24 rotations that map axes to axes.
    for turn in 0..24 {
        let quarters = |count: i32| core::f64::consts::FRAC_PI_2 * f64::from(count);
        let face = match turn / 4 {
            count @ 0..4 => Rotation3::from_axis_angle(&Vector3::x_axis(), quarters(count)),
            4 => Rotation3::from_axis_angle(&Vector3::y_axis(), quarters(1)),
            _ => Rotation3::from_axis_angle(&Vector3::y_axis(), quarters(-1)),
        };
        let mut r = face * Rotation3::from_axis_angle(&Vector3::z_axis(), quarters(turn % 4));
        let mut level = 0.0;
        let mut last: Option<(f64, SMatrix<f64, 4, 4>)> = None;
        for _ in 0..30 {
            let mut information = SMatrix::<f64, 4, 4>::zeros();
            let mut gradient = SVector::<f64, 4>::zeros();
            let mut cost = 0.0;
            for (_, b, up) in seen() {
                let (residual, row) = level_row(&r, level, &b, &up);
                information.ger(1.0, &row, &row, 1.0);
                gradient.axpy(residual, &row, 1.0);
                cost += residual * residual;
            }
            last = Some((cost, information));
            let Some(factor) = Cholesky::new(information) else {
                break;
            };
            let step = -factor.solve(&gradient);
            r = Rotation3::new(Vector3::new(step[0], step[1], step[2])) * r;
            level += step[3];
            if step.norm() < last_step() {
                break;
            }
        }
        let Some((cost, information)) = last else {
            continue;
        };
        if best.as_ref().is_none_or(|(least, ..)| cost < *least) {
            best = Some((cost, r, level, information));
        }
    }
    let (cost, r, level, information) = best.ok_or_else(none)?;
    let inverse = Cholesky::new(information).ok_or_else(none)?.inverse();
    let sine = level.clamp(-1.0, 1.0);
    let cosine = libm::sqrt((1.0 - sine * sine).max(0.01));
    let spread_rad = libm::sqrt(cost / n) / cosine;
    let variance = cost / (n - 4.0);
    let mut worst = Worst::default();
    for (place, b, up) in seen() {
        let (residual, row) = level_row(&r, level, &b, &up);
        let left = 1.0 - row.dot(&(inverse * row));
        worst.take(place, residual * residual / left);
    }
    if spread_rad.is_nan() || spread_rad > MOST_DIP_RMS {
        let index = worst.place;
        let text = format!(
            "the dip is not the same in all poses ({:.1}° rms, most in pose {index} from 0): the field was disturbed, or \
             field and direction are of different times; repeat the poses away from iron, currents and phones",
            spread_rad.to_degrees()
        );
        return Err(Refusal::new(Reason::PoorFit { rms: spread_rad, index }, text));
    }
    let covariance: [[f64; 3]; 3] =
        core::array::from_fn(|a| core::array::from_fn(|b| variance * inverse[(a, b)]));
    let q = nalgebra::UnitQuaternion::from_rotation_matrix(&r);
    let found = MagnetometerRotation {
        rotation: Alignment::from_quaternion([q.w, q.i, q.j, q.k]).map_err(|_| none())?,
        covariance: RotationCovariance::from_matrix(&covariance).map_err(|_| none())?,
        // Down is minus up.
        dip_rad: -libm::asin(sine) as f32,
        dip_rms_rad: spread_rad as f32,
    };
    Ok((found, worst.beyond_chance(cost, have, 4)))
}

/// The pose with the largest residual.
#[derive(Default)]
struct Worst {
    place: usize,
    /// Its r²/(1 − h).
    square: f64,
}

impl Worst {
    fn take(&mut self, place: usize, square: f64) {
        if square > self.square {
            *self = Self { place, square };
        }
    }

    /// The pose, if its residual is significant: equation (16), with the variance of the other
    /// poses.
    fn beyond_chance(&self, squares: f64, poses: usize, parameters: usize) -> Option<usize> {
        let freedom = poses.checked_sub(parameters + 1).filter(|left| *left > 1)? as f64;
        let variance = (squares - self.square) / freedom;
        let most = student::two_sided(SIGNIFICANCE / poses as f64, freedom);
        // Rounding is not significant.
        (self.square > 1e-12 && self.square > most * most * variance).then_some(self.place)
    }
}
