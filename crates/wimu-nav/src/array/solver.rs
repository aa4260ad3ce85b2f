//! One sample of an array: equations (70) to (75).

mod roots;

use alloc::vec::Vec;

use nalgebra::{DVector, Matrix6, Matrix6x3, MatrixXx6, RowVector6, SVector, Vector3, Vector6};

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
    /// Combinations of the outputs in which only ω shows, of unit variance: equation (72). Those beyond the rank are 0.
    pub z: Vector6<f64>,
    /// ω̇ (rad/s²) and s (m/s²) as they would be without centripetal acceleration.
    pub theta: Vector6<f64>,
}

impl Linear {
    /// ω̇ and z.
    pub fn rotation(&self) -> SVector<f64, 9> {
        SVector::from_fn(|k, _| if k < 3 { self.theta[k] } else { self.z[k - 3] })
    }

    /// Specific force, m/s², as it would be without centripetal acceleration.
    pub fn force_mps2(&self) -> Vector3<f64> {
        self.theta.fixed_rows::<3>(3).into_owned()
    }
}

/// A geometry worked out once, so that a sample costs 12 inner products and a few steps in three
/// unknowns.
#[derive(Clone, Debug, PartialEq)]
pub struct ArraySolver {
    /// 1/σ of each output; 0 for axes that are left out.
    weights: DVector<f64>,
    /// H over the noise, for θ in `unit`s.
    h: MatrixXx6<f64>,
    /// V of equation (72): orthonormal columns, of which `rank` count.
    v: MatrixXx6<f64>,
    /// (HᵀH)⁻¹.
    inverse: Matrix6<f64>,
    /// ω̇ and s in their units over those of H.
    unit: Vector6<f64>,
    /// U of equation (72), of which `rank` rows count.
    u: Matrix6<f64>,
    /// Least-norm inverse of U: the closed form of the start, equation (74).
    u_inverse: Matrix6<f64>,
    /// What centripetal acceleration adds to θ.
    quadratic_theta: Matrix6<f64>,
    theta_covariance: Matrix6<f64>,
    used: usize,
    rank: usize,
    variance: f64,
    arm_m: f64,
}

impl ArraySolver {
    /// Works out a geometry.
    ///
    /// # Errors
    /// Too few axes, all at one place, or arranged so that a component of ω̇ or s does not show:
    /// [`GeometryError`] says which.
    pub fn new(geometry: &Geometry) -> Result<Self, GeometryError> {
        Self::of(geometry, |_| true)
    }

    /// The same without the sensors for which `usable` is false; the outputs keep their places.
    ///
    /// # Errors
    /// As [`ArraySolver::new`], for what remains.
    pub fn of(geometry: &Geometry, usable: impl Fn(usize) -> bool) -> Result<Self, GeometryError> {
        let (all, group) = (geometry.axes(), geometry.group());
        let used: Vec<usize> = (0..all.len()).filter(|k| usable(k / group)).collect();
        if used.len() < UNKNOWNS {
            return Err(GeometryError::TooFew { have: used.len(), need: UNKNOWNS });
        }
        let (centre, arm) = centre_and_arm(all, &used)?;
        // Rows weighted by 1/σ; ω̇ and ω² in units of 1/arm, so that all columns are alike.
        let mut weights = DVector::zeros(all.len());
        let (mut h, mut k) = (MatrixXx6::zeros(all.len()), MatrixXx6::zeros(all.len()));
        for index in &used {
            let axis = &all[*index];
            let (of_theta, of_square) = rows(axis, &centre, arm);
            let weight = 1.0 / axis.noise_mps2;
            weights[*index] = weight;
            h.set_row(*index, &(of_theta * weight));
            k.set_row(*index, &(of_square * weight));
        }
        let quadratic: Matrix6<f64> = k.tr_mul(&k);
        let mixed: Matrix6<f64> = h.tr_mul(&k);
        let inverse = checked_inverse(h.tr_mul(&h), &quadratic)?;
        let quadratic_theta = inverse * mixed;
        let eigen = (quadratic - mixed.tr_mul(&quadratic_theta)).symmetric_eigen();
        let value = |i: usize| eigen.eigenvalues[i];
        let mut shown: Vec<usize> = (0..6).collect();
        shown.retain(|i| value(*i) > quadratic.trace() * QUADRATIC_RANK * QUADRATIC_RANK);
        shown.sort_unstable_by(|a, b| value(*b).total_cmp(&value(*a)));
        let projected = &k - &h * quadratic_theta;
        let mut v = MatrixXx6::zeros(all.len());
        let (mut u, mut u_inverse) = (Matrix6::zeros(), Matrix6::zeros());
        // q(ω) = scaled / arm.
        for (row, from) in shown.iter().enumerate() {
            let (along, root) = (eigen.eigenvectors.column(*from), libm::sqrt(value(*from)));
            v.set_column(row, &(&projected * along / root));
            u.set_row(row, &(along.transpose() * (root * arm)));
            u_inverse.set_column(row, &(along / (root * arm)));
        }
        let unit = Vector6::from_fn(|row, _| if row < 3 { 1.0 / arm } else { 1.0 });
        let variances = used.iter().map(|k| all[*k].noise_mps2 * all[*k].noise_mps2);
        Ok(Self {
            weights,
            h,
            v,
            inverse,
            unit,
            u,
            u_inverse,
            quadratic_theta: Matrix6::from_diagonal(&unit) * quadratic_theta * arm,
            theta_covariance: inverse.component_mul(&(unit * unit.transpose())),
            used: used.len(),
            rank: shown.len(),
            variance: variances.sum::<f64>() / used.len() as f64,
            arm_m: arm,
        })
    }

    /// How many of [`Linear::z`] count, and so how many angular rates fit a sample: with 6 ω and −ω; with 3 to 5, of a planar
    /// array, their mirror images at its plane too; with fewer none is known without its history, and with 0 only ω̇ and s are
    /// measured (Chen, Lee & DeBra's cube, two or three triads in special places).
    pub fn rank(&self) -> usize {
        self.rank
    }

    /// Covariance of ω̇ (rad/s²) and s (m/s²) at known ω.
    pub fn covariance(&self) -> &Matrix6<f64> {
        &self.theta_covariance
    }

    /// Mean variance of the axes in use, (m/s²)².
    pub fn variance_mps2(&self) -> f64 {
        self.variance
    }

    /// Relative standard deviation of a component of ω by errors of the lever arms with this deviation of each coordinate, m:
    /// equation (105).
    pub fn rate_error(&self, position_sd_m: f64) -> f64 {
        let arms = self.theta_covariance.fixed_view::<3, 3>(0, 0).trace() / 3.0;
        position_sd_m * libm::sqrt(1.5 * arms / self.variance)
    }

    /// Root mean square distance of the sensors from their centre, m.
    pub fn arm_m(&self) -> f64 {
        self.arm_m
    }

    /// Variance that the outputs show among themselves, in units of what was declared: what no
    /// motion of a rigid body explains, per degree of freedom, equation (76). `None` where motion
    /// can explain everything.
    pub fn excess(&self, output_mps2: &[f64], linear: &Linear) -> Option<f64> {
        let free = self.used.checked_sub(6 + self.rank).filter(|n| *n > 0)?;
        Some(self.residuals(output_mps2, linear, &linear.z).norm_squared() / free as f64)
    }

    /// What is left of each output, over its noise, with `z` explained of the reduced measurement; 0 for axes that are left out.
    pub fn residuals(
        &self,
        output_mps2: &[f64],
        linear: &Linear,
        z: &Vector6<f64>,
    ) -> DVector<f64> {
        let force = &self.h * linear.theta.component_div(&self.unit);
        self.weighted(output_mps2) - force - &self.v * z
    }

    fn weighted(&self, output_mps2: &[f64]) -> DVector<f64> {
        // Axes that are left out may have no output.
        DVector::from_fn(self.weights.len(), |axis, _| match self.weights[axis] {
            weight if weight > 0.0 => output_mps2.get(axis).map_or(f64::NAN, |y| y * weight),
            _ => 0.0,
        })
    }

    /// Axes in use.
    pub fn used(&self) -> usize {
        self.used
    }

    /// The linear part of the work, equations (71) and (72): all that a sample says. One output for each axis of the geometry.
    pub fn reduce(&self, output_mps2: &[f64]) -> Linear {
        let weighted = self.weighted(output_mps2);
        let theta = self.inverse * self.h.tr_mul(&weighted);
        Linear { z: self.v.tr_mul(&weighted), theta: theta.component_mul(&self.unit) }
    }

    /// ω̇ (rad/s²) and s (m/s²) of a reduced sample at a known angular rate, rad/s, equation (71).
    pub fn theta(&self, linear: &Linear, rate_rad_s: &Vector3<f64>) -> Vector6<f64> {
        linear.theta - self.quadratic_theta * monomials(rate_rad_s)
    }

    /// What z should be at `rate_rad_s`, and its derivatives.
    pub fn expected_z(&self, rate_rad_s: &Vector3<f64>) -> (Vector6<f64>, Matrix6x3<f64>) {
        (self.u * monomials(rate_rad_s), self.u * slopes(rate_rad_s))
    }

    /// What centripetal acceleration at `rate_rad_s` adds to [`Linear::theta`], and its derivatives.
    pub fn expected_theta(&self, rate_rad_s: &Vector3<f64>) -> (Vector6<f64>, Matrix6x3<f64>) {
        let quadratic = &self.quadratic_theta;
        (quadratic * monomials(rate_rad_s), quadratic * slopes(rate_rad_s))
    }
}

/// Monomials of ω that centripetal acceleration is made of.
fn monomials(rate: &Vector3<f64>) -> Vector6<f64> {
    let [x, y, z] = (*rate).into();
    Vector6::new(x * x, y * y, z * z, y * z, x * z, x * y)
}

/// Their derivatives.
fn slopes(rate: &Vector3<f64>) -> Matrix6x3<f64> {
    let [x, y, z] = (*rate).into();
    let (x2, y2, z2) = (2.0 * x, 2.0 * y, 2.0 * z);
    Matrix6x3::from_row_slice(&[
        x2, 0.0, 0.0, 0.0, y2, 0.0, 0.0, 0.0, z2, 0.0, z, y, z, 0.0, x, y, x, 0.0,
    ])
}

/// Mean position, m, weighted by 1/σ², and the root mean square distance from it.
fn centre_and_arm(axes: &[Axis], used: &[usize]) -> Result<(Vector3<f64>, f64), GeometryError> {
    let places = || {
        let used = used.iter().map(|index| &axes[*index]);
        used.map(|axis| (Vector3::from(axis.position_m), 1.0 / (axis.noise_mps2 * axis.noise_mps2)))
    };
    let total: f64 = places().map(|(_, weight)| weight).sum();
    let centre = places().map(|(place, weight)| place * weight).sum::<Vector3<f64>>() / total;
    let squares = places().map(|(place, weight)| (place - centre).norm_squared() * weight);
    let arm = libm::sqrt(squares.sum::<f64>() / total);
    let farthest = places().map(|(place, _)| place.norm()).fold(0.0, f64::max);
    if arm > farthest * 1e-9 && arm > 1e-9 {
        Ok((centre, arm))
    } else {
        Err(GeometryError::Coincident)
    }
}

/// Rows of H and K of one axis, equation (70); `arm` is the unit of length.
fn rows(axis: &Axis, centre: &Vector3<f64>, arm: f64) -> (RowVector6<f64>, RowVector6<f64>) {
    let r = (Vector3::from(axis.position_m) - centre) / arm;
    let d = Vector3::from(axis.direction);
    let turn = r.cross(&d);
    let along = d.dot(&r);
    let h = RowVector6::new(turn.x, turn.y, turn.z, d.x, d.y, d.z);
    let k = RowVector6::new(
        d.x * r.x - along,
        d.y * r.y - along,
        d.z * r.z - along,
        d.y * r.z + d.z * r.y,
        d.x * r.z + d.z * r.x,
        d.x * r.y + d.y * r.x,
    );
    (h, k)
}

/// (HᵀQ⁻¹H)⁻¹, or which component does not show; `quadratic` is KᵀQ⁻¹K.
fn checked_inverse(
    information: Matrix6<f64>,
    quadratic: &Matrix6<f64>,
) -> Result<Matrix6<f64>, GeometryError> {
    let eigen = information.symmetric_eigen();
    let (at, least) = eigen.eigenvalues.argmin();
    if least > eigen.eigenvalues.max() * LINEAR_RANK * LINEAR_RANK {
        let factor = information.cholesky().ok_or(GeometryError::Coincident)?;
        return Ok(factor.inverse());
    }
    let direction = eigen.eigenvectors.column(at);
    let turn: Vector3<f64> = direction.fixed_rows::<3>(0).into();
    let force: Vector3<f64> = direction.fixed_rows::<3>(3).into();
    if turn.norm() < force.norm() {
        return Err(GeometryError::NoForce { along: force.normalize().into() });
    }
    let about = turn.normalize();
    // On one line along `about`, a turn about it has no arm: its square shows nowhere.
    let square = monomials(&about);
    let collinear = square.dot(&(quadratic * square)) < 1e-6 * quadratic.trace();
    Err(GeometryError::NoTurn { about: about.into(), collinear })
}
