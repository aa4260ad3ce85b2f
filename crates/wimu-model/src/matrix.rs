//! 3 × 3 matrix operations of the error model in f64, with + − × ÷ in a fixed order, so that every
//! target computes the same bits.

/// A 3 × 3 matrix, row by row.
pub type Matrix3 = [[f64; 3]; 3];

pub(crate) const IDENTITY: Matrix3 = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];

// Never inlined: an f64 multiplication is a call on most microcontrollers, and there are many.

#[inline(never)]
fn dot(a: &[f64; 3], b: &[f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

#[inline(never)]
fn cross(a: &[f64; 3], b: &[f64; 3]) -> [f64; 3] {
    let mut product = [0.0; 3];
    for axis in 0..3 {
        let (next, last) = ((axis + 1) % 3, (axis + 2) % 3);
        product[axis] = a[next] * b[last] - a[last] * b[next];
    }
    product
}

pub(crate) fn apply(m: &Matrix3, v: [f64; 3]) -> [f64; 3] {
    [dot(&m[0], &v), dot(&m[1], &v), dot(&m[2], &v)]
}

pub(crate) fn multiply(a: &Matrix3, b: &Matrix3) -> Matrix3 {
    let mut product = [[0.0; 3]; 3];
    for c in 0..3 {
        let column = [b[0][c], b[1][c], b[2][c]];
        for r in 0..3 {
            product[r][c] = dot(&a[r], &column);
        }
    }
    product
}

pub(crate) fn transposed(m: &Matrix3) -> Matrix3 {
    [0, 1, 2].map(|row| [0, 1, 2].map(|column| m[column][row]))
}

pub(crate) fn determinant(m: &Matrix3) -> f64 {
    dot(&m[0], &cross(&m[1], &m[2]))
}

/// The inverse by cofactors; infinite or not-a-number where the determinant is zero.
pub(crate) fn inverse(m: &Matrix3) -> Matrix3 {
    let det = determinant(m);
    let mut inv = [[0.0; 3]; 3];
    for r in 0..3 {
        let cofactors = cross(&m[(r + 1) % 3], &m[(r + 2) % 3]);
        for c in 0..3 {
            inv[c][r] = cofactors[c] / det;
        }
    }
    inv
}
