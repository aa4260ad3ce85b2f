//! Vectors and rotations of three components.

use crate::Real;

pub(crate) type Vector<R> = [R; 3];
pub(crate) type Matrix<R> = [[R; 3]; 3];

/// Whether every component is finite.
pub(crate) fn all_finite<'a, R: Real + 'a>(
    vectors: impl IntoIterator<Item = &'a Vector<R>>,
) -> bool {
    vectors.into_iter().flatten().all(|v| v.is_finite())
}

pub(crate) fn zero<R: Real>() -> Vector<R> {
    [R::default(); 3]
}

pub(crate) fn add<R: Real>(a: Vector<R>, b: Vector<R>) -> Vector<R> {
    [a[0] + b[0], a[1] + b[1], a[2] + b[2]]
}

pub(crate) fn sub<R: Real>(a: Vector<R>, b: Vector<R>) -> Vector<R> {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

pub(crate) fn scale<R: Real>(a: Vector<R>, by: R) -> Vector<R> {
    [a[0] * by, a[1] * by, a[2] * by]
}

pub(crate) fn dot<R: Real>(a: Vector<R>, b: Vector<R>) -> R {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

pub(crate) fn norm<R: Real>(a: Vector<R>) -> R {
    dot(a, a).sqrt()
}

pub(crate) fn cross<R: Real>(a: Vector<R>, b: Vector<R>) -> Vector<R> {
    [
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    ]
}

pub(crate) fn times<R: Real>(m: &Matrix<R>, v: Vector<R>) -> Vector<R> {
    [dot(m[0], v), dot(m[1], v), dot(m[2], v)]
}

pub(crate) fn transpose<R: Real>(m: &Matrix<R>) -> Matrix<R> {
    core::array::from_fn(|i| core::array::from_fn(|j| m[j][i]))
}

pub(crate) fn product<R: Real>(a: &Matrix<R>, b: &Matrix<R>) -> Matrix<R> {
    let columns = transpose(b);
    core::array::from_fn(|i| core::array::from_fn(|j| dot(a[i], columns[j])))
}

pub(crate) fn diagonal<R: Real>(value: R) -> Matrix<R> {
    let o = R::default();
    [[value, o, o], [o, value, o], [o, o, value]]
}

pub(crate) fn scaled<R: Real>(m: &Matrix<R>, by: R) -> Matrix<R> {
    m.map(|row| scale(row, by))
}

/// [v]×.
pub(crate) fn skew<R: Real>(v: Vector<R>) -> Matrix<R> {
    let o = R::default();
    [[o, -v[2], v[1]], [v[2], o, -v[0]], [-v[1], v[0], o]]
}

/// The rotation by a rotation vector, rad.
pub(crate) fn turn<R: Real>(by: Vector<R>) -> Matrix<R> {
    let square = dot(by, by);
    let (sine, cosine) = if square < R::from_f64(1e-4) {
        // To the fourth order: 10⁻¹⁰ at 0.01 rad.
        (
            R::from_f64(1.0) - square * R::from_f64(1.0 / 6.0),
            R::from_f64(0.5) - square * R::from_f64(1.0 / 24.0),
        )
    } else {
        let angle = libm::sqrt(square.to_f64());
        (
            R::from_f64(libm::sin(angle) / angle),
            R::from_f64((1.0 - libm::cos(angle)) / (angle * angle)),
        )
    };
    // 1 + s [v]× + c (v vᵀ − v² 1).
    let k = skew(by);
    core::array::from_fn(|i| {
        core::array::from_fn(|j| {
            let one = if i == j {
                R::from_f64(1.0) - cosine * square
            } else {
                R::default()
            };
            one + sine * k[i][j] + cosine * by[i] * by[j]
        })
    })
}

/// Rows at right angles and of length 1 again, by one step of Newton's.
pub(crate) fn orthonormal<R: Real>(m: &Matrix<R>) -> Matrix<R> {
    let square = product(m, &transpose(m));
    let step = core::array::from_fn(|i| {
        core::array::from_fn(|j| {
            let one = if i == j {
                R::from_f64(1.5)
            } else {
                R::default()
            };
            one - square[i][j] * R::from_f64(0.5)
        })
    });
    product(&step, m)
}

/// Of a rotation matrix, W X Y Z.
pub(crate) fn quaternion<R: Real>(m: &Matrix<R>) -> [R; 4] {
    let m = m.map(|row| row.map(R::to_f64));
    let size = |v: f64| libm::sqrt(v.max(0.0)) / 2.0;
    let [x, y, z] = [m[0][0], m[1][1], m[2][2]];
    // The largest by its square root, the others by division.
    let all = [
        size(1.0 + x + y + z),
        size(1.0 + x - y - z),
        size(1.0 - x + y - z),
        size(1.0 - x - y + z),
    ];
    let largest = (1..4).fold(0, |best, k| if all[k] > all[best] { k } else { best });
    let by = 0.25 / all[largest].max(1e-12);
    let [a, b, c] = [m[2][1] - m[1][2], m[0][2] - m[2][0], m[1][0] - m[0][1]];
    let [d, e, f] = [m[0][1] + m[1][0], m[0][2] + m[2][0], m[1][2] + m[2][1]];
    let q = match largest {
        0 => [all[0], a * by, b * by, c * by],
        1 => [a * by, all[1], d * by, e * by],
        2 => [b * by, d * by, all[2], f * by],
        _ => [c * by, e * by, f * by, all[3]],
    };
    let sign = if q[0] < 0.0 { -1.0 } else { 1.0 };
    q.map(|v| R::from_f64(sign * v))
}
