//! Least squares on |f| − g, and what the data can know.

use nalgebra::{Cholesky, Const, Matrix3, RealField, SMatrix, SVector, Vector3, convert};

use crate::terms::{Slot, Theta};
use crate::{Orientation, Pose};

/// f32 or f64.
pub(crate) trait Real: RealField + Copy {}

impl Real for f32 {}
impl Real for f64 {}

/// Iterations after which a fit counts as not converged; a good one takes 3 to 6.
const MOST_ITERATIONS: usize = 100;
/// A step that changes the residuals by less than this, m/s² rms, is the last.
const LAST_STEP_MPS2: f64 = 1e-9;
/// Of an information matrix with unit diagonal: below, the step counts as undamped.
const LEAST_DAMPING: f64 = 1e-6;
/// Beyond, no step descends.
const MOST_DAMPING: f64 = 1e8;
/// Up to this many poses, one of great leverage is left out by a true refit.
const MOST_REFITS: usize = 256;
/// Leverage up to which the first step of the refit is the refit: what it leaves is of second
/// order in the step, which grows with 1 / (1 − h).
const MOST_LEVERAGE: f64 = 0.5;

pub(crate) fn real<R: Real>(x: f64) -> R {
    convert(x)
}

pub(crate) fn double<R: Real>(x: R) -> f64 {
    nalgebra::try_convert(x).unwrap_or(f64::NAN)
}

/// The poses that a fit does without, at most [`Rejected::MOST`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Rejected {
    poses: [usize; Self::MOST],
    count: usize,
}

impl Rejected {
    /// More than so many bad poses are not left out: the recording is.
    pub const MOST: usize = 16;

    /// Their indices, the worst first.
    pub fn as_slice(&self) -> &[usize] {
        self.poses.get(..self.count).unwrap_or(&[])
    }

    /// Whether `pose` is one of them.
    pub fn contains(&self, pose: usize) -> bool {
        self.as_slice().contains(&pose)
    }

    /// The first `count` of them.
    pub(crate) fn first(mut self, count: usize) -> Self {
        self.count = self.count.min(count);
        self
    }

    /// With one more, if there is room.
    pub(crate) fn with(mut self, pose: usize) -> Self {
        if let Some(place) = self.poses.get_mut(self.count) {
            *place = pose;
            self.count += 1;
        }
        self
    }
}

/// How much each pose counts: 1 / (σ₀² + its noise), 1 on average. Equation (40).
#[derive(Clone, Copy, Debug)]
pub(crate) struct Weighting {
    /// σ₀²: what differs from pose to pose and is no noise, (m/s²)².
    common: f64,
    /// Mean noise of a pose's mean, (m/s²)²; 0 when all count the same.
    mean_noise: f64,
}

impl Weighting {
    pub const EQUAL: Self = Self {
        common: 1.0,
        mean_noise: 0.0,
    };

    pub fn new(common: f64, mean_noise: f64) -> Self {
        Self { common, mean_noise }
    }

    pub fn of(&self, pose: &Pose) -> f64 {
        if self.mean_noise > 0.0 {
            (self.common + self.mean_noise) / (self.common + pose.mean_noise())
        } else {
            1.0
        }
    }
}

/// When poses were taken and how warm, as the terms see it.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Conditions {
    /// Time of the last pose, s.
    pub end_s: f64,
    /// From the first to it, s; not 0.
    pub span_s: f64,
    /// T₀, °C.
    pub reference_c: f64,
}

impl Conditions {
    /// −1 at the first pose, 0 at the last.
    fn progress(&self, pose: &Pose) -> f64 {
        (pose.time_s - self.end_s) / self.span_s
    }

    fn warmer(&self, pose: &Pose) -> f64 {
        pose.temperature_c
            .map_or(0.0, |celsius| celsius - self.reference_c)
    }
}

/// A model at one value of its parameters, ready to be applied to poses.
struct Evaluated<'a, R: Real> {
    theta: &'a Theta<R>,
    /// A⁻¹ at T₀.
    inverse: Matrix3<R>,
    /// Whether A moves with temperature.
    warms: bool,
}

/// One pose under a model.
struct Applied<R: Real> {
    inverse: Matrix3<R>,
    z: Vector3<R>,
    force: Vector3<R>,
    progress: R,
    warmer: R,
}

impl<'a, R: Real> Evaluated<'a, R> {
    fn new(theta: &'a Theta<R>) -> Option<Self> {
        let a = Self::matrix(theta, R::zero());
        // A mirrored A gives the same magnitudes: the step that led there was too long.
        (a.determinant() > R::zero()).then_some(())?;
        Some(Self {
            theta,
            inverse: a.try_inverse()?,
            warms: Slot::SCALE_SLOPE
                .iter()
                .any(|slot| !theta[slot.index()].is_zero()),
        })
    }

    fn matrix(theta: &Theta<R>, warmer: R) -> Matrix3<R> {
        let mut a = Matrix3::from_fn(|r, c| theta[3 + 3 * r + c]);
        for axis in 0..3 {
            a[(axis, axis)] *= R::one() + theta[Slot::SCALE_SLOPE[axis].index()] * warmer;
        }
        a
    }

    /// The specific force that `output` means: equation (41).
    fn apply(&self, output: [R; 3], progress: R, warmer: R) -> Applied<R> {
        let theta = self.theta;
        let inverse = if self.warms && !warmer.is_zero() {
            Self::matrix(theta, warmer)
                .try_inverse()
                .unwrap_or(self.inverse)
        } else {
            self.inverse
        };
        let offset = Vector3::from_fn(|i, _| {
            output[i] - theta[i] - theta[12 + i] * progress - theta[15 + i] * warmer
        });
        let z = inverse * offset;
        let force = Vector3::from_fn(|i, _| z[i] - theta[21 + i] * z[i] * z[i]);
        Applied {
            inverse,
            z,
            force,
            progress,
            warmer,
        }
    }

    /// The same for gravity `force` at the end of the session at T₀, where derivatives are asked
    /// for a given force and not for an output.
    fn at(&self, force: Vector3<R>) -> Applied<R> {
        Applied {
            inverse: self.inverse,
            z: force,
            force,
            progress: R::zero(),
            warmer: R::zero(),
        }
    }

    /// What every derivative of |f| is made of: w = A⁻ᵀ (1 − 2 diag(q ∘ z)) n, and n = f/|f|.
    fn directions(&self, at: &Applied<R>) -> (Vector3<R>, Vector3<R>) {
        let norm = at.force.norm();
        let n = if norm > R::zero() {
            at.force / norm
        } else {
            at.force
        };
        let two: R = real(2.0);
        let m = Vector3::from_fn(|i, _| n[i] * (R::one() - two * self.theta[21 + i] * at.z[i]));
        (at.inverse.tr_mul(&m), n)
    }

    /// ∂|f|/∂θ of one parameter: equations (13) and (41).
    fn derivative(&self, slot: Slot, at: &Applied<R>, w: &Vector3<R>, n: &Vector3<R>) -> R {
        let index = slot.index();
        let axis = index % 3;
        match index {
            0..3 => -w[axis],
            3..12 => {
                let (row, column) = (index / 3 - 1, index % 3);
                let d = -w[row] * at.z[column];
                if row == column && self.warms {
                    d * (R::one() + self.theta[18 + row] * at.warmer)
                } else {
                    d
                }
            }
            12..15 => -w[axis] * at.progress,
            15..18 => -w[axis] * at.warmer,
            18..21 => -w[axis] * self.theta[3 + 4 * axis] * at.warmer * at.z[axis],
            _ => -n[axis] * at.z[axis] * at.z[axis],
        }
    }
}

/// Sums over poses: JᵀWJ, JᵀWr and rᵀWr.
#[derive(Clone)]
struct Normal<R: Real, const N: usize> {
    /// The lower triangle counts.
    information: SMatrix<R, N, N>,
    gradient: SVector<R, N>,
    cost: R,
    poses: usize,
}

impl<R: Real, const N: usize> Normal<R, N> {
    /// 1 / |column of J|, which makes the diagonal of the scaled information 1.
    fn scale(&self) -> Option<SVector<R, N>> {
        let scale = self.information.diagonal().map(|d| R::one() / d.sqrt());
        scale.iter().all(|s| s.is_finite()).then_some(scale)
    }

    fn scaled(&self, scale: &SVector<R, N>) -> SMatrix<R, N, N> {
        SMatrix::from_fn(|r, c| self.information[(r.max(c), r.min(c))] * scale[r] * scale[c])
    }

    /// The damped Gauss-Newton step, equation (14), and the change of residual it means, m/s² rms.
    fn step(&self, damping: f64) -> Option<(SVector<R, N>, f64)> {
        let scale = self.scale()?;
        let mut information = self.scaled(&scale);
        for i in 0..N {
            information[(i, i)] += real(damping);
        }
        let step = -factor(information)?.solve(&self.gradient.component_mul(&scale));
        let change = libm::sqrt(double(step.norm_squared()) / self.poses as f64);
        Some((step.component_mul(&scale), change))
    }
}

/// The Cholesky factor, where the matrix is positive definite to rounding.
fn factor<R: Real, const N: usize>(matrix: SMatrix<R, N, N>) -> Option<Cholesky<R, Const<N>>> {
    let cholesky = Cholesky::new(matrix)?;
    let least = R::default_epsilon().sqrt();
    let sound = (0..N).all(|i| cholesky.l_dirty()[(i, i)] > least);
    sound.then_some(cholesky)
}

/// The fit of some parameters to |f| = g over static poses: equations (12) to (17), (40), (41).
pub(crate) struct Magnitude<'a, const N: usize> {
    pub poses: &'a [Pose],
    pub gravity_mps2: f64,
    pub conditions: Conditions,
    pub weighting: Weighting,
    pub rejected: Rejected,
    /// The parameters that are fitted; the others stay as they start.
    pub free: [Slot; N],
}

/// A converged fit.
pub(crate) struct Fit<R: Real, const N: usize> {
    pub theta: Theta<R>,
    /// (JᵀWJ)⁻¹: the covariance for residuals of unit variance.
    pub inverse: SMatrix<R, N, N>,
    /// Σ w r², (m/s²)².
    pub cost: f64,
}

impl<R: Real, const N: usize> Fit<R, N> {
    /// Standard deviation of a residual, m/s².
    pub fn sd(&self, dof: usize) -> f64 {
        libm::sqrt(self.cost / dof.max(1) as f64)
    }
}

impl<const N: usize> Magnitude<'_, N> {
    fn applied<R: Real>(&self, at: &Evaluated<R>, pose: &Pose) -> Applied<R> {
        at.apply(
            pose.mean_mps2.map(real),
            real(self.conditions.progress(pose)),
            real(self.conditions.warmer(pose)),
        )
    }

    /// |f| − g of one pose, m/s², and its derivatives.
    fn row<R: Real>(&self, at: &Evaluated<R>, pose: &Pose) -> (R, SVector<R, N>) {
        let applied = self.applied(at, pose);
        let residual = applied.force.norm() - real(self.gravity_mps2);
        (residual, self.derivatives(at, &applied))
    }

    fn derivatives<R: Real>(&self, at: &Evaluated<R>, applied: &Applied<R>) -> SVector<R, N> {
        let (w, n) = at.directions(applied);
        SVector::from_fn(|i, _| at.derivative(self.free[i], applied, &w, &n))
    }

    fn normal<R: Real>(&self, theta: &Theta<R>, skip: Option<usize>) -> Option<Normal<R, N>> {
        self.weighted_normal(theta, skip, &self.weighting)
    }

    fn weighted_normal<R: Real>(
        &self,
        theta: &Theta<R>,
        skip: Option<usize>,
        weighting: &Weighting,
    ) -> Option<Normal<R, N>> {
        let at = Evaluated::new(theta)?;
        let mut normal = Normal::<R, N> {
            information: SMatrix::zeros(),
            gradient: SVector::zeros(),
            cost: R::zero(),
            poses: 0,
        };
        for (k, pose) in self.poses.iter().enumerate() {
            if Some(k) == skip || self.rejected.contains(k) {
                continue;
            }
            let (residual, row) = self.row(&at, pose);
            let weight: R = real(weighting.of(pose));
            for c in 0..N {
                let weighted = row[c] * weight;
                normal.gradient[c] += weighted * residual;
                for r in c..N {
                    normal.information[(r, c)] += weighted * row[r];
                }
            }
            normal.cost += weight * residual * residual;
            normal.poses += 1;
        }
        normal.cost.is_finite().then_some(normal)
    }

    /// Damped Gauss-Newton from `start`, leaving out pose `skip`. `None` when it does not converge
    /// or a parameter is not determined at all.
    pub fn solve<R: Real>(&self, start: &Theta<R>, skip: Option<usize>) -> Option<Fit<R, N>> {
        let epsilon = double(R::default_epsilon());
        let last_step = LAST_STEP_MPS2.max(4.0 * epsilon * self.gravity_mps2);
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
            for (slot, by) in self.free.iter().zip(step.iter()) {
                trial[slot.index()] += *by;
            }
            let last = damping < LEAST_DAMPING && change <= last_step;
            let cost = double(normal.cost);
            // That of a sum of squares.
            let rounding =
                20.0 * epsilon * self.gravity_mps2 * libm::sqrt(cost * normal.poses as f64);
            match self.normal(&trial, skip) {
                Some(next) if double(next.cost) <= cost + rounding => {
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
                let scale = normal.scale()?;
                let inverse = factor(normal.scaled(&scale))?.inverse();
                return Some(Fit {
                    theta,
                    inverse: SMatrix::from_fn(|r, c| inverse[(r, c)] * scale[r] * scale[c]),
                    cost: double(normal.cost),
                });
            }
        }
        None
    }

    /// |f| − g of `pose` under `theta`, m/s².
    pub fn residual<R: Real>(&self, theta: &Theta<R>, pose: &Pose) -> Option<f64> {
        let at = Evaluated::new(theta)?;
        Some(double(
            self.applied(&at, pose).force.norm() - real(self.gravity_mps2),
        ))
    }

    /// What the poses' orientations tell of the parameters at `theta`, converged or not.
    pub fn knowledge<R: Real>(&self, theta: &Theta<R>) -> Option<Knowledge<R, N>> {
        let at = Evaluated::new(theta)?;
        let normal = self.weighted_normal(theta, None, &Weighting::EQUAL)?;
        // Every parameter as the error that it makes at 1 g, m/s².
        let unit = |slot: Slot| real(slot.per_mps2(self.gravity_mps2));
        let scale = SVector::from_fn(|i, _| unit(self.free[i]));
        let (values, vectors) = eigen(normal.scaled(&scale));
        let largest = values.max();
        // Rounding leaves a zero eigenvalue at about this.
        let values = values.map(|v| v.max(largest * R::default_epsilon() * real(0.5)));
        let condition = (largest / values.min()).sqrt();
        let variance = SVector::from_fn(|i, _| {
            (0..N).fold(R::zero(), |sum, k| {
                sum + vectors[(i, k)] * vectors[(i, k)] / values[k]
            })
        });
        let mut amplification = R::zero();
        let mut poorest = Orientation::ALL[0];
        for orientation in Orientation::ALL {
            let force = Vector3::from(orientation.up().map(|c| real(c * self.gravity_mps2)));
            let row = self.derivatives(&at, &at.at(force)).component_mul(&scale);
            let along = vectors.tr_mul(&row);
            let square = (0..N).fold(R::zero(), |sum, k| sum + along[k] * along[k] / values[k]);
            if square > amplification {
                amplification = square;
                poorest = orientation;
            }
        }
        Some(Knowledge {
            condition: double(condition),
            amplification: double(amplification.sqrt()),
            poorest,
            variance,
        })
    }

    /// Goes over the poses that were fitted with each one's residual and leverage.
    pub fn scrutinise<R: Real>(&self, fit: &Fit<R, N>, mut take: impl FnMut(usize, Scrutiny)) {
        let Some(at) = Evaluated::new(&fit.theta) else {
            return;
        };
        for (k, pose) in self.poses.iter().enumerate() {
            if self.rejected.contains(k) {
                continue;
            }
            let (residual, row) = self.row(&at, pose);
            let weight = self.weighting.of(pose);
            take(
                k,
                Scrutiny {
                    residual_mps2: double(residual),
                    noise: pose.mean_noise(),
                    weight,
                    leverage: weight * double(row.dot(&(fit.inverse * row))),
                },
            );
        }
    }

    /// Goes over all poses with the residual of each and the one under the fit to all others:
    /// equation (16); infinite for a pose that cannot be spared.
    pub fn leave_out<R: Real>(&self, fit: &Fit<R, N>, mut take: impl FnMut(usize, f64, f64)) {
        let Some(at) = Evaluated::new(&fit.theta) else {
            return;
        };
        let few = self.poses.len() <= MOST_REFITS;
        for (k, pose) in self.poses.iter().enumerate() {
            let (residual, row) = self.row(&at, pose);
            if self.rejected.contains(k) {
                take(k, double(residual), double(residual));
                continue;
            }
            let weight: R = real(self.weighting.of(pose));
            let step = fit.inverse * row;
            let leverage = weight * row.dot(&step);
            let left_out = if few && double(leverage) > MOST_LEVERAGE {
                self.solve(&fit.theta, Some(k))
                    .and_then(|without| self.residual(&without.theta, pose))
            } else {
                let by = weight * residual / (R::one() - leverage);
                let mut theta = fit.theta;
                for (slot, along) in self.free.iter().zip(step.iter()) {
                    theta[slot.index()] += *along * by;
                }
                self.residual(&theta, pose)
            };
            let left_out = left_out.filter(|r| r.is_finite());
            take(k, double(residual), left_out.unwrap_or(f64::INFINITY));
        }
    }
}

/// What a fit says about one pose.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Scrutiny {
    pub residual_mps2: f64,
    /// Variance of the pose's mean from the sensor's noise, (m/s²)².
    pub noise: f64,
    pub weight: f64,
    /// How much the fit follows this pose, 0 to 1.
    pub leverage: f64,
}

impl Scrutiny {
    /// The residual in standard deviations that the other poses give it, `dof` being those of all:
    /// Student's t with dof − 1. Equation (42).
    pub fn studentized(&self, cost: f64, dof: usize) -> f64 {
        let square =
            self.weight * self.residual_mps2 * self.residual_mps2 / (1.0 - self.leverage).max(1e-9);
        let others = (cost - square) / (dof as f64 - 1.0);
        if others > 0.0 {
            libm::sqrt(square / others)
        } else {
            f64::INFINITY
        }
    }
}

fn more(damping: f64) -> f64 {
    (damping * 10.0).max(LEAST_DAMPING)
}

/// What a set of poses can tell about parameters.
pub(crate) struct Knowledge<R: Real, const N: usize> {
    /// Condition of the Jacobian, its parameters scaled to m/s² at 1 g.
    pub condition: f64,
    /// Standard deviation of |f| − g in the worst of 26 orientations, per unit of the residuals'.
    pub amplification: f64,
    /// That orientation: a pose there adds most.
    pub poorest: Orientation,
    /// Variance of each parameter, as the error that it makes at 1 g, for residuals of unit
    /// variance.
    pub variance: SVector<R, N>,
}

/// Eigenvalues and eigenvectors (columns) of a symmetric matrix by Jacobi rotations, which keep
/// small eigenvalues of a positive definite matrix accurate.
fn eigen<R: Real, const N: usize>(mut m: SMatrix<R, N, N>) -> (SVector<R, N>, SMatrix<R, N, N>) {
    let mut vectors = SMatrix::identity();
    let tiny = m.diagonal().amax() * R::default_epsilon() * real(0.05);
    let ten: R = real(10.0);
    for _ in 0..30 {
        let mut off = R::zero();
        for p in 0..N {
            for q in p + 1..N {
                let size = m[(p, q)].abs();
                if size <= tiny {
                    continue;
                }
                off = off.max(size);
                let half = (m[(q, q)] - m[(p, p)]) / (real::<R>(2.0) * m[(p, q)]);
                let root = (R::one() + half * half).sqrt();
                let sign = if half < R::zero() {
                    -R::one()
                } else {
                    R::one()
                };
                let t = sign / (half.abs() + root);
                let cos = R::one() / (R::one() + t * t).sqrt();
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
        if off <= ten * tiny {
            break;
        }
    }
    (m.diagonal(), vectors)
}

/// |f| that `output` means at `warmer` K above T₀, m/s², and its derivatives with respect to the
/// first twelve parameters: equation (13).
pub(crate) fn magnitude(
    theta: &Theta<f64>,
    output: [f64; 3],
    warmer: f64,
) -> Option<(f64, [f64; 12])> {
    let at = Evaluated::new(theta)?;
    let applied = at.apply(output, 0.0, warmer);
    let (w, n) = at.directions(&applied);
    let row = core::array::from_fn(|i| at.derivative(Slot::ALL[i], &applied, &w, &n));
    Some((applied.force.norm(), row))
}

/// Standard deviation of |f| − g in the worst of 26 orientations, m/s², from the covariance of the
/// first twelve parameters: equation (17).
pub(crate) fn worst_sd(
    theta: &Theta<f64>,
    covariance: &crate::Covariance,
    gravity_mps2: f64,
) -> f64 {
    let Some(at) = Evaluated::new(theta) else {
        return f64::INFINITY;
    };
    let variance = |orientation: Orientation| {
        let applied = at.at(Vector3::from(orientation.up()) * gravity_mps2);
        let (w, n) = at.directions(&applied);
        let row: [f64; 12] =
            core::array::from_fn(|i| at.derivative(Slot::ALL[i], &applied, &w, &n));
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
