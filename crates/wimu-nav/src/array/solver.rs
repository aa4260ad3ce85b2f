//! One sample of an array: equations (70) to (75).

mod roots;

use nalgebra::{Matrix6, Vector3, Vector6};

pub use roots::Hypothesis;

use super::geometry::{Axis, Geometry, GeometryError};

/// Least singular value against the largest, of the linear part with arms scaled to 1, below which
/// a direction counts as not observed.
const LINEAR_RANK: f64 = 1e-4;
/// The same of the quadratic part.
const QUADRATIC_RANK: f64 = 1e-4;
/// Unknowns of the linear part.
const UNKNOWNS: usize = 6;

/// What is left of a sample: what the filter works on.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Linear {
    /// Combinations of the outputs in which only ω shows, of unit variance: equation (72).
    pub z: [f64; 6],
    /// ω̇ (rad/s²) and s (m/s²) as they would be without centripetal acceleration.
    pub theta: [f64; 6],
}

/// A geometry worked out once, so that a sample costs 12 inner products and a few steps in three
/// unknowns.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ArraySolver<const M: usize> {
    /// Rows that make z of equation (72).
    to_z: [[f64; M]; 6],
    /// Rows that make θ of equation (71).
    to_theta: [[f64; M]; 6],
    /// U of equation (72), of which `rank` rows count.
    u: [[f64; 6]; 6],
    /// What centripetal acceleration adds to θ.
    quadratic_theta: [[f64; 6]; 6],
    /// Least-norm inverse of U: the closed form of the start, equation (74).
    u_inverse: [[f64; 6]; 6],
    theta_covariance: [[f64; 6]; 6],
    /// Rows of H, and 1/σ; 0 for axes that are left out.
    rows: [[f64; 6]; M],
    weights: [f64; M],
    used: usize,
    rank: usize,
    variance: f64,
    arm_m: f64,
}

/// Monomials of ω that centripetal acceleration is made of.
fn monomials([x, y, z]: [f64; 3]) -> [f64; 6] {
    [x * x, y * y, z * z, y * z, x * z, x * y]
}

impl<const M: usize> ArraySolver<M> {
    /// Works out a geometry.
    ///
    /// # Errors
    /// Too few axes, all at one place, or arranged so that a component of ω̇ or s does not show:
    /// [`GeometryError`] says which.
    pub fn new(geometry: &Geometry<M>) -> Result<Self, GeometryError> {
        Self::of(geometry, |_| true)
    }

    /// The same without the sensors for which `usable` is false; the outputs keep their places.
    ///
    /// # Errors
    /// As [`ArraySolver::new`], for what remains.
    pub fn of(
        geometry: &Geometry<M>,
        usable: impl Fn(usize) -> bool,
    ) -> Result<Self, GeometryError> {
        let group = geometry.group();
        let axes = || geometry.axes().iter().enumerate().filter(|(index, _)| usable(index / group));
        let have = axes().count();
        if have < UNKNOWNS {
            return Err(GeometryError::TooFew { have, need: UNKNOWNS });
        }
        let weight = |noise: f64| 1.0 / (noise * noise);
        let total: f64 = axes().map(|(_, axis)| weight(axis.noise_mps2)).sum();
        let variances = axes().map(|(_, axis)| axis.noise_mps2 * axis.noise_mps2);
        let variance = variances.sum::<f64>() / have as f64;
        let centre: Vector3<f64> = axes()
            .map(|(_, axis)| Vector3::from(axis.position_m) * (weight(axis.noise_mps2) / total))
            .sum();
        let arm = libm::sqrt(
            axes()
                .map(|(_, axis)| {
                    (Vector3::from(axis.position_m) - centre).norm_squared()
                        * (weight(axis.noise_mps2) / total)
                })
                .sum(),
        );
        let farthest =
            axes().map(|(_, axis)| Vector3::from(axis.position_m).norm()).fold(0.0, f64::max);
        if !(arm > farthest * 1e-9 && arm > 1e-9) {
            return Err(GeometryError::Coincident);
        }
        // Rows weighted by 1/σ; ω̇ and ω² in units of 1/arm, so that all columns are alike. They are worked
        // out twice: small processors have no room for all of them.
        let row = |axis: &Axis| weighted_row(axis, &centre, arm);
        let mut information = Matrix6::<f64>::zeros();
        let mut mixed = Matrix6::<f64>::zeros();
        let mut quadratic = Matrix6::<f64>::zeros();
        for (_, axis) in axes() {
            let (h, k) = row(axis);
            information.ger(1.0, &h, &h, 1.0);
            mixed.ger(1.0, &h, &k, 1.0);
            quadratic.ger(1.0, &k, &k, 1.0);
        }
        let inverse = checked_inverse(information, &quadratic)?;
        let quadratic_theta = inverse * mixed;
        let eigen = (quadratic - mixed.tr_mul(&quadratic_theta)).symmetric_eigen();
        let mut order = [0, 1, 2, 3, 4, 5];
        let value = |i: usize| eigen.eigenvalues.get(i).copied().unwrap_or(0.0);
        order.sort_unstable_by(|a, b| value(*b).total_cmp(&value(*a)));
        let size = quadratic.trace();
        let mut solver = Self {
            to_z: [[0.0; M]; 6],
            to_theta: [[0.0; M]; 6],
            u: [[0.0; 6]; 6],
            quadratic_theta: [[0.0; 6]; 6],
            u_inverse: [[0.0; 6]; 6],
            theta_covariance: [[0.0; 6]; 6],
            rows: [[0.0; 6]; M],
            weights: [0.0; M],
            used: have,
            rank: 0,
            variance,
            arm_m: arm,
        };
        // ω̇ = scaled / arm, q(ω) = scaled / arm.
        let unit = |row: usize| if row < 3 { 1.0 / arm } else { 1.0 };
        for (index, axis) in axes() {
            let (h, k) = row(axis);
            let weight = 1.0 / axis.noise_mps2;
            solver.weights[index] = weight;
            let fit = inverse * h;
            for column in 0..6 {
                solver.rows[index][column] = h[column] / (unit(column) * weight);
                solver.to_theta[column][index] = fit[column] * unit(column) * weight;
            }
            let projected = k - quadratic_theta.tr_mul(&h);
            for (row, from) in order.into_iter().enumerate() {
                let lambda = value(from);
                if lambda <= size * QUADRATIC_RANK * QUADRATIC_RANK {
                    break;
                }
                let along = projected.dot(&eigen.eigenvectors.column(from));
                solver.to_z[row][index] = along / libm::sqrt(lambda) * weight;
            }
        }
        for (row, from) in order.into_iter().enumerate() {
            let lambda = value(from);
            if lambda <= size * QUADRATIC_RANK * QUADRATIC_RANK {
                break;
            }
            solver.rank = row + 1;
            let root = libm::sqrt(lambda);
            for column in 0..6 {
                let along = eigen.eigenvectors[(column, from)];
                solver.u[row][column] = root * along * arm;
                solver.u_inverse[column][row] = along / (root * arm);
            }
        }
        for row in 0..6 {
            for column in 0..6 {
                solver.quadratic_theta[row][column] =
                    quadratic_theta[(row, column)] * unit(row) * arm;
                solver.theta_covariance[row][column] =
                    inverse[(row, column)] * unit(row) * unit(column);
            }
        }
        Ok(solver)
    }

    /// How many of [`Linear::z`] count, and so how many angular rates fit a sample: with 6 ω and −ω; with 3 to 5, of a planar
    /// array, their mirror images at its plane too; with fewer none is known without its history, and with 0 only ω̇ and s are
    /// measured (Chen, Lee & DeBra's cube, two or three triads in special places).
    pub fn rank(&self) -> usize {
        self.rank
    }

    /// Covariance of ω̇ (rad/s²) and s (m/s²) at known ω.
    pub fn covariance(&self) -> &[[f64; 6]; 6] {
        &self.theta_covariance
    }

    /// Mean variance of the axes in use, (m/s²)².
    pub fn variance_mps2(&self) -> f64 {
        self.variance
    }

    /// Relative standard deviation of a component of ω by errors of the lever arms with this deviation of each coordinate, m:
    /// equation (105).
    pub fn rate_error(&self, position_sd_m: f64) -> f64 {
        let arms = (0..3).map(|i| self.theta_covariance[i][i]).sum::<f64>() / 3.0;
        position_sd_m * libm::sqrt(1.5 * arms / self.variance)
    }

    /// Root mean square distance of the sensors from their centre, m.
    pub fn arm_m(&self) -> f64 {
        self.arm_m
    }

    /// Variance that the outputs show among themselves, in units of what was declared: what no
    /// motion of a rigid body explains, per degree of freedom, equation (76). `None` where motion
    /// can explain everything.
    pub fn excess(&self, output_mps2: &[f64; M], linear: &Linear) -> Option<f64> {
        let free = self.used.checked_sub(6 + self.rank).filter(|n| *n > 0)?;
        let rest = self.residuals(output_mps2, linear, &linear.z);
        Some(inner(&rest, &rest) / free as f64)
    }

    /// What is left of each output, over its noise, with `z` explained of the reduced measurement; 0 for axes that are left out.
    pub fn residuals(&self, output_mps2: &[f64; M], linear: &Linear, z: &[f64; 6]) -> [f64; M] {
        let mut rest = [0.0; M];
        for (index, rest) in rest.iter_mut().enumerate() {
            let weight = self.weights[index];
            if weight <= 0.0 {
                continue;
            }
            let force = inner(&self.rows[index], &linear.theta);
            *rest = (output_mps2[index] - force) * weight;
            for row in 0..self.rank.min(6) {
                // The columns of V are the rows of `to_z` without their weight.
                *rest -= self.to_z[row][index] / weight * z[row];
            }
        }
        rest
    }

    /// Axes in use.
    pub fn used(&self) -> usize {
        self.used
    }

    /// The linear part of the work, equations (71) and (72): all that a sample says.
    pub fn reduce(&self, output_mps2: &[f64; M]) -> Linear {
        let mut linear = Linear::default();
        for row in 0..6 {
            linear.theta[row] = inner(&self.to_theta[row], output_mps2);
            if row < self.rank {
                linear.z[row] = inner(&self.to_z[row], output_mps2);
            }
        }
        linear
    }

    /// ω̇ (rad/s²) and s (m/s²) of a reduced sample at a known angular rate, equation (71).
    pub fn theta(&self, linear: &Linear, rate_rad_s: [f64; 3]) -> [f64; 6] {
        let q = monomials(rate_rad_s);
        let mut theta = linear.theta;
        for row in 0..6 {
            theta[row] -= inner(&self.quadratic_theta[row], &q);
        }
        theta
    }

    /// What z should be at `rate_rad_s`, and its derivatives.
    pub fn expected_z(&self, rate_rad_s: [f64; 3]) -> ([f64; 6], [[f64; 3]; 6]) {
        let rows = self.u.iter().take(self.rank);
        at_rate(rows, rate_rad_s)
    }

    /// What centripetal acceleration at `rate_rad_s` adds to [`Linear::theta`], and its derivatives.
    pub fn expected_theta(&self, rate_rad_s: [f64; 3]) -> ([f64; 6], [[f64; 3]; 6]) {
        at_rate(self.quadratic_theta.iter(), rate_rad_s)
    }
}

/// Combinations of the monomials at `rate`, and their derivatives.
fn at_rate<'a>(
    rows: impl Iterator<Item = &'a [f64; 6]>,
    rate: [f64; 3],
) -> ([f64; 6], [[f64; 3]; 6]) {
    let q = monomials(rate);
    let [x, y, z] = rate;
    let mut value = [0.0; 6];
    let mut slope = [[0.0; 3]; 6];
    for ((u, value), slope) in rows.zip(&mut value).zip(&mut slope) {
        *value = inner(u, &q);
        *slope = [
            (u[0] + u[0]) * x + u[4] * z + u[5] * y,
            (u[1] + u[1]) * y + u[3] * z + u[5] * x,
            (u[2] + u[2]) * z + u[3] * y + u[4] * x,
        ];
    }
    (value, slope)
}

/// Rows of H and K of one axis, equation (70), over its noise; `arm` is the unit of length.
fn weighted_row(axis: &Axis, centre: &Vector3<f64>, arm: f64) -> (Vector6<f64>, Vector6<f64>) {
    let r = (Vector3::from(axis.position_m) - centre) / arm;
    let d = Vector3::from(axis.direction);
    let turn = r.cross(&d);
    let along = d.dot(&r);
    let h = Vector6::new(turn.x, turn.y, turn.z, d.x, d.y, d.z);
    let k = Vector6::new(
        d.x * r.x - along,
        d.y * r.y - along,
        d.z * r.z - along,
        d.y * r.z + d.z * r.y,
        d.x * r.z + d.z * r.x,
        d.x * r.y + d.y * r.x,
    );
    (h / axis.noise_mps2, k / axis.noise_mps2)
}

/// (HᵀQ⁻¹H)⁻¹, or which component does not show; `quadratic` is KᵀQ⁻¹K.
fn checked_inverse(
    information: Matrix6<f64>,
    quadratic: &Matrix6<f64>,
) -> Result<Matrix6<f64>, GeometryError> {
    let eigen = information.symmetric_eigen();
    let largest = eigen.eigenvalues.max();
    let (least, at) = eigen
        .eigenvalues
        .iter()
        .zip(0..)
        .fold((f64::INFINITY, 0), |best, (v, i)| if *v < best.0 { (*v, i) } else { best });
    if least > largest * LINEAR_RANK * LINEAR_RANK {
        return information
            .cholesky()
            .map(|factor| factor.inverse())
            .ok_or(GeometryError::Coincident);
    }
    let v = eigen.eigenvectors.column(at).into_owned();
    let turn = Vector3::new(v[0], v[1], v[2]);
    let force = Vector3::new(v[3], v[4], v[5]);
    if turn.norm() < force.norm() {
        return Err(GeometryError::NoForce { along: force.normalize().into() });
    }
    let about = turn.normalize();
    // On one line along `about`, a turn about it has no arm: its square shows nowhere.
    let [x, y, z]: [f64; 3] = about.into();
    let square = Vector6::new(x * x, y * y, z * z, y * z, x * z, x * y);
    let collinear = square.dot(&(quadratic * square)) < 1e-6 * quadratic.trace();
    Err(GeometryError::NoTurn { about: about.into(), collinear })
}

fn inner<const N: usize>(a: &[f64; N], b: &[f64; N]) -> f64 {
    let mut sum = 0.0;
    for (x, y) in a.iter().zip(b) {
        sum += *x * *y;
    }
    sum
}
