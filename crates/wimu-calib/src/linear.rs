//! Scalar type and matrix decompositions of the least-squares fits.

use nalgebra::{Cholesky, Const, RealField, SMatrix, SVector, convert};

/// f32 or f64.
pub trait Real: RealField + Copy + Default {}

impl Real for f32 {}
impl Real for f64 {}

pub(crate) fn real<R: Real>(x: f64) -> R {
    convert(x)
}

pub(crate) fn double<R: Real>(x: R) -> f64 {
    nalgebra::try_convert(x).unwrap_or(f64::NAN)
}

/// A matrix and its Cholesky factor, both scaled to unit diagonal of the matrix.
pub(crate) struct Scaled<R: Real, const N: usize> {
    /// 1 / square root of each diagonal element of the matrix.
    scale: SVector<R, N>,
    factor: Cholesky<R, Const<N>>,
}

impl<R: Real, const N: usize> Scaled<R, N> {
    /// Of the symmetric `matrix`, of which the lower triangle is read, with `damping` added to the
    /// unit diagonal. `None` unless it is positive definite beyond rounding.
    pub fn new(matrix: &SMatrix<R, N, N>, damping: R) -> Option<Self> {
        let scale = matrix.diagonal().map(|d| R::one() / d.sqrt());
        if !scale.iter().all(|s| s.is_finite()) {
            return None;
        }
        let mut scaled = rescaled(matrix, &scale);
        for i in 0..N {
            scaled[(i, i)] += damping;
        }
        let factor = Cholesky::new(scaled)?;
        let pivots = factor.l_dirty().diagonal();
        let least = R::default_epsilon();
        (pivots.iter().all(|pivot| *pivot * *pivot > least)).then_some(Self { scale, factor })
    }

    /// Solution of matrix · x = `right`, and its norm in the scaled unknowns.
    pub fn solve(&self, right: &SVector<R, N>) -> (SVector<R, N>, R) {
        let scaled = self.factor.solve(&right.component_mul(&self.scale));
        (scaled.component_mul(&self.scale), scaled.norm())
    }

    /// Inverse of the matrix.
    pub fn inverse(&self) -> SMatrix<R, N, N> {
        rescaled(&self.factor.inverse(), &self.scale)
    }

    /// ln of the determinant of the matrix.
    pub fn ln_det(&self) -> f64 {
        let scale: f64 = self.scale.iter().map(|s| libm::log(double(*s))).sum();
        double(self.factor.ln_determinant()) - 2.0 * scale
    }
}

/// D M D with D = diag(`scale`), from the lower triangle of M.
pub(crate) fn rescaled<R: Real, const N: usize>(
    matrix: &SMatrix<R, N, N>,
    scale: &SVector<R, N>,
) -> SMatrix<R, N, N> {
    SMatrix::from_fn(|r, c| matrix[(r.max(c), r.min(c))] * scale[r] * scale[c])
}

/// The smallest and the largest eigenvalue of a positive definite matrix, of which the lower triangle
/// is read: Householder tridiagonalisation [GL], then Laguerre's method from outside the spectrum,
/// which converges monotonically.
///
/// A nine-parameter fit of 38 poses takes 12.1 µs with it and 17.8 µs with all eigenvalues
/// (examples/speed.rs).
pub(crate) fn eigenvalue_range<R: Real, const N: usize>(mut m: SMatrix<R, N, N>) -> (R, R) {
    let two: R = real(2.0);
    let mut off_diagonal = [R::zero(); N];
    for k in 0..N.saturating_sub(1) {
        let first = m[(k + 1, k)];
        let rest = (k + 2..N).fold(R::zero(), |sum, i| sum + m[(i, k)] * m[(i, k)]);
        if rest.is_zero() {
            off_diagonal[k] = first;
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
        off_diagonal[k] = alpha;
    }
    let values: [R; N] = core::array::from_fn(|i| m[(i, i)]);
    let squares = off_diagonal.map(|b| b * b);
    let before = |i: usize| {
        if i > 0 {
            off_diagonal[i - 1].abs()
        } else {
            R::zero()
        }
    };
    let bound = (0..N).fold(R::zero(), |most, i| {
        most.max(values[i] + before(i) + off_diagonal[i].abs())
    });
    if bound <= R::zero() {
        return (R::zero(), R::zero());
    }
    // Scaled to at most 1, so that products of N of them do not overflow.
    let values = values.map(|v| v / bound);
    let squares = squares.map(|s| s / (bound * bound));
    let end = |start: R| bound * towards_spectrum(&values, &squares, start).max(R::zero());
    (end(R::zero()), end(R::one()))
}

/// The eigenvalue nearest to `from`, which is outside the spectrum, of a tridiagonal matrix given by
/// its diagonal and the squares of its off-diagonal elements.
fn towards_spectrum<R: Real, const N: usize>(diagonal: &[R; N], squares: &[R; N], from: R) -> R {
    const ROUNDS: usize = 40;
    let two: R = real(2.0);
    let n: R = real(N as f64);
    let enough: R = real(1e-6);
    let mut at = from;
    for _ in 0..ROUNDS {
        // Characteristic polynomial and its first two derivatives, by leading minors.
        let (mut p, mut p1, mut p2) = (R::one(), R::zero(), R::zero());
        let (mut q, mut q1, mut q2) = (R::zero(), R::zero(), R::zero());
        let mut square = R::zero();
        for i in 0..N {
            let x = diagonal[i] - at;
            let next = x * p - square * q;
            let next1 = x * p1 - square * q1 - p;
            let next2 = x * p2 - square * q2 - two * p1;
            (q, q1, q2) = (p, p1, p2);
            (p, p1, p2) = (next, next1, next2);
            square = squares[i];
        }
        let (g, h) = (p1 / p, p2 / p);
        let root = ((n - R::one()) * (n * (g * g - h) - g * g))
            .max(R::zero())
            .sqrt();
        let step = n / if g < R::zero() { g - root } else { g + root };
        if !step.is_finite() {
            break;
        }
        at -= step;
        if step.abs() <= enough * at.abs() {
            break;
        }
    }
    at
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn eigenvalues_and_inverse_agree_with_the_matrix() {
        let mut state = 1_u32;
        for round in 0..200 {
            let j = SMatrix::<f64, 9, 9>::from_fn(|_, c| {
                state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                // Down to a condition of 10⁻⁴ in some rounds.
                let size = if c == round % 9 { 1e-4 } else { 1.0 };
                (f64::from(state >> 8) / f64::from(1 << 23) - 1.0) * size
            });
            let m = j.tr_mul(&j) + SMatrix::identity() * 1e-10;
            let values = m.symmetric_eigenvalues();
            let (low, high) = (values.min(), values.max());
            let (smallest, largest) = eigenvalue_range(m);
            assert!((largest / high - 1.0).abs() < 1e-6, "{largest} {high}");
            assert!((smallest / low - 1.0).abs() < 1e-3, "{smallest} {low}");
            let factor = Scaled::new(&m, 0.0).expect("positive definite");
            let one = factor.inverse() * m;
            assert!(
                (one - SMatrix::identity()).norm() < 1e-15 * high / low,
                "{one}"
            );
            let right = SVector::from_fn(|i, _| m[(i, 3)]);
            let unit = SVector::from_fn(|i, _| if i == 3 { 1.0 } else { 0.0 });
            assert!((factor.solve(&right).0 - unit).norm() < 1e-15 * high / low);
            let ln_det = libm::log(m.determinant());
            assert!((factor.ln_det() - ln_det).abs() < 1e-3);
        }
        // Diagonal already, and of equal values.
        let (smallest, largest) =
            eigenvalue_range(SMatrix::<f64, 3, 3>::from_diagonal_element(2.0));
        assert!((smallest - 2.0).abs() < 1e-9 && (largest - 2.0).abs() < 1e-9);
        assert!(Scaled::new(&SMatrix::<f64, 2, 2>::from_element(1.0), 0.0).is_none());
    }
}
