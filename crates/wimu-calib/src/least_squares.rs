//! Least squares on |f| − g, and what the data can know.

use nalgebra::{Cholesky, Const, Matrix3, SMatrix, SVector, Vector3};

use crate::{Covariance, Orientation, Parameter, Pose};

/// The 12 parameters in the order of [`Parameter::ALL`].
pub(crate) type Theta = [f64; Parameter::COUNT];

/// A perfect sensor.
pub(crate) const PERFECT: Theta = [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0];

/// Iterations after which a fit counts as not converged; a good one takes 3 to 6.
const MOST_ITERATIONS: usize = 100;
/// A step that changes the residuals by less than this, m/s² rms, is the last.
const LAST_STEP_MPS2: f64 = 1e-9;
/// Rounding of a sum of squared residuals, per residual, m/s².
const ROUNDING_MPS2: f64 = 4e-14;
/// Of an information matrix with unit diagonal: below, the step counts as undamped.
const LEAST_DAMPING: f64 = 1e-6;
/// Beyond, no step descends.
const MOST_DAMPING: f64 = 1e8;
/// Up to this many poses each is left out by a true refit; beyond, by a rank-one step.
const MOST_REFITS: usize = 256;

pub(crate) fn bias(theta: &Theta) -> [f64; 3] {
    [theta[0], theta[1], theta[2]]
}

pub(crate) fn matrix(theta: &Theta) -> [[f64; 3]; 3] {
    [
        [theta[3], theta[4], theta[5]],
        [theta[6], theta[7], theta[8]],
        [theta[9], theta[10], theta[11]],
    ]
}

/// A model at one value of its parameters, ready to be applied to poses.
struct Evaluated {
    bias: Vector3<f64>,
    inverse: Matrix3<f64>,
}

impl Evaluated {
    fn new(theta: &Theta) -> Option<Self> {
        let [x, y, z] = matrix(theta);
        let a = Matrix3::new(x[0], x[1], x[2], y[0], y[1], y[2], z[0], z[1], z[2]);
        // A mirrored A gives the same magnitudes: the step that led there was too long.
        (a.determinant() > 0.0).then_some(())?;
        Some(Self {
            bias: bias(theta).into(),
            inverse: a.try_inverse()?,
        })
    }

    fn force(&self, output: &[f64; 3]) -> Vector3<f64> {
        self.inverse * (Vector3::from(*output) - self.bias)
    }

    /// Derivatives of |f| with respect to all 12 parameters: equation (13).
    fn derivatives(&self, force: Vector3<f64>) -> Theta {
        let norm = force.norm();
        let direction = if norm > 0.0 { force / norm } else { force };
        let w = self.inverse.tr_mul(&direction);
        let mut derivatives = [0.0; Parameter::COUNT];
        for row in 0..3 {
            derivatives[row] = -w[row];
            for column in 0..3 {
                derivatives[3 + 3 * row + column] = -w[row] * force[column];
            }
        }
        derivatives
    }
}

/// Sums over poses: JᵀJ, Jᵀr and rᵀr.
struct Normal<const N: usize> {
    information: SMatrix<f64, N, N>,
    gradient: SVector<f64, N>,
    cost: f64,
    poses: f64,
}

impl<const N: usize> Normal<N> {
    /// 1 / |column of J|, which makes the diagonal of the scaled information 1.
    fn scale(&self) -> Option<SVector<f64, N>> {
        let scale = self.information.diagonal().map(|d| 1.0 / libm::sqrt(d));
        scale.iter().all(|s| s.is_finite()).then_some(scale)
    }

    fn scaled(&self, scale: &SVector<f64, N>) -> SMatrix<f64, N, N> {
        SMatrix::from_fn(|r, c| self.information[(r, c)] * scale[r] * scale[c])
    }

    /// The damped Gauss-Newton step, equation (14), and the change of residual it means, m/s² rms.
    fn step(&self, damping: f64) -> Option<(SVector<f64, N>, f64)> {
        let scale = self.scale()?;
        let mut information = self.scaled(&scale);
        for i in 0..N {
            information[(i, i)] += damping;
        }
        let step = -factor(information)?.solve(&self.gradient.component_mul(&scale));
        let change = libm::sqrt(step.norm_squared() / self.poses);
        Some((step.component_mul(&scale), change))
    }
}

/// The Cholesky factor, where the matrix is positive definite to rounding.
fn factor<const N: usize>(matrix: SMatrix<f64, N, N>) -> Option<Cholesky<f64, Const<N>>> {
    let cholesky = Cholesky::new(matrix)?;
    let sound = (0..N).all(|i| cholesky.l_dirty()[(i, i)] > 1e-8);
    sound.then_some(cholesky)
}

/// The fit of some of the 12 parameters to |f| = g over static poses: equations (12) to (17).
pub(crate) struct Magnitude<'a, const N: usize> {
    pub poses: &'a [Pose],
    pub gravity_mps2: f64,
    /// The parameters that are fitted; the others stay as they start.
    pub free: [Parameter; N],
}

/// A converged fit.
pub(crate) struct Fit<const N: usize> {
    pub theta: Theta,
    /// Σ r², (m/s²)².
    pub cost: f64,
    normal: Normal<N>,
}

impl<const N: usize> Magnitude<'_, N> {
    /// |f| − g of one pose, m/s²: equation (12); and its derivatives: equation (13).
    fn row(&self, at: &Evaluated, pose: &Pose) -> (f64, SVector<f64, N>) {
        let force = at.force(&pose.mean_mps2);
        (
            force.norm() - self.gravity_mps2,
            self.derivatives(at, force),
        )
    }

    /// Equation (13) at specific force `force`, for the free parameters.
    fn derivatives(&self, at: &Evaluated, force: Vector3<f64>) -> SVector<f64, N> {
        let all = at.derivatives(force);
        SVector::from_fn(|i, _| all[self.free[i].index()])
    }

    fn normal(&self, theta: &Theta, skip: Option<usize>) -> Option<Normal<N>> {
        let at = Evaluated::new(theta)?;
        let mut normal = Normal::<N> {
            information: SMatrix::zeros(),
            gradient: SVector::zeros(),
            cost: 0.0,
            poses: 0.0,
        };
        for (k, pose) in self.poses.iter().enumerate() {
            if Some(k) == skip {
                continue;
            }
            let (residual, row) = self.row(&at, pose);
            normal.information.ger(1.0, &row, &row, 1.0);
            normal.gradient.axpy(residual, &row, 1.0);
            normal.cost += residual * residual;
            normal.poses += 1.0;
        }
        normal.cost.is_finite().then_some(normal)
    }

    /// Damped Gauss-Newton from `start`, leaving out pose `skip`. `None` when it does not converge
    /// or a parameter is not determined at all.
    pub fn solve(&self, start: &Theta, skip: Option<usize>) -> Option<Fit<N>> {
        let mut theta = *start;
        let mut normal = self.normal(&theta, skip)?;
        let mut damping = 0.0;
        for _ in 0..MOST_ITERATIONS {
            let Some((step, change)) = normal.step(damping) else {
                if damping > 1.0 {
                    return None;
                }
                damping = more(damping);
                continue;
            };
            let mut trial = theta;
            for (parameter, by) in self.free.iter().zip(step.iter()) {
                trial[parameter.index()] += by;
            }
            let last = damping < LEAST_DAMPING && change <= LAST_STEP_MPS2;
            let rounding = ROUNDING_MPS2 * libm::sqrt(normal.cost * normal.poses);
            match self.normal(&trial, skip) {
                Some(next) if next.cost <= normal.cost + rounding => {
                    theta = trial;
                    normal = next;
                    damping = if damping > LEAST_DAMPING {
                        damping * 0.1
                    } else {
                        0.0
                    };
                }
                // At the minimum itself rounding decides.
                _ if last => {}
                _ if damping > MOST_DAMPING => return None,
                _ => {
                    damping = more(damping);
                    continue;
                }
            }
            if last {
                let cost = normal.cost;
                return Some(Fit {
                    theta,
                    cost,
                    normal,
                });
            }
        }
        None
    }

    /// |f| − g of `pose` under `theta`, m/s².
    pub fn residual(&self, theta: &Theta, pose: &Pose) -> Option<f64> {
        Some(Evaluated::new(theta)?.force(&pose.mean_mps2).norm() - self.gravity_mps2)
    }

    /// What the poses know about the parameters at `theta`, converged or not.
    pub fn knowledge(&self, theta: &Theta) -> Option<Knowledge<N>> {
        let at = Evaluated::new(theta)?;
        let normal = self.normal(theta, None)?;
        // Every parameter as the error that it makes at 1 g, m/s².
        let scale = SVector::from_fn(|i, _| match self.free[i].index() {
            0..3 => 1.0,
            _ => 1.0 / self.gravity_mps2,
        });
        let (values, vectors) = eigen(normal.scaled(&scale));
        let largest = values.max();
        // Rounding leaves a zero eigenvalue at about 1e-16 of the largest.
        let values = values.map(|v| v.max(largest * 1e-16));
        let condition = libm::sqrt(largest / values.min());
        let variance = SVector::from_fn(|i, _| {
            (0..N)
                .map(|k| vectors[(i, k)] * vectors[(i, k)] / values[k])
                .sum()
        });
        let mut amplification = 0.0;
        let mut poorest = Orientation::ALL[0];
        for orientation in Orientation::ALL {
            let force = Vector3::from(orientation.up()) * self.gravity_mps2;
            let row = self.derivatives(&at, force).component_mul(&scale);
            let along = vectors.tr_mul(&row);
            let square: f64 = (0..N).map(|k| along[k] * along[k] / values[k]).sum();
            if square > amplification {
                amplification = square;
                poorest = orientation;
            }
        }
        Some(Knowledge {
            condition,
            amplification: libm::sqrt(amplification),
            poorest,
            variance,
        })
    }

    /// (JᵀJ)⁻¹ of a fit: the covariance for residuals of unit variance.
    pub fn inverse_information(&self, fit: &Fit<N>) -> Option<SMatrix<f64, N, N>> {
        let scale = fit.normal.scale()?;
        let inverse = factor(fit.normal.scaled(&scale))?.inverse();
        Some(SMatrix::from_fn(|r, c| {
            inverse[(r, c)] * scale[r] * scale[c]
        }))
    }

    /// The residual of each pose under the fit to all others: equation (16).
    pub fn leave_one_out(&self, fit: &Fit<N>) -> LeftOut {
        if self.poses.len() <= MOST_REFITS {
            self.leave_out_by_refit(fit)
        } else {
            self.leave_out_by_rank_one(fit)
        }
    }

    pub fn leave_out_by_refit(&self, fit: &Fit<N>) -> LeftOut {
        LeftOut::of(self.poses.iter().enumerate().map(|(k, pose)| {
            let without = self.solve(&fit.theta, Some(k))?;
            self.residual(&without.theta, pose)
        }))
    }

    /// By the first Gauss-Newton step of the refit, which is exact in rank one.
    pub fn leave_out_by_rank_one(&self, fit: &Fit<N>) -> LeftOut {
        let ready = Evaluated::new(&fit.theta).zip(self.inverse_information(fit));
        LeftOut::of(self.poses.iter().map(|pose| {
            let (at, inverse) = ready.as_ref()?;
            let (residual, row) = self.row(at, pose);
            let step = inverse * row;
            let leverage = row.dot(&step);
            let mut theta = fit.theta;
            for (parameter, by) in self.free.iter().zip(step.iter()) {
                theta[parameter.index()] += by * residual / (1.0 - leverage);
            }
            self.residual(&theta, pose)
        }))
    }
}

/// Residuals of poses that were left out.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct LeftOut {
    /// m/s² rms; infinite where a pose cannot be spared.
    pub rms_mps2: f64,
    /// The pose with the largest.
    pub worst_pose: usize,
}

impl LeftOut {
    /// From the residuals, `None` for a pose that cannot be spared.
    fn of(residuals: impl ExactSizeIterator<Item = Option<f64>>) -> Self {
        let count = residuals.len() as f64;
        let (mut squares, mut largest, mut worst_pose) = (0.0, 0.0, 0);
        for (k, residual) in residuals.enumerate() {
            let square = residual
                .map(|r| r * r)
                .filter(|square| square.is_finite())
                .unwrap_or(f64::INFINITY);
            squares += square;
            if square > largest {
                (largest, worst_pose) = (square, k);
            }
        }
        Self {
            rms_mps2: libm::sqrt(squares / count),
            worst_pose,
        }
    }
}

/// Standard deviation of |f| − g in the worst of 26 orientations, m/s²: equation (17).
pub(crate) fn worst_sd(theta: &Theta, covariance: &Covariance, gravity_mps2: f64) -> f64 {
    let Some(at) = Evaluated::new(theta) else {
        return f64::INFINITY;
    };
    let variance = |orientation: Orientation| {
        let row = at.derivatives(Vector3::from(orientation.up()) * gravity_mps2);
        let along = covariance.matrix().iter().zip(row).map(|(covariances, d)| {
            let sum: f64 = covariances.iter().zip(row).map(|(c, e)| c * e).sum();
            d * sum
        });
        along.sum()
    };
    libm::sqrt(
        Orientation::ALL
            .into_iter()
            .map(variance)
            .fold(0.0, f64::max),
    )
}

fn more(damping: f64) -> f64 {
    (damping * 10.0).max(LEAST_DAMPING)
}

/// What a set of poses can tell about parameters.
pub(crate) struct Knowledge<const N: usize> {
    /// Condition of the Jacobian, its parameters scaled to m/s² at 1 g.
    pub condition: f64,
    /// Standard deviation of |f| − g in the worst of 26 orientations, per unit of the residuals'.
    pub amplification: f64,
    /// That orientation: a pose there adds most.
    pub poorest: Orientation,
    /// Variance of each parameter, as the error that it makes at 1 g, for residuals of unit
    /// variance.
    pub variance: SVector<f64, N>,
}

/// Eigenvalues and eigenvectors (columns) of a symmetric matrix by Jacobi rotations, which keep
/// small eigenvalues of a positive definite matrix accurate.
fn eigen<const N: usize>(mut m: SMatrix<f64, N, N>) -> (SVector<f64, N>, SMatrix<f64, N, N>) {
    let mut vectors = SMatrix::identity();
    let tiny = m.diagonal().amax() * 1e-17;
    for _ in 0..30 {
        let mut off = 0.0_f64;
        for p in 0..N {
            for q in p + 1..N {
                let size = m[(p, q)].abs();
                if size <= tiny {
                    continue;
                }
                off = off.max(size);
                let half = (m[(q, q)] - m[(p, p)]) / (2.0 * m[(p, q)]);
                let root = libm::sqrt(1.0 + half * half);
                let t = if half < 0.0 { -1.0 } else { 1.0 } / (half.abs() + root);
                let cos = 1.0 / libm::sqrt(1.0 + t * t);
                let sin = t * cos;
                for k in 0..N {
                    let (a, b) = (m[(k, p)], m[(k, q)]);
                    m[(k, p)] = cos * a - sin * b;
                    m[(k, q)] = sin * a + cos * b;
                    let (a, b) = (vectors[(k, p)], vectors[(k, q)]);
                    vectors[(k, p)] = cos * a - sin * b;
                    vectors[(k, q)] = sin * a + cos * b;
                }
                for k in 0..N {
                    let (a, b) = (m[(p, k)], m[(q, k)]);
                    m[(p, k)] = cos * a - sin * b;
                    m[(q, k)] = sin * a + cos * b;
                }
            }
        }
        if off <= 10.0 * tiny {
            break;
        }
    }
    (m.diagonal(), vectors)
}
