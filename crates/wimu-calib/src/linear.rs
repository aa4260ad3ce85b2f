//! Extreme eigenvalues of a matrix.

use crate::symmetric::{MOST, Symmetric, add, dot};

/// The smallest and the largest eigenvalue of a positive definite matrix, of which the lower triangle
/// is read: Householder tridiagonalisation [GL], then Laguerre's method from outside the spectrum,
/// which converges monotonically.
///
/// A nine-parameter fit of 38 poses takes 12.1 µs with it and 17.8 µs with all eigenvalues
/// (examples/speed.rs).
pub(crate) fn eigenvalue_range(mut m: Symmetric) -> (f64, f64) {
    let n = m.n();
    let mut off_diagonal = [0.0; MOST];
    for k in 0..n.saturating_sub(1) {
        let mut v = [0.0; MOST];
        for i in k + 1..n {
            v[i] = m.at(i, k);
        }
        let first = v[k + 1];
        let rest = dot(&v[k + 2..n], &v[k + 2..n]);
        if rest == 0.0 {
            off_diagonal[k] = first;
            continue;
        }
        let norm = libm::sqrt(first * first + rest);
        let alpha = if first > 0.0 { -norm } else { norm };
        v[k + 1] -= alpha;
        let beta = 1.0 / (norm * (norm + first.abs()));
        let p = m.times_from(k + 1, &v);
        let half = dot(&v, &p) * beta / 2.0;
        let w: [f64; MOST] = core::array::from_fn(|i| (p[i] - half * v[i]) * beta);
        for r in k + 1..n {
            let row = m.row_mut(r);
            add(&mut row[k + 1..], -v[r], &w[k + 1..]);
            add(&mut row[k + 1..], -w[r], &v[k + 1..]);
        }
        off_diagonal[k] = alpha;
    }
    let before = |i: usize| i.checked_sub(1).map_or(0.0, |i| off_diagonal[i].abs());
    let bound = m
        .diagonal()
        .enumerate()
        .fold(0.0_f64, |most, (i, value)| most.max(value + before(i) + off_diagonal[i].abs()));
    if bound <= 0.0 {
        return (0.0, 0.0);
    }
    // Scaled to at most 1, so that products of them do not overflow.
    let mut elements = [(0.0, 0.0); MOST];
    for ((element, value), b) in elements.iter_mut().zip(m.diagonal()).zip(off_diagonal) {
        *element = (value / bound, b / bound * (b / bound));
    }
    let end = |start: f64| bound * towards_spectrum(&elements[..n], start).max(0.0);
    (end(0.0), end(1.0))
}

/// The eigenvalue nearest to `from`, which is outside the spectrum, of a tridiagonal matrix given by
/// its diagonal elements, each with the square of the element below it.
fn towards_spectrum(elements: &[(f64, f64)], from: f64) -> f64 {
    const ROUNDS: usize = 40;
    let n = elements.len() as f64;
    let mut at = from;
    for _ in 0..ROUNDS {
        // Characteristic polynomial and its first two derivatives, by leading minors.
        let (mut p, mut p1, mut p2) = (1.0, 0.0, 0.0);
        let (mut q, mut q1, mut q2) = (0.0, 0.0, 0.0);
        let mut square = 0.0;
        for &(value, below) in elements {
            let x = value - at;
            let next = x * p - square * q;
            let next1 = x * p1 - square * q1 - p;
            let next2 = x * p2 - square * q2 - 2.0 * p1;
            (q, q1, q2) = (p, p1, p2);
            (p, p1, p2) = (next, next1, next2);
            square = below;
        }
        let (g, h) = (p1 / p, p2 / p);
        let root = libm::sqrt(((n - 1.0) * (n * (g * g - h) - g * g)).max(0.0));
        let step = n / if g < 0.0 { g - root } else { g + root };
        if !step.is_finite() {
            break;
        }
        at -= step;
        if step.abs() <= 1e-6 * at.abs() {
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
