//! Calibration of the accelerometers of an array from rests: at each, all sensors show one specific force, equation (99).

use alloc::vec::Vec;

use nalgebra::{DMatrix, DVector, Matrix2xX, Matrix3, Vector2, Vector3, Vector4};
use wimu_model::{ErrorModel, ErrorTerms};

use crate::least_squares::{self, Normal, Rows, Settings};
use crate::{Gravity, Pose, Reason, Refusal};

/// Unknowns of an axis: bias and row of the matrix.
const PER_AXIS: usize = 4;
/// Unknowns of a sensor.
const PER_SENSOR: usize = 3 * PER_AXIS;
/// Convergence threshold: change of the residuals in a step, in standard deviations; and the size of the sums for their
/// rounding error.
const SETTINGS: Settings = Settings { cauchy: None, last_step: 1e-3, magnitude: 1e5 };
/// Iterations for the direction of gravity.
const DIRECTION_STEPS: usize = 4;
/// Standard deviation of gravity that is taken as exact, m/s².
const EXACT_MPS2: f64 = 1e-6;

/// Prior standard deviations: from a datasheet, or as stated.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ArrayPrior {
    /// Bias of an axis, m/s².
    pub bias_mps2: f64,
    /// Entry of the matrix (scale factor, misalignment), 1.
    pub matrix: f64,
    /// Change of a bias from rest to rest, m/s².
    pub repeatability_mps2: f64,
    /// Length of the specific force at rest, m/s²: local gravity, or that in the scale of uncalibrated sensors.
    pub gravity_mps2: f64,
    /// Its standard deviation, m/s².
    pub gravity_sd_mps2: f64,
}

impl Default for ArrayPrior {
    /// A consumer sensor off the reel (MPU-9150 datasheet: ±50 mg, ±3 % scale, ±2 % cross-axis).
    fn default() -> Self {
        Self {
            bias_mps2: 0.5,
            matrix: 0.03,
            repeatability_mps2: 0.015,
            gravity_mps2: Gravity::UNKNOWN_PLACE.mps2(),
            gravity_sd_mps2: Gravity::UNKNOWN_PLACE.sd_mps2(),
        }
    }
}

/// One sensor of an array as its rests show it, body axes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ArraySensorEstimate {
    /// `None` beyond the bounds of an error model.
    pub model: Option<ErrorModel>,
    /// Standard deviation of its bias, m/s².
    pub bias_sd_mps2: [f64; 3],
    /// Standard deviation of the entries of its matrix.
    pub matrix_sd: [[f64; 3]; 3],
}

/// Maximum-a-posteriori estimate of an array.
#[derive(Clone, Debug)]
pub struct ArrayEstimate {
    /// Each sensor; one without a rest keeps its prior.
    pub sensors: Vec<ArraySensorEstimate>,
    /// Standard deviation of an entry of a matrix against those of the other sensors with a rest, rms.
    pub matrix_sd: f64,
}

/// Fits bias and matrix of each sensor of an array to rests, body axes: `rests[rest][sensor]`, `None` where a sensor has no
/// output.
///
/// # Errors
/// [`Refusal`]: priors or poses that are not finite, no rest, rests of different numbers of sensors.
///
/// ```
/// use wimu_calib::{ArrayPrior, Pose, calibrate_array};
///
/// // Two sensors at rest on six sides; the second has a bias of 0.2 m/s² along x.
/// let g = 9.80665;
/// let sides = [[g, 0.0, 0.0], [-g, 0.0, 0.0], [0.0, g, 0.0], [0.0, -g, 0.0], [0.0, 0.0, g], [0.0, 0.0, -g]];
/// let rests = sides.map(|[x, y, z]| {
///     vec![Some(Pose::from_mean([x, y, z])), Some(Pose::from_mean([x + 0.2, y, z]))]
/// });
/// let found = calibrate_array(&rests, &ArrayPrior::default())?;
/// let [bias, _, _] = found.sensors[1].model.expect("within bounds").terms().bias_mps2;
/// assert!((bias - 0.2).abs() < 3.0 * found.sensors[1].bias_sd_mps2[0]);
/// # Ok::<(), wimu_calib::Refusal>(())
/// ```
pub fn calibrate_array(
    rests: &[Vec<Option<Pose>>],
    prior: &ArrayPrior,
) -> Result<ArrayEstimate, Refusal> {
    check(rests, prior)?;
    let model = Model { rests, prior, sensors: rests[0].len() };
    let start = DVector::zeros(model.gravity() + 1);
    let moved = |at: &DVector<f64>, step: &DVector<f64>| at + step;
    let end = least_squares::iterate(&start, 1.0, SETTINGS, |at| model.normal(at), moved);
    let found = end.ok_or_else(diverged)?;
    let covariance = found.information.inverse();
    Ok(ArrayEstimate {
        sensors: (0..model.sensors).map(|k| sensor(&found.at, &covariance, k)).collect(),
        matrix_sd: model.relative_matrix_sd(&covariance),
    })
}

fn check(rests: &[Vec<Option<Pose>>], prior: &ArrayPrior) -> Result<(), Refusal> {
    let positive = [prior.bias_mps2, prior.matrix, prior.gravity_mps2];
    let others = [prior.repeatability_mps2, prior.gravity_sd_mps2];
    let sound = positive.iter().all(|v| *v > 0.0 && v.is_finite())
        && others.iter().all(|v| *v >= 0.0 && v.is_finite());
    if !sound {
        let text = "prior deviations and gravity have to be positive and finite";
        return Err(Refusal::new(Reason::Input { index: 0 }, text));
    }
    let mut poses = rests.iter().flatten().flatten();
    if poses.next().is_none() {
        let text = "no sensor has a rest: hold the array still";
        return Err(Refusal::new(Reason::TooFew { have: 0, need: 1 }, text));
    }
    let finite =
        |pose: &Pose| (0..3).all(|i| pose.mean_mps2[i].is_finite() && pose.noise(i) >= 0.0);
    let is_bad = |rest: &Vec<Option<Pose>>| {
        rest.len() != rests[0].len() || !rest.iter().flatten().all(finite)
    };
    match rests.iter().position(is_bad) {
        Some(index) => {
            let text = "a rest has poses that are not finite, or of another number of sensors";
            Err(Refusal::new(Reason::Input { index }, text))
        }
        None => Ok(()),
    }
}

fn diverged() -> Refusal {
    let text = "the fit does not converge: check outputs and sensitivity";
    Refusal::new(Reason::PoorFit { rms: f64::INFINITY, index: 0 }, text)
}

fn sensor(at: &DVector<f64>, covariance: &DMatrix<f64>, sensor: usize) -> ArraySensorEstimate {
    let place = |axis: usize, i: usize| PER_SENSOR * sensor + PER_AXIS * axis + i;
    let sd = |i: usize| libm::sqrt(covariance[(i, i)].max(0.0));
    let mut terms = ErrorTerms::default();
    for (axis, row) in terms.matrix.iter_mut().enumerate() {
        terms.bias_mps2[axis] = at[place(axis, 0)];
        for (i, entry) in row.iter_mut().enumerate() {
            *entry += at[place(axis, 1 + i)];
        }
    }
    ArraySensorEstimate {
        model: ErrorModel::new(terms).ok(),
        bias_sd_mps2: [0, 1, 2].map(|axis| sd(place(axis, 0))),
        matrix_sd: [0, 1, 2].map(|axis| [1, 2, 3].map(|i| sd(place(axis, i)))),
    }
}

/// Rests and priors. The unknowns are [`PER_AXIS`] for each axis, and what gravity differs by from its prior.
struct Model<'a> {
    rests: &'a [Vec<Option<Pose>>],
    prior: &'a ArrayPrior,
    sensors: usize,
}

/// One axis at a rest, over its standard deviation.
struct Row {
    /// The first unknown of the axis.
    place: usize,
    /// Output without bias, and row of the matrix.
    output: f64,
    matrix: Vector3<f64>,
    weight: f64,
}

impl Model<'_> {
    /// Place of gravity among the unknowns.
    fn gravity(&self) -> usize {
        PER_SENSOR * self.sensors
    }

    fn rows(&self, rest: &[Option<Pose>], at: &DVector<f64>) -> Vec<Row> {
        let axes = rest.iter().enumerate().flat_map(|(k, pose)| (0..3).map(move |i| (k, pose, i)));
        let row = |(sensor, pose, axis): (usize, &Option<Pose>, usize)| {
            let pose = pose.as_ref()?;
            let place = PER_SENSOR * sensor + PER_AXIS * axis;
            let changes = self.prior.repeatability_mps2 * self.prior.repeatability_mps2;
            let variance = pose.noise(axis) + changes;
            let weight = 1.0 / libm::sqrt(variance.max(EXACT_MPS2 * EXACT_MPS2));
            let mut matrix: Vector3<f64> = at.fixed_rows::<3>(place + 1).into();
            matrix[axis] += 1.0;
            let output = (pose.mean_mps2[axis] - at[place]) * weight;
            Some(Row { place, output, matrix: matrix * weight, weight })
        };
        axes.filter_map(row).collect()
    }

    /// Sums over all rests and the priors. The direction of gravity at each rest is eliminated.
    fn normal(&self, at: &DVector<f64>) -> Option<Normal> {
        let n = at.len();
        let mut sums = Normal {
            rows: Rows::zeros(0, n),
            information: DMatrix::zeros(n, n),
            gradient: DVector::zeros(n),
            cost: 0.0,
        };
        let gravity = self.prior.gravity_mps2 + at[self.gravity()];
        for rest in self.rests {
            let rows = self.rows(rest, at);
            if let Some(up) = direction(&rows, gravity) {
                self.add_rest(&rows, up, gravity, &mut sums);
            }
        }
        for (i, value) in at.iter().enumerate() {
            let sd = if i == self.gravity() {
                self.prior.gravity_sd_mps2.max(EXACT_MPS2)
            } else if i.is_multiple_of(PER_AXIS) {
                self.prior.bias_mps2
            } else {
                self.prior.matrix
            };
            sums.information[(i, i)] += 1.0 / (sd * sd);
            sums.gradient[i] += value / (sd * sd);
            sums.cost += value * value / (sd * sd);
        }
        sums.information.fill_upper_triangle_with_lower_triangle();
        sums.cost.is_finite().then_some(sums)
    }

    /// Adds a rest, lower triangle, less what the two tangents of the direction `up` explain (Schur complement).
    fn add_rest(&self, rows: &[Row], up: Vector3<f64>, gravity: f64, sums: &mut Normal) {
        let helper = if up.x.abs() < 0.6 { Vector3::x() } else { Vector3::y() };
        let first = up.cross(&helper).normalize();
        let tangents = [first, up.cross(&first)];
        let last = self.gravity();
        let mut tilt = nalgebra::Matrix2::zeros();
        let mut mixed = Matrix2xX::zeros(last + 1);
        for Row { place, output, matrix, weight } in rows {
            let residual = matrix.dot(&up) * gravity - output;
            let force = up * (gravity * weight);
            let own = Vector4::new(*weight, force.x, force.y, force.z);
            let along = matrix.dot(&up);
            let turned = Vector2::from(tangents.map(|t| matrix.dot(&t) * gravity));
            sums.cost += residual * residual;
            let mut pull = sums.gradient.fixed_rows_mut::<PER_AXIS>(*place);
            pull += own * residual;
            sums.gradient[last] += along * residual;
            let mut block = sums.information.fixed_view_mut::<PER_AXIS, PER_AXIS>(*place, *place);
            block += own * own.transpose();
            let mut line = sums.information.fixed_view_mut::<1, PER_AXIS>(last, *place);
            line += own.transpose() * along;
            sums.information[(last, last)] += along * along;
            tilt += turned * turned.transpose();
            let mut line = mixed.fixed_view_mut::<2, PER_AXIS>(0, *place);
            line += turned * own.transpose();
            let mut line = mixed.fixed_view_mut::<2, 1>(0, last);
            line += turned * along;
        }
        if let Some(inverse) = tilt.try_inverse() {
            sums.information -= mixed.tr_mul(&(inverse * &mixed));
        }
    }

    /// Without what the axes of the same number of all sensors have in common.
    fn relative_matrix_sd(&self, covariance: &DMatrix<f64>) -> f64 {
        let has_rest = |k: &usize| self.rests.iter().any(|rest| rest[*k].is_some());
        let used: Vec<usize> = (0..self.sensors).filter(has_rest).collect();
        let (count, mut sum) = (used.len().max(1) as f64, 0.0);
        for i in (0..PER_SENSOR).filter(|i| !i.is_multiple_of(PER_AXIS)) {
            let place = |k: usize| PER_SENSOR * k + i;
            for a in &used {
                let common = used.iter().map(|b| covariance[(place(*a), place(*b))]).sum::<f64>();
                sum += covariance[(place(*a), place(*a))] - common / count;
            }
        }
        libm::sqrt((sum / (9.0 * count)).max(0.0))
    }
}

/// Direction of gravity that fits the outputs of all axes best, by Newton's method on the sphere.
fn direction(rows: &[Row], gravity: f64) -> Option<Vector3<f64>> {
    let information: Matrix3<f64> = rows.iter().map(|r| r.matrix * r.matrix.transpose()).sum();
    let pulled: Vector3<f64> = rows.iter().map(|r| r.matrix * r.output).sum();
    let mut up = information.cholesky()?.solve(&pulled).try_normalize(1e-9)?;
    for _ in 0..DIRECTION_STEPS {
        let gradient = pulled - information * up * gravity;
        let tangent = Matrix3::identity() - up * up.transpose();
        let across = tangent * information * tangent * gravity;
        let curved = across + up * up.transpose() * (information.trace() * gravity);
        up = (up + curved.cholesky()?.solve(&(tangent * gradient))).try_normalize(1e-9)?;
    }
    Some(up)
}
