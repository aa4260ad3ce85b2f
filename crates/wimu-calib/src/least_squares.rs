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
/// A step that changes the residuals by less than this, m/s² rms, is the last: what a Gauss-Newton
/// step leaves is smaller than it by a factor of the residuals per gravity, 10⁻³ or less.
const LAST_STEP_MPS2: f64 = 1e-6;
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

    /// Without the one at `place`.
    pub(crate) fn without(mut self, place: usize) -> Self {
        if place < self.count {
            self.poses.copy_within(place + 1..self.count, place);
            self.count -= 1;
        }
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

    pub fn is_equal(&self) -> bool {
        self.mean_noise <= 0.0
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
    /// 1 / the time from the first to it, 1/s; 0 where that does not matter.
    pub per_span: f64,
    /// T₀, °C.
    pub reference_c: f64,
}

impl Conditions {
    /// −1 at the first pose, 0 at the last.
    fn progress(&self, pose: &Pose) -> f64 {
        (pose.time_s - self.end_s) * self.per_span
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
    /// Whether more than the first twelve parameters are asked for, or are not 0.
    terms: bool,
}

/// A⁻¹ of a matrix that is not mirrored: a mirrored A gives the same magnitudes, and a step that
/// leads to one was too long.
#[inline(always)]
fn inverse<R: Real>(a: &Matrix3<R>) -> Option<Matrix3<R>> {
    let minor = |r: usize, c: usize| {
        let (i, j) = ((r + 1) % 3, (r + 2) % 3);
        let (k, l) = ((c + 1) % 3, (c + 2) % 3);
        a[(i, k)] * a[(j, l)] - a[(i, l)] * a[(j, k)]
    };
    let minors = Matrix3::from_fn(|r, c| minor(c, r));
    let determinant =
        a[(0, 0)] * minors[(0, 0)] + a[(0, 1)] * minors[(1, 0)] + a[(0, 2)] * minors[(2, 0)];
    let factor = R::one() / determinant;
    (determinant > R::zero() && factor.is_finite()).then(|| minors * factor)
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
    #[inline(always)]
    fn new(theta: &'a Theta<R>, terms: bool) -> Option<Self> {
        Some(Self {
            theta,
            inverse: inverse(&Self::matrix(theta, R::zero()))?,
            warms: terms
                && Slot::SCALE_SLOPE
                    .iter()
                    .any(|slot| !theta[slot.index()].is_zero()),
            terms,
        })
    }

    fn matrix(theta: &Theta<R>, warmer: R) -> Matrix3<R> {
        let mut a = Matrix3::from_fn(|r, c| theta[3 + 3 * r + c]);
        if !warmer.is_zero() {
            for axis in 0..3 {
                a[(axis, axis)] *= R::one() + theta[Slot::SCALE_SLOPE[axis].index()] * warmer;
            }
        }
        a
    }

    /// The specific force that `output` means: equation (41).
    #[inline(always)]
    fn apply(&self, output: [R; 3], progress: R, warmer: R) -> Applied<R> {
        let theta = self.theta;
        let inverse = if self.warms && !warmer.is_zero() {
            inverse(&Self::matrix(theta, warmer)).unwrap_or(self.inverse)
        } else {
            self.inverse
        };
        let mut offset = Vector3::from_fn(|i, _| output[i] - theta[i]);
        if self.terms {
            for i in 0..3 {
                offset[i] -= theta[12 + i] * progress + theta[15 + i] * warmer;
            }
        }
        let z = inverse * offset;
        let mut force = z;
        if self.terms {
            for i in 0..3 {
                force[i] -= theta[21 + i] * z[i] * z[i];
            }
        }
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
    #[inline(always)]
    fn directions(&self, at: &Applied<R>) -> (Vector3<R>, Vector3<R>) {
        let norm = at.force.norm();
        let n = if norm > R::zero() {
            at.force / norm
        } else {
            at.force
        };
        let mut m = n;
        if self.terms {
            let two: R = real(2.0);
            for i in 0..3 {
                m[i] *= R::one() - two * self.theta[21 + i] * at.z[i];
            }
        }
        (at.inverse.tr_mul(&m), n)
    }

    /// ∂|f|/∂θ of all parameters: equations (13) and (41).
    #[inline(always)]
    fn derivatives(&self, at: &Applied<R>) -> Theta<R> {
        let (w, n) = self.directions(at);
        let z = &at.z;
        let mut d = [R::zero(); Slot::COUNT];
        for row in 0..3 {
            d[row] = -w[row];
            for column in 0..3 {
                d[3 + 3 * row + column] = -w[row] * z[column];
            }
        }
        if !self.terms {
            return d;
        }
        for row in 0..3 {
            d[12 + row] = -w[row] * at.progress;
            d[15 + row] = -w[row] * at.warmer;
            d[18 + row] = d[3 + 4 * row] * self.theta[3 + 4 * row] * at.warmer;
            d[3 + 4 * row] *= R::one() + self.theta[18 + row] * at.warmer;
            d[21 + row] = -n[row] * z[row] * z[row];
        }
        d
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

    /// The damped Gauss-Newton step: equation (14).
    fn step(&self, damping: f64) -> Option<Step<R, N>> {
        let scale = self.scale()?;
        let mut information = self.scaled(&scale);
        for i in 0..N {
            information[(i, i)] += real(damping);
        }
        let factor = factor(information)?;
        let step = -factor.solve(&self.gradient.component_mul(&scale));
        Some(Step {
            change_mps2: libm::sqrt(double(step.norm_squared()) / self.poses as f64),
            by: step.component_mul(&scale),
            scale,
            factor,
        })
    }

    fn inverse(&self) -> Option<SMatrix<R, N, N>> {
        let scale = self.scale()?;
        Some(unscaled(&factor(self.scaled(&scale))?, &scale))
    }
}

/// A step, and what it was computed with.
struct Step<R: Real, const N: usize> {
    by: SVector<R, N>,
    /// The change of residual that it means, m/s² rms.
    change_mps2: f64,
    scale: SVector<R, N>,
    factor: Cholesky<R, Const<N>>,
}

fn unscaled<R: Real, const N: usize>(
    factor: &Cholesky<R, Const<N>>,
    scale: &SVector<R, N>,
) -> SMatrix<R, N, N> {
    let inverse = factor.inverse();
    SMatrix::from_fn(|r, c| inverse[(r, c)] * scale[r] * scale[c])
}

/// A product, column by column, which compilers turn into vector instructions.
#[inline(always)]
fn times<R: Real, const N: usize>(m: &SMatrix<R, N, N>, v: &SVector<R, N>) -> SVector<R, N> {
    let mut product = [R::zero(); N];
    for c in 0..N {
        for r in 0..N {
            product[r] += m[(r, c)] * v[c];
        }
    }
    SVector::from(product)
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
    normal: Normal<R, N>,
}

impl<R: Real, const N: usize> Fit<R, N> {
    /// Standard deviation of a residual, m/s².
    pub fn sd(&self, dof: usize) -> f64 {
        libm::sqrt(self.cost / dof.max(1) as f64)
    }
}

impl<const N: usize> Magnitude<'_, N> {
    fn has_terms(&self) -> bool {
        self.free.iter().any(|slot| slot.term().is_some())
    }

    #[inline(always)]
    fn applied<R: Real>(&self, at: &Evaluated<R>, pose: &Pose) -> Applied<R> {
        at.apply(
            pose.mean_mps2.map(real),
            real(self.conditions.progress(pose)),
            real(self.conditions.warmer(pose)),
        )
    }

    /// |f| − g of one pose, m/s², and its derivatives.
    #[inline(always)]
    fn row<R: Real>(&self, at: &Evaluated<R>, pose: &Pose) -> (R, SVector<R, N>) {
        let applied = self.applied(at, pose);
        let residual = applied.force.norm() - real(self.gravity_mps2);
        (residual, self.derivatives(at, &applied))
    }

    #[inline(always)]
    fn derivatives<R: Real>(&self, at: &Evaluated<R>, applied: &Applied<R>) -> SVector<R, N> {
        let all = at.derivatives(applied);
        SVector::from_fn(|i, _| all[self.free[i].index()])
    }

    fn normal<R: Real>(&self, theta: &Theta<R>, skip: Option<usize>) -> Option<Normal<R, N>> {
        self.weighted_normal(theta, skip, &self.weighting, None)
    }

    /// With `cauchy`, m/s², each residual counts as cauchy² ln(1 + (r/cauchy)²) instead of r².
    fn weighted_normal<R: Real>(
        &self,
        theta: &Theta<R>,
        skip: Option<usize>,
        weighting: &Weighting,
        cauchy: Option<f64>,
    ) -> Option<Normal<R, N>> {
        let at = Evaluated::new(theta, self.has_terms())?;
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
            let mut weight: R = real(weighting.of(pose));
            let mut cost = weight * residual * residual;
            if let Some(cauchy) = cauchy {
                let square: R = real(cauchy * cauchy);
                let grown = R::one() + residual * residual / square;
                cost = square * grown.ln();
                weight = R::one() / grown;
            }
            for c in 0..N {
                let weighted = row[c] * weight;
                normal.gradient[c] += weighted * residual;
                for r in c..N {
                    normal.information[(r, c)] += weighted * row[r];
                }
            }
            normal.cost += cost;
            normal.poses += 1;
        }
        normal.cost.is_finite().then_some(normal)
    }

    /// Damped Gauss-Newton from `start`, leaving out pose `skip`. `None` when it does not converge
    /// or a parameter is not determined at all.
    pub fn solve<R: Real>(&self, start: &Theta<R>, skip: Option<usize>) -> Option<Fit<R, N>> {
        self.minimise(start, |theta| self.normal(theta, skip))
    }

    /// The fit that large residuals pull on ever less, beyond `cauchy`, m/s².
    pub fn solve_robust<R: Real>(&self, start: &Theta<R>, cauchy: f64) -> Option<Fit<R, N>> {
        let normal =
            |theta: &Theta<R>| self.weighted_normal(theta, None, &Weighting::EQUAL, Some(cauchy));
        self.minimise(start, normal)
    }

    fn minimise<R: Real>(
        &self,
        start: &Theta<R>,
        normal_at: impl Fn(&Theta<R>) -> Option<Normal<R, N>>,
    ) -> Option<Fit<R, N>> {
        let epsilon = double(R::default_epsilon());
        let last_step = LAST_STEP_MPS2.max(4.0 * epsilon * self.gravity_mps2);
        let mut theta = *start;
        let mut normal = normal_at(&theta)?;
        let mut damping = 0.0;
        for _ in 0..MOST_ITERATIONS {
            let Some(step) = normal.step(damping) else {
                if damping > 1.0 {
                    return None;
                }
                damping = more(damping);
                continue;
            };
            let mut trial = theta;
            for (slot, by) in self.free.iter().zip(step.by.iter()) {
                trial[slot.index()] += *by;
            }
            if damping < LEAST_DAMPING && step.change_mps2 <= last_step {
                // The step lowers the cost by its own square.
                let gained = step.change_mps2 * step.change_mps2 * normal.poses as f64;
                return Some(Fit {
                    theta: trial,
                    inverse: if damping > 0.0 {
                        normal.inverse()?
                    } else {
                        unscaled(&step.factor, &step.scale)
                    },
                    cost: (double(normal.cost) - gained).max(0.0),
                    normal,
                });
            }
            let cost = double(normal.cost);
            // That of a sum of squares.
            let rounding =
                20.0 * epsilon * self.gravity_mps2 * libm::sqrt(cost * normal.poses as f64);
            match normal_at(&trial) {
                Some(next) if double(next.cost) <= cost + rounding => {
                    theta = trial;
                    normal = next;
                    damping = if damping > LEAST_DAMPING {
                        damping * 0.1
                    } else {
                        0.0
                    };
                }
                _ if damping > MOST_DAMPING => return None,
                _ => damping = more(damping),
            }
        }
        None
    }

    /// |f| − g of `pose` under `theta`, m/s².
    pub fn residual<R: Real>(&self, theta: &Theta<R>, pose: &Pose) -> Option<f64> {
        let at = Evaluated::new(theta, self.has_terms())?;
        Some(double(
            self.applied(&at, pose).force.norm() - real(self.gravity_mps2),
        ))
    }

    /// What the poses' orientations tell of the parameters that were fitted.
    pub fn knowledge<R: Real>(&self, fit: &Fit<R, N>) -> Option<Knowledge<R, N>> {
        if self.weighting.is_equal() {
            let at = Evaluated::new(&fit.theta, self.has_terms())?;
            self.told(&at, &fit.normal, &fit.inverse)
        } else {
            self.knowledge_at(&fit.theta)
        }
    }

    /// The same at `theta`, converged or not.
    pub fn knowledge_at<R: Real>(&self, theta: &Theta<R>) -> Option<Knowledge<R, N>> {
        let at = Evaluated::new(theta, self.has_terms())?;
        let normal = self.weighted_normal(theta, None, &Weighting::EQUAL, None)?;
        if let Some(inverse) = normal.inverse() {
            return self.told(&at, &normal, &inverse);
        }
        // Rounding leaves a zero eigenvalue at about this.
        let units = self.units();
        let (values, vectors) = eigen(normal.scaled(&units));
        let largest = values.max();
        let least = largest * R::default_epsilon() * real(0.5);
        let inverse = SMatrix::from_fn(|r, c| {
            (0..N).fold(R::zero(), |sum, k| {
                sum + vectors[(r, k)] * vectors[(c, k)] / values[k].max(least)
            }) * units[r]
                * units[c]
        });
        let condition = (largest / values.min().max(least)).sqrt();
        Some(self.with_condition(&at, condition, &inverse))
    }

    /// Every parameter as the error that it makes at 1 g, m/s².
    fn units<R: Real>(&self) -> SVector<R, N> {
        SVector::from_fn(|i, _| real(self.free[i].per_mps2(self.gravity_mps2)))
    }

    fn told<R: Real>(
        &self,
        at: &Evaluated<R>,
        normal: &Normal<R, N>,
        inverse: &SMatrix<R, N, N>,
    ) -> Option<Knowledge<R, N>> {
        let (least, largest) = eigenvalue_range(normal.scaled(&self.units()))?;
        let floor = largest * R::default_epsilon() * real(0.5);
        let condition = (largest / least.max(floor)).sqrt();
        Some(self.with_condition(at, condition, inverse))
    }

    fn with_condition<R: Real>(
        &self,
        at: &Evaluated<R>,
        condition: R,
        inverse: &SMatrix<R, N, N>,
    ) -> Knowledge<R, N> {
        let units = self.units::<R>();
        let mut worst = R::zero();
        let mut poorest = Orientation::ALL[0];
        let mut see = |variance: R, orientation: Orientation| {
            if variance > worst {
                worst = variance;
                poorest = orientation;
            }
        };
        let row = |orientation: Orientation| {
            let force = Vector3::from(orientation.up().map(|c| real(c * self.gravity_mps2)));
            self.derivatives(at, &at.at(force))
        };
        if at.terms {
            for orientation in Orientation::ALL {
                let row = row(orientation);
                see(row.dot(&times(inverse, &row)), orientation);
            }
        } else {
            // Opposite orientations differ in the sign of the bias's derivatives, the first three.
            let opposites = Orientation::ALL.iter().zip(Orientation::ALL.iter().rev());
            for (&one, &other) in opposites.take(Orientation::ALL.len() / 2) {
                let mut rest = row(one);
                let mut bias = SVector::<R, N>::zeros();
                for i in 0..3.min(N) {
                    bias[i] = rest[i];
                    rest[i] = R::zero();
                }
                let along = times(inverse, &rest);
                let mut own = R::zero();
                for r in 0..3.min(N) {
                    for c in 0..3.min(N) {
                        own += bias[r] * inverse[(r, c)] * bias[c];
                    }
                }
                let (square, cross) = (rest.dot(&along) + own, bias.dot(&along));
                see(square + cross + cross, one);
                see(square - cross - cross, other);
            }
        }
        Knowledge {
            condition: double(condition),
            amplification: double(worst.sqrt()),
            poorest,
            variance: SVector::from_fn(|i, _| inverse[(i, i)] / (units[i] * units[i])),
        }
    }

    /// Goes over the poses with the residual of each under `theta`, m/s².
    pub fn residuals<R: Real>(&self, theta: &Theta<R>, mut take: impl FnMut(usize, f64)) {
        let Some(at) = Evaluated::new(theta, self.has_terms()) else {
            return;
        };
        for (k, pose) in self.poses.iter().enumerate() {
            let norm = self.applied(&at, pose).force.norm();
            take(k, double(norm - real(self.gravity_mps2)));
        }
    }

    /// Residual of a pose that was left out, m/s², and the variance of its prediction per that of a
    /// residual.
    pub fn predicted<R: Real>(&self, fit: &Fit<R, N>, pose: usize) -> Option<(f64, f64)> {
        let at = Evaluated::new(&fit.theta, self.has_terms())?;
        let (residual, row) = self.row(&at, self.poses.get(pose)?);
        Some((
            double(residual),
            double(row.dot(&times(&fit.inverse, &row))),
        ))
    }

    /// Goes over all poses with the residual of each and the one under the fit to all others:
    /// equation (16); infinite for a pose that cannot be spared.
    pub fn leave_out<R: Real>(&self, fit: &Fit<R, N>, mut take: impl FnMut(usize, f64, f64)) {
        let Some(at) = Evaluated::new(&fit.theta, self.has_terms()) else {
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
            let step = times(&fit.inverse, &row);
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

/// The least and the largest eigenvalue of a positive definite matrix (its lower triangle), to four
/// digits: Householder's tridiagonal form, then QL steps with implicit shifts [GL].
fn eigenvalue_range<R: Real, const N: usize>(mut m: SMatrix<R, N, N>) -> Option<(R, R)> {
    let two: R = real(2.0);
    let mut beside = [R::zero(); N];
    for k in 0..N.saturating_sub(1) {
        let first = m[(k + 1, k)];
        let rest = (k + 2..N).fold(R::zero(), |sum, i| sum + m[(i, k)] * m[(i, k)]);
        if rest.is_zero() {
            beside[k] = first;
            continue;
        }
        let norm = (first * first + rest).sqrt();
        let alpha = if first > R::zero() { -norm } else { norm };
        let mut v = [R::zero(); N];
        for i in k + 1..N {
            v[i] = m[(i, k)];
        }
        v[k + 1] -= alpha;
        let beta = R::one() / (norm * (norm + first.abs()));
        let mut p = [R::zero(); N];
        for c in k + 1..N {
            for r in k + 1..N {
                p[r] += m[(r.max(c), r.min(c))] * v[c] * beta;
            }
        }
        let half = (k + 1..N).fold(R::zero(), |sum, i| sum + v[i] * p[i]) * beta / two;
        for c in k + 1..N {
            let (vc, wc) = (v[c], p[c] - half * v[c]);
            for r in c..N {
                m[(r, c)] -= v[r] * wc + (p[r] - half * v[r]) * vc;
            }
        }
        beside[k] = alpha;
    }
    let mut values: [R; N] = core::array::from_fn(|i| m[(i, i)]);
    let negligible = R::default_epsilon().max(real(1e-10));
    for l in 0..N {
        for round in 0.. {
            let split = (l..N - 1).find(|&i| {
                let size = values[i].abs() + values[i + 1].abs();
                beside[i].abs() <= negligible * size
            });
            let end = split.unwrap_or(N - 1);
            if end == l {
                break;
            }
            if round > 30 {
                return None;
            }
            let hypotenuse = |a: R, b: R| (a * a + b * b).sqrt();
            let mut g = (values[l + 1] - values[l]) / (two * beside[l]);
            let root = hypotenuse(g, R::one());
            let shift = if g < R::zero() { g - root } else { g + root };
            g = values[end] - values[l] + beside[l] / shift;
            let (mut s, mut c, mut p) = (R::one(), R::one(), R::zero());
            let mut recovered = false;
            for i in (l..end).rev() {
                let (f, b) = (s * beside[i], c * beside[i]);
                let r = hypotenuse(f, g);
                beside[i + 1] = r;
                if r.is_zero() {
                    values[i + 1] -= p;
                    recovered = true;
                    break;
                }
                let inverse = R::one() / r;
                s = f * inverse;
                c = g * inverse;
                g = values[i + 1] - p;
                let t = (values[i] - g) * s + two * c * b;
                p = s * t;
                values[i + 1] = g + p;
                g = c * t - b;
            }
            if !recovered {
                values[l] -= p;
                beside[l] = g;
            }
            beside[end] = R::zero();
        }
    }
    let least = values.iter().fold(values[0], |a, b| a.min(*b));
    let largest = values.iter().fold(values[0], |a, b| a.max(*b));
    Some((least, largest))
}

/// Eigenvalues and eigenvectors (columns) of a symmetric matrix (its lower triangle) by Jacobi
/// rotations, which keep small eigenvalues of a positive definite matrix accurate.
pub(crate) fn eigen<R: Real, const N: usize>(
    mut m: SMatrix<R, N, N>,
) -> (SVector<R, N>, SMatrix<R, N, N>) {
    let mut vectors = SMatrix::<R, N, N>::identity();
    let tiny = m.diagonal().amax() * R::default_epsilon() * real(0.05);
    for _ in 0..30 {
        let mut done = true;
        for q in 1..N {
            for p in 0..q {
                let off = m[(q, p)];
                if off.abs() <= tiny {
                    continue;
                }
                done = false;
                let (app, aqq) = (m[(p, p)], m[(q, q)]);
                let half = (aqq - app) / (off + off);
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
                    if k != p && k != q {
                        let (i, j) = ((k.max(p), k.min(p)), (k.max(q), k.min(q)));
                        let (a, b) = (m[i], m[j]);
                        m[i] = cos * a - sin * b;
                        m[j] = sin * a + cos * b;
                    }
                    let (a, b) = (vectors[(k, p)], vectors[(k, q)]);
                    vectors[(k, p)] = cos * a - sin * b;
                    vectors[(k, q)] = sin * a + cos * b;
                }
                m[(p, p)] = app - t * off;
                m[(q, q)] = aqq + t * off;
                m[(q, p)] = R::zero();
            }
        }
        if done {
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
    let at = Evaluated::new(theta, true)?;
    let applied = at.apply(output, 0.0, warmer);
    let all = at.derivatives(&applied);
    Some((applied.force.norm(), core::array::from_fn(|i| all[i])))
}

/// Standard deviation of |f| − g in the worst of 26 orientations, m/s², from the covariance of the
/// first twelve parameters: equation (17).
pub(crate) fn worst_sd(
    theta: &Theta<f64>,
    covariance: &crate::Covariance,
    gravity_mps2: f64,
) -> f64 {
    let Some(at) = Evaluated::new(theta, true) else {
        return f64::INFINITY;
    };
    let variance = |orientation: Orientation| {
        let applied = at.at(Vector3::from(orientation.up()) * gravity_mps2);
        let all = at.derivatives(&applied);
        let row: [f64; 12] = core::array::from_fn(|i| all[i]);
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_two_ways_to_eigenvalues_agree() {
        let mut state = 1_u32;
        for round in 0..200 {
            let j = SMatrix::<f64, 9, 9>::from_fn(|_, c| {
                state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                // Down to a condition of 10⁻⁴ in some rounds.
                let size = if c == round % 9 { 1e-4 } else { 1.0 };
                (f64::from(state >> 8) / f64::from(1 << 23) - 1.0) * size
            });
            let m = j.tr_mul(&j) + SMatrix::identity() * 1e-10;
            let (values, vectors) = eigen(m);
            let again = vectors * SMatrix::from_diagonal(&values) * vectors.transpose();
            assert!((again - m).norm() < 1e-12 * m.norm());
            let (least, largest) = eigenvalue_range(m).expect("it converges");
            assert!(
                (largest / values.max() - 1.0).abs() < 1e-5,
                "{largest} {}",
                values.max()
            );
            assert!(
                (least / values.min() - 1.0).abs() < 1e-3,
                "{least} {}",
                values.min()
            );
        }
        // Diagonal already, and of equal values.
        let (least, largest) =
            eigenvalue_range(SMatrix::<f64, 3, 3>::from_diagonal_element(2.0)).expect("a range");
        assert_eq!((least, largest), (2.0, 2.0));
    }
}
