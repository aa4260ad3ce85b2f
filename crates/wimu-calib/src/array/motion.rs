//! Motion of a rigid body in one sample: the nuisance parameters of the fit, equations (70) to (73), (99).

use nalgebra::{Matrix3, Matrix6, SMatrix, SVector, Vector3, Vector6};
use wimu_model::geometry::Geometry;

/// Smallest eigenvalue of the part quadratic in ω over its trace, below which a component is not observed.
const LEAST_RANK: f64 = 1e-8;
/// Most Levenberg-Marquardt steps for ω; typical convergence after four.
const STEPS: usize = 20;
/// First damping relative to the trace, and the square of the relative step at which ω has converged.
const FIRST_DAMPING: f64 = 1e-3;
const SETTLED: f64 = 1e-20;
/// ω counts as observed from this many of its standard deviations on. Below, its monomials are eliminated instead.
const OBSERVED_SD: f64 = 5.0;

/// An axis with the current parameters: y = bias + m · (f₀ + S r) + noise.
#[derive(Clone, Copy, Default)]
pub(super) struct AxisNow {
    pub bias_mps2: f64,
    /// Change of the bias in motion.
    pub drift_mps2: f64,
    pub m: Vector3<f64>,
    /// Lever arm from the weighted centre, m.
    pub r: Vector3<f64>,
    /// 1/σ of a sample, 0 where the axis is not used.
    pub weight: f64,
}

/// Array with the current parameters; rows are whitened by 1/σ.
pub(super) struct Body<const M: usize> {
    pub axes: [AxisNow; M],
    pub used: usize,
    /// Root mean square lever arm, m: unit of length of the columns.
    pub arm_m: f64,
    /// Orthonormal basis of the columns of ω̇ and f₀, and the inverse of their triangular factor.
    linear: SMatrix<f64, M, 6>,
    triangle: Matrix6<f64>,
    /// Part of the columns of the monomials of ω in `linear`.
    coupling: Matrix6<f64>,
    /// Orthonormal basis of what is left of `quadratic` without `linear`; columns from `rank` on are zero.
    basis: SMatrix<f64, M, 6>,
    pub rank: usize,
    /// z = `to_z` q, and its pseudo-inverse.
    to_z: Matrix6<f64>,
    from_z: Matrix6<f64>,
}

/// ω of a sample.
#[derive(Clone)]
pub(super) struct Rate {
    pub omega: Vector3<f64>,
    pub omega_dot: Vector3<f64>,
}

/// A sample without its motion.
#[derive(Clone)]
pub(super) struct Reduced<const M: usize> {
    /// Whitened residual, and its degrees of freedom.
    pub residual: SVector<f64, M>,
    /// What no ω explains, observed or not: the residual, and z − U q(ω) where that is left out of it.
    pub unexplained: SVector<f64, M>,
    pub degrees: usize,
    /// Orthonormal basis of what the motion explains; the projection is 1 − B Bᵀ.
    pub explained: SMatrix<f64, M, 12>,
    pub force_mps2: Vector3<f64>,
    /// S = [ω̇]× + [ω]×².
    pub tensor: Matrix3<f64>,
    /// `None` where ω is not observed.
    pub rate: Option<Rate>,
}

fn monomials(w: &Vector3<f64>) -> Vector6<f64> {
    Vector6::new(w.x * w.x, w.y * w.y, w.z * w.z, w.y * w.z, w.x * w.z, w.x * w.y)
}

fn slopes(w: &Vector3<f64>) -> SMatrix<f64, 6, 3> {
    SMatrix::<f64, 6, 3>::from_row_slice(&[
        2.0 * w.x,
        0.0,
        0.0, //
        0.0,
        2.0 * w.y,
        0.0, //
        0.0,
        0.0,
        2.0 * w.z, //
        0.0,
        w.z,
        w.y, //
        w.z,
        0.0,
        w.x, //
        w.y,
        w.x,
        0.0,
    ])
}

impl<const M: usize> Body<M> {
    /// `None` where the axes do not determine ω̇ and f₀.
    pub fn new(mut axes: [AxisNow; M]) -> Option<Self> {
        let total: f64 = axes.iter().map(|a| a.weight * a.weight).sum();
        let used = axes.iter().filter(|a| a.weight > 0.0).count();
        let weighted = axes.iter().map(|a| a.r * (a.weight * a.weight / total));
        let centre: Vector3<f64> = weighted.sum();
        for axis in &mut axes {
            axis.r -= centre;
        }
        let squares = axes.iter().map(|a| a.r.norm_squared() * a.weight * a.weight);
        let arm_m = libm::sqrt(squares.sum::<f64>() / total);
        if used < 6 || !(arm_m > 1e-9 && arm_m.is_finite()) {
            return None;
        }
        let mut h = SMatrix::<f64, M, 6>::zeros();
        let mut k = SMatrix::<f64, M, 6>::zeros();
        for (row, axis) in axes.iter().enumerate() {
            let (r, m) = (axis.r / arm_m, axis.m * axis.weight);
            let turn = r.cross(&m);
            let along = m.dot(&r);
            h.set_row(row, &Vector6::new(turn.x, turn.y, turn.z, m.x, m.y, m.z).transpose());
            let monomials = Vector6::new(
                m.x * r.x - along,
                m.y * r.y - along,
                m.z * r.z - along,
                m.y * r.z + m.z * r.y,
                m.x * r.z + m.z * r.x,
                m.x * r.y + m.y * r.x,
            );
            k.set_row(row, &monomials.transpose());
        }
        let triangle = h.tr_mul(&h).cholesky()?.l().transpose().try_inverse()?;
        let linear = h * triangle;
        let left = k - linear * linear.tr_mul(&k);
        let eigen = left.tr_mul(&left).symmetric_eigen();
        let least = LEAST_RANK * k.norm_squared();
        let mut rank = 0;
        let (mut to_z, mut from_z) = (Matrix6::zeros(), Matrix6::zeros());
        for (i, value) in eigen.eigenvalues.iter().enumerate() {
            if *value > least {
                let (v, root) = (eigen.eigenvectors.column(i), libm::sqrt(*value));
                to_z.set_row(rank, &(v * root).transpose());
                from_z.set_column(rank, &(v / root));
                rank += 1;
            }
        }
        Some(Self {
            axes,
            used,
            arm_m,
            linear,
            triangle,
            coupling: linear.tr_mul(&k),
            basis: left * from_z,
            rank,
            to_z,
            from_z,
        })
    }

    /// Most degrees of freedom of a sample without its motion.
    pub fn degrees(&self) -> usize {
        let motion = if self.rank == 6 { 3 } else { self.rank };
        self.used.saturating_sub(6 + motion)
    }

    /// ω in units of 1/√arm by Gauss-Newton from the eigenvector of q̂ = ω ωᵀ.
    fn rate(&self, z: &Vector6<f64>) -> Vector3<f64> {
        let q = self.from_z * z;
        let square = Matrix3::new(q[0], q[5], q[4], q[5], q[1], q[3], q[4], q[3], q[2]);
        let eigen = square.symmetric_eigen();
        let mut best = (f64::INFINITY, Vector3::zeros());
        for (value, vector) in eigen.eigenvalues.iter().zip(eigen.eigenvectors.column_iter()) {
            if *value <= 0.0 {
                continue;
            }
            let (w, cost) = self.refine(z, vector * libm::sqrt(*value));
            if cost < best.0 {
                best = (cost, w);
            }
        }
        best.1
    }

    /// Levenberg-Marquardt from `w`; with its cost.
    fn refine(&self, z: &Vector6<f64>, mut w: Vector3<f64>) -> (Vector3<f64>, f64) {
        let mut rest = z - self.to_z * monomials(&w);
        let mut damping = FIRST_DAMPING;
        for _ in 0..STEPS {
            let slope = self.to_z * slopes(&w);
            let mut information = slope.tr_mul(&slope);
            let size = information.trace();
            for i in 0..3 {
                information[(i, i)] += damping * size;
            }
            let Some(factor) = information.cholesky() else {
                break;
            };
            let step = factor.solve(&slope.tr_mul(&rest));
            let moved = z - self.to_z * monomials(&(w + step));
            if moved.norm_squared() <= rest.norm_squared() {
                (w, rest) = (w + step, moved);
                damping *= 0.1;
                if step.norm_squared() <= SETTLED * w.norm_squared() {
                    break;
                }
            } else {
                damping *= 10.0;
            }
        }
        (w, rest.norm_squared())
    }

    /// Takes the motion off whitened outputs without bias; `None` where they are not finite.
    pub fn reduce(&self, output: &SVector<f64, M>) -> Option<Reduced<M>> {
        let shares = self.linear.tr_mul(output);
        let z = self.basis.tr_mul(output);
        let mut explained = SMatrix::<f64, M, 12>::zeros();
        explained.fixed_columns_mut::<6>(0).copy_from(&self.linear);
        let w = if self.rank == 6 { self.rate(&z) } else { Vector3::zeros() };
        let slope = self.to_z * slopes(&w);
        let information = slope.tr_mul(&slope);
        let free = self.used.saturating_sub(6 + self.rank);
        let outside = output - self.linear * shares - self.basis * z;
        let excess = (outside.norm_squared() / free.max(1) as f64).max(1.0);
        let inverse = information.try_inverse().filter(|inverse| {
            let largest = inverse.symmetric_eigenvalues().max() * excess;
            w.norm_squared() > OBSERVED_SD * OBSERVED_SD * largest
        });
        let (q, rate_basis) = match inverse.and_then(|inverse| inverse.cholesky()) {
            Some(factor) => (monomials(&w), Some(slope * factor.l())),
            None => (self.from_z * z, None),
        };
        let motion = match &rate_basis {
            Some(basis) => {
                explained.fixed_columns_mut::<3>(6).copy_from(&(self.basis * basis));
                3
            }
            None => {
                explained.fixed_columns_mut::<6>(6).copy_from(&self.basis);
                self.rank
            }
        };
        let theta = self.triangle * (shares - self.coupling * q);
        let unit = 1.0 / self.arm_m;
        let omega_dot = theta.fixed_rows::<3>(0) * unit;
        let rate = rate_basis.is_some().then(|| Rate { omega: w * libm::sqrt(unit), omega_dot });
        let unexplained = match self.rank {
            6 => outside + self.basis * (z - self.to_z * monomials(&w)),
            _ => outside,
        };
        let residual = if rate.is_some() { unexplained } else { outside };
        let [a, b, c, d, e, f]: [f64; 6] = (q * unit).into();
        let tensor =
            omega_dot.cross_matrix() + Matrix3::new(-b - c, f, e, f, -a - c, d, e, d, -a - b);
        let finite = residual.iter().chain(tensor.iter()).all(|v| v.is_finite());
        finite.then_some(Reduced {
            residual,
            unexplained,
            degrees: self.used.saturating_sub(6 + motion),
            explained,
            force_mps2: theta.fixed_rows::<3>(3).into(),
            tensor,
            rate,
        })
    }
}

/// The axes of a geometry without errors.
pub(super) fn nominal<const M: usize>(
    geometry: &Geometry<M>,
    usable: &dyn Fn(usize) -> bool,
) -> [AxisNow; M] {
    let mut axes = [AxisNow::default(); M];
    for (index, (slot, axis)) in axes.iter_mut().zip(geometry.axes()).enumerate() {
        *slot = AxisNow {
            m: axis.direction.into(),
            r: axis.position_m.into(),
            weight: if usable(index / geometry.group()) { 1.0 / axis.noise_mps2 } else { 0.0 },
            ..AxisNow::default()
        };
    }
    axes
}
