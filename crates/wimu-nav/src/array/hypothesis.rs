//! One history of an array's body, and what a sample makes of it: equations (96) to (98).

use super::filter::ArrayConfig;
use super::matrix::{
    cholesky, cross_matrix, inverse, log_determinant, product, rotation, rotation_vector, solve,
    times, transposed,
};
use super::solver::{ArraySolver, Linear};
use crate::Real;

/// Attitude, velocity, position, ω, ω̇, bias of ω̇, bias of s, biases of z.
pub(super) const STATES: usize = 27;
pub(super) const PHI: usize = 0;
pub(super) const VELOCITY: usize = 3;
pub(super) const POSITION: usize = 6;
pub(super) const OMEGA: usize = 9;
pub(super) const TURN: usize = 12;
pub(super) const TURN_BIAS: usize = 15;
pub(super) const FORCE_BIAS: usize = 18;
pub(super) const Z_BIAS: usize = 21;

/// What a sample measures of ω and ω̇: ω̇, z.
pub(super) const MEASURED: usize = 9;
/// ω and ω̇: what the measurement is not linear in, and goes with it.
pub(super) const TURNING: usize = 6;
/// Two hypotheses closer than this many variances in ω and ω̇ are one.
const SAME: f64 = 1.0;
/// A root this many variances from where a hypothesis expects ω is not tried.
const REACH: f64 = 60.0;
/// Degrees of freedom of the t-distribution by which hypotheses are weighed: outliers must not
/// decide.
pub(super) const WEIGHT_FREEDOM: f64 = 10.0;
const MOST_STEPS: usize = 12;

/// One history of the body that fits what was measured.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Hypothesis<R> {
    /// Logarithm of its probability.
    pub(super) weight: f64,
    pub(super) attitude: [[R; 3]; 3],
    /// Acceleration at the sample before, navigation axes.
    pub(super) acceleration: [R; 3],
    pub(super) mean: [R; STATES],
    pub(super) cov: [[R; STATES]; STATES],
}

/// What one hypothesis makes of a sample, before the rest of its state follows.
#[derive(Clone, Copy, Debug)]
pub(super) struct Candidate<R> {
    pub(super) parent: usize,
    pub(super) misfit: f64,
    pub(super) turning: [R; TURNING],
    pub(super) weight: f64,
}

/// ω and ω̇ that a sample and a hypothesis agree on.
#[derive(Clone, Copy, Debug)]
pub(super) struct Found<R> {
    pub(super) turning: [R; TURNING],
    /// Logarithm of the probability.
    pub(super) weight: f64,
    /// χ² of what is left of both.
    pub(super) misfit: f64,
}

/// Noise of a sample.
#[derive(Clone, Copy, Debug)]
pub(super) struct Noise<R> {
    /// In units of the declared variance.
    pub(super) factor: R,
    /// Variance of the ω̇ that lasts for one sample only, (rad/s²)².
    pub(super) fast: R,
    /// Variance of s that vibration adds, (m/s²)².
    pub(super) vibration: R,
}

pub(super) fn r<R: Real>(value: f64) -> R {
    R::from_f64(value)
}

pub(super) fn dot<R: Real, const N: usize>(a: &[R; N], b: &[R; N]) -> R {
    let mut sum = R::default();
    for (x, y) in a.iter().zip(b) {
        sum += *x * *y;
    }
    sum
}

pub(super) fn part<R: Real>(v: &[R; STATES], at: usize) -> [R; 3] {
    [v[at], v[at + 1], v[at + 2]]
}

pub(super) fn block<R: Real>(m: &[[R; STATES]; STATES], row: usize, column: usize) -> [[R; 3]; 3] {
    core::array::from_fn(|i| core::array::from_fn(|j| m[row + i][column + j]))
}

pub(super) fn scaled_identity<R: Real>(by: R) -> [[R; 3]; 3] {
    let mut m = [[R::default(); 3]; 3];
    for (i, row) in m.iter_mut().enumerate() {
        row[i] = by;
    }
    m
}

/// P ← F P Fᵀ for F that adds `m` times block `from` to block `to`.
pub(super) fn couple<R: Real>(
    cov: &mut [[R; STATES]; STATES],
    to: usize,
    from: usize,
    m: &[[R; 3]; 3],
) {
    for column in 0..STATES {
        let source = [
            cov[from][column],
            cov[from + 1][column],
            cov[from + 2][column],
        ];
        for i in 0..3 {
            cov[to + i][column] += dot(&m[i], &source);
        }
    }
    for row in cov.iter_mut() {
        let source = [row[from], row[from + 1], row[from + 2]];
        for i in 0..3 {
            row[to + i] += dot(&m[i], &source);
        }
    }
}

/// ω and ω̇ of a hypothesis, and how a sample is expected to follow from them.
pub(super) struct View<R> {
    pub(super) mean: [R; TURNING],
    /// Cholesky factor of P of ω.
    rate: [[R; 3]; 3],
    /// P⁻¹ of ω and ω̇.
    information: [[R; TURNING]; TURNING],
    log_determinant: f64,
    /// Mean of the biases, and how it moves with ω and ω̇.
    bias: [R; MEASURED],
    slope: [[R; TURNING]; MEASURED],
    /// Inverse of the covariance of what is measured at known ω and ω̇.
    precision: [[R; MEASURED]; MEASURED],
    freedom: f64,
}

/// Where the biases of what is measured are among the states.
fn bias_of(row: usize) -> usize {
    if row < 3 {
        TURN_BIAS + row
    } else {
        Z_BIAS + row - 3
    }
}

/// Noise of what is measured.
fn noise_of<R: Real, const M: usize>(
    solver: &ArraySolver<R, M>,
    noise: &Noise<R>,
) -> [[R; MEASURED]; MEASURED] {
    let covariance = solver.covariance();
    let mut out = [[R::default(); MEASURED]; MEASURED];
    for i in 0..3 {
        for j in 0..3 {
            out[i][j] = r::<R>(covariance[i][j]) * noise.factor;
        }
        out[i][i] += noise.fast;
    }
    for (i, row) in out.iter_mut().enumerate().skip(3) {
        row[i] = noise.factor;
    }
    out
}

impl<R: Real> View<R> {
    pub(super) fn of<const M: usize>(
        hypothesis: &Hypothesis<R>,
        solver: &ArraySolver<R, M>,
        noise: &Noise<R>,
    ) -> Option<Self> {
        let cov = &hypothesis.cov;
        let own: [[R; TURNING]; TURNING] =
            core::array::from_fn(|i| core::array::from_fn(|j| cov[OMEGA + i][OMEGA + j]));
        let factor = cholesky(&own)?;
        let information = inverse(&factor);
        let crossed: [[R; TURNING]; MEASURED] =
            core::array::from_fn(|row| core::array::from_fn(|j| cov[bias_of(row)][OMEGA + j]));
        let slope = product(&crossed, &information);
        let explained = product(&slope, &transposed(&crossed));
        let mut total = noise_of(solver, noise);
        for i in 0..MEASURED {
            for j in 0..MEASURED {
                total[i][j] += cov[bias_of(i)][bias_of(j)] - explained[i][j];
            }
        }
        Some(Self {
            mean: core::array::from_fn(|i| hypothesis.mean[OMEGA + i]),
            rate: core::array::from_fn(|i| core::array::from_fn(|j| factor[i][j])),
            information,
            log_determinant: log_determinant(&factor),
            bias: core::array::from_fn(|row| hypothesis.mean[bias_of(row)]),
            slope,
            precision: inverse(&cholesky(&total)?),
            freedom: (solver.rank() + 3) as f64,
        })
    }

    pub(super) fn apart(&self, a: &[R; TURNING], b: &[R; TURNING]) -> f64 {
        let d: [R; TURNING] = core::array::from_fn(|i| a[i] - b[i]);
        dot(&d, &times(&self.information, &d)).to_f64()
    }

    pub(super) fn within_reach(&self, start: &[R; TURNING]) -> bool {
        let away: [R; 3] = core::array::from_fn(|i| start[i] - self.mean[i]);
        dot(&away, &solve(&self.rate, &away)).to_f64() < REACH
    }

    /// What is left of a sample at `x`, and its derivatives.
    fn residual<const M: usize>(
        &self,
        solver: &ArraySolver<R, M>,
        measured: &[R; MEASURED],
        x: &[R; TURNING],
    ) -> ([R; MEASURED], [[R; TURNING]; MEASURED]) {
        let (value, mut jacobian) = expected(solver, x);
        let away: [R; TURNING] = core::array::from_fn(|i| x[i] - self.mean[i]);
        let moved = times(&self.slope, &away);
        let mut residual = [R::default(); MEASURED];
        for row in 0..MEASURED {
            residual[row] = measured[row] - value[row] - self.bias[row] - moved[row];
            for (j, slope) in jacobian[row].iter_mut().zip(&self.slope[row]) {
                *j += *slope;
            }
        }
        (residual, jacobian)
    }

    /// The likeliest ω and ω̇ near a start, and the logarithm of the probability of what lies about it:
    /// damped Gauss-Newton, Laplace's approximation.
    pub(super) fn refine<const M: usize>(
        &self,
        solver: &ArraySolver<R, M>,
        measured: &[R; MEASURED],
        start: [R; TURNING],
    ) -> Option<Found<R>> {
        let cost = |x: &[R; TURNING], residual: &[R; MEASURED]| {
            self.apart(x, &self.mean) + dot(residual, &times(&self.precision, residual)).to_f64()
        };
        let mut x = start;
        let (mut residual, mut jacobian) = self.residual(solver, measured, &x);
        let mut best = cost(&x, &residual);
        let mut damping = 0.0;
        let mut hessian = self.hessian(&jacobian);
        for _ in 0..MOST_STEPS {
            let weighted = times(&self.precision, &residual);
            let back: [R; TURNING] = core::array::from_fn(|i| self.mean[i] - x[i]);
            let mut gradient = times(&self.information, &back);
            for (row, w) in jacobian.iter().zip(weighted) {
                for (g, j) in gradient.iter_mut().zip(row) {
                    *g += *j * w;
                }
            }
            let mut damped = hessian;
            for (i, row) in damped.iter_mut().enumerate() {
                row[i] = row[i] * r(1.0 + damping);
            }
            let step = solve(&cholesky(&damped)?, &gradient);
            let trial: [R; TURNING] = core::array::from_fn(|i| x[i] + step[i]);
            let (next, slope) = self.residual(solver, measured, &trial);
            let value = cost(&trial, &next);
            if value <= best {
                let gain = dot(&step, &gradient).to_f64();
                (x, residual, jacobian, best) = (trial, next, slope, value);
                hessian = self.hessian(&jacobian);
                damping *= 0.1;
                if gain < 1e-3 {
                    break;
                }
            } else if value.is_nan() || damping > 1e3 {
                break;
            } else {
                damping = (damping * 10.0).max(1e-3);
            }
        }
        let narrowed = log_determinant(&cholesky(&hessian)?) + self.log_determinant;
        let spread = (WEIGHT_FREEDOM + self.freedom) * libm::log1p(best / WEIGHT_FREEDOM);
        let weight = -0.5 * (spread + narrowed);
        weight.is_finite().then_some(Found {
            turning: x,
            weight,
            misfit: best,
        })
    }

    fn hessian(&self, jacobian: &[[R; TURNING]; MEASURED]) -> [[R; TURNING]; TURNING] {
        let mut hessian = product(&transposed(jacobian), &product(&self.precision, jacobian));
        for (row, more) in hessian.iter_mut().zip(&self.information) {
            for (h, i) in row.iter_mut().zip(more) {
                *h += *i;
            }
        }
        hessian
    }
}

/// ω̇ and z as they should be at ω and ω̇, and their derivatives.
fn expected<R: Real, const M: usize>(
    solver: &ArraySolver<R, M>,
    x: &[R; TURNING],
) -> ([R; MEASURED], [[R; TURNING]; MEASURED]) {
    let rate = [x[0], x[1], x[2]];
    let (theta, theta_slope) = solver.expected_theta(rate);
    let (z, z_slope) = solver.expected_z(rate);
    let mut value = [R::default(); MEASURED];
    let mut jacobian = [[R::default(); TURNING]; MEASURED];
    for row in 0..MEASURED {
        let slope = if row < 3 {
            value[row] = theta[row] + x[3 + row];
            jacobian[row][3 + row] = r(1.0);
            theta_slope[row]
        } else {
            value[row] = z[row - 3];
            z_slope[row - 3]
        };
        jacobian[row][..3].copy_from_slice(&slope);
    }
    (value, jacobian)
}

impl<R: Real> Hypothesis<R> {
    /// Biases as they are before anything is known: those of the axes, brought to θ and z; those of s where `all`.
    pub(super) fn begin_biases<const M: usize>(
        &mut self,
        solver: &ArraySolver<R, M>,
        config: &ArrayConfig,
        all: bool,
    ) {
        let share = config.bias_mps2 * config.bias_mps2 / solver.variance_mps2().to_f64();
        let kept = |at: usize| !all && (FORCE_BIAS..Z_BIAS).contains(&at);
        for at in (TURN_BIAS..STATES).filter(|at| !kept(*at)) {
            self.mean[at] = R::default();
            for k in 0..STATES {
                self.cov[at][k] = R::default();
                self.cov[k][at] = R::default();
            }
        }
        let covariance = solver.covariance();
        for i in 0..6 {
            for j in 0..6 {
                if !(kept(TURN_BIAS + i) || kept(TURN_BIAS + j)) {
                    self.cov[TURN_BIAS + i][TURN_BIAS + j] = r(covariance[i][j] * share);
                }
            }
            if i < solver.rank() {
                self.cov[Z_BIAS + i][Z_BIAS + i] = r(share);
            }
        }
        if all {
            for i in FORCE_BIAS..Z_BIAS {
                self.cov[i][i] += r(config.common_bias_mps2 * config.common_bias_mps2);
            }
        }
    }

    /// Of the biases of ω̇ and z this share is kept.
    pub(super) fn forget_part(&mut self, kept: R) {
        for at in (TURN_BIAS..FORCE_BIAS).chain(Z_BIAS..STATES) {
            self.mean[at] = self.mean[at] * kept;
            for k in 0..STATES {
                self.cov[at][k] = self.cov[at][k] * kept;
            }
            for row in &mut self.cov {
                row[at] = row[at] * kept;
            }
        }
    }

    /// The hypothesis after a sample, linearised where the candidate found ω and ω̇.
    pub(super) fn measured<const M: usize>(
        &self,
        solver: &ArraySolver<R, M>,
        measured: &[R; MEASURED],
        noise: &Noise<R>,
        candidate: &Candidate<R>,
    ) -> Option<Self> {
        let (value, jacobian) = expected(solver, &candidate.turning);
        let back: [R; TURNING] =
            core::array::from_fn(|i| self.mean[OMEGA + i] - candidate.turning[i]);
        let moved = times(&jacobian, &back);
        // P Hᵀ, column by column.
        let mut gain = [[R::default(); MEASURED]; STATES];
        for (out, row) in gain.iter_mut().zip(&self.cov) {
            for (k, slope) in jacobian.iter().enumerate() {
                let mut sum = row[bias_of(k)];
                for (j, s) in slope.iter().enumerate() {
                    sum += *s * row[OMEGA + j];
                }
                out[k] = sum;
            }
        }
        let mut total = noise_of(solver, noise);
        for (k, slope) in jacobian.iter().enumerate() {
            for l in 0..MEASURED {
                let mut sum = gain[bias_of(k)][l];
                for (j, s) in slope.iter().enumerate() {
                    sum += *s * gain[OMEGA + j][l];
                }
                total[k][l] += sum;
            }
        }
        let factor = cholesky(&total)?;
        let innovation: [R; MEASURED] =
            core::array::from_fn(|k| measured[k] - value[k] - moved[k] - self.mean[bias_of(k)]);
        let weighted = solve(&factor, &innovation);
        let mut next = *self;
        next.weight = candidate.weight;
        let solved: [[R; MEASURED]; STATES] = core::array::from_fn(|i| solve(&factor, &gain[i]));
        for i in 0..STATES {
            next.mean[i] += dot(&gain[i], &weighted);
            for j in 0..=i {
                let value = next.cov[i][j] - dot(&gain[i], &solved[j]);
                next.cov[i][j] = value;
                next.cov[j][i] = value;
            }
        }
        next.fold();
        next.mean
            .iter()
            .all(|v| Real::is_finite(*v))
            .then_some(next)
    }

    /// Velocity and position over one sample: equation (98).
    pub(super) fn advance<const M: usize>(
        &mut self,
        step: f64,
        linear: &Linear<R>,
        solver: &ArraySolver<R, M>,
        noise: &Noise<R>,
        config: &ArrayConfig,
    ) {
        let (theta, slope) = solver.expected_theta(part(&self.mean, OMEGA));
        let force: [R; 3] = core::array::from_fn(|i| {
            linear.theta[3 + i] - theta[3 + i] - self.mean[FORCE_BIAS + i]
        });
        let turned = times(&self.attitude, &force);
        let gravity = [R::default(), R::default(), r(config.gravity_mps2)];
        let dt = r::<R>(step);
        let half = r::<R>(0.5);
        let mut acceleration = turned;
        for i in 0..3 {
            acceleration[i] -= gravity[i];
            let mid = (acceleration[i] + self.acceleration[i]) * half;
            let v = self.mean[VELOCITY + i];
            self.mean[POSITION + i] += (v + mid * dt * half) * dt;
            self.mean[VELOCITY + i] = v + mid * dt;
        }
        self.acceleration = acceleration;
        let minus = self.attitude.map(|row| row.map(|v| -v * dt));
        let by_rate = product(&minus, &[slope[3], slope[4], slope[5]]);
        let cov = &mut self.cov;
        couple(cov, POSITION, VELOCITY, &scaled_identity(dt));
        couple(
            cov,
            VELOCITY,
            PHI,
            &cross_matrix(turned).map(|row| row.map(|v| -v * dt)),
        );
        couple(cov, VELOCITY, FORCE_BIAS, &minus);
        couple(cov, VELOCITY, OMEGA, &by_rate);
        let more = r::<R>(config.force_noise_mps2 * config.force_noise_mps2) + noise.vibration;
        let covariance = solver.covariance();
        let mut input = [[R::default(); 3]; 3];
        for i in 0..3 {
            for j in 0..3 {
                input[i][j] = r::<R>(covariance[3 + i][3 + j]) * noise.factor * dt * dt;
            }
            input[i][i] += more * dt * dt;
        }
        let input = product(
            &product(&self.attitude, &input),
            &transposed(&self.attitude),
        );
        for i in 0..3 {
            for j in 0..3 {
                self.cov[VELOCITY + i][VELOCITY + j] += input[i][j];
            }
        }
    }

    /// The square of a departure, in variances of what was expected.
    pub(super) fn departs(&self, row: &[R; STATES], rest: R, variance: R) -> f64 {
        let total = dot(&times(&self.cov, row), row) + variance;
        (rest * rest / total).to_f64()
    }

    /// Velocity and attitude are not what was thought: at a rest they are known again from it, the
    /// position is not, nor the heading.
    pub(super) fn begin_again(&mut self, gravity_mps2: f64, since_s: f64) {
        let [x, y, z] = self.acceleration.map(|a| a.to_f64());
        let tilt = ((x * x + y * y + z * z) / (gravity_mps2 * gravity_mps2)).min(1.0) + 1e-4;
        for i in 0..3 {
            let strayed = self.mean[VELOCITY + i].to_f64() * since_s;
            let position = self.cov[POSITION + i][POSITION + i];
            for at in [PHI + i, VELOCITY + i, POSITION + i] {
                for k in 0..STATES {
                    self.cov[at][k] = R::default();
                    self.cov[k][at] = R::default();
                }
            }
            self.mean[VELOCITY + i] = R::default();
            self.cov[PHI + i][PHI + i] = r(tilt);
            self.cov[VELOCITY + i][VELOCITY + i] = r(1e-4);
            self.cov[POSITION + i][POSITION + i] = position + r((strayed * strayed).min(1e9));
        }
    }

    /// One number that was measured; returns −2 ln of its likelihood.
    pub(super) fn absorb(&mut self, row: &[R; STATES], rest: R, variance: R) -> f64 {
        let spread = times(&self.cov, row);
        let total = dot(&spread, row) + variance;
        if !total.is_finite() || total <= R::default() {
            return 0.0;
        }
        let rest_over = rest / total;
        for i in 0..STATES {
            self.mean[i] += spread[i] * rest_over;
            let scaled = spread[i] / total;
            for j in 0..STATES {
                self.cov[i][j] -= scaled * spread[j];
            }
        }
        (rest * rest_over).to_f64() + libm::log(total.to_f64())
    }

    /// Moves the attitude's error into the attitude.
    pub(super) fn fold(&mut self) {
        let phi = part(&self.mean, PHI);
        let turned = product(&rotation(phi), &self.attitude);
        // Rows at right angles and of length 1 again, by one step of Newton's.
        let square = product(&turned, &transposed(&turned));
        let mut mend = scaled_identity(r::<R>(1.5));
        for i in 0..3 {
            for j in 0..3 {
                mend[i][j] -= square[i][j] * r(0.5);
            }
        }
        self.attitude = product(&mend, &turned);
        for i in 0..3 {
            self.mean[PHI + i] = R::default();
        }
    }

    /// Whether ω and ω̇ differ by less than is known of them.
    pub(super) fn same(&self, other: &Self) -> bool {
        let both: [[R; TURNING]; TURNING] = core::array::from_fn(|i| {
            core::array::from_fn(|j| {
                (self.cov[OMEGA + i][OMEGA + j] + other.cov[OMEGA + i][OMEGA + j]) * r(0.5)
            })
        });
        let d: [R; TURNING] =
            core::array::from_fn(|i| self.mean[OMEGA + i] - other.mean[OMEGA + i]);
        cholesky(&both).is_some_and(|factor| dot(&d, &solve(&factor, &d)).to_f64() < SAME)
    }

    /// One Gaussian with the mean and the covariance of two.
    pub(super) fn joined(&self, other: &Self) -> Self {
        let most = self.weight.max(other.weight);
        let (a, b) = (
            libm::exp(self.weight - most),
            libm::exp(other.weight - most),
        );
        let share = b / (a + b);
        let mut next = *self;
        next.weight = most + libm::log(a + b);
        let between = product(&other.attitude, &transposed(&self.attitude));
        let mut d: [R; STATES] = core::array::from_fn(|i| other.mean[i] - self.mean[i]);
        d[PHI..PHI + 3].copy_from_slice(&rotation_vector(&between));
        let (keep, take) = (r::<R>(1.0 - share), r::<R>(share));
        for i in 0..STATES {
            next.mean[i] += d[i] * take;
            for j in 0..STATES {
                next.cov[i][j] =
                    self.cov[i][j] * keep + other.cov[i][j] * take + d[i] * d[j] * keep * take;
            }
        }
        for i in 0..3 {
            let away = other.acceleration[i] - self.acceleration[i];
            next.acceleration[i] += away * take;
        }
        next.fold();
        next
    }
}

/// Of a rotation matrix, W X Y Z.
pub(super) fn quaternion<R: Real>(m: &[[R; 3]; 3]) -> [R; 4] {
    let one = r::<R>(1.0);
    let size = |v: R| {
        if v > R::default() {
            v.sqrt() * r(0.5)
        } else {
            R::default()
        }
    };
    let signed = |size: R, like: R| if like < R::default() { -size } else { size };
    let [[xx, xy, xz], [yx, yy, yz], [zx, zy, zz]] = *m;
    [
        size(one + xx + yy + zz),
        signed(size(one + xx - yy - zz), zy - yz),
        signed(size(one - xx + yy - zz), xz - zx),
        signed(size(one - xx - yy + zz), yx - xy),
    ]
}
