//! Small matrices in f32 or f64, as plain arrays.

use crate::Real;

/// Lower triangle L with L Lᵀ = m; `None` where m is not positive definite.
pub(super) fn cholesky<R: Real, const N: usize>(m: &[[R; N]; N]) -> Option<[[R; N]; N]> {
    let mut lower = [[R::default(); N]; N];
    for i in 0..N {
        for j in 0..=i {
            let mut sum = m[i][j];
            for k in 0..j {
                sum -= lower[i][k] * lower[j][k];
            }
            if i != j {
                lower[i][j] = sum / lower[j][j];
            } else if sum > R::default() && sum.is_finite() {
                lower[i][i] = sum.sqrt();
            } else {
                return None;
            }
        }
    }
    Some(lower)
}

/// (L Lᵀ)⁻¹ v.
pub(super) fn solve<R: Real, const N: usize>(lower: &[[R; N]; N], v: &[R; N]) -> [R; N] {
    let mut x = *v;
    for i in 0..N {
        for k in 0..i {
            x[i] -= lower[i][k] * x[k];
        }
        x[i] = x[i] / lower[i][i];
    }
    for i in (0..N).rev() {
        for k in i + 1..N {
            x[i] -= lower[k][i] * x[k];
        }
        x[i] = x[i] / lower[i][i];
    }
    x
}

/// (L Lᵀ)⁻¹.
pub(super) fn inverse<R: Real, const N: usize>(lower: &[[R; N]; N]) -> [[R; N]; N] {
    let mut out = [[R::default(); N]; N];
    for (i, row) in out.iter_mut().enumerate() {
        let mut unit = [R::default(); N];
        unit[i] = R::from_f64(1.0);
        *row = solve(lower, &unit);
    }
    out
}

/// ln det(L Lᵀ).
pub(super) fn log_determinant<R: Real, const N: usize>(lower: &[[R; N]; N]) -> f64 {
    (0..N).map(|i| 2.0 * libm::log(lower[i][i].to_f64())).sum()
}

/// a b.
pub(super) fn product<R: Real, const A: usize, const B: usize, const C: usize>(
    a: &[[R; B]; A],
    b: &[[R; C]; B],
) -> [[R; C]; A] {
    let mut out = [[R::default(); C]; A];
    for (row, from) in out.iter_mut().zip(a) {
        for (value, other) in from.iter().zip(b) {
            for (sum, b) in row.iter_mut().zip(other) {
                *sum += *value * *b;
            }
        }
    }
    out
}

/// aᵀ.
pub(super) fn transposed<R: Real, const A: usize, const B: usize>(a: &[[R; B]; A]) -> [[R; A]; B] {
    let mut out = [[R::default(); A]; B];
    for (i, row) in a.iter().enumerate() {
        for (j, value) in row.iter().enumerate() {
            out[j][i] = *value;
        }
    }
    out
}

/// m v.
pub(super) fn times<R: Real, const A: usize, const B: usize>(
    m: &[[R; B]; A],
    v: &[R; B],
) -> [R; A] {
    let mut out = [R::default(); A];
    for (sum, row) in out.iter_mut().zip(m) {
        for (a, b) in row.iter().zip(v) {
            *sum += *a * *b;
        }
    }
    out
}

/// [v]×, so that [v]× w = v × w.
pub(super) fn cross_matrix<R: Real>([x, y, z]: [R; 3]) -> [[R; 3]; 3] {
    let zero = R::default();
    [[zero, -z, y], [z, zero, -x], [-y, x, zero]]
}

/// The rotation by a rotation vector, rad.
pub(super) fn rotation<R: Real>(by: [R; 3]) -> [[R; 3]; 3] {
    let square = by[0] * by[0] + by[1] * by[1] + by[2] * by[2];
    let angle = square.sqrt().to_f64();
    let (sine, cosine) = if angle < 0.01 {
        (1.0 - angle * angle / 6.0, 0.5 - angle * angle / 24.0)
    } else {
        (
            libm::sin(angle) / angle,
            (1.0 - libm::cos(angle)) / (angle * angle),
        )
    };
    let once = cross_matrix(by);
    let twice = product(&once, &once);
    core::array::from_fn(|i| {
        core::array::from_fn(|j| {
            R::from_f64(if i == j { 1.0 } else { 0.0 })
                + once[i][j] * R::from_f64(sine)
                + twice[i][j] * R::from_f64(cosine)
        })
    })
}

/// The rotation vector of a rotation, rad, for angles below π.
pub(super) fn rotation_vector<R: Real>(m: &[[R; 3]; 3]) -> [R; 3] {
    let trace = (m[0][0] + m[1][1] + m[2][2]).to_f64();
    let angle = libm::acos(((trace - 1.0) / 2.0).clamp(-1.0, 1.0));
    let factor = if angle < 1e-3 {
        0.5
    } else {
        0.5 * angle / libm::sin(angle).max(1e-6)
    };
    let k = R::from_f64(factor);
    [
        (m[2][1] - m[1][2]) * k,
        (m[0][2] - m[2][0]) * k,
        (m[1][0] - m[0][1]) * k,
    ]
}
