//! Symmetric positive definite matrices of any size in slices, row by row; the lower triangle counts.

/// Replaces `matrix`, n × n, by its Cholesky factor; `None` unless it is positive definite and finite.
pub(super) fn factorise(matrix: &mut [f64], n: usize) -> Option<()> {
    for i in 0..n {
        for j in 0..=i {
            let (row_i, row_j) = (matrix.get(i * n..)?, matrix.get(j * n..)?);
            let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
            let sum = row_i.get(j)? - dot(row_i.get(..j)?, row_j.get(..j)?);
            let pivot = *row_j.get(j)?;
            let value = if i != j {
                sum / pivot
            } else if sum > 0.0 && sum.is_finite() {
                libm::sqrt(sum)
            } else {
                return None;
            };
            *matrix.get_mut(i * n + j)? = value;
        }
    }
    Some(())
}

/// Replaces `right` by the solution x of L Lᵀ x = `right`.
pub(super) fn solve(factor: &[f64], right: &mut [f64]) -> Option<()> {
    let n = right.len();
    for i in 0..n {
        let row = factor.get(i * n..i * n + i + 1)?;
        let (before, rest) = right.split_at_mut_checked(i)?;
        let known: f64 = row.iter().zip(before.iter()).map(|(l, x)| l * x).sum();
        let x = rest.first_mut()?;
        *x = (*x - known) / row.last()?;
    }
    for i in (0..n).rev() {
        let row = factor.get(i * n..i * n + i + 1)?;
        let (before, rest) = right.split_at_mut_checked(i)?;
        let x = rest.first_mut()?;
        *x /= row.last()?;
        for (value, l) in before.iter_mut().zip(row) {
            *value -= l * *x;
        }
    }
    Some(())
}

/// Puts (L Lᵀ)⁻¹ in `inverse`, n × n, all of it.
pub(super) fn invert(factor: &[f64], inverse: &mut [f64], n: usize) -> Option<()> {
    inverse.fill(0.0);
    for (i, row) in inverse.chunks_exact_mut(n.max(1)).enumerate() {
        *row.get_mut(i)? = 1.0;
        solve(factor, row)?;
    }
    Some(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_inverse_times_the_matrix_is_one() {
        let matrix = [4.0, 9.0, 9.0, 2.0, 5.0, 9.0, -1.0, 0.5, 3.0];
        let (mut factor, mut inverse) = (matrix, [0.0; 9]);
        factorise(&mut factor, 3)
            .and_then(|()| invert(&factor, &mut inverse, 3))
            .expect("definite");
        for (i, j) in (0..3).flat_map(|i| (0..3).map(move |j| (i, j))) {
            let lower = |r: usize, c: usize| matrix[3 * r.max(c) + r.min(c)];
            let sum: f64 = (0..3).map(|k| lower(i, k) * inverse[3 * k + j]).sum();
            assert!((sum - if i == j { 1.0 } else { 0.0 }).abs() < 1e-12);
        }
        assert!(factorise(&mut [1.0, 0.0, 2.0, 1.0], 2).is_none());
    }
}
