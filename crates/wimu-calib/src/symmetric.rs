//! Symmetric matrices whose size is known at run time, and their Cholesky decomposition.

/// Largest size: nine parameters, and three of each of four terms.
pub(crate) const MOST: usize = 21;

/// A vector; elements from the size of the matrix on are 0.
pub(crate) type Vector = [f64; MOST];

/// A symmetric n × n matrix: the lower triangle, row by row.
#[derive(Clone, PartialEq)]
pub(crate) struct Symmetric {
    n: usize,
    lower: [f64; start(MOST)],
}

/// Index of the first element of a row.
const fn start(row: usize) -> usize {
    row * (row + 1) / 2
}

pub(crate) fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).fold(0.0, |sum, (a, b)| sum + *a * *b)
}

/// Adds `factor` times `b` to `a`, as far as both reach.
pub(crate) fn add(a: &mut [f64], factor: f64, b: &[f64]) {
    for (a, b) in a.iter_mut().zip(b) {
        *a += factor * *b;
    }
}

impl Symmetric {
    /// The zero matrix of size `n`, at most [`MOST`].
    pub fn zero(n: usize) -> Self {
        Self { n: n.min(MOST), lower: [0.0; start(MOST)] }
    }

    pub fn clear(&mut self) {
        self.lower[..start(self.n)].fill(0.0);
    }

    pub fn n(&self) -> usize {
        self.n
    }

    /// Of elements with row ≥ column.
    pub fn from_fn(n: usize, element: impl Fn(usize, usize) -> f64) -> Self {
        let mut matrix = Self::zero(n);
        for r in 0..matrix.n {
            for (c, place) in matrix.row_mut(r).iter_mut().enumerate() {
                *place = element(r, c);
            }
        }
        matrix
    }

    /// The elements of a row up to the diagonal.
    fn row(&self, r: usize) -> &[f64] {
        &self.lower[start(r)..=start(r) + r]
    }

    pub fn row_mut(&mut self, r: usize) -> &mut [f64] {
        &mut self.lower[start(r)..=start(r) + r]
    }

    pub fn at(&self, r: usize, c: usize) -> f64 {
        self.lower[start(r.max(c)) + r.min(c)]
    }

    pub fn diagonal(&self) -> impl Iterator<Item = f64> + '_ {
        (0..self.n).map(|i| self.at(i, i))
    }

    /// Replaces M by D M D with D = diag(`scale`).
    pub fn rescale(&mut self, scale: &Vector) {
        for r in 0..self.n {
            for (element, other) in self.row_mut(r).iter_mut().zip(scale) {
                *element *= *other * scale[r];
            }
        }
    }

    /// Adds `weight` · v vᵀ.
    pub fn add_outer(&mut self, v: &[f64], weight: f64) {
        let mut rest = self.lower.as_mut_slice();
        for (r, x) in v.iter().enumerate().take(self.n) {
            let (row, below) = rest.split_at_mut(r + 1);
            add(row, *x * weight, v);
            rest = below;
        }
    }

    /// Adds the sum of `weights` · v vᵀ over the vectors v, which are the columns of `elements`.
    pub fn add_outers<const K: usize>(&mut self, elements: &[[f64; K]; MOST], weights: &[f64; K]) {
        let mut sums = self.lower.iter_mut();
        for r in 0..self.n {
            let weighted: [f64; K] = core::array::from_fn(|k| elements[r][k] * weights[k]);
            for (sum, element) in sums.by_ref().take(r + 1).zip(elements) {
                *sum += dot(&weighted, element);
            }
        }
    }

    /// M v from row and column `first` on.
    pub fn times_from(&self, first: usize, v: &Vector) -> Vector {
        let mut product = [0.0; MOST];
        for r in first..self.n {
            let row = &self.row(r)[first..];
            let (before, rest) = product[first..].split_at_mut(r - first);
            rest[0] = dot(row, &v[first..]);
            add(before, v[r], row);
        }
        product
    }

    pub fn times(&self, v: &Vector) -> Vector {
        self.times_from(0, v)
    }

    /// M V for the matrix V of the columns of `elements`.
    pub fn times_columns<const K: usize>(&self, elements: &[[f64; K]; MOST]) -> [[f64; K]; MOST] {
        let mut products = [[0.0; K]; MOST];
        for r in 0..self.n {
            let (before, rest) = products.split_at_mut(r);
            let row = self.row(r);
            let mut sum = elements[r].map(|x| x * row[r]);
            for ((m, column), product) in row[..r].iter().zip(elements).zip(before) {
                for k in 0..K {
                    sum[k] += *m * column[k];
                    product[k] += *m * elements[r][k];
                }
            }
            rest[0] = sum;
        }
        products
    }

    /// vᵀ M v.
    pub fn form(&self, v: &Vector) -> f64 {
        (0..self.n).fold(0.0, |sum, r| {
            let (before, diagonal) = (dot(&self.row(r)[..r], v), self.at(r, r));
            sum + v[r] * (before + before + diagonal * v[r])
        })
    }

    /// The trace of M `other`.
    pub fn trace_with(&self, other: &Self) -> f64 {
        (0..self.n).fold(0.0, |sum, r| {
            let before = dot(&self.row(r)[..r], other.row(r));
            sum + before + before + self.at(r, r) * other.at(r, r)
        })
    }

    /// M⁻¹; `None` unless M is positive definite beyond rounding.
    pub fn inverse(&self) -> Option<Self> {
        Some(Scaled::new(self, 0.0)?.inverse())
    }

    /// M `inner` M.
    pub fn around(&self, inner: &Self) -> Self {
        let mut product = Self::zero(self.n);
        for c in 0..self.n {
            let column = core::array::from_fn(|r| if r < self.n { self.at(r, c) } else { 0.0 });
            let column = self.times(&inner.times(&column));
            for r in c..self.n {
                product.row_mut(r)[c] = column[r];
            }
        }
        product
    }
}

/// A positive definite matrix, scaled to unit diagonal, as L Lᵀ.
pub(crate) struct Scaled {
    /// 1 / square root of each diagonal element of the matrix.
    scale: Vector,
    /// L, with the reciprocals of its diagonal elements in their place.
    factor: Symmetric,
}

impl Scaled {
    /// Of `matrix`, with `damping` added to the unit diagonal. `None` unless it is positive definite
    /// beyond rounding.
    pub fn new(matrix: &Symmetric, damping: f64) -> Option<Self> {
        Self::with_pivots(matrix, damping, f64::EPSILON)
    }

    /// Of a matrix whose pivots, relative to the diagonal, all exceed `least`.
    pub fn with_pivots(matrix: &Symmetric, damping: f64, least: f64) -> Option<Self> {
        let n = matrix.n;
        let mut scaled = Self { scale: [0.0; MOST], factor: matrix.clone() };
        let Self { scale, factor } = &mut scaled;
        for (scale, element) in scale.iter_mut().zip(matrix.diagonal()) {
            *scale = 1.0 / libm::sqrt(element);
            if !scale.is_finite() {
                return None;
            }
        }
        factor.rescale(scale);
        let mut column = [0.0; MOST];
        for k in 0..n {
            let pivot = factor.at(k, k) + damping;
            // Not if it is NaN, either.
            if !(pivot > least && pivot.is_finite()) {
                return None;
            }
            let per_root = 1.0 / libm::sqrt(pivot);
            factor.row_mut(k)[k] = per_root;
            for r in k + 1..n {
                let row = &mut factor.row_mut(r)[k..];
                row[0] *= per_root;
                column[r] = row[0];
                let (below, row) = (-row[0], &mut row[1..]);
                add(row, below, &column[k + 1..]);
            }
        }
        Some(scaled)
    }

    /// Solution of matrix · x = `right`, and its norm in the scaled unknowns.
    pub fn solve(&self, right: &Vector) -> (Vector, f64) {
        let (n, factor) = (self.factor.n, &self.factor);
        let mut x: Vector = core::array::from_fn(|i| right[i] * self.scale[i]);
        for r in 0..n {
            let row = factor.row(r);
            x[r] = (x[r] - dot(&row[..r], &x)) * row[r];
        }
        for r in (0..n).rev() {
            let row = factor.row(r);
            x[r] *= row[r];
            let below = -x[r];
            add(&mut x[..r], below, row);
        }
        let norm = libm::sqrt(dot(&x, &x));
        for (x, scale) in x.iter_mut().zip(&self.scale) {
            *x *= *scale;
        }
        (x, norm)
    }

    /// Inverse of the matrix.
    pub fn inverse(&self) -> Symmetric {
        let n = self.factor.n;
        // L⁻¹ row by row, then M⁻¹ = L⁻ᵀ L⁻¹.
        let mut roots = Symmetric::zero(n);
        let mut inverse = Symmetric::zero(n);
        for r in 0..n {
            let row = self.factor.row(r);
            let mut root = [0.0; MOST];
            root[r] = -1.0;
            for (k, l) in row.iter().enumerate().take(r) {
                add(&mut root, *l, roots.row(k));
            }
            for (place, x) in roots.row_mut(r).iter_mut().zip(&root) {
                *place = -*x * row[r];
            }
            inverse.add_outer(roots.row(r), 1.0);
        }
        inverse.rescale(&self.scale);
        inverse
    }

    /// ln of the determinant of the matrix.
    pub fn ln_det(&self) -> f64 {
        let factors = self.factor.diagonal().zip(self.scale);
        let per_root = factors.map(|(l, scale)| libm::log(l) + libm::log(scale));
        -2.0 * per_root.sum::<f64>()
    }
}
