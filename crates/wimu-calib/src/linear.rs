//! Scalar type of the least-squares fits, and the extreme eigenvalues of a matrix.

use nalgebra::{RealField, convert};

use crate::symmetric::{MOST, Symmetric, add, dot};

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

/// The smallest and the largest eigenvalue of a positive definite matrix, of which the lower triangle
/// is read: Householder tridiagonalisation [GL], then Laguerre's method from outside the spectrum,
/// which converges monotonically.
///
/// A nine-parameter fit of 38 poses takes 12.1 µs with it and 17.8 µs with all eigenvalues
/// (examples/speed.rs).
pub(crate) fn eigenvalue_range<R: Real>(mut m: Symmetric<R>) -> (R, R) {
    let n = m.n();
    let two: R = real(2.0);
    let mut off_diagonal = [R::zero(); MOST];
    for k in 0..n.saturating_sub(1) {
        let mut v = [R::zero(); MOST];
        for i in k + 1..n {
            v[i] = m.at(i, k);
        }
        let first = v[k + 1];
        let rest = dot(&v[k + 2..n], &v[k + 2..n]);
        if rest.is_zero() {
            off_diagonal[k] = first;
            continue;
        }
        let norm = (first * first + rest).sqrt();
        let alpha = if first > R::zero() { -norm } else { norm };
        v[k + 1] -= alpha;
        let beta = R::one() / (norm * (norm + first.abs()));
        let p = m.times_from(k + 1, &v);
        let half = dot(&v, &p) * beta / two;
        let w: [R; MOST] = core::array::from_fn(|i| (p[i] - half * v[i]) * beta);
        for r in k + 1..n {
            let row = m.row_mut(r);
            add(&mut row[k + 1..], -v[r], &w[k + 1..]);
            add(&mut row[k + 1..], -w[r], &v[k + 1..]);
        }
        off_diagonal[k] = alpha;
    }
    let before = |i: usize| i.checked_sub(1).map_or(R::zero(), |i| off_diagonal[i].abs());
    let bound = m
        .diagonal()
        .enumerate()
        .fold(R::zero(), |most, (i, value)| most.max(value + before(i) + off_diagonal[i].abs()));
    if bound <= R::zero() {
        return (R::zero(), R::zero());
    }
    // Scaled to at most 1, so that products of them do not overflow.
    let mut elements = [(R::zero(), R::zero()); MOST];
    for ((element, value), b) in elements.iter_mut().zip(m.diagonal()).zip(off_diagonal) {
        *element = (value / bound, b / bound * (b / bound));
    }
    let end = |start: R| bound * towards_spectrum(&elements[..n], start).max(R::zero());
    (end(R::zero()), end(R::one()))
}

/// The eigenvalue nearest to `from`, which is outside the spectrum, of a tridiagonal matrix given by
/// its diagonal elements, each with the square of the element below it.
fn towards_spectrum<R: Real>(elements: &[(R, R)], from: R) -> R {
    const ROUNDS: usize = 40;
    let two: R = real(2.0);
    let n: R = real(elements.len() as f64);
    let enough: R = real(1e-6);
    let mut at = from;
    for _ in 0..ROUNDS {
        // Characteristic polynomial and its first two derivatives, by leading minors.
        let (mut p, mut p1, mut p2) = (R::one(), R::zero(), R::zero());
        let (mut q, mut q1, mut q2) = (R::zero(), R::zero(), R::zero());
        let mut square = R::zero();
        for &(value, below) in elements {
            let x = value - at;
            let next = x * p - square * q;
            let next1 = x * p1 - square * q1 - p;
            let next2 = x * p2 - square * q2 - two * p1;
            (q, q1, q2) = (p, p1, p2);
            (p, p1, p2) = (next, next1, next2);
            square = below;
        }
        let (g, h) = (p1 / p, p2 / p);
        let root = ((n - R::one()) * (n * (g * g - h) - g * g)).max(R::zero()).sqrt();
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
    use nalgebra::SMatrix;

    use super::*;
    use crate::symmetric::Scaled;

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
            let full = j.tr_mul(&j) + SMatrix::identity() * 1e-10;
            let m = Symmetric::from_fn(9, |r, c| full[(r, c)]);
            let values = full.symmetric_eigenvalues();
            let (low, high) = (values.min(), values.max());
            let (smallest, largest) = eigenvalue_range(m.clone());
            assert!((largest / high - 1.0).abs() < 1e-6, "{largest} {high}");
            assert!((smallest / low - 1.0).abs() < 1e-3, "{smallest} {low}");
            let factor = Scaled::new(&m, 0.0).expect("positive definite");
            let inverse = factor.inverse();
            let one = SMatrix::<f64, 9, 9>::from_fn(|r, c| inverse.at(r, c)) * full;
            assert!((one - SMatrix::identity()).norm() < 1e-15 * high / low, "{one}");
            let right = core::array::from_fn(|i| if i < 9 { m.at(i, 3) } else { 0.0 });
            let (solution, _) = factor.solve(&right);
            let off = |(i, x): (usize, &f64)| (x - if i == 3 { 1.0 } else { 0.0 }).abs();
            let largest = solution.iter().enumerate().map(off).fold(0.0, f64::max);
            assert!(largest < 1e-15 * high / low);
            let (once, columns) = (m.times(&right), right.map(|x| [x, -2.0 * x]));
            for (x, [a, b]) in once.iter().zip(m.times_columns(&columns)) {
                assert!((x - a).abs() <= 1e-14 * high * high);
                assert!((2.0 * x + b).abs() <= 1e-14 * high * high);
            }
            let ln_det = libm::log(full.determinant());
            assert!((factor.ln_det() - ln_det).abs() < 1e-3);
            // M⁻¹ M M⁻¹ = M⁻¹, and tr(M⁻¹ M) = 9.
            let again = inverse.around(&m);
            let apart = (0..9).map(|i| (again.at(i, 0) - inverse.at(i, 0)).abs());
            assert!(apart.fold(0.0, f64::max) < 1e-14 * high / low * inverse.at(0, 0));
            assert!((inverse.trace_with(&m) - 9.0).abs() < 1e-14 * high / low);
        }
        // Diagonal already, and of equal values.
        let two = Symmetric::from_fn(3, |r, c| if r == c { 2.0_f64 } else { 0.0 });
        let (smallest, largest) = eigenvalue_range(two);
        assert!((smallest - 2.0).abs() < 1e-9 && (largest - 2.0).abs() < 1e-9);
        assert!(Scaled::new(&Symmetric::from_fn(2, |_, _| 1.0), 0.0).is_none());
    }
}
