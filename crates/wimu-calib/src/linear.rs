//! The little linear algebra that a fit needs.

use nalgebra::{RealField, SMatrix, SVector, convert};

/// f32 or f64.
pub(crate) trait Real: RealField + Copy + Default {}

impl Real for f32 {}
impl Real for f64 {}

pub(crate) fn real<R: Real>(x: f64) -> R {
    convert(x)
}

pub(crate) fn double<R: Real>(x: R) -> f64 {
    nalgebra::try_convert(x).unwrap_or(f64::NAN)
}

/// A product, column by column, which compilers turn into vector instructions.
#[inline(always)]
pub(crate) fn times<R: Real, const N: usize>(
    m: &SMatrix<R, N, N>,
    v: &SVector<R, N>,
) -> SVector<R, N> {
    let mut product = [R::zero(); N];
    for c in 0..N {
        for r in 0..N {
            product[r] += m[(r, c)] * v[c];
        }
    }
    SVector::from(product)
}

/// The Cholesky factor L of a symmetric matrix, L Lᵀ.
pub(crate) struct Cholesky<R: Real, const N: usize> {
    /// Below the diagonal, by rows.
    lower: [[R; N]; N],
    /// 1 / the diagonal.
    reciprocal: [R; N],
}

impl<R: Real, const N: usize> Cholesky<R, N> {
    /// Of the lower triangle of `m`, if it is positive definite to rounding.
    pub fn new(m: &SMatrix<R, N, N>) -> Option<Self> {
        let least = R::default_epsilon();
        let mut lower = [[R::zero(); N]; N];
        let mut reciprocal = [R::zero(); N];
        for r in 0..N {
            for c in 0..r {
                let mut sum = m[(r, c)];
                for k in 0..c {
                    sum -= lower[r][k] * lower[c][k];
                }
                lower[r][c] = sum * reciprocal[c];
            }
            let square = lower[r]
                .iter()
                .take(r)
                .fold(m[(r, r)], |rest, x| rest - *x * *x);
            if square > least {
                reciprocal[r] = R::one() / square.sqrt();
            } else {
                return None;
            }
        }
        Some(Self { lower, reciprocal })
    }

    /// x with L Lᵀ x = `right`.
    pub fn solve(&self, right: &SVector<R, N>) -> SVector<R, N> {
        let mut x = *right;
        for r in 0..N {
            for c in 0..r {
                x[r] = x[r] - self.lower[r][c] * x[c];
            }
            x[r] *= self.reciprocal[r];
        }
        for r in (0..N).rev() {
            x[r] *= self.reciprocal[r];
            for c in 0..r {
                x[c] = x[c] - self.lower[r][c] * x[r];
            }
        }
        x
    }

    /// ln det(L Lᵀ).
    pub fn ln_det(&self) -> f64 {
        let ln = |reciprocal: &R| libm::log(double(*reciprocal));
        -2.0 * self.reciprocal.iter().map(ln).sum::<f64>()
    }

    /// (L Lᵀ)⁻¹.
    pub fn inverse(&self) -> SMatrix<R, N, N> {
        // Column c of L⁻¹, kept as row c.
        let mut columns = [[R::zero(); N]; N];
        for (c, column) in columns.iter_mut().enumerate() {
            column[c] = self.reciprocal[c];
            for r in c + 1..N {
                let mut sum = R::zero();
                for k in c..r {
                    sum -= self.lower[r][k] * column[k];
                }
                column[r] = sum * self.reciprocal[r];
            }
        }
        let mut inverse = SMatrix::zeros();
        for r in 0..N {
            for c in 0..=r {
                let mut sum = R::zero();
                for k in r..N {
                    sum += columns[r][k] * columns[c][k];
                }
                inverse[(r, c)] = sum;
                inverse[(c, r)] = sum;
            }
        }
        inverse
    }
}

/// The least and the largest eigenvalue of a positive definite matrix (its lower triangle):
/// Householder's tridiagonal form [GL], then Laguerre's rule from outside the spectrum, which
/// converges without passing the end.
pub(crate) fn eigenvalue_range<R: Real, const N: usize>(mut m: SMatrix<R, N, N>) -> (R, R) {
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
    let values: [R; N] = core::array::from_fn(|i| m[(i, i)]);
    let squares = beside.map(|b| b * b);
    let before = |i: usize| {
        if i > 0 {
            beside[i - 1].abs()
        } else {
            R::zero()
        }
    };
    let bound = (0..N).fold(R::zero(), |most, i| {
        most.max(values[i] + before(i) + beside[i].abs())
    });
    if bound <= R::zero() {
        return (R::zero(), R::zero());
    }
    // Of 1 at the most, so that products of N of them stay numbers.
    let values = values.map(|v| v / bound);
    let squares = squares.map(|s| s / (bound * bound));
    let end = |start: R| bound * towards_spectrum(&values, &squares, start).max(R::zero());
    (end(R::zero()), end(R::one()))
}

/// The end of the spectrum of a tridiagonal matrix (diagonal, squares of what is beside it) that is
/// nearest to `from`, which is outside.
fn towards_spectrum<R: Real, const N: usize>(diagonal: &[R; N], squares: &[R; N], from: R) -> R {
    const ROUNDS: usize = 40;
    let two: R = real(2.0);
    let n: R = real(N as f64);
    let enough: R = real(1e-6);
    let mut at = from;
    for _ in 0..ROUNDS {
        // The characteristic polynomial and its first two derivatives, by the leading minors.
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
            let (least, largest) = eigenvalue_range(m);
            let (low, high) = (values.min(), values.max());
            assert!((largest / high - 1.0).abs() < 1e-6, "{largest} {high}");
            assert!((least / low - 1.0).abs() < 1e-3, "{least} {low}");
            let factor = Cholesky::new(&m).expect("positive definite");
            let one = factor.inverse() * m;
            assert!(
                (one - SMatrix::identity()).norm() < 1e-15 * high / low,
                "{one}"
            );
            let right = SVector::from_fn(|i, _| m[(i, 3)]);
            let unit = SVector::from_fn(|i, _| if i == 3 { 1.0 } else { 0.0 });
            assert!((factor.solve(&right) - unit).norm() < 1e-15 * high / low);
        }
        // Diagonal already, and of equal values.
        let (least, largest) = eigenvalue_range(SMatrix::<f64, 3, 3>::from_diagonal_element(2.0));
        assert!((least - 2.0).abs() < 1e-9 && (largest - 2.0).abs() < 1e-9);
        assert!(Cholesky::new(&SMatrix::<f64, 2, 2>::from_element(1.0)).is_none());
    }
}
