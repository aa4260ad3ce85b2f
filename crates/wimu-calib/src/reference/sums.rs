//! Sums over blocks of two streams, and what follows from them.

use nalgebra::{Matrix3, Vector3};

use crate::Scalar;
use crate::scalar::sealed::Total;

/// Distances in samples at which neighbours are compared.
pub(super) const LAGS: [usize; 5] = [1, 2, 4, 8, 16];

/// The last samples of an axis, for the lags.
#[derive(Clone, Copy, Debug)]
pub(super) struct Recent<R> {
    pairs: [[R; 2]; LAGS[LAGS.len() - 1]],
    /// Unbroken samples so far.
    run: usize,
}

impl<R: Scalar> Recent<R> {
    pub fn none() -> Self {
        Self {
            pairs: [[R::default(); 2]; LAGS[LAGS.len() - 1]],
            run: 0,
        }
    }

    /// The pair `lag` samples ago, if none is missing since.
    fn before(&self, lag: usize) -> Option<[R; 2]> {
        let place = self.run.checked_sub(lag)? % self.pairs.len();
        self.pairs.get(place).copied()
    }

    fn take(&mut self, pair: [R; 2]) {
        let place = self.run % self.pairs.len();
        if let Some(kept) = self.pairs.get_mut(place) {
            *kept = pair;
        }
        self.run += 1;
    }
}

/// Sums over samples of an axis; in f64 once they are looked at.
#[derive(Clone, Copy, Debug)]
pub(super) struct Sums<R: Scalar = f64> {
    pub n: R::Total,
    x: R::Total,
    y: R::Total,
    xx: R::Total,
    xy: R::Total,
    yy: R::Total,
    /// Of each sample with the one so many before.
    lagged: [Products<R>; LAGS.len()],
}

/// Sums of products of two samples some way apart; that of x with y is the mean of both ways.
#[derive(Clone, Copy, Debug)]
struct Products<R: Scalar> {
    n: R::Total,
    xx: R::Total,
    xy: R::Total,
    yy: R::Total,
}

impl<R: Scalar> Products<R> {
    const NONE: Self = Self {
        n: R::Total::ZERO,
        xx: R::Total::ZERO,
        xy: R::Total::ZERO,
        yy: R::Total::ZERO,
    };

    /// Of each sum and that of `other`.
    fn zip<S: Scalar>(
        &self,
        other: &Self,
        with: impl Fn(R::Total, R::Total) -> S::Total,
    ) -> Products<S> {
        Products {
            n: with(self.n, other.n),
            xx: with(self.xx, other.xx),
            xy: with(self.xy, other.xy),
            yy: with(self.yy, other.yy),
        }
    }
}

/// Means and central second moments.
pub(super) struct Moments {
    pub x: f64,
    pub y: f64,
    pub xx: f64,
    pub xy: f64,
    pub yy: f64,
}

impl<R: Scalar> Sums<R> {
    pub const NONE: Self = Self {
        n: R::Total::ZERO,
        x: R::Total::ZERO,
        y: R::Total::ZERO,
        xx: R::Total::ZERO,
        xy: R::Total::ZERO,
        yy: R::Total::ZERO,
        lagged: [Products::NONE; LAGS.len()],
    };

    /// Takes the next pair, `recent` being those before it.
    pub fn take(&mut self, pair: [R; 2], recent: &mut Recent<R>) {
        let (one, half) = (R::of(1.0), R::of(0.5));
        let [x, y] = pair;
        for (products, lag) in self.lagged.iter_mut().zip(LAGS) {
            if let Some([u, v]) = recent.before(lag) {
                products.n.add(one);
                products.xx.add(x * u);
                products.xy.add(half * (x * v + y * u));
                products.yy.add(y * v);
            }
        }
        recent.take(pair);
        self.n.add(one);
        self.x.add(x);
        self.y.add(y);
        self.xx.add(x * x);
        self.xy.add(x * y);
        self.yy.add(y * y);
    }

    fn zip<S: Scalar>(
        &self,
        other: &Self,
        with: impl Fn(R::Total, R::Total) -> S::Total,
    ) -> Sums<S> {
        Sums {
            n: with(self.n, other.n),
            x: with(self.x, other.x),
            y: with(self.y, other.y),
            xx: with(self.xx, other.xx),
            xy: with(self.xy, other.xy),
            yy: with(self.yy, other.yy),
            lagged: core::array::from_fn(|i| self.lagged[i].zip(&other.lagged[i], &with)),
        }
    }

    /// With those of `other`.
    pub fn joined(&self, other: &Self) -> Self {
        self.zip(other, R::Total::joined)
    }

    /// To be looked at.
    pub fn seen(&self) -> Sums {
        self.zip(self, |sum, _| sum.value())
    }
}

impl Sums {
    /// With `sign` times `other` added.
    pub fn plus(&self, other: &Self, sign: f64) -> Self {
        self.zip(other, |a, b| a + sign * b)
    }

    /// Without samples at which `side`, 0 the reference, is `at`, and of the other side how many
    /// there are, their sum and that of their squares.
    pub fn without(&self, side: usize, at: f64, [n, other, squares]: [f64; 3]) -> Self {
        let own = [n * at, n * at * at];
        let (x, y) = if side == 0 {
            (own, [other, squares])
        } else {
            ([other, squares], own)
        };
        Self {
            n: self.n - n,
            x: self.x - x[0],
            y: self.y - y[0],
            xx: self.xx - x[1],
            xy: self.xy - at * other,
            yy: self.yy - y[1],
            ..*self
        }
    }

    /// The same of samples a lag of [`LAGS`] apart, where noise that is white has no part.
    pub fn lagged(&self, lag: usize) -> Option<Moments> {
        let (x, y) = (self.x / self.n, self.y / self.n);
        let products = self.lagged.get(lag).filter(|products| products.n >= 1.0)?;
        Some(Moments {
            x,
            y,
            xx: products.xx / products.n - x * x,
            xy: products.xy / products.n - x * y,
            yy: products.yy / products.n - y * y,
        })
    }

    pub fn moments(&self) -> Moments {
        let (x, y) = (self.x / self.n, self.y / self.n);
        Moments {
            x,
            y,
            xx: self.xx / self.n - x * x,
            xy: self.xy / self.n - x * y,
            yy: self.yy / self.n - y * y,
        }
    }
}

impl Moments {
    /// Deming's slope, equation (50); δ is the variance of the output's noise per that of the
    /// reference's.
    pub fn slope(&self, delta: f64) -> Option<f64> {
        let apart = self.yy - delta * self.xx;
        let root = libm::sqrt(apart * apart + 4.0 * delta * self.xy * self.xy);
        // Two forms of the same root; each keeps its digits on its side.
        let slope = if apart >= 0.0 {
            (apart + root) / (2.0 * self.xy)
        } else {
            2.0 * delta * self.xy / (root - apart)
        };
        (slope.is_finite() && slope != 0.0).then_some(slope)
    }
}

/// Spread of estimates made without one block each: equation (51).
pub(super) struct Jackknife<const N: usize> {
    count: f64,
    mean: [f64; N],
    squares: [[f64; N]; N],
}

impl<const N: usize> Default for Jackknife<N> {
    fn default() -> Self {
        Self {
            count: 0.0,
            mean: [0.0; N],
            squares: [[0.0; N]; N],
        }
    }
}

impl<const N: usize> Jackknife<N> {
    pub fn take(&mut self, estimate: [f64; N]) {
        self.count += 1.0;
        let before: [f64; N] = core::array::from_fn(|i| estimate[i] - self.mean[i]);
        for (mean, step) in self.mean.iter_mut().zip(before) {
            *mean += step / self.count;
        }
        for i in 0..N {
            for j in 0..N {
                self.squares[i][j] += before[i] * (estimate[j] - self.mean[j]);
            }
        }
    }

    pub fn covariance(&self) -> [[f64; N]; N] {
        let factor = (self.count - 1.0) / self.count;
        core::array::from_fn(|i| {
            core::array::from_fn(|j| factor * 0.5 * (self.squares[i][j] + self.squares[j][i]))
        })
    }
}

/// Sums of products across the axes: of the reference with itself, and with the output.
#[derive(Clone, Copy, Debug)]
pub(super) struct Across<R: Scalar = f64> {
    xx: [[R::Total; 3]; 3],
    xy: [[R::Total; 3]; 3],
}

impl<R: Scalar> Across<R> {
    pub const NONE: Self = Self {
        xx: [[R::Total::ZERO; 3]; 3],
        xy: [[R::Total::ZERO; 3]; 3],
    };

    pub fn take(&mut self, pairs: [[R; 2]; 3]) {
        for (i, [x, _]) in pairs.into_iter().enumerate() {
            for (j, [other, y]) in pairs.into_iter().enumerate() {
                self.xx[i][j].add(x * other);
                self.xy[i][j].add(x * y);
            }
        }
    }

    fn zip<S: Scalar>(
        &self,
        other: &Self,
        with: impl Fn(R::Total, R::Total) -> S::Total,
    ) -> Across<S> {
        let of = |a: &[[R::Total; 3]; 3], b: &[[R::Total; 3]; 3]| {
            core::array::from_fn(|i| core::array::from_fn(|j| with(a[i][j], b[i][j])))
        };
        Across {
            xx: of(&self.xx, &other.xx),
            xy: of(&self.xy, &other.xy),
        }
    }

    pub fn joined(&self, other: &Self) -> Self {
        self.zip(other, R::Total::joined)
    }

    /// To be looked at.
    pub fn seen(&self) -> Across {
        self.zip(self, |sum, _| sum.value())
    }
}

impl Across {
    pub fn plus(&self, other: &Self, sign: f64) -> Self {
        self.zip(other, |a, b| a + sign * b)
    }

    /// How much `other` moves along when `axis` of the reference moves by 1.
    pub fn along(&self, axis: usize, other: usize, sums: &[Sums; 3]) -> f64 {
        let n = sums[axis].n;
        let both = self.xx[axis][other] / n - sums[axis].x / n * (sums[other].x / n);
        both / sums[axis].moments().xx.max(f64::MIN_POSITIVE)
    }

    /// What output `axis` sees of each axis of the reference, by least squares over those that
    /// are `moving`; 0 for the others.
    pub fn seen_by(&self, axis: usize, sums: &[Sums; 3], moving: [bool; 3]) -> Option<[f64; 3]> {
        let n = sums[axis].n;
        let covariance = |sum: f64, a: f64, b: f64| sum / n - a / n * (b / n);
        let matrix = Matrix3::from_fn(|i, j| {
            if moving[i] && moving[j] {
                covariance(self.xx[i][j], sums[i].x, sums[j].x)
            } else {
                f64::from(u8::from(i == j))
            }
        });
        let right = Vector3::from_fn(|i, _| {
            if moving[i] {
                covariance(self.xy[i][axis], sums[i].x, sums[axis].y)
            } else {
                0.0
            }
        });
        let seen = matrix.try_inverse()? * right;
        Some([seen[0], seen[1], seen[2]])
    }
}
