//! Fits of the iron parameters to the magnitude of the field, and of the rotation to its dip.

use alloc::format;
use alloc::string::String;
use alloc::vec::Vec;
use core::cmp::Ordering;

use nalgebra::{DMatrix, DVector, Matrix3, Rotation3, SVector, Vector3};
use wimu_model::{
    Alignment, MagnetometerModel, MagnetometerRotation, MagnetometerTerms, RotationCovariance,
};

use super::{EARTHS_NT, MagneticPose, not_earths};
use crate::ellipsoid::ellipsoid;
use crate::least_squares::{self, ResidualModel, Rows, Settings};
use crate::{Reason, Refusal, student};

/// The fits have converged when the residuals change by this fraction of the field, rms.
const SETTINGS: Settings = Settings { cauchy: None, last_step: 1e-10, magnitude: 1.0 };
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

/// |B| = 1 at normalised points: equation (55).
pub(super) struct Magnitude(pub Vec<Vector3<f64>>);

impl ResidualModel for Magnitude {
    type Point = Iron;

    fn rows(&self, theta: &Iron) -> Option<Rows> {
        let count = self.0.len();
        let mut rows = Rows { residual: DVector::zeros(count), jacobian: DMatrix::zeros(count, 9) };
        let (w, hard) = (inverse_soft(theta), hard(theta));
        for (k, point) in self.0.iter().enumerate() {
            let off = point - hard;
            let field = w * off;
            let ahead = field.try_normalize(0.0)?;
            rows.residual[k] = field.norm() - 1.0;
            rows.jacobian.fixed_view_mut::<1, 3>(k, 0).copy_from(&-(w * ahead).transpose());
            for (i, (r, c)) in PLACES.into_iter().enumerate() {
                let other = if r == c { 0.0 } else { ahead[c] * off[r] };
                rows.jacobian[(k, 3 + i)] = ahead[r] * off[c] + other;
            }
        }
        Some(rows)
    }

    fn moved(&self, theta: &Iron, step: &DVector<f64>) -> Iron {
        theta + Iron::from_column_slice(step.as_slice())
    }
}

impl Magnitude {
    /// The fit from an ellipsoid; with a scale the robust one from `start`.
    pub fn fit(&self, start: &Iron, cauchy: Option<f64>) -> Option<least_squares::Fit<Iron>> {
        let weights = alloc::vec![1.0; self.0.len()];
        least_squares::minimise(self, start, &weights, Settings { cauchy, ..SETTINGS })
    }
}

/// up · R b is the same in all poses, for unit vectors b, of the field, and up: equation (57).
struct Dip(Vec<[Vector3<f64>; 2]>);

impl ResidualModel for Dip {
    /// R, magnetometer to accelerometer, and up · R b.
    type Point = (Rotation3<f64>, f64);

    fn rows(&self, (rotation, level): &Self::Point) -> Option<Rows> {
        let count = self.0.len();
        let mut rows = Rows { residual: DVector::zeros(count), jacobian: DMatrix::zeros(count, 4) };
        for (k, [b, up]) in self.0.iter().enumerate() {
            let turned = rotation * b;
            rows.residual[k] = up.dot(&turned) - level;
            // A small rotation δ of R b adds δ × R b.
            let slope = turned.cross(up).transpose();
            rows.jacobian.fixed_view_mut::<1, 3>(k, 0).copy_from(&slope);
            rows.jacobian[(k, 3)] = -1.0;
        }
        Some(rows)
    }

    fn moved(&self, (rotation, level): &Self::Point, step: &DVector<f64>) -> Self::Point {
        let turn = Rotation3::new(Vector3::new(step[0], step[1], step[2]));
        (turn * rotation, level + step[3])
    }
}

/// The model of the poses of these indices. `suspect` is the most significant outlier, if there is one.
pub(super) fn model(
    all: &[MagneticPose],
    kept: &[usize],
    suspect: &mut Option<usize>,
) -> Result<MagnetometerModel, Refusal> {
    let poses = || kept.iter().filter_map(|k| all.get(*k));
    let none = || not_observable(f64::INFINITY);
    let scaled = Scaled::of(poses()).ok_or_else(none)?;
    let field = Magnitude(poses().map(|pose| scaled.point(pose)).collect());
    let first = start(field.0.iter().copied()).ok_or_else(none)?;
    let fit = field.fit(&first, None).ok_or_else(none)?;
    let values = fit.inverse.symmetric_eigenvalues();
    let condition = libm::sqrt(values.max() / values.min());
    if condition.is_nan() || condition > MOST_CONDITION {
        return Err(not_observable(condition));
    }
    let judged = Judged::new(&fit);
    *suspect = judged.suspect(kept);
    let worst = kept[judged.worst];
    let Judged { rms, left_out_rms: loo, variance, .. } = judged;
    if rms.is_nan() || rms > MOST_RMS {
        return Err(not_constant(rms, &[worst]));
    }
    if loo.is_nan() || loo > (MOST_LEFT_OUT * libm::sqrt(variance)).max(1e-4) {
        let text = format!(
            "Pose {worst} (from 0) dominates the fit: left out, it is predicted to {:.2} % of the field only. Add orientations.",
            loo * 100.0
        );
        return Err(Refusal::new(Reason::PoorPrediction { index: worst }, text));
    }
    // The scale of the field is not observable: S is normalised to determinant one.
    let (w, hard) = (inverse_soft(&fit.at), hard(&fit.at));
    let raw = w.try_inverse().ok_or_else(none)?;
    let size = libm::cbrt(raw.determinant());
    // Also if it is NaN.
    if !matches!(size.partial_cmp(&0.0), Some(Ordering::Greater)) {
        return Err(none());
    }
    let field_nt = size * scaled.unit_nt;
    if !EARTHS_NT.contains(&field_nt) {
        return Err(not_earths(field_nt));
    }
    let directions = |pose: &MagneticPose| {
        let field = w * (scaled.point(pose) - hard);
        [field.normalize(), Vector3::from(pose.up).normalize()]
    };
    let (to_accelerometer, bent) = rotation(Dip(poses().map(directions).collect()), kept)?;
    *suspect = suspect.or(bent);
    let hard_sd = |k: usize| (scaled.unit_nt * libm::sqrt(variance * fit.inverse[(k, k)])) as f32;
    let soft_sd = |slope: DVector<f64>| libm::sqrt(variance * fit.variance(&slope)) as f32;
    let terms = MagnetometerTerms {
        hard_iron_nt: scaled.output_nt(&hard),
        hard_iron_sd_nt: [0, 1, 2].map(hard_sd),
        soft_iron: PLACES.map(|(r, c)| (raw[(r, c)] / size) as f32),
        soft_iron_sd: soft_iron_slopes(&raw).map(soft_sd),
        field_nt: field_nt as f32,
        poses: u32::try_from(kept.len()).unwrap_or(u32::MAX),
        rms_nt: (rms * field_nt) as f32,
        loo_rms_nt: (loo * field_nt) as f32,
        condition: condition.max(1.0) as f32,
        to_accelerometer: Some(to_accelerometer),
    };
    MagnetometerModel::new(terms).map_err(|error| Refusal::out_of_bounds(error, "a magnetometer"))
}

/// Derivatives of S = W⁻¹ / det(W⁻¹)^⅓ by the parameters: dS = −S dW S/det^⅓, and the change of the normalisation.
fn soft_iron_slopes(raw: &Matrix3<f64>) -> [DVector<f64>; 6] {
    let size = libm::cbrt(raw.determinant());
    PLACES.map(|(r, c)| {
        let mut slope = DVector::zeros(9);
        for (k, (i, j)) in PLACES.into_iter().enumerate() {
            let mut along = raw[(r, i)] * raw[(j, c)];
            let mut trace = raw[(i, j)];
            if i != j {
                along += raw[(r, j)] * raw[(i, c)];
                trace += raw[(j, i)];
            }
            slope[3 + k] = (raw[(r, c)] * trace / 3.0 - along) / size;
        }
        slope
    })
}

fn not_observable(condition: f64) -> Refusal {
    let number = if condition.is_finite() {
        format!(" (condition number {condition:.0})")
    } else {
        String::new()
    };
    let text = format!(
        "These poses do not determine hard and soft iron{number}. Add poses upside down and on every side."
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
        "The field differs by {:.0} % rms: it was disturbed{poses}. Repeat these away from iron, currents and phones, and \
         rotate the sensor about one place.",
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

/// Starting values of a sphere of the points' rms radius about their mean.
pub(super) fn sphere(points: &[Vector3<f64>]) -> Iron {
    let squares: f64 = points.iter().map(Vector3::norm_squared).sum();
    let inverse = libm::sqrt(points.len() as f64 / squares);
    Iron::from([0.0, 0.0, 0.0, inverse, inverse, inverse, 0.0, 0.0, 0.0])
}

/// The rotation from magnetometer to accelerometer axes, and the most significant outlier, if there is one.
fn rotation(dip: Dip, kept: &[usize]) -> Result<(MagnetometerRotation, Option<usize>), Refusal> {
    let none = || not_observable(f64::INFINITY);
    let weights = alloc::vec![1.0; kept.len()];
    // Starting values: the 24 rotations that map axes to axes.
    let fits = (0..24).filter_map(|turn| {
        let quarters = |count: i32| core::f64::consts::FRAC_PI_2 * f64::from(count);
        let face = match turn / 4 {
            count @ 0..4 => Rotation3::from_axis_angle(&Vector3::x_axis(), quarters(count)),
            4 => Rotation3::from_axis_angle(&Vector3::y_axis(), quarters(1)),
            _ => Rotation3::from_axis_angle(&Vector3::y_axis(), quarters(-1)),
        };
        let start = face * Rotation3::from_axis_angle(&Vector3::z_axis(), quarters(turn % 4));
        least_squares::minimise(&dip, &(start, 0.0), &weights, SETTINGS)
    });
    let fit = fits.min_by(|a, b| a.cost.total_cmp(&b.cost)).ok_or_else(none)?;
    let judged = Judged::new(&fit);
    let (rotation, level) = fit.at;
    let sine = level.clamp(-1.0, 1.0);
    let cosine = libm::sqrt((1.0 - sine * sine).max(0.01));
    let spread_rad = judged.rms / cosine;
    if spread_rad.is_nan() || spread_rad > MOST_DIP_RMS {
        let index = kept[judged.worst];
        let text = format!(
            "The dip differs by {:.1}° rms between the poses, most in pose {index} (from 0): the field was disturbed, or field \
             and direction are of different times. Repeat the poses away from iron, currents and phones.",
            spread_rad.to_degrees()
        );
        return Err(Refusal::new(Reason::PoorFit { rms: spread_rad, index }, text));
    }
    let covariance: [[f64; 3]; 3] =
        core::array::from_fn(|a| core::array::from_fn(|b| judged.variance * fit.inverse[(a, b)]));
    let q = nalgebra::UnitQuaternion::from_rotation_matrix(&rotation);
    let found = MagnetometerRotation {
        rotation: Alignment::from_quaternion([q.w, q.i, q.j, q.k]).map_err(|_| none())?,
        covariance: RotationCovariance::from_matrix(&covariance).map_err(|_| none())?,
        // Down is minus up.
        dip_rad: -libm::asin(sine) as f32,
        dip_rms_rad: spread_rad as f32,
    };
    Ok((found, judged.suspect(kept)))
}

/// Residuals of a fit, as they are and with their pose left out.
struct Judged {
    rms: f64,
    left_out_rms: f64,
    /// Of a residual.
    variance: f64,
    parameters: usize,
    squares: f64,
    /// The pose with the largest r²/(1 − h), and that.
    worst: usize,
    worst_square: f64,
}

impl Judged {
    fn new<P: Clone>(fit: &least_squares::Fit<P>) -> Self {
        let (rows, variances) = (&fit.rows, fit.variances());
        let (n, parameters) = (rows.residual.len() as f64, rows.jacobian.ncols());
        let squares = rows.residual.norm_squared();
        let (mut left_out, mut worst, mut worst_square) = (0.0, 0, 0.0);
        for (k, residual) in rows.residual.iter().enumerate() {
            let left = 1.0 - variances[k];
            left_out += (residual / left) * (residual / left);
            let square = residual * residual / left;
            if square > worst_square {
                (worst, worst_square) = (k, square);
            }
        }
        Self {
            rms: libm::sqrt(squares / n),
            left_out_rms: libm::sqrt(left_out / n),
            variance: squares / (n - parameters as f64),
            parameters,
            squares,
            worst,
            worst_square,
        }
    }

    /// The worst pose, if its residual is significant: equation (16), with the variance of the other poses.
    fn suspect(&self, kept: &[usize]) -> Option<usize> {
        let freedom = kept.len().checked_sub(self.parameters + 1).filter(|left| *left > 1)? as f64;
        let variance = (self.squares - self.worst_square) / freedom;
        let most = student::two_sided(SIGNIFICANCE / kept.len() as f64, freedom);
        // Rounding is not significant.
        let is_outlier = self.worst_square > 1e-12 && self.worst_square > most * most * variance;
        is_outlier.then(|| kept[self.worst])
    }
}
