//! Sums over blocks of two streams, and what follows from them.

use core::array::from_fn;

use nalgebra::Matrix3;

/// Distances in samples at which neighbours are compared.
pub(super) const LAGS: [usize; 5] = [1, 2, 4, 8, 16];

/// Reference and output of three axes.
type Pairs = [[f64; 2]; 3];

/// The last samples, for the lags.
#[derive(Clone, Copy, Debug)]
pub(super) struct Recent {
    pairs: [Pairs; LAGS[LAGS.len() - 1]],
    /// Unbroken samples so far.
    run: usize,
}

impl Recent {
    pub fn none() -> Self {
        Self {
            pairs: [[[0.0; 2]; 3]; LAGS[LAGS.len() - 1]],
            run: 0,
        }
    }

    /// The pairs `lag` samples ago, if none is missing since.
    fn before(&self, lag: usize) -> Option<Pairs> {
        let place = self.run.checked_sub(lag)? % self.pairs.len();
        self.pairs.get(place).copied()
    }

    fn take(&mut self, pairs: Pairs) {
        let place = self.run % self.pairs.len();
        if let Some(kept) = self.pairs.get_mut(place) {
            *kept = pairs;
        }
        self.run += 1;
    }
}

/// Sums over samples x of the reference and y of the output; in f64 once they are looked at.
#[derive(Clone, Copy, Debug)]
pub(super) struct Sums {
    /// Of each sample with itself.
    own: Products,
    /// Of each sample with the one so many before.
    lagged: [Products; LAGS.len()],
}

/// Sums over two samples some way apart, and of their products, each the mean of both ways.
#[derive(Clone, Copy, Debug)]
struct Products {
    n: f64,
    x: [f64; 3],
    y: [f64; 3],
    /// Of the reference's axes: XX, YY, ZZ, XY, XZ, YZ.
    xx: [f64; 6],
    /// Of each axis of the reference, row, with each of the output.
    xy: [[f64; 3]; 3],
    /// Of each axis of the output.
    yy: [f64; 3],
}

/// Which axes [`Products::xx`] are of.
const AXES: [[usize; 2]; 6] = [[0, 0], [1, 1], [2, 2], [0, 1], [0, 2], [1, 2]];

impl Products {
    const NONE: Self = Self {
        n: 0.0,
        x: [0.0; 3],
        y: [0.0; 3],
        xx: [0.0; 6],
        xy: [[0.0; 3]; 3],
        yy: [0.0; 3],
    };

    fn take(&mut self, now: Pairs, then: Pairs) {
        let half = 0.5;
        self.n += 1.0;
        for (sum, [i, j]) in self.xx.iter_mut().zip(AXES) {
            *sum += half * (now[i][0] * then[j][0] + now[j][0] * then[i][0]);
        }
        for i in 0..3 {
            for j in 0..3 {
                self.xy[i][j] += half * (now[i][0] * then[j][1] + now[j][1] * then[i][0]);
            }
            self.yy[i] += now[i][1] * then[i][1];
            self.x[i] += half * (now[i][0] + then[i][0]);
            self.y[i] += half * (now[i][1] + then[i][1]);
        }
    }

    fn plus(&self, other: &Self, sign: f64) -> Self {
        Self {
            n: self.n + sign * other.n,
            x: from_fn(|i| self.x[i] + sign * other.x[i]),
            y: from_fn(|i| self.y[i] + sign * other.y[i]),
            xx: from_fn(|i| self.xx[i] + sign * other.xx[i]),
            xy: from_fn(|i| from_fn(|j| self.xy[i][j] + sign * other.xy[i][j])),
            yy: from_fn(|i| self.yy[i] + sign * other.yy[i]),
        }
    }

    fn spread(&self) -> Spread {
        let (x, y) = (self.x.map(|x| x / self.n), self.y.map(|y| y / self.n));
        let mut xx = Matrix3::zeros();
        for (sum, [i, j]) in self.xx.into_iter().zip(AXES) {
            let value = sum / self.n - x[i] * x[j];
            (xx[(i, j)], xx[(j, i)]) = (value, value);
        }
        Spread {
            n: self.n,
            xx,
            xy: from_fn(|i| from_fn(|j| self.xy[i][j] / self.n - x[i] * y[j])),
            yy: from_fn(|i| self.yy[i] / self.n - y[i] * y[i]),
            x,
            y,
        }
    }
}

impl Sums {
    pub const NONE: Self = Self {
        own: Products::NONE,
        lagged: [Products::NONE; LAGS.len()],
    };

    /// Takes the next pairs, `recent` being those before them.
    pub fn take(&mut self, pairs: Pairs, recent: &mut Recent) {
        for (products, lag) in self.lagged.iter_mut().zip(LAGS) {
            if let Some(before) = recent.before(lag) {
                products.take(pairs, before);
            }
        }
        recent.take(pairs);
        self.own.take(pairs, pairs);
    }

    /// With `sign` times `other` added.
    pub fn plus(&self, other: &Self, sign: f64) -> Self {
        Self {
            own: self.own.plus(&other.own, sign),
            lagged: from_fn(|i| self.lagged[i].plus(&other.lagged[i], sign)),
        }
    }

    pub fn spread(&self) -> Spread {
        self.own.spread()
    }

    /// The same of samples a lag of [`LAGS`] apart, where noise that is white has no part.
    pub fn lagged(&self, lag: usize) -> Option<Spread> {
        let products = self.lagged.get(lag).filter(|products| products.n >= 1.0)?;
        Some(products.spread())
    }

    /// Of one axis.
    pub fn axis(&self, axis: usize) -> AxisSums {
        AxisSums {
            n: self.own.n,
            x: self.own.x[axis],
            y: self.own.y[axis],
            xx: self.own.xx[axis],
            xy: self.own.xy[axis][axis],
            yy: self.own.yy[axis],
        }
    }
}

/// Means and central second moments of all axes.
pub(super) struct Spread {
    pub n: f64,
    pub x: [f64; 3],
    pub y: [f64; 3],
    pub xx: Matrix3<f64>,
    /// Of each axis of the reference, row, with each of the output.
    pub xy: [[f64; 3]; 3],
    pub yy: [f64; 3],
}

impl Spread {
    /// Those of one axis.
    pub fn axis(&self, axis: usize) -> Moments {
        Moments {
            x: self.x[axis],
            y: self.y[axis],
            xx: self.xx[(axis, axis)],
            xy: self.xy[axis][axis],
            yy: self.yy[axis],
        }
    }
}

/// Sums over samples of an axis.
#[derive(Clone, Copy)]
pub(super) struct AxisSums {
    pub n: f64,
    x: f64,
    y: f64,
    xx: f64,
    xy: f64,
    yy: f64,
}

impl AxisSums {
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
        }
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

/// Means and central second moments of an axis.
pub(super) struct Moments {
    pub x: f64,
    pub y: f64,
    pub xx: f64,
    pub xy: f64,
    pub yy: f64,
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

    /// What is left of y less `slope` times x, squared.
    pub fn left(&self, slope: f64) -> f64 {
        self.yy - 2.0 * slope * self.xy + slope * slope * self.xx
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
        let before: [f64; N] = from_fn(|i| estimate[i] - self.mean[i]);
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
        from_fn(|i| from_fn(|j| factor * 0.5 * (self.squares[i][j] + self.squares[j][i])))
    }
}
