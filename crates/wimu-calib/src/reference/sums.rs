//! Sums over blocks of two streams, and what follows from them.

use nalgebra::{Matrix3, Vector3};

/// Distances in samples at which neighbours are compared.
pub(super) const LAGS: [usize; 5] = [1, 2, 4, 8, 16];

/// The last samples of an axis, for the lags.
#[derive(Clone, Copy, Debug)]
pub(super) struct Recent {
    pairs: [[f64; 2]; LAGS[LAGS.len() - 1]],
    /// Unbroken samples so far.
    run: usize,
}

impl Recent {
    pub const NONE: Self = Self {
        pairs: [[0.0; 2]; LAGS[LAGS.len() - 1]],
        run: 0,
    };

    /// The pair `lag` samples ago, if none is missing since.
    fn before(&self, lag: usize) -> Option<[f64; 2]> {
        let place = self.run.checked_sub(lag)? % self.pairs.len();
        self.pairs.get(place).copied()
    }

    fn take(&mut self, pair: [f64; 2]) {
        let place = self.run % self.pairs.len();
        if let Some(kept) = self.pairs.get_mut(place) {
            *kept = pair;
        }
        self.run += 1;
    }
}

/// Sums over samples of an axis.
#[derive(Clone, Copy, Debug)]
pub(super) struct Sums {
    pub n: f64,
    x: f64,
    y: f64,
    xx: f64,
    xy: f64,
    yy: f64,
    /// Of each sample with the one so many before.
    lagged: [Products; LAGS.len()],
}

/// Sums of products of two samples some way apart; that of x with y is the mean of both ways.
#[derive(Clone, Copy, Debug)]
struct Products {
    n: f64,
    xx: f64,
    xy: f64,
    yy: f64,
}

impl Products {
    const ZERO: Self = Self {
        n: 0.0,
        xx: 0.0,
        xy: 0.0,
        yy: 0.0,
    };

    fn take(&mut self, now: [f64; 2], before: [f64; 2]) {
        self.n += 1.0;
        self.xx += now[0] * before[0];
        self.xy += 0.5 * (now[0] * before[1] + now[1] * before[0]);
        self.yy += now[1] * before[1];
    }

    fn plus(&self, other: &Self, sign: f64) -> Self {
        Self {
            n: self.n + sign * other.n,
            xx: self.xx + sign * other.xx,
            xy: self.xy + sign * other.xy,
            yy: self.yy + sign * other.yy,
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

impl Sums {
    pub const ZERO: Self = Self {
        n: 0.0,
        x: 0.0,
        y: 0.0,
        xx: 0.0,
        xy: 0.0,
        yy: 0.0,
        lagged: [Products::ZERO; LAGS.len()],
    };

    /// Takes the next pair, `recent` being those before it.
    pub fn take(&mut self, pair: [f64; 2], recent: &mut Recent) {
        for (products, lag) in self.lagged.iter_mut().zip(LAGS) {
            if let Some(before) = recent.before(lag) {
                products.take(pair, before);
            }
        }
        recent.take(pair);
        let [x, y] = pair;
        self.n += 1.0;
        self.x += x;
        self.y += y;
        self.xx += x * x;
        self.xy += x * y;
        self.yy += y * y;
    }

    /// With `sign` times `other` added.
    pub fn plus(&self, other: &Self, sign: f64) -> Self {
        Self {
            n: self.n + sign * other.n,
            x: self.x + sign * other.x,
            y: self.y + sign * other.y,
            xx: self.xx + sign * other.xx,
            xy: self.xy + sign * other.xy,
            yy: self.yy + sign * other.yy,
            lagged: core::array::from_fn(|i| self.lagged[i].plus(&other.lagged[i], sign)),
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
pub(super) struct Across {
    xx: [[f64; 3]; 3],
    xy: [[f64; 3]; 3],
}

impl Across {
    pub const ZERO: Self = Self {
        xx: [[0.0; 3]; 3],
        xy: [[0.0; 3]; 3],
    };

    pub fn take(&mut self, pairs: [[f64; 2]; 3]) {
        for (i, [x, _]) in pairs.into_iter().enumerate() {
            for (j, [other, y]) in pairs.into_iter().enumerate() {
                self.xx[i][j] += x * other;
                self.xy[i][j] += x * y;
            }
        }
    }

    pub fn plus(&self, other: &Self, sign: f64) -> Self {
        let of = |a: &[[f64; 3]; 3], b: &[[f64; 3]; 3]| {
            core::array::from_fn(|i| core::array::from_fn(|j| a[i][j] + sign * b[i][j]))
        };
        Self {
            xx: of(&self.xx, &other.xx),
            xy: of(&self.xy, &other.xy),
        }
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
